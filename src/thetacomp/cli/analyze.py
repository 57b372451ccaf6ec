"""`thetacomp analyze`: from a machine folder to model, validation, report and figures."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thetacomp.cli.common import DONE, NOT_FIT, JsonOption, Outcome, progress_lines, run
from thetacomp.extras import require

if TYPE_CHECKING:
    from thetacomp.analysis_result import AnalysisResult
    from thetacomp.validation.outcome import ValidationRow


def analyze(
    folder: Annotated[Path, typer.Argument(help="The machine folder.", show_default=False)],
    out: Annotated[Path, typer.Option("--out", help="Where the results go; made where it does not exist.")],
    train: Annotated[
        list[str] | None, typer.Option("--train", help="Campaign to train on; repeat for more. Default: all.")
    ] = None,
    test: Annotated[
        list[str] | None,
        typer.Option("--test", help="Campaign to test on only; repeat for more. Default: each is held out in turn."),
    ] = None,
    no_repair: Annotated[
        bool,
        typer.Option("--no-repair", help="Only report faulty temperatures and held labels; use all values as read."),
    ] = False,
    mix: Annotated[
        bool, typer.Option("--mix", help="Let campaigns of different modes or active tables share one model.")
    ] = False,
    compare: Annotated[
        bool, typer.Option("--compare", help="Judge other families of models as well; takes minutes.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Separate, choose key points, fit, validate; write model.json, tables, figures and report.html."""

    def work() -> Outcome:
        if compare:
            require("families")
        from thetacomp.analysis import analyze_folder
        from thetacomp.files import write_files
        from thetacomp.outputs import output_folder
        from thetacomp.reading import read_folder
        from thetacomp.report.analysis_files import OWN, analysis_files

        progress = progress_lines(as_json)
        with output_folder(out, [folder], OWN) as fresh:
            progress("reading")
            read = read_folder(folder)
            analysis = analyze_folder(read, train or (), test or (), progress, not no_repair, mix, compare)
            progress("drawing")
            files = analysis_files(analysis)
            write_files(fresh, files)
        return summary(analysis, out, tuple(out / name for name in files))

    run(work, as_json)


def summary(analysis: AnalysisResult, out: Path, paths: tuple[Path, ...]) -> Outcome:
    """What a person wants to read first: key points, before and after, fit for use or not, where to look."""
    failed = [check for check in analysis.acceptance if not check.passed]
    lines = [f"machine {analysis.model.machine}, {len(analysis.model.components)} error components"]
    for chosen in analysis.key_points:
        where = f"axis {chosen.axis}" if chosen.axis else "drift"
        lines.append(
            f"key points of {where}: {', '.join(chosen.key_points) or 'none, no sensor predicts held-out data'}"
        )
    lines += _screening_lines(analysis)
    for axis, law in analysis.model.prediction.items():
        where = f"axis {axis}" if axis else "drift"
        campaigns = law.border.distance.campaigns if law.border.distance else 0
        speed = " and spindle speed" if law.layout.speed_powers else ""
        lines.append(
            f"in use for {where}: heat history of {len(law.layout.sensors)} sensors{speed}"
            f" ({law.candidates} block models weighed over {campaigns} campaigns)"
        )
    lines += ["", *_before_and_after(analysis), ""]
    if failed:
        lines.append("NOT FIT FOR USE yet; failed acceptance checks:")
        lines += [f"  - {line}" for line in analysis.model.failed_checks]
    else:
        lines.append(
            f"all {len(analysis.acceptance)} acceptance checks passed on held-out data;"
            " still open is the sign test on the machine, which every export describes"
        )
    if analysis.model.failed_static_checks:
        lines.append("not fit for a control: the law on key points, which it would carry, failed:")
        lines += [f"  - {line}" for line in analysis.model.failed_static_checks]
    lines += ["", f"open {out / 'report.html'}; model in {out / 'model.json'}"]
    data = {
        "fit_for_use": not failed,
        "key_points": {chosen.axis or "drift": list(chosen.key_points) for chosen in analysis.key_points},
        "equations": {name: c.equation for name, c in analysis.model.components.items()},
        "validation": [asdict(row) for row in analysis.validation],
        "heat_history": sorted(key or "drift" for key in analysis.model.prediction),
        "failed_static_checks": list(analysis.model.failed_static_checks),
        "acceptance": [asdict(check) for check in analysis.acceptance],
        "permutations": [asdict(test) for test in analysis.permutations],
        "screening": [
            {"campaign": name, **asdict(found)}
            for name, found in (analysis.screening.findings if analysis.screening else ())
        ],
        "sensor_curves": [asdict(curve) for curve in analysis.sensor_curves],
        "comparison": [asdict(row) for row in analysis.comparison],
        "notes": list(analysis.notes),
        "files": [str(path) for path in paths],
    }
    return Outcome("\n".join(lines), data, NOT_FIT if failed else DONE)


def _screening_lines(analysis: AnalysisResult) -> list[str]:
    """What was found faulty, and what could not be looked for: nobody should read the figures without knowing."""
    found = analysis.screening
    if found is None:
        return []
    channels = dict.fromkeys(f"{channel.sensor} in {channel.campaign}" for channel in found.channels)
    held = sum(entry.count for entry in found.held if not entry.kept_because)
    parts = [f"faulty temperatures: {', '.join(channels)}"] if channels else []
    parts += [f"{held} displacements that are no measurement"] if held else []
    done = "repaired or left out" if found.repair else "used as read (--no-repair)"
    lines = [f"{'; '.join(parts)}; {done}, see the notes and screening.csv"] if parts else []
    for reason in dict.fromkeys(why for _, why in found.unscreened):
        names = ", ".join(name for name, why in found.unscreened if why == reason)
        lines.append(f"not screened for all faults of thermometers: campaign {names} ({reason})")
    return lines


SHOWN = ("default", "key_points", "clock", "one_sensor", "all_sensors", "training_mean")


def _before_and_after(analysis: AnalysisResult) -> list[str]:
    """Held-out figures of the column deviation, or of all components where no column was measured."""
    rows = [row for row in analysis.validation if row.split != "forward" and row.model in SHOWN]
    column = [row for row in rows if row.component.startswith("column")]
    pooled = [row for row in (column or rows) if row.campaign == "all"] or column or rows
    lines = [
        "held out, in µm    campaign         model            max before → after      RMS before → after"
        "    RMS in-sample    less max"
    ]
    shown: dict[tuple[str, str, float, float], ValidationRow] = {}
    for row in pooled:
        twin = shown.get((row.component, row.campaign, row.max_after_um, row.rms_after_um))
        if twin is not None:
            lines.append(f"{row.component:<18} {row.campaign:<16.16} {row.model:<14} the same as {twin.model}")
            continue
        shown[row.component, row.campaign, row.max_after_um, row.rms_after_um] = row
        lines.append(
            f"{row.component:<18} {row.campaign:<16.16} {row.model:<14}"
            f" {row.max_before_um:11.1f} → {row.max_after_um:<8.1f}"
            f" {row.rms_before_um:12.1f} → {row.rms_after_um:<8.1f}"
            f" {row.rms_in_sample_um:11.1f} {row.reduction_percent:11.1f} %"
        )
    return lines

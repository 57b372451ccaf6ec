"""`thetacomp verify`: compensation off against on, before and after, go or no-go on one page."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thetacomp.cli.common import DONE, NOT_FIT, JsonOption, Outcome, progress_lines, run

if TYPE_CHECKING:
    from thetacomp.verification import VerificationResult


def verify(
    folder: Annotated[Path, typer.Argument(help="The machine folder.", show_default=False)],
    off: Annotated[list[str], typer.Option("--off", help="Campaign measured with compensation off; repeat for more.")],
    on: Annotated[list[str], typer.Option("--on", help="Campaign measured with compensation on; repeat for more.")],
    out: Annotated[Path, typer.Option("--out", help="Where the results go; made where it does not exist.")],
    model: Annotated[
        Path | None, typer.Option("--model", help="The model.json that was compensated with. Default: a fit to --off.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Compare runs with compensation off and on; name the cause where the result is a no-go."""

    def work() -> Outcome:
        from thetacomp.files import write_files
        from thetacomp.model.load import load_model
        from thetacomp.outputs import output_folder
        from thetacomp.reading import read_folder
        from thetacomp.report.verification import OWN, verification_files
        from thetacomp.verification import verify_folder

        progress = progress_lines(as_json)
        with output_folder(out, [folder, *([model] if model is not None else [])], OWN) as fresh:
            progress("reading")
            loaded = load_model(model) if model is not None else None
            result = verify_folder(read_folder(folder), off, on, loaded, progress)
            progress("drawing")
            files = verification_files(result)
            write_files(fresh, files)
        return summary(result, tuple(out / name for name in files))

    run(work, as_json)


def summary(result: VerificationResult, paths: tuple[Path, ...]) -> Outcome:
    """The verdict, causes, failed checks, figures and notes, and the same for scripts."""
    from thetacomp.report.tables import component_name, number

    lines = [
        f"{result.verdict}: {result.machine.name}, off {', '.join(result.off.campaigns)}, on "
        f"{', '.join(result.on.campaigns)}"
    ]
    for cause in result.causes:
        lines += [f"  cause: {cause.text}", f"    Fix: {cause.fix}"]
    lines += [f"  FAILED {c.name}: {c.found} (required {c.required})" for c in result.checks if not c.passed]
    lines += ["", "largest error, µm: off -> off at the heat of the run with compensation on -> on"]
    for row in result.rows:
        one = row.of("max")
        lines.append(
            f"  {component_name(row.component):<22} {number(one.before_um):>7} -> {number(one.like_before_um):>7} ->"
            f" {number(one.after_um):>7}   {number(one.like_reduction_percent, 0)} %"
            f" (95 %: {number(one.low_percent, 0)} to {number(one.high_percent, 0)})"
        )
    lines += [f"note: {note}" for note in result.notes]
    lines += ["", f"open {paths[0]}"]
    data = {
        "go": result.go,
        "causes": [asdict(cause) for cause in result.causes],
        "checks": [asdict(check) for check in result.checks],
        "heat_ratio": result.heat_ratio,
        "off": asdict(result.off),
        "on": asdict(result.on),
        "before_after": [asdict(row) for row in result.rows],
        "shares": [asdict(share) for share in result.shares],
        "pooled_shares": [asdict(group) for group in result.pooled],
        "harm": [
            {"component": h.component, "largest_um": h.largest_um, "limit_um": h.limit_um, "at_s": h.largest_at_s,
             "at_mm": h.largest_at_mm}
            for h in result.harm
        ],
        "straightness": [asdict(one) for one in result.straightness],
        "squareness": [asdict(one) for one in result.squareness],
        "notes": list(result.notes),
        "files": [str(path) for path in paths],
    }  # fmt: skip
    return Outcome("\n".join(lines), data, DONE if result.go else NOT_FIT)

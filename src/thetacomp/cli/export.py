"""`thetacomp export`: controller files from a stored model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thetacomp.cli.common import BAD_USAGE, DONE, NOT_FIT, JsonOption, Outcome, run

if TYPE_CHECKING:
    from thetacomp.model.document import ModelDocument


def export(
    model: Annotated[Path, typer.Argument(help="The model.json that `thetacomp analyze` wrote.")],
    target: Annotated[str, typer.Option(help="The control: sinumerik.")],
    out: Annotated[Path, typer.Option(help="Folder for the files; it is made if needed.")],
    settings: Annotated[Path | None, typer.Option(help="export.toml: axis names, signs and limits.")] = None,
    replay: Annotated[
        Path | None, typer.Option(help="Machine folder whose campaigns are replayed through the control's limits.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Write the files that bring a model to a control, with a commissioning sheet."""
    run(lambda: _export(model, target, out, settings, replay), as_json)


def _export(model_path: Path, target: str, out: Path, settings: Path | None, replay: Path | None) -> Outcome:
    from thetacomp.controllers.targets import TARGETS
    from thetacomp.files import write_files
    from thetacomp.model.load import load_model
    from thetacomp.outputs import output_folder
    from thetacomp.report.export import OWN, export_files

    if target not in TARGETS:
        text = f"error: this version writes {', '.join(TARGETS)}, not '{target}'. Fix: --target {next(iter(TARGETS))}."
        return Outcome(text, {"error": text, "targets": list(TARGETS)}, BAD_USAGE)
    with output_folder(out, [path for path in (model_path, settings, replay) if path is not None], OWN) as fresh:
        model = load_model(model_path)
        made = export_files(model, target, settings)
        write_files(fresh, {file.name: file.text for file in made.files})
        replayed = _replay(model, target, out, fresh, settings, replay) if replay is not None else Outcome("")
    lines = [f"{target} files for {model.machine} in {out}:", *(f"  {file.name}" for file in made.files), *made.remarks]
    lines += [
        f"An older {name} is still in {out}: it does not belong to this model, delete it."
        for name in made.absent
        if (out / name).exists()
    ]
    lines += [replayed.text] if replay is not None else []
    reasons = []
    if model.sign == "unproven":
        reasons.append(
            "The sign of this model is unproven: its source does not state the sign convention or the axis directions."
            " The files are for preparation and sign tests, not for compensation."
        )
    failed = model.failed_export_checks
    if failed:
        count = len(failed)
        reasons.append(f"The model failed {count} acceptance check{'s' if count > 1 else ''}.")
    lines += [f"NOT FIT FOR USE: {reason}" for reason in reasons]
    lines += [f"  - {sentence}" for sentence in failed]
    if not reasons:
        lines.append("Next: follow commissioning_sheet.html; nothing is compensated before its sign test has passed.")
    data = {
        "out": str(out),
        "files": [file.name for file in made.files],
        "sign": model.sign,
        "failed_checks": list(failed),
        "remarks": list(made.remarks),
        "reason": " ".join(reasons),
        **replayed.data,
    }
    return Outcome("\n".join(lines), data, NOT_FIT if reasons else DONE)


def _replay(model: ModelDocument, target: str, out: Path, fresh: Path, settings: Path | None, folder: Path) -> Outcome:
    """Replay every campaign of a machine folder through the limits; a table and a picture of the worst one."""
    from dataclasses import asdict

    from thetacomp.controllers.targets import REPLAYS
    from thetacomp.files import write_files
    from thetacomp.reading import read_folder
    from thetacomp.report.replay import replay_files, replay_lines, series

    campaigns = read_folder(folder).campaigns
    replays = [REPLAYS[target](model, settings, campaign.name, *series(campaign)) for campaign in campaigns]
    files = replay_files(replays)
    write_files(fresh, files)
    data = {
        "replay": [
            {
                "campaign": one.campaign,
                "losses": [asdict(loss) for loss in one.losses],
                "motion": [{**asdict(check), "holds": check.holds} for check in one.motion],
            }
            for one in replays
        ],
        "replay_files": [str(out / name) for name in files],
    }
    return Outcome("\n".join(replay_lines(replays)), data)

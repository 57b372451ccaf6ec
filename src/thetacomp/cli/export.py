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
    from thetacomp.model.load import load_model

    if target not in TARGETS:
        text = f"error: this version writes {', '.join(TARGETS)}, not '{target}'. Fix: --target {next(iter(TARGETS))}."
        return Outcome(text, {"error": text, "targets": list(TARGETS)}, BAD_USAGE)
    model = load_model(model_path)
    made = TARGETS[target](model, settings)
    out.mkdir(parents=True, exist_ok=True)
    for file in made.files:
        # Newlines as they are: the same files come out on every system.
        (out / file.name).write_text(file.text, encoding="utf-8", newline="\n")
    lines = [f"{target} files for {model.machine} in {out}:", *(f"  {file.name}" for file in made.files), *made.remarks]
    lines += [
        f"An older {name} is still in {out}: it does not belong to this model, delete it."
        for name in made.absent
        if (out / name).exists()
    ]
    replayed = _replay(model, target, out, settings, replay) if replay is not None else Outcome("")
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


def _replay(model: ModelDocument, target: str, out: Path, settings: Path | None, folder: Path) -> Outcome:
    """Replay every campaign of a machine folder through the limits; a table and a picture of the worst one."""
    from dataclasses import asdict

    from thetacomp.controllers.targets import REPLAYS
    from thetacomp.reading import read_folder
    from thetacomp.report.replay import replay_lines, series, write_replay

    campaigns = read_folder(folder).campaigns
    replays = [REPLAYS[target](model, settings, campaign.name, *series(campaign)) for campaign in campaigns]
    paths = write_replay(replays, out)
    data = {
        "replay": [
            {
                "campaign": one.campaign,
                "losses": [asdict(loss) for loss in one.losses],
                "motion": [{**asdict(check), "holds": check.holds} for check in one.motion],
            }
            for one in replays
        ],
        "replay_files": [str(path) for path in paths],
    }
    return Outcome("\n".join(replay_lines(replays)), data)

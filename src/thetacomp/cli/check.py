"""`thetacomp check`: everything that is wrong or doubtful in a machine folder, all at once."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thetacomp.cli.common import BAD_INPUT, DONE, JsonOption, Outcome, run

if TYPE_CHECKING:
    from thetacomp.reading import CampaignSummary, FolderSummary


def check(
    folder: Annotated[Path, typer.Argument(help="The machine folder, with machine.toml in it.")],
    as_json: JsonOption = False,
) -> None:
    """Read a machine folder and list everything wrong or doubtful. Exit code 1 where there are errors."""
    run(lambda: _check(folder), as_json)


def _check(path: Path) -> Outcome:
    from dataclasses import asdict

    from thetacomp.reading import check_folder, summarize

    folder, problems = check_folder(path)
    summary = summarize(folder) if folder is not None else None
    errors = sum(problem.severity == "error" for problem in problems)
    lines = _summary_lines(summary) if summary is not None else []
    lines += [str(problem) for problem in problems]
    lines.append(_verdict(errors, len(problems) - errors))
    data = {
        "summary": asdict(summary) if summary is not None else None,
        "problems": [asdict(problem) for problem in problems],
        "errors": errors,
        "warnings": len(problems) - errors,
    }
    return Outcome("\n".join(lines), data, BAD_INPUT if errors else DONE)


def _summary_lines(summary: FolderSummary) -> list[str]:
    axes = f"{'axis' if len(summary.axes) == 1 else 'axes'} {', '.join(summary.axes) or 'none'}"
    head = (
        f"{summary.machine}: {axes}; {_count(summary.sensors, 'sensor')}; {_count(len(summary.campaigns), 'campaign')}"
    )
    lines = [head]
    for campaign in summary.campaigns:
        lines += [_campaign_line(campaign), *(f"    tracker: {note}" for note in campaign.tracker)]
    return lines


def _campaign_line(campaign: CampaignSummary) -> str:
    tables = []
    for name, points in campaign.points.items():
        text = f"{name} {_count(points, 'row')}"
        if name == "temperatures":
            text += f" of {_count(campaign.sensors, 'sensor')}"
        if name == "sweeps":
            text += f" in {', '.join(f'{count} × {axis}' for axis, count in campaign.sweeps.items())}"
            text += " sweep" if sum(campaign.sweeps.values()) == 1 else " sweeps"
            text += "" if campaign.direction_given else " (direction not given: inferred from the motion)"
        tables.append(text)
    before = f" after {campaign.lead_s / 3600:.2f} h of logging" if campaign.lead_s else ""
    return f"  {campaign.name}: {campaign.duration_s / 3600:.2f} h{before}; {'; '.join(tables)}"


def _verdict(errors: int, warnings: int) -> str:
    if not errors and not warnings:
        return "No problems found."
    end = (
        "The folder cannot be used until the errors are corrected."
        " Further checks wait for these errors: run the check again then."
        if errors
        else "The folder can be used."
    )
    return f"{_count(errors, 'error')}, {_count(warnings, 'warning')}. {end}"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"

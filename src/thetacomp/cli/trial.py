"""`thetacomp trial`: some days of training, then months of work on a virtual machine, judged by its truth."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from thetacomp.cli.common import DONE, NOT_FIT, JsonOption, Outcome, run
from thetacomp.extras import require


def trial(
    out: Annotated[
        Path, typer.Option(help="Folder for trial.html, monthly.csv, model.json and the training campaigns.")
    ],
    preset: Annotated[str, typer.Option(help="standard, hard, or the path of a TOML file of conditions.")] = "standard",
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same machine, year and probes.")] = 1,
    months: Annotated[int, typer.Option(min=1, max=24, help="Months of 30 days after the training.")] = 12,
    training: Annotated[
        str, typer.Option(help="Days of each training campaign, at most ten in all: 2,2,2,2,2 are five campaigns.")
    ] = "2,2,2,2,2",
    every_min: Annotated[
        int, typer.Option(min=30, max=720, help="Minutes from one round of sweeps to the next in training.")
    ] = 120,
    screening: Annotated[
        bool, typer.Option("--screening", help="Screen all temperatures; else they are used as they were read.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Train a model in at most ten days, run it for a year, frozen and with one probe a day, and judge every month."""
    run(lambda: _work(out, preset, seed, months, training, every_min, screening), as_json)


def _work(out: Path, preset: str, seed: int, months: int, training: str, every_min: int, screening: bool) -> Outcome:
    require("twin")
    from thetacomp.files import write_files
    from thetacomp.outputs import output_folder
    from thetatwin.campaigns import make_twin
    from thetatwin.conditions import load_conditions
    from thetatwin.description import load_description
    from thetatwin.trial.monthly_figures import acceptance, monthly
    from thetatwin.trial.page import trial_files
    from thetatwin.trial.run import run_trial
    from thetatwin.virtual_machine import build
    from thetatwin.writer import refuse_filled
    from thetatwin.year import Schedule

    schedule = Schedule(_days(training), months=months, between_rounds_min=every_min)
    refuse_filled(out)
    conditions = load_conditions(preset)
    with output_folder(out) as fresh:
        _say("building the machine")
        twin = make_twin(build(load_description(conditions.machine)), conditions, seed)
        result = run_trial(twin, schedule, fresh / "machine", progress=_say, screening=screening)
        rows = monthly(result)
        checks = acceptance(rows)
        files = trial_files(result, rows, checks)
        write_files(fresh, files)
    paths = tuple(out / name for name in files)
    passed = all(check.passed for check in checks)
    lines = [
        f"{months} months on a virtual machine, preset {conditions.name}, seed {seed};"
        f" trained on {schedule.training_days} days in {len(schedule.campaign_days)} campaigns"
    ]
    for check in checks:
        lines.append(
            f"  {'passed' if check.passed else 'FAILED'}: {check.meaning}: {check.statistic:.2f}"
            f" (required {check.operator} {check.threshold:g})"
        )
    lines.append(f"Month by month: {paths[0]}")
    data = {
        "preset": conditions.name,
        "seed": seed,
        "training_days": schedule.training_days,
        "passed": passed,
        "limits": [vars(check) for check in checks],
        "probes": dict(result.probes),
        "months": [vars(row) for row in rows],
        "files": [str(path) for path in paths],
    }
    return Outcome("\n".join(lines), data, DONE if passed else NOT_FIT)


def _days(training: str) -> tuple[int, ...]:
    """`2,2,2` as whole days. Raises AnalysisError for anything that is no schedule of at most ten days."""
    from thetacomp.errors import AnalysisError
    from thetatwin.year import MOST_TRAINING_DAYS

    days = tuple(int(part) for part in training.split(",") if part.strip().isdecimal())
    if len(days) != len(training.split(",")) or len(days) < 2 or 0 in days or sum(days) > MOST_TRAINING_DAYS:
        raise AnalysisError(
            f"--training {training}: expected the days of at least two campaigns, together at most"
            f" {MOST_TRAINING_DAYS}. Fix: for example 2,2,2,2,2."
        )
    return days


def _say(message: str) -> None:
    print(f"{message} …", file=sys.stderr)

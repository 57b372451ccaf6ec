"""All files of a plan, made and written. Nothing that exists is overwritten: it may hold what somebody has measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from thetacomp.errors import InputError
from thetacomp.files import write_files
from thetacomp.machine import Machine
from thetacomp.outputs import output_folder
from thetacomp.planning import tables
from thetacomp.planning.foundation import FoundationTarget, propose_targets
from thetacomp.planning.nc import nc_files
from thetacomp.planning.options import PlanOptions, problem
from thetacomp.planning.page import PlanAssessment, assess_plan, assumptions, render_plan_page
from thetacomp.planning.timetable import Timetable, make_timetable
from thetacomp.planning.uncertainty import VisibleChange, visible_changes

PAGE = "plan.html"
MACHINE_FOLDER = "machine_folder"


@dataclass(frozen=True)
class MeasuringPlan:
    """A campaign before it is measured. `notes` says what was taken for granted and what deserves a second thought."""

    timetable: Timetable
    targets: tuple[FoundationTarget, ...]
    visible_changes: tuple[VisibleChange, ...]
    assessment: PlanAssessment
    notes: tuple[str, ...]


def make_plan(machine: Machine, options: PlanOptions) -> MeasuringPlan:
    """Plan one campaign. Raises InputError with everything that keeps it from being measured."""
    timetable = make_timetable(machine, options)
    targets = propose_targets(timetable.setup)
    visible = visible_changes(timetable.setup, targets)
    notes = (*assumptions(timetable.setup), *timetable.notes)
    return MeasuringPlan(timetable, targets, visible, assess_plan(timetable.setup, visible), notes)


def refuse_filled(out: Path) -> None:
    """Raise InputError where `out` holds something already."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(
            [
                problem(
                    "it already exists and is not empty; tables in it may have been filled in.",
                    "name another folder, or remove it.",
                    "plan-folder",
                    str(out),
                )
            ]
        )


def plan_files(plan: MeasuringPlan, machine_toml: bytes) -> dict[str, str | bytes]:
    """All files by name, the page first. `machine_toml` is copied as it is."""
    programs = nc_files(plan.timetable)
    campaign = f"{MACHINE_FOLDER}/campaigns/{tables.campaign_name(plan.timetable)}"
    return {
        PAGE: render_plan_page(plan.timetable, plan.targets, plan.visible_changes, [file.path for file in programs]),
        "timetable.csv": tables.timetable_csv(plan.timetable),
        "points.csv": tables.points_csv(plan.timetable, plan.targets),
        "tracker_points.csv": tables.tracker_points_csv(plan.timetable),
        "uncertainty.csv": tables.uncertainty_csv(plan.visible_changes),
        "foundation_targets.csv": tables.foundation_csv(plan.targets),
        "sensor_commissioning.csv": tables.sensors_csv(plan.timetable.setup),
        **{file.path: file.text for file in programs},
        **{f"{campaign}/{name}": text for name, text in tables.campaign_files(plan.timetable).items()},
        f"{MACHINE_FOLDER}/machine.toml": machine_toml,
    }


def write_plan(plan: MeasuringPlan, machine_toml: bytes, out: Path, inputs: Sequence[Path] = ()) -> tuple[str, ...]:
    """Write all files as the folder `out`, whole; returns their names, the page first.

    Raises InputError where `out` holds something already, OutputError where it cannot be written.
    """
    refuse_filled(out)
    with output_folder(out, inputs) as fresh:
        files = plan_files(plan, machine_toml)
        write_files(fresh, files)
    return tuple(files)

"""`thetacomp plan`: everything that a measuring campaign needs, before it begins."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thetacomp.cli.common import DONE, NOT_FIT, JsonOption, Outcome, run

if TYPE_CHECKING:
    from thetacomp.planning.options import PlanOptions
    from thetacomp.planning.writer import MeasuringPlan


def plan(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Machine folder; only machine.toml is needed.")],
    out: Annotated[Path, typer.Option(help="Folder for the plan; it must be empty or absent.")],
    points: Annotated[int, typer.Option(help="Measured positions an axis.")] = 11,
    dwell_s: Annotated[float, typer.Option(help="Time for the tracker at each point, s.")] = 4.0,
    settle_s: Annotated[float, typer.Option(help="Time to come to rest before that, s.")] = 2.0,
    sweep_feed_mm_min: Annotated[float, typer.Option(help="Feed between measured points, mm/min.")] = 3000.0,
    feed_mm_min: Annotated[float, typer.Option(help="Feed of the axes in the warm-up, mm/min.")] = 1000.0,
    speed_rpm: Annotated[float, typer.Option(help="Spindle speed in the warm-up, rpm; 0 leaves it off.")] = 650.0,
    duration_h: Annotated[float, typer.Option(help="Length of the warm-up, h.")] = 7.5,
    cool_h: Annotated[float, typer.Option(help="Length of the cool-down, h; 0 for none.")] = 3.0,
    interval_min: Annotated[float, typer.Option(help="A measuring round about each so many minutes.")] = 60.0,
    mode: Annotated[str, typer.Option(help="Cooling and operating mode, as in production.")] = "",
    instrument: Annotated[str, typer.Option(help="Name of the tracker.")] = "laser tracker",
    tracker_u_um: Annotated[float, typer.Option(help="Expanded uncertainty (k = 2) of a point, µm …")] = 15.0,
    tracker_u_um_per_m: Annotated[float, typer.Option(help="… growing with the distance, µm/m.")] = 6.0,
    tracker_at: Annotated[str | None, typer.Option(metavar="X,Y,Z", help="Position of the tracker, mm.")] = None,
    tracker_distance_mm: Annotated[float, typer.Option(help="Its distance, where the place is unknown, mm.")] = 5000.0,
    vertical: Annotated[str, typer.Option(help="Machine direction that points up: X, Y or Z.")] = "Y",
    park: Annotated[list[str] | None, typer.Option(metavar="AXIS=MM", help="Rest position of an axis; repeat.")] = None,
    nc_axis: Annotated[
        list[str] | None, typer.Option(metavar="AXIS=LETTER", help="Letter of an axis in the NC programs; repeat.")
    ] = None,
    start: Annotated[
        datetime | None, typer.Option(formats=["%Y-%m-%dT%H:%M"], help="When the temperature log begins.")
    ] = None,
    must_see_um: Annotated[
        float | None, typer.Option(help="Change at the travel's end that must be detected, µm.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Plan a measuring campaign: NC programs, timetable, empty tables, and what it will be able to see."""

    def options() -> PlanOptions:
        from thetacomp.planning.options import PlanOptions, numbers, pairs

        rest = pairs("--park", park or (), "--park X=1500")
        place = None if tracker_at is None else numbers("--tracker-at", tracker_at, 3)
        return PlanOptions(
            points=points,
            dwell_s=dwell_s,
            settle_s=settle_s,
            sweep_feed_mm_min=sweep_feed_mm_min,
            feed_mm_min=feed_mm_min,
            speed_rpm=speed_rpm,
            duration_h=duration_h,
            cool_h=cool_h,
            interval_min=interval_min,
            mode=mode,
            instrument=instrument,
            tracker_u_um=tracker_u_um,
            tracker_u_um_per_m=tracker_u_um_per_m,
            tracker_at_mm=None if place is None else (place[0], place[1], place[2]),
            tracker_distance_mm=tracker_distance_mm,
            vertical=vertical.upper(),
            park_mm={name: numbers("--park", text, 1)[0] for name, text in rest.items()},
            nc_axis=pairs("--nc-axis", nc_axis or (), "--nc-axis X1=X"),
            start=start,
            must_see_um=must_see_um,
        )

    run(lambda: _work(folder, options(), out), as_json)


def _work(folder: Path, options: PlanOptions, out: Path) -> Outcome:
    from thetacomp.planning.writer import make_plan, write_plan
    from thetacomp.reading import read_machine

    toml = folder / "machine.toml"
    made = make_plan(read_machine(toml), options)
    files = write_plan(made, toml.read_bytes(), out, [folder])
    exit_code = NOT_FIT if made.assessment.good is False else DONE
    return Outcome(_text(made, files, out), _data(made, files, out), exit_code)


def _text(plan: MeasuringPlan, files: tuple[str, ...], out: Path) -> str:
    table, setup = plan.timetable, plan.timetable.setup
    lines = [
        f"{setup.machine.name}: {len(table.rounds)} rounds of {table.rounds[0].length_s / 60:.0f} min,"
        f" {sum(1 for point in table.points if point.axis)} sweep points,"
        f" {table.blocks[-1].end_s / 3600:.1f} h in all",
        "Standard errors (k = 1) of one heated round:",
        "  component   S µm/m   I µm   drift µm   visible at the travel's end (95 %) µm",
        *(
            f"  {row.component:<9} {row.slope_se_um_per_m:8.1f} {row.intercept_se_um:6.1f} {row.drift_se_um:10.1f}"
            f" {row.visible_um:8.0f}"
            for row in plan.visible_changes
        ),
        *(f"note: {note}" for note in plan.notes),
        plan.assessment.headline + ".",
        f"{len(files)} files in {out}. Open {out / files[0]} first; it says what to do before a program is started.",
    ]
    return "\n".join(lines)


def _data(plan: MeasuringPlan, files: tuple[str, ...], out: Path) -> dict[str, Any]:
    table = plan.timetable
    return {
        "out": str(out),
        "files": list(files),
        "rounds": [
            {"round": block.round, "part": block.part, "t_begin_s": block.begin_s, "t_end_s": block.end_s}
            for block in table.rounds
        ],
        "points": len(table.points),
        "length_s": table.blocks[-1].end_s,
        "reference_s": table.reference_s,
        "reach": [
            {**vars(row), "end_se_um": row.end_se_um, "visible_um": row.visible_um} for row in plan.visible_changes
        ],
        "foundation_targets_mm": {target.name: target.at_mm.tolist() for target in plan.targets},
        "good_enough": plan.assessment.good,
        "notes": list(plan.notes),
    }

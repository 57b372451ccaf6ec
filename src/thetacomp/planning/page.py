"""The plan as one printable page, in the same style as the report of an analysis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from thetacomp.planning import tables
from thetacomp.planning.figures import day_figure, floor_figure, visible_change_figure
from thetacomp.planning.foundation import FoundationTarget
from thetacomp.planning.setup import Setup, undetermined_frame
from thetacomp.planning.steps import FOUNDATION_S, TARGETS
from thetacomp.planning.timetable import (
    COLD_ROUNDS,
    LOG_LEAD_S,
    REST_CHANGE_K,
    REST_H,
    Timetable,
    moved_mm,
    sweep_span_s,
)
from thetacomp.planning.uncertainty import STEEL_UM_PER_M_K, VisibleChange
from thetacomp.report import style
from thetacomp.report.page_writer import page
from thetacomp.report.rendering import draw
from thetacomp.report.tables import counted


@dataclass(frozen=True)
class PlanAssessment:
    """Whether the plan sees enough, in words; `good` is None where no size was required."""

    good: bool | None
    headline: str
    text: str


def assess_plan(setup: Setup, visible_changes: Sequence[VisibleChange]) -> PlanAssessment:
    """The plan against the size that must be seen."""
    worst = max(visible_changes, key=lambda one: one.visible_um)
    best = min(visible_changes, key=lambda one: one.visible_um)
    wanted = setup.options.must_see_um
    seen = (
        f"At the end of its travel a thermal change of {worst.visible_um:.0f} µm differs from zero in every"
        f" component (worst {worst.component}, best {best.component} with {best.visible_um:.0f} µm), by one round,"
        " with 95 % confidence."
    )
    if wanted is None:
        return PlanAssessment(
            None,
            f"One round can detect {worst.visible_um:.0f} µm at the end of the travel",
            f"{seen} Compare this with the thermal errors that matter on this machine: a model can hardly be better"
            " than its training data. --must-see-um turns the comparison into a check.",
        )
    failing = [one.component for one in visible_changes if one.visible_um > wanted]
    if not failing:
        return PlanAssessment(True, f"Good enough: {wanted:g} µm can be detected in every component", seen)
    return PlanAssessment(
        False,
        f"Not good enough: {wanted:g} µm cannot be detected in {len(failing)} of {len(visible_changes)} components",
        f"Too small for this plan in {', '.join(failing)}. {seen} Bring the tracker nearer, measure more points, or use"
        " an instrument of lower uncertainty.",
    )


def assumptions(setup: Setup) -> tuple[str, ...]:
    """What the plan takes for granted because it was not stated, and what the machine itself rules out."""
    options, notes = setup.options, []
    if not options.mode:
        notes.append(
            "The cooling and operating mode is not named. Measure with the cooling that production uses, and name it"
            ' (--mode "chiller on, as in production"): campaigns of different modes are not mixed.'
        )
    if options.tracker_at_mm is None:
        notes.append(
            f"The place of the tracker is not stated: every point is taken to be"
            f" {options.tracker_distance_mm / 1000:g} m away (--tracker-at X,Y,Z in mm, or --tracker-distance-mm)."
        )
    if undetermined_frame(setup.axes):
        notes.append(
            f"All sweeps run along machine {setup.axes[0].axis.cartesian}: a single line leaves the roll of the"
            " tracker's frame about it open, so errors across the line cannot be given machine directions from the"
            " sweeps alone. Measure at least one further axis in the cold block, or find the directions by other means."
        )
    assumed_rest = [axis.name for axis in setup.axes if axis.name not in options.park_mm]
    if assumed_rest:
        notes.append(
            f"The rest positions of {', '.join(assumed_rest)} are the plan's own choice: the middle of the travel, and"
            " for axes along Z the end away from the workpiece (positive Z, ISO 841). Check them, or state others with"
            " --park NAME=MM."
        )
    return tuple(notes)


def render_plan_page(
    timetable: Timetable,
    targets: Sequence[FoundationTarget],
    visible_changes: Sequence[VisibleChange],
    programs: Sequence[str],
) -> str:
    """The page as HTML text. A note on stderr says where no installed font has the letters of a name."""
    setup = timetable.setup
    figures = [
        day_figure(timetable),
        visible_change_figure(visible_changes, setup.options.must_see_um),
        floor_figure(setup, targets),
    ]
    return page(
        "thetacomp.planning/plan.html.j2",
        timetable=timetable,
        setup=setup,
        options=setup.options,
        machine=setup.machine,
        targets=targets,
        visible_changes=visible_changes,
        programs=programs,
        figures=draw(figures).inline(),
        assessment=assess_plan(setup, visible_changes),
        notes=[*assumptions(setup), *timetable.notes],
        sweeps=[(axis, _span_min(timetable, axis.name)) for axis in setup.axes],
        feeds={axis.name: _mean_feed(timetable, axis.name) for axis in setup.axes},
        campaign=tables.campaign_name(timetable),
        clock=lambda t_s: tables.clock(timetable, t_s).replace("T", " "),
        hours=_hours,
        counted=counted,
        foundation_min=FOUNDATION_S * len(TARGETS) / 60.0,
        cold_rounds=COLD_ROUNDS,
        rest_h=REST_H,
        rest_change_K=REST_CHANGE_K,
        log_lead_min=LOG_LEAD_S / 60.0,
        steel_um_per_m_K=STEEL_UM_PER_M_K,
        hour_s=style.HOUR_S,
    )


def _span_min(timetable: Timetable, axis: str) -> float:
    begin_s, end_s = sweep_span_s(timetable.rounds[0], axis)
    return (end_s - begin_s) / 60.0


def _mean_feed(timetable: Timetable, axis: str) -> float:
    """Mean feed of an axis over the working time of the warm-up, in mm/min."""
    duty = [block for block in timetable.blocks if block.kind == "duty"]
    moved = sum(moved_mm(timetable.setup, block, axis) for block in duty)
    return 60.0 * moved / sum(block.length_s for block in duty)


def _hours(t_s: float) -> str:
    """Hours and minutes, like 7:05."""
    minutes = round(t_s / 60.0)
    return f"{minutes // 60}:{minutes % 60:02d}"

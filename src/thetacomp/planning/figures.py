"""The pictures of a plan: the day, what can be seen, and where tracker and foundation targets stand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.patches import Rectangle

from thetacomp.arrays import CARTESIAN
from thetacomp.planning.foundation import FoundationTarget, tool_reach_mm
from thetacomp.planning.setup import Setup
from thetacomp.planning.timetable import Timetable
from thetacomp.planning.uncertainty import TWO_SIDED_95, VisibleChange
from thetacomp.report import style

_LANES = (
    ("round", "measuring round", style.BLUE),
    ("duty", "spindle and axes at work", style.VERMILLION),
    ("rest", "machine at rest", style.FAINT),
    ("log", "temperature log alone", style.FAINT),
)
_REACH_COLOR = "#c9dcea"
_DAY_CAPTION = "Each round measures the foundation targets, every axis, and the targets again."


@style.styled
def day_figure(timetable: Timetable) -> style.NamedFigure:
    """The day as a strip: when the machine works, when it rests, when it is measured."""
    figure = style.new_figure(1.9)
    axes = figure.subplots()
    kinds = [lane for lane in _LANES if any(block.kind == lane[0] for block in timetable.blocks)]
    for row, (kind, _, color) in enumerate(kinds):
        spans = [
            (block.begin_s / style.HOUR_S, block.length_s / style.HOUR_S)
            for block in timetable.blocks
            if block.kind == kind
        ]
        axes.broken_barh(spans, (row - 0.34, 0.68), color=color)
    for block in timetable.rounds:
        middle = 0.5 * (block.begin_s + block.end_s) / style.HOUR_S
        axes.text(middle, -0.42, block.round, ha="center", va="bottom", fontsize=7)
    axes.set_yticks(range(len(kinds)), [name for _, name, _ in kinds])
    axes.set_ylim(len(kinds) - 0.5, -0.95)
    axes.set_xlim(0, timetable.blocks[-1].end_s / style.HOUR_S)
    axes.set_xlabel("time since the start of the temperature log (h)")
    axes.grid(False, axis="y")
    return style.NamedFigure(
        "day",
        "day",
        "The day",
        _DAY_CAPTION,
        figure,
    )


@style.styled
def visible_change_figure(visible_changes: Sequence[VisibleChange], must_see_um: float | None) -> style.NamedFigure:
    """The smallest visible change of every component, and what it is made of."""
    figure = style.new_figure(0.9 + 0.24 * len(visible_changes))
    axes = figure.subplots()
    rows = np.arange(len(visible_changes))
    axes.barh(rows, [one.visible_um for one in visible_changes], height=0.66, color=_REACH_COLOR, label="all together")
    for name, part, color, marker in (
        ("scatter of the points", "end_points_um", style.BLUE, "o"),
        ("angle of a sweep", "end_angle_um", style.AMBER, "^"),
        ("tie to the foundation", "end_tie_um", style.VERMILLION, "s"),
    ):
        values = [TWO_SIDED_95 * getattr(one, part) for one in visible_changes]
        axes.plot(values, rows, marker, color=color, markersize=4.5, label=f"{name} alone")
    if must_see_um is not None:
        axes.axvline(must_see_um, color=style.WORSE, linewidth=1.2, label=f"must be seen: {must_see_um:g} µm")
    axes.set_yticks(rows, [one.component for one in visible_changes])
    axes.set_ylim(len(visible_changes) - 0.4, -0.6)
    axes.set_xlim(left=0)
    axes.set_xlabel("smallest visible change at the end of the travel, one round, 95 % (µm)")
    axes.grid(False, axis="y")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=5)
    return style.NamedFigure(
        "reach",
        "reach",
        "What one round can detect",
        "The parts add up as squares. The longest part is the one to improve: scatter by more points, a longer dwell"
        " or a nearer tracker; angle and tie by a nearer tracker; tie also by targets further apart.",
        figure,
    )


@style.styled
def floor_figure(setup: Setup, targets: Sequence[FoundationTarget]) -> style.NamedFigure:
    """Foundation targets, the reach of the tool and the tracker, seen from above."""
    figure = style.new_figure(3.6, 5.6)
    axes = figure.subplots()
    across, along = (k for k in range(3) if CARTESIAN[k] != setup.options.vertical)
    low, high = (place / 1000.0 for place in tool_reach_mm(setup))
    size = (high[across] - low[across], high[along] - low[along])
    axes.add_patch(
        Rectangle(
            (low[across], low[along]), *size, facecolor=_REACH_COLOR, edgecolor=style.BLUE, label="reach of the tool"
        )
    )
    places = np.array([target.at_mm for target in targets]) / 1000.0
    axes.plot(places[:, across], places[:, along], "s", color=style.VERMILLION, label="foundation target")
    # With Y up and X to the right, Z comes towards the reader: drawn upwards it would be a view from below.
    upwards = -1 if setup.options.vertical == "Y" else 1
    outward = np.sign(places - places.mean(axis=0))
    for target, place, side in zip(targets, places, outward, strict=True):
        offset = (11 * side[across], 9 * upwards * side[along])
        axes.annotate(target.name, place[[across, along]], offset, textcoords="offset points", ha="center", va="center")
    if setup.options.tracker_at_mm is not None:
        station = np.array(setup.options.tracker_at_mm) / 1000.0
        axes.plot(station[across], station[along], "^", color=style.INK, markersize=8, label="tracker")
    axes.set_aspect("equal", adjustable="box")
    axes.margins(0.25)
    if upwards < 0:
        axes.invert_yaxis()
    axes.set_xlabel(f"{CARTESIAN[across]} (m)")
    axes.set_ylabel(f"{CARTESIAN[along]} (m)")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return style.NamedFigure(
        "floor",
        "floor",
        "Seen from above",
        "Machine frame; the origin is the tool with all axes at zero. Free places near these are also suitable:"
        " it matters that the targets are far apart, not on one line, and on floor that the machine does not warm.",
        figure,
    )

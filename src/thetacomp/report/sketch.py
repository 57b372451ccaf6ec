"""The sensors on a machine sketch: a floor-type machine where X, Y and Z move, else one block for each axis."""

from __future__ import annotations

import textwrap
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyBboxPatch, Polygon

from thetacomp.analysis_result import AnalysisResult
from thetacomp.machine import Axis, Machine, Sensor
from thetacomp.report import style

Place = tuple[float, float, float]
_FRONT, _TOP, _SIDE = "#eef1f4", "#f8f9fa", "#dde2e8"
_EDGE = "#8f9bab"
_DOT = "#52606d"
_ROW_IN = 0.185

# Boxes of the floor-type machine in drawing units: x right, y up, z towards the reader (low and high corner).
_BOXES: tuple[tuple[str, Place, Place], ...] = (
    ("foundation", (-0.8, -0.6, -0.8), (11.4, 0.0, 3.8)),
    ("bed", (0.0, 0.0, 0.0), (9.8, 1.1, 3.0)),
    ("slide", (2.9, 1.1, -0.1), (7.1, 1.8, 3.1)),
    ("column", (3.7, 1.8, 0.4), (6.3, 12.4, 2.6)),
    ("headstock", (3.4, 6.2, 2.6), (6.6, 9.2, 4.4)),
    ("ram", (4.2, 6.9, 4.4), (5.8, 8.5, 8.4)),
)
_COLUMN_MIDDLE_U = 4.0
# Where sensors of a Cartesian direction and role sit: a line from one place to another, shared by all of them.
_LINES: dict[tuple[str, str], tuple[Place, Place]] = {
    ("X", "drive"): ((7.2, 1.5, 3.0), (8.9, 1.5, 3.0)),
    ("X", "bearing"): ((8.8, 0.8, 3.0), (9.6, 0.8, 3.0)),
    ("X", "guide"): ((0.3, 1.1, 2.5), (2.7, 1.1, 2.5)),
    ("X", "structure"): ((0.4, 0.5, 3.0), (3.4, 0.5, 3.0)),
    ("Y", "drive"): ((4.4, 10.2, 2.6), (4.4, 11.4, 2.6)),
    ("Y", "bearing"): ((4.3, 11.9, 2.6), (5.5, 11.9, 2.6)),
    ("Y", "guide"): ((3.9, 9.6, 2.6), (3.9, 10.6, 2.6)),
    ("Y", "structure"): ((6.3, 2.6, 1.5), (6.3, 12.4, 1.5)),
    ("Z", "drive"): ((3.6, 9.2, 3.6), (5.2, 9.2, 3.6)),
    ("Z", "bearing"): ((5.3, 7.7, 8.4), (5.3, 7.3, 8.4)),
    ("Z", "guide"): ((4.6, 8.5, 5.0), (5.6, 8.5, 5.0)),
    ("Z", "structure"): ((4.6, 8.5, 8.2), (4.6, 8.5, 6.2)),
    ("", "reference"): ((3.1, 1.45, 3.1), (5.0, 1.45, 3.1)),
    ("", "fluid"): ((10.6, 1.0, 2.2), (10.6, 1.5, 2.2)),
    ("", "ambient"): ((8.6, 9.4, 0.0), (9.8, 9.4, 0.0)),
    ("", "foundation"): ((0.0, -0.3, 3.8), (9.8, -0.3, 3.8)),
    ("", "workpiece"): ((1.4, 1.6, 8.0), (2.8, 1.6, 8.0)),
    ("", "structure"): ((5.7, 2.6, 2.6), (5.7, 4.6, 2.6)),
    ("", "drive"): ((6.6, 6.6, 3.5), (6.6, 9.0, 3.5)),
    ("", "bearing"): ((4.5, 7.1, 8.4), (5.5, 7.1, 8.4)),
    ("", "guide"): ((7.4, 1.1, 2.5), (9.4, 1.1, 2.5)),
}


@dataclass(frozen=True)
class _Look:
    """Colours of the key points, and the sensors that were read at all."""

    colors: dict[str, str]
    read: frozenset[str]


@dataclass(frozen=True)
class _Mark:
    sensor: str
    u: float
    v: float


@style.styled
def machine_sketch(analysis: AnalysisResult) -> list[style.NamedFigure]:
    """The sensors on the machine, key points coloured, with a table of where each sensor is mounted."""
    machine = analysis.folder.machine
    read = frozenset(i for campaign in analysis.folder.campaigns for i in campaign.temperatures.sensor_ids)
    look = _Look(key_colors(analysis), read)
    rows = _table_rows(machine)
    height = max(4.9, 0.5 + _ROW_IN * sum(len(lines) for _, lines, _ in rows) + 0.06 * len(rows))
    figure = style.new_figure(height)
    picture, table = figure.subplots(1, 2, width_ratios=(1.55, 1.0))
    for axes in (picture, table):
        axes.set_axis_off()
    if all(sensor.at_mm is not None for sensor in machine.sensors):
        note = "Sensors where at_mm puts them, to scale; dotted lines run down to the lowest sensor's height."
        _draw_to_scale(picture, machine, look)
    elif {axis.cartesian for axis in machine.axes} == {"X", "Y", "Z"}:
        note = "Floor-type layout, not to scale. Each sensor sits on the part of its axis, by its role."
        _draw_floor_type(picture, machine, look)
    else:
        note = "One block for each axis or role, not to scale."
        _draw_blocks(picture, machine, look)
    _draw_table(table, rows, look, height)
    caption = f"{note} A coloured mark with a ring is a key point."
    if not read.issuperset(machine.sensor_ids):
        caption += " Hollow marks: sensors without a reading in these campaigns."
    return [style.NamedFigure("machine_sketch", "placement", "Sensors on the machine", caption, figure)]


def key_colors(analysis: AnalysisResult) -> dict[str, str]:
    """Each key point with its colour, the same in every picture."""
    keys = dict.fromkeys(sensor for points in analysis.key_points for sensor in points.key_points)
    return {sensor: style.KEY_COLORS[k % len(style.KEY_COLORS)] for k, sensor in enumerate(keys)}


def _project(place: Place) -> tuple[float, float]:
    x, y, z = place
    return x - 0.52 * z, y - 0.40 * z


def _box(axes: Axes, low: Place, high: Place) -> None:
    """Front, top and right side of a box."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    faces = (
        (_TOP, [(x0, y1, z1), (x1, y1, z1), (x1, y1, z0), (x0, y1, z0)]),
        (_SIDE, [(x1, y0, z1), (x1, y1, z1), (x1, y1, z0), (x1, y0, z0)]),
        (_FRONT, [(x0, y0, z1), (x1, y0, z1), (x1, y1, z1), (x0, y1, z1)]),
    )
    for color, corners in faces:
        axes.add_patch(Polygon([_project(c) for c in corners], facecolor=color, edgecolor=_EDGE, linewidth=0.8))


def _draw_floor_type(axes: Axes, machine: Machine, look: _Look) -> None:
    roles = {sensor.role for sensor in machine.sensors}
    for name, low, high in _BOXES:
        _box(axes, low, high)
        if name == "bed":
            for z in (0.7, 2.3):
                _line(axes, (0.0, 1.1, z), (9.8, 1.1, z))
            if "fluid" in roles:
                _box(axes, (10.1, 0.0, 0.6), (11.1, 1.9, 2.2))
        if name == "slide":
            _box(axes, (7.1, 1.15, 2.0), (9.2, 1.8, 3.0))
        if name == "column":
            for x in (4.05, 5.95):
                _line(axes, (x, 1.8, 2.6), (x, 12.4, 2.6))
    nose = _project((5.0, 7.7, 8.4))
    for radius, color in ((0.56, _SIDE), (0.24, "white")):
        axes.add_patch(Circle(nose, radius, facecolor=color, edgecolor=_EDGE, linewidth=0.8))
    if "workpiece" in roles:
        _box(axes, (0.0, 0.0, 6.2), (3.6, 1.9, 8.0))
    axes.set_xlim(-3.2, 13.0)
    axes.set_ylim(-3.6 if "workpiece" in roles else -3.1, 13.0)
    axes.set_aspect("equal")
    _axis_arrows(axes, machine)
    _label_marks(axes, _floor_type_marks(machine), look, _COLUMN_MIDDLE_U)


def _line(axes: Axes, start: Place, end: Place) -> None:
    (u0, v0), (u1, v1) = _project(start), _project(end)
    axes.plot([u0, u1], [v0, v1], color=_EDGE, lw=0.7, zorder=1)  # as the boxes: later ones cover it


def _limits(marks: Sequence[_Mark]) -> tuple[tuple[float, float], tuple[float, float]]:
    u, v = [m.u for m in marks], [m.v for m in marks]
    return (min(u), min(v)), (max(u), max(v))


def _axis_arrows(axes: Axes, machine: Machine) -> None:
    """A double arrow for each Cartesian direction with the axes that move along it and their travel."""
    arrows = {
        "X": ((0.2, -0.3, 3.8), (4.2, -0.3, 3.8), (4.6, 0.0), "left"),
        "Y": ((3.35, 10.2, 2.6), (3.35, 12.4, 2.6), (-0.1, 0.55), "right"),
        "Z": ((6.2, 6.3, 5.2), (6.2, 6.3, 8.6), (-0.25, -0.4), "right"),
    }
    for letter, (start, end, (du, dv), side) in arrows.items():
        mine = [axis for axis in machine.axes if axis.cartesian == letter]
        if not mine:
            continue
        tail, head = _project(start), _project(end)
        axes.annotate("", head, tail, arrowprops={"arrowstyle": "<->", "color": style.INK, "lw": 1.0})
        text = "\n".join(_axis_text(axis) for axis in mine)
        at = tail if letter == "X" else head
        axes.text(at[0] + du, at[1] + dv, text, fontsize=7.5, ha=side, va="center", linespacing=1.25, zorder=6)


def _axis_text(axis: Axis) -> str:
    return f"{style.short(axis.name, 12)} ({axis.direction})  {axis.travel_mm[0]:g} to {axis.travel_mm[1]:g} mm"


def _floor_type_marks(machine: Machine) -> list[_Mark]:
    groups: dict[tuple[str, str], list[Sensor]] = defaultdict(list)
    for sensor in machine.sensors:
        letter = machine.axis(sensor.axis).cartesian if sensor.axis else ""
        place: tuple[str, str] = (letter, sensor.role)
        groups[place if place in _LINES else ("", sensor.role)].append(sensor)
    marks = []
    for key, sensors in groups.items():
        start, end = (np.array(place) for place in _LINES[key])
        for k, sensor in enumerate(sensors):
            share = (k + 0.5) / len(sensors)
            u, v = _project(tuple(start + share * (end - start)))
            marks.append(_Mark(sensor.id, float(u), float(v)))
    return marks


def _label_marks(axes: Axes, marks: Sequence[_Mark], look: _Look, middle_u: float) -> None:
    """Ids in two columns next to the drawing, each with a line to its mark."""
    low_u, high_u = axes.get_xlim()
    low_v, high_v = axes.get_ylim()
    for side in ("left", "right"):
        group = [m for m in marks if (m.u < middle_u) == (side == "left")]
        if not group:
            continue
        gap = min(0.78, (high_v - low_v) / max(len(group), 1))
        heights = style.spread(np.array([m.v for m in group]), gap, low_v + 0.3, high_v - 0.3)
        edge = low_u if side == "left" else high_u
        inward = 0.35 if side == "left" else -0.35
        for mark, v in zip(group, heights, strict=True):
            color = look.colors.get(mark.sensor, _DOT)
            key = mark.sensor in look.colors
            axes.plot(
                [edge + inward * 0.4, edge + inward * 2.2, mark.u], [v, v, mark.v],
                color=color, lw=1.1 if key else 0.6, alpha=0.9 if key else 0.6, zorder=4,
            )  # fmt: skip
            _dot(axes, mark.u, mark.v, mark.sensor, look)
            axes.text(
                edge, v, style.short(mark.sensor, 14), ha="right" if side == "left" else "left", va="center",
                fontsize=8.0, color=color if key else style.INK, fontweight="bold" if key else "normal",
            )  # fmt: skip


def _dot(axes: Axes, u: float, v: float, sensor: str, look: _Look) -> None:
    color = look.colors.get(sensor, _DOT)
    if sensor in look.colors:
        axes.plot(u, v, "o", ms=11, mfc="none", mec=color, mew=1.4, zorder=5)
    if sensor in look.read:
        axes.plot(u, v, "o", ms=5.5, mfc=color, mec="white", mew=0.7, zorder=6)
    else:
        axes.plot(u, v, "o", ms=4.8, mfc="white", mec=color, mew=1.1, zorder=6)


def _draw_to_scale(axes: Axes, machine: Machine, look: _Look) -> None:
    """Sensors at their own places in mm, with lines down to the lowest height."""
    places = np.array([sensor.at_mm for sensor in machine.sensors], dtype=float)
    size = float(max(np.ptp(places, axis=0).max(), 1.0))
    scaled = (places - places.min(axis=0)) / size * 10.0
    marks = []
    for sensor, place in zip(machine.sensors, scaled, strict=True):
        u, v = _project(tuple(place))
        foot = _project((place[0], 0.0, place[2]))
        axes.plot([u, foot[0]], [v, foot[1]], ":", color=style.FAINT, lw=0.8)
        marks.append(_Mark(sensor.id, float(u), float(v)))
    floor = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 0.0, 1.0), (0.0, 0.0, 1.0)]
    corners = [_project(tuple(np.array(c) * scaled.max(axis=0))) for c in floor]
    axes.add_patch(Polygon(corners, facecolor=_TOP, edgecolor=_EDGE, linewidth=0.8, zorder=0))
    for letter, end in (("X", (2.0, 0.0, 0.0)), ("Y", (0.0, 2.0, 0.0)), ("Z", (0.0, 0.0, 2.0))):
        head = _project(end)
        axes.annotate("", head, _project((0.0, 0.0, 0.0)), arrowprops={"arrowstyle": "->", "color": style.INK})
        axes.text(head[0] * 1.15, head[1] * 1.15 - 0.1, f"+{letter} {size / 5.0:.0f} mm", fontsize=7.5)
    (low_u, low_v), (high_u, high_v) = _limits([*marks, *(_Mark("", *corner) for corner in corners)])
    axes.set_xlim(low_u - 2.5, high_u + 2.5)
    axes.set_ylim(low_v - 1.0, high_v + 1.0)
    axes.set_aspect("equal")
    _label_marks(axes, marks, look, float(np.median([m.u for m in marks])))


def _draw_blocks(axes: Axes, machine: Machine, look: _Look) -> None:
    """A card for each axis in the order of the machine file, then one for each role without an axis."""
    cards: dict[str, list[str]] = {f"axis {_axis_text(a)}": [] for a in machine.axes}
    for sensor in machine.sensors:
        title = f"axis {_axis_text(machine.axis(sensor.axis))}" if sensor.axis else sensor.role
        cards.setdefault(title, []).append(sensor.id)
    columns = 2 if len(cards) <= 2 else 4
    v = 0.0
    for number, (title, sensors) in enumerate(cards.items()):
        lines = max(1, -(-len(sensors) // columns))
        high = 0.75 + 0.62 * lines
        box = FancyBboxPatch((0.0, v - high), 10.0, high, "round,pad=0,rounding_size=0.12", fc=_TOP, ec=_EDGE, lw=0.8)
        axes.add_patch(box)
        axes.text(0.25, v - 0.38, title, va="center", fontsize=8.5, fontweight="bold")
        for k, sensor_id in enumerate(sensors):
            u, w = 0.4 + 9.8 / columns * (k % columns), v - 0.95 - 0.62 * (k // columns)
            key = sensor_id in look.colors
            color = look.colors.get(sensor_id, _DOT)
            _dot(axes, u, w, sensor_id, look)
            axes.text(
                u + 0.28, w, style.short(sensor_id, 14), va="center", fontsize=8.0,
                color=color if key else style.INK, fontweight="bold" if key else "normal",
            )  # fmt: skip
        if number + 1 < len(machine.axes):
            arrow = {"arrowstyle": "-|>", "color": _EDGE, "lw": 1.0}
            axes.annotate("", (5.0, v - high - 0.55), (5.0, v - high), arrowprops=arrow)
        v -= high + 0.55
    axes.set_xlim(-0.3, 10.3)
    axes.set_ylim(v, 0.3)
    axes.set_aspect("equal", anchor="N")


def _table_rows(machine: Machine) -> list[tuple[str, list[str], str]]:
    return [(s.id, textwrap.wrap(s.location or s.role, 42) or [s.role], s.role) for s in machine.sensors]


def _draw_table(axes: Axes, rows: Sequence[tuple[str, list[str], str]], look: _Look, height: float) -> None:
    """Sensor id and mounting place, one row a sensor, from the top."""
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(height, 0.0)
    axes.text(0.0, 0.12, "sensor", fontsize=8.0, fontweight="bold", va="center")
    axes.text(0.25, 0.12, "mounted on", fontsize=8.0, fontweight="bold", va="center")
    v = 0.12 + 1.25 * _ROW_IN
    for sensor, lines, _ in rows:
        color = look.colors.get(sensor, style.INK)
        weight = "bold" if sensor in look.colors else "normal"
        axes.text(0.0, v, style.short(sensor, 14), fontsize=7.5, color=color, fontweight=weight, va="center")
        for k, line in enumerate(lines):
            axes.text(0.25, v + k * 0.82 * _ROW_IN, line, fontsize=7.5, color=color, va="center")
        v += _ROW_IN * (0.82 * (len(lines) - 1) + 1.0) + 0.06

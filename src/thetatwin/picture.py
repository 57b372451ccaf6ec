"""Pictures of the warm machine: temperature as colour, displacement exaggerated, sensors, drawn without a display."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from thetacomp.arrays import Floats, Ints
from thetatwin.campaigns import Record
from thetatwin.label_placement import Label, place_labels
from thetatwin.mesh import AXES, BodyMesh
from thetatwin.operation import STEP_S
from thetatwin.raster import Canvas, contour_lines, paint, smaller
from thetatwin.sensor_sets import PLACED
from thetatwin.virtual_machine import VirtualMachine

# Where the eye stands: in front of the machine on the headstock's side, and behind it on the other side.
FRONT, BACK = (-0.62, 0.42, -0.66), (0.62, 0.42, 0.66)
_SHOT_FROM_ABOVE_LEFT = np.array([-0.5, 0.85, -0.2])  # light, as right, up, towards the eye
_LARGEST_DRAWN_M = 0.4
_PIXELS, _OVERSAMPLING = 900, 2
_EDGE_PIECES = 12
_LETTERS_PER_IN = 15.5  # of the words below a picture
_LABEL_PT = 7.5
_MOST_ISOTHERMS = 14
# Turbo without its near-black ends, on which lines and shading would drown.
HEAT = LinearSegmentedColormap.from_list("thetacomp_heat", matplotlib.colormaps["turbo"](np.linspace(0.10, 0.94, 128)))


@dataclass(frozen=True)
class Mark:
    """A sensor on the picture: `place` is a body, patch, lump or rod, `at_mm` its place with all axes at zero."""

    label: str
    place: str
    at_mm: tuple[float, float, float]
    color: str = "white"


@dataclass(frozen=True)
class View:
    """The machine from one side. `axes_m` (3, 3) turn machine coordinates into right, up and towards the eye.

    `edges` (n, 2, 3) of the drawn shape are in those, `ghosts` (m, 2, 2) of the cold shape are flat.
    """

    axes_m: Floats
    canvas: Canvas
    edges: Floats
    ghosts: Floats

    @property
    def low(self) -> Floats:
        """Left and low end of what is drawn, (2,)."""
        return np.asarray(np.minimum(self.ghosts.min(axis=(0, 1)), self.edges.min(axis=(0, 1))[:2]))

    @property
    def high(self) -> Floats:
        """Right and high end of what is drawn, (2,)."""
        return np.asarray(np.maximum(self.ghosts.max(axis=(0, 1)), self.edges.max(axis=(0, 1))[:2]))


@dataclass(frozen=True)
class WarmMachine:
    """A machine at one position, with its temperatures and the displacement that it is drawn with.

    `where_m` are the cold nodes of every body, `moved_m` their displacement, `degC` their temperature; `drawn` is
    the exaggeration. `tool_um` is the displacement of the tool (X, Y, Z).
    """

    machine: VirtualMachine
    where_m: Mapping[str, Floats]
    moved_m: Mapping[str, Floats]
    degC: Mapping[str, Floats]
    drawn: float
    largest_um: float
    tool_um: Floats


def warm_machine(
    machine: VirtualMachine,
    rise_K: Floats,
    change_K: Floats,
    positions_mm: Mapping[str, float],
    tool_length_mm: float,
) -> WarmMachine:
    """Temperatures (states,) above the reference, and the displacement that a change of temperatures makes."""
    moved = machine.displacement_m(change_K, positions_mm)
    largest_m = max(float(np.linalg.norm(u, axis=1).max()) for u in moved.values())
    degC = {}
    for name in machine.meshes:
        start = machine.system.offset[name]
        degC[name] = rise_K[start : start + machine.system.size[name]] + machine.description.reference_degC
    at = {name: np.array([value]) for name, value in positions_mm.items()}
    tool = machine.tool_error_um((machine.rows[machine.tool_rows] @ change_K)[None], at, tool_length_mm)[0, :3]
    drawn = _round_figure(_LARGEST_DRAWN_M / largest_m) if largest_m > 0 else 1.0
    return WarmMachine(machine, _places(machine, positions_mm), moved, degC, drawn, largest_m * 1e6, tool)


def campaign_figure(machine: VirtualMachine, record: Record, tool_length_mm: float) -> Figure:
    """The end of the warm-up of a campaign against its cold reference."""
    truth, history = record.truth, record.history
    busy = record.work_t_s[(record.work.rpm > 0) & (record.work_t_s >= 0)]
    warm_s = record.begin_s + STEP_S + (busy[-1] if len(busy) else record.work_t_s[-1])
    states = [history.states[int(np.argmin(np.abs(history.kept_s - t)))] for t in (record.begin_s, warm_s)]
    cold, warm = (machine.reduced.shapes @ state for state in states)
    positions = {name: float(np.median(p[truth.axis == -1])) for name, p in truth.positions_mm.items()}
    shown = warm_machine(machine, warm, warm - cold, positions, tool_length_mm)
    hours = (warm_s - record.begin_s) / 3600
    title = f"{machine.description.name}, campaign {record.plan.name}, {hours:.1f} h after the cold start"
    return machine_figure(shown, title, sensor_marks(machine))


def sensor_marks(machine: VirtualMachine, color: str = "white") -> tuple[Mark, ...]:
    """The sensors of the description."""
    oil = machine.description.cooling.lump
    return tuple(
        Mark(_short(s.id) + (" oil tank" if s.place == oil else ""), s.place, s.at_mm, color)
        for s in machine.description.sensors
    )


def _short(sensor: str) -> str:
    """An id as it is written next to its dot; a chosen place has its rank, as in the picture of `thetacomp place`."""
    return sensor.removeprefix(PLACED).replace("theta_", "θ")


def machine_figure(
    shown: WarmMachine,
    title: str,
    marks: Sequence[Mark] = (),
    eyes: Sequence[tuple[str, tuple[float, float, float]]] = (("", FRONT),),
    size_in: tuple[float, float] = (7.4, 7.4),
) -> Figure:
    """The machine from one or more sides, each with its caption. A mark is drawn where it is seen first."""
    figure = Figure(figsize=size_in, dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(1, len(eyes), squeeze=False)[0]
    views = [_view(shown, np.array(eye)) for _, eye in eyes]
    degC = np.concatenate(list(shown.degC.values()))
    scale = ScalarMappable(Normalize(float(degC.min()), float(degC.max())), HEAT)
    step = isotherm_step(float(np.ptp(degC)))
    spots = [spot_m(shown, mark) for mark in marks]
    seen = np.array([[bool(v.canvas.sees((spot @ v.axes_m)[None])[0]) for v in views] for spot in spots])
    seen = seen.reshape(len(spots), len(views))
    home = seen.argmax(axis=1)
    size = np.max([view.high - view.low for view in views], axis=0)
    for axes, view, (caption, _) in zip(grid, views, eyes, strict=True):
        _draw_view(axes, view, scale, step, size)
        axes.set_title(caption, fontsize=9.5, loc="center")
    bar = figure.colorbar(scale, ax=list(grid), shrink=0.55, pad=0.015, aspect=24)
    bar.set_label("temperature (°C)", fontsize=9)
    bar.ax.yaxis.set_major_locator(MultipleLocator(step))
    bar.ax.tick_params(labelsize=8)
    figure.suptitle(title, x=0.012, ha="left", fontsize=11, fontweight="bold")
    figure.supxlabel(_words(shown, step, len(marks) > 0, size_in[0]), x=0.012, ha="left", fontsize=8.5)
    figure.draw_without_rendering()  # labels are arranged in pixels: everything must have its place before
    for k, (axes, view) in enumerate(zip(grid, views, strict=True)):
        own = [i for i in range(len(marks)) if home[i] == k]
        _draw_marks(axes, [(marks[i], spots[i] @ view.axes_m, bool(seen[i, k])) for i in own])
    return figure


def _words(shown: WarmMachine, step_K: float, marked: bool, width_in: float) -> str:
    """What stands below the picture."""
    tool = ", ".join(f"{d} {u:+.0f}" for d, u in zip(AXES, shown.tool_um, strict=True)).replace("-", "\N{MINUS SIGN}")
    parts = [
        f"Displacement since cold × {shown.drawn:,.0f}: largest {shown.largest_um:.0f} µm, at the tool {tool} µm."
        f" Grey: cold shape. Dark lines: isotherms, {step_K:g} K apart."
    ]
    if marked:
        parts.append("Dots: sensors; half-transparent where a casting hides them.")
    return "\n".join(textwrap.fill(part, int(_LETTERS_PER_IN * width_in)) for part in parts)


def figure_content(figure: Figure, name: str) -> bytes:
    """The figure as PNG or SVG, by the ending of its name; the same figure gives the same bytes."""
    out, kind = io.BytesIO(), name.rpartition(".")[2]
    with matplotlib.rc_context({"svg.hashsalt": "thetacomp", "svg.fonttype": "none"}):
        figure.canvas.print_figure(
            out, format=kind, dpi=figure.dpi, metadata={"Date": None, "Creator": None} if kind == "svg" else None
        )
    return out.getvalue()


def isotherm_step(span_K: float) -> float:
    """Distance of isotherms, 1, 2 or 5 times a power of ten, for at most 14 of them."""
    return 1.0 / _round_figure(_MOST_ISOTHERMS / span_K) if span_K > 0 else 1.0


def _view(shown: WarmMachine, eye: Floats) -> View:
    towards = eye / np.linalg.norm(eye)
    right = np.cross([0.0, 1.0, 0.0], towards)
    right /= np.linalg.norm(right)
    axes_m = np.stack([right, np.cross(towards, right), towards], axis=1)
    quads, heat, light, edges, ghosts = [], [], [], [], []
    lamp = axes_m @ (_SHOT_FROM_ABOVE_LEFT + np.array([0.0, 0.0, 0.75]))
    lamp /= np.linalg.norm(lamp)
    for name, mesh in shown.machine.meshes.items():
        bent = shown.where_m[name] + shown.drawn * shown.moved_m[name]
        facing = mesh.faces.normal @ towards > 1e-9
        corners = mesh.faces.corners[facing][:, [0, 1, 3, 2]]
        quads.append(bent[corners] @ axes_m)
        heat.append(shown.degC[name][corners])
        light.append(0.78 + 0.22 * np.clip(mesh.faces.normal[facing] @ lamp, 0.0, 1.0))
        creases = _creases(mesh, corners)
        edges.append(bent[creases] @ axes_m)
        outer = _creases(mesh, mesh.faces.corners[facing & ~mesh.faces.inner][:, [0, 1, 3, 2]])
        ghosts.append(shown.where_m[name][outer] @ axes_m)
    canvas = paint(
        np.concatenate(quads), np.concatenate(heat), np.concatenate(light), _PIXELS * _OVERSAMPLING, margin_m=0.02
    )
    return View(axes_m, canvas, np.concatenate(edges), np.concatenate(ghosts)[:, :, :2])


def _draw_view(axes: Axes, view: View, scale: ScalarMappable, step_K: float, size: Floats) -> None:
    canvas = view.canvas
    image = scale.to_rgba(canvas.value)
    image[..., :3] *= canvas.light[..., None]
    image[contour_lines(canvas, step_K), :3] *= 0.68
    image[..., 3] = np.isfinite(canvas.value)
    image = smaller(image, _OVERSAMPLING)
    axes.add_collection(LineCollection(list(view.ghosts), colors="#9aa3ad", linewidths=0.7, zorder=1))
    axes.imshow(image, extent=canvas.extent_m, origin="lower", interpolation="none", zorder=2)
    axes.add_collection(
        LineCollection(_seen_parts(view), colors="#20262d", linewidths=0.55, capstyle="round", zorder=3)
    )
    # All views show the same width and height, so that they have one scale.
    left, low = 0.5 * (view.high + view.low - size)
    axes.set(xlim=(left - 0.45, left + size[0] + 0.45), ylim=(low - 0.5, low + size[1] + 0.2), aspect="equal")
    axes.axis("off")
    _draw_triad(axes, view, (left + 0.1, low - 0.1))


def _seen_parts(view: View) -> list[Floats]:
    """The parts of the edges that no face hides, each (2, 2)."""
    s = np.linspace(0.0, 1.0, _EDGE_PIECES + 1)
    middles = view.edges[:, :1] + (view.edges[:, 1:] - view.edges[:, :1]) * (0.5 * (s[1:] + s[:-1]))[None, :, None]
    seen = view.canvas.sees(middles.reshape(-1, 3)).reshape(len(view.edges), -1)
    closed = np.zeros((len(seen), 1), dtype=int)
    steps = np.diff(np.concatenate([closed, seen.astype(int), closed], axis=1), axis=1)
    edge, begin = np.nonzero(steps == 1)
    _, end = np.nonzero(steps == -1)
    a, b = view.edges[edge, 0, :2], view.edges[edge, 1, :2]
    return list(np.stack([a + (b - a) * s[begin, None], a + (b - a) * s[end, None]], axis=1))


def _draw_triad(axes: Axes, view: View, corner: tuple[float, float]) -> None:
    for k, name in enumerate(AXES):
        tip = 0.7 * view.axes_m[k, :2]
        axes.annotate(
            "", (corner[0] + tip[0], corner[1] + tip[1]), corner,
            arrowprops={"arrowstyle": "-|>", "lw": 1.0, "color": "#3e4c59", "shrinkA": 0, "shrinkB": 0},
        )  # fmt: skip
        axes.text(corner[0] + 1.25 * tip[0], corner[1] + 1.25 * tip[1], name, fontsize=8, ha="center", va="center")


def _draw_marks(axes: Axes, marks: Sequence[tuple[Mark, Floats, bool]]) -> None:
    points = np.array([place[:2] for _, place, _ in marks]).reshape(-1, 2)
    pixels = axes.transData.transform(points) if len(points) else points
    point_px = axes.figure.dpi / 72.0
    texts = [Label(mark.label, (float(x), float(y))) for (mark, _, _), (x, y) in zip(marks, pixels, strict=True)]
    labels = place_labels(texts, _LABEL_PT * point_px)
    for (mark, place, seen), (dx, dy) in zip(marks, labels, strict=True):
        spot = (float(place[0]), float(place[1]))
        opacity = 1.0 if seen else 0.5
        axes.plot(*spot, "o", ms=5.5, mfc=mark.color, mec="black", mew=0.9, alpha=opacity, zorder=6)
        axes.annotate(
            mark.label, spot, xytext=(dx / point_px, dy / point_px), textcoords="offset points", fontsize=_LABEL_PT,
            ha="center", va="center", zorder=7,
            bbox={"boxstyle": "round,pad=0.14", "fc": mark.color, "ec": "none", "alpha": 0.92},
            arrowprops={"arrowstyle": "-", "lw": 0.6, "color": "black", "shrinkA": 0, "shrinkB": 2},
        )  # fmt: skip


def spot_m(shown: WarmMachine, mark: Mark) -> Floats:
    """Where a mark is on the drawn machine, (3,) in m: it moves with the body that it sits on."""
    here = np.array(mark.at_mm) * 1e-3
    body = _body_of(shown.machine, mark.place)
    if body is None:
        return here
    mesh = shown.machine.meshes[body]
    node = int(np.argmin(np.linalg.norm(mesh.points_m - here, axis=1)))
    shift = shown.where_m[body][node] - mesh.points_m[node]
    return np.asarray(here + shift + shown.drawn * shown.moved_m[body][node])


def _body_of(machine: VirtualMachine, place: str) -> str | None:
    """The body that a place rides on; None for the tank of the cooling, which stands on the floor."""
    description = machine.description
    if place == description.cooling.lump:
        return None
    rides = {name: name for name in machine.meshes} | {p.name: p.body for p in description.patches}
    rides |= {rod.name: rides[rod.patch] for rod in description.rods}
    # A small part rides on the body that it touches, if need be through other small parts.
    for _ in description.lumps:
        for contact in description.contacts:
            if contact.a not in rides and contact.b in rides and contact.a != description.cooling.lump:
                rides[contact.a] = rides[contact.b]
    return rides.get(place, description.axes[0].lower)


def _round_figure(value: float) -> float:
    """1, 2 or 5 times a power of ten, at most `value`."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(m for m in (1.0, 2.0, 5.0) if m * power <= value) * power)


def _places(machine: VirtualMachine, positions_mm: Mapping[str, float]) -> dict[str, Floats]:
    """Nodes of every body where the axes stand."""
    out = {machine.description.axes[0].lower: machine.meshes[machine.description.axes[0].lower].points_m}
    travelled = np.zeros(3)
    for station, axis in zip(machine.tool.stations, machine.description.axes, strict=True):
        travelled = travelled + station.direction * positions_mm[axis.name] * 1e-3
        out[axis.upper] = machine.meshes[axis.upper].points_m + travelled
    return out


def _creases(mesh: BodyMesh, faces: Ints) -> Ints:
    """Edges (n, 2) where faces (m, 4) of different direction meet, or where they end."""
    sides = np.concatenate([faces[:, [k, (k + 1) % 4]] for k in range(4)])
    p = mesh.points_m[faces]
    normal = np.argmax(np.abs(np.cross(p[:, 1] - p[:, 0], p[:, 3] - p[:, 0])), axis=1)
    owner = np.tile(normal, 4)
    key = np.sort(sides, axis=1)
    unique, inverse, count = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    low, high = np.full(len(unique), 9), np.full(len(unique), -1)
    np.minimum.at(low, inverse.ravel(), owner)
    np.maximum.at(high, inverse.ravel(), owner)
    return np.asarray(unique[(count == 1) | (low != high)])

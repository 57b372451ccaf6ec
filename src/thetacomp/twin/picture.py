"""A picture of the warm machine: temperature as colour, displacement exaggerated, drawn without a display."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from thetacomp.twin.campaigns import Record
from thetacomp.twin.mesh import BodyMesh, Floats, Ints
from thetacomp.twin.operation import STEP_S
from thetacomp.twin.virtual import VirtualMachine

_SPLIT = 4  # each element face is painted as so many squares a side, for smooth colours
_EDGE_IN_FRONT_M = 0.02
_LARGEST_DRAWN_M = 0.6  # the largest displacement on the picture
# The eye stands in front of the machine on the headstock's side, somewhat above it.
_EYE = np.array([-0.62, 0.42, -0.66])
_LIGHT = np.array([-0.35, 0.85, -0.4])


def draw_machine(machine: VirtualMachine, record: Record, path: Path) -> None:
    """Draw the end of the warm-up of a campaign against its cold reference and save it as PNG or SVG."""
    truth, history = record.truth, record.history
    busy = np.flatnonzero(record.work.rpm > 0)
    warm_s = record.begin_s + STEP_S * (float(busy[-1]) + 1 if len(busy) else len(record.work.on))
    states = [history.states[int(np.argmin(np.abs(history.kept_s - t)))] for t in (record.begin_s, warm_s)]
    cold, warm = (machine.reduced.shapes @ state for state in states)
    positions = {name: float(np.median(p[truth.axis == -1])) for name, p in truth.positions_mm.items()}
    title = (
        f"{machine.description.name}, {record.plan.name}: {(warm_s - record.begin_s) / 3600:.1f} h after the cold start"
    )
    draw_state(machine, warm, warm - cold, positions, title, path)


def draw_state(
    machine: VirtualMachine, rise_K: Floats, change_K: Floats, positions_mm: Mapping[str, float], title: str, path: Path
) -> None:
    """Draw temperatures (states,) above the reference, and the displacement that a change of temperatures makes."""
    moved = machine.displacement_m(change_K, positions_mm)
    largest_m = max(float(np.linalg.norm(u, axis=1).max()) for u in moved.values())
    exaggeration = _round_figure(_LARGEST_DRAWN_M / largest_m) if largest_m > 0 else 1.0
    right, up, towards = _camera()
    view = np.stack([right, up], axis=1)
    scenes = []
    for name, where in _places(machine, positions_mm).items():
        start = machine.system.offset[name]
        degC = rise_K[start : start + machine.system.size[name]] + machine.description.reference_degC
        scenes.append(_scene(machine.meshes[name], where, exaggeration * moved[name], degC, view, towards))
    words = (
        f"{title}\ndisplacement since cold × {exaggeration:,.0f}, largest {largest_m * 1e6:.0f} µm\n"
        "grey lines: cold shape; sensors are shown through the castings"
    )
    _paint(scenes, _dots(machine, positions_mm, view), words, path)


@dataclass(frozen=True)
class _Scene:
    """One body on the picture: n small squares (n, 4, 2) with depth, temperature and light; its edges as m pieces
    (m, 2, 2) with depth; and the edges of the cold shape."""

    squares: Floats
    depth: Floats
    degC: Floats
    light: Floats
    edges: Floats
    edge_depth: Floats
    ghost: Floats


def _scene(mesh: BodyMesh, where: Floats, moved: Floats, degC: Floats, view: Floats, towards: Floats) -> _Scene:
    bent, faces = where + moved, _visible(mesh, towards)
    squares, heat = _subdivide(bent, degC, faces)
    lit = np.clip(mesh.faces.normal[_shown(mesh, towards)] @ (_LIGHT / np.linalg.norm(_LIGHT)), 0, 1)
    creases = _creases(mesh, faces)
    s = np.linspace(0.0, 1.0, _SPLIT + 1)[:, None, None]
    line = bent[creases[:, 0]] * (1 - s) + bent[creases[:, 1]] * s
    pieces = np.stack([line[:-1].reshape(-1, 3), line[1:].reshape(-1, 3)], axis=1)
    return _Scene(
        squares @ view,
        squares.mean(axis=1) @ towards,
        heat,
        np.repeat(0.72 + 0.28 * lit, _SPLIT**2),
        pieces @ view,
        pieces.mean(axis=1) @ towards + _EDGE_IN_FRONT_M,
        where[creases] @ view,
    )


def _camera() -> tuple[Floats, Floats, Floats]:
    towards = _EYE / np.linalg.norm(_EYE)
    right = np.cross([0.0, 1.0, 0.0], towards)
    right /= np.linalg.norm(right)
    return right, np.cross(towards, right), towards


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


def _shown(mesh: BodyMesh, towards: Floats) -> Ints:
    return np.flatnonzero((mesh.faces.normal @ towards > 1e-9) & ~mesh.faces.inner)


def _visible(mesh: BodyMesh, towards: Floats) -> Ints:
    """Corner nodes (n, 4), going round, of outer faces that look at the eye."""
    return mesh.faces.corners[_shown(mesh, towards)][:, [0, 1, 3, 2]]


def _subdivide(points: Floats, values: Floats, faces: Ints) -> tuple[Floats, Floats]:
    """Split quadrilaterals into small ones: corners (n * _SPLIT², 4, 3) and mean values."""
    s = np.linspace(0.0, 1.0, _SPLIT + 1)
    u, v = np.meshgrid(s, s, indexing="ij")
    shape = np.stack([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v], axis=-1)
    grid = np.einsum("abk,nkd->nabd", shape, points[faces])
    heat = np.einsum("abk,nk->nab", shape, values[faces])
    corners = np.stack([grid[:, :-1, :-1], grid[:, 1:, :-1], grid[:, 1:, 1:], grid[:, :-1, 1:]], axis=3)
    mean = 0.25 * (heat[:, :-1, :-1] + heat[:, 1:, :-1] + heat[:, 1:, 1:] + heat[:, :-1, 1:])
    return corners.reshape(-1, 4, 3), mean.ravel()


def _creases(mesh: BodyMesh, faces: Ints) -> Ints:
    """Edges (n, 2) where visible faces of different direction meet, or where the visible part ends."""
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


def _dots(machine: VirtualMachine, positions_mm: Mapping[str, float], view: Floats) -> list[tuple[str, Floats]]:
    """Where the sensors are on the picture."""
    body_of = {p.name: p.body for p in machine.description.patches}
    at_rest = {name: machine.meshes[name].points_m[0] for name in machine.meshes}
    shift = {name: where[0] - at_rest[name] for name, where in _places(machine, positions_mm).items()}
    # A small part rides on the body that it touches, if need be through other small parts.
    rides = dict(body_of)
    for _ in machine.description.lumps:
        for contact in machine.description.contacts:
            if contact.a not in rides and contact.b in rides:
                rides[contact.a] = rides[contact.b]
    out = []
    for sensor in machine.description.sensors:
        body = rides.get(sensor.place, machine.description.axes[0].lower)
        if sensor.place == machine.description.cooling.lump:
            body = machine.description.axes[0].lower  # the tank stands on the floor
        label = sensor.id.replace("theta_", "θ") + (
            " oil tank" if sensor.place == machine.description.cooling.lump else ""
        )
        out.append((label, (np.array(sensor.at_mm) * 1e-3 + shift[body]) @ view))
    return out


def _paint(scenes: Sequence[_Scene], dots: Sequence[tuple[str, Floats]], title: str, path: Path) -> None:
    figure = Figure(figsize=(8.4, 8.0), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    degC = np.concatenate([scene.degC for scene in scenes])
    scale = ScalarMappable(Normalize(float(degC.min()), float(degC.max())), "turbo")
    colour = scale.to_rgba(degC)
    colour[:, :3] *= np.concatenate([scene.light for scene in scenes])[:, None]
    # Edges are flat polygons among the others, so that what is in front hides them.
    flat = np.concatenate([scene.edges for scene in scenes])[:, [0, 1, 1, 0]]
    colour = np.concatenate([colour, np.tile([1.0, 1.0, 1.0, 0.45], (len(flat), 1))])
    depth = np.concatenate([*(scene.depth for scene in scenes), *(scene.edge_depth for scene in scenes)])
    order = np.argsort(depth)
    polygons = np.concatenate([*(scene.squares for scene in scenes), flat])[order]
    ghosts = np.concatenate([scene.ghost for scene in scenes])
    axes.add_collection(LineCollection(list(ghosts), colors="#9aa3ad", linewidths=0.7, zorder=1))
    axes.add_collection(
        PolyCollection(list(polygons), facecolors=colour[order], edgecolors=colour[order], linewidths=0.4)
    )
    box = {"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.75}
    for name, place in dots:
        spot = (float(place[0]), float(place[1]))
        axes.plot(*spot, "o", ms=5, mfc="white", mec="black", mew=0.9, zorder=5)
        axes.annotate(name, spot, xytext=(5, 4), textcoords="offset points", fontsize=8, zorder=6, bbox=box)
    everything = np.concatenate([polygons.reshape(-1, 2), ghosts.reshape(-1, 2), np.array([d[1] for d in dots])])
    (left, low), (right, high) = everything.min(axis=0), everything.max(axis=0)
    axes.set(xlim=(left - 0.15, right + 0.3), ylim=(low - 0.15, high + 0.15), aspect="equal")
    axes.axis("off")
    axes.set_title(title, fontsize=10.5, loc="left")
    bar = figure.colorbar(scale, ax=axes, shrink=0.6, pad=0.01)
    bar.set_label("temperature in °C")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)

"""Heat in the whole machine: C dT/dt + K T = B u, every body, lump and rod in one symmetric system.

Temperatures count in K above the machine's reference temperature, inputs in W or in K above the reference.
Bodies that move against each other exchange heat over the whole strip that they share on their travel: that is
what the strip sees on average, and it keeps the system the same at every position.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu
from skfem import BilinearForm

from thetacomp.arrays import Floats, Ints
from thetacomp.errors import AnalysisError
from thetatwin.description import Air, Body, Description, Material, Patch, Rod, TwinSensor
from thetatwin.elastic import Scalar
from thetatwin.mesh import AXES, BodyMesh, NodeWeights, face_weights, nearest_surface_node, patch_weights

AIR_INPUTS = ("air_K", "air_gradient_K_per_m", "air_rear_K_per_m", "air_side_K_per_m", "draught_K")
GROUND_INPUT = "ground_K"
COOLING_INPUT = "cooling_W"
_CAVITY_CAPACITY_J_PER_K = 5000.0  # air of a few cubic metres
_SENSOR_FOOT_M = 0.02  # half the edge of the square that a Pt100 averages over


@dataclass(frozen=True)
class ThermalSystem:
    """The assembled system of n states. `inputs` names the columns of `source` (n, inputs).

    `offset` gives the first state of every body, lump, cavity and rod; `size` how many states it has.
    """

    capacity: sp.csc_matrix
    conductance: sp.csc_matrix
    source: Floats
    inputs: tuple[str, ...]
    offset: Mapping[str, int]
    size: Mapping[str, int]

    @property
    def states(self) -> int:
        """Number of temperatures."""
        return int(self.capacity.shape[0])


class _Assembly:
    """Collects symmetric contributions to C and K and the columns of B."""

    def __init__(self, size: Mapping[str, int]) -> None:
        self.size = dict(size)
        starts = np.concatenate([[0], np.cumsum(list(size.values()))]).astype(int)
        self.offset = dict(zip(size, (int(s) for s in starts), strict=False))
        self.states = int(starts[-1])
        self.capacity: list[Any] = []
        self.conductance: list[Any] = []
        self.columns: dict[str, Floats] = {}

    def blocks(self, name: str, capacity: sp.csc_matrix, conductance: sp.csc_matrix) -> None:
        start = self.offset[name]
        for target, block in ((self.capacity, capacity), (self.conductance, conductance)):
            coo = sp.coo_matrix(block)
            target.append((coo.row + start, coo.col + start, coo.data))

    def diagonal(self, states: Ints, capacity: Floats | float = 0.0, conductance: Floats | float = 0.0) -> None:
        for target, value in ((self.capacity, capacity), (self.conductance, conductance)):
            target.append((states, states, np.broadcast_to(np.asarray(value, dtype=float), states.shape)))

    def link(self, a: Ints, b: Ints, conductance: Floats) -> None:
        """Ordinary links between pairs of states."""
        rows, cols = np.concatenate([a, b, a, b]), np.concatenate([a, b, b, a])
        self.conductance.append((rows, cols, np.concatenate([conductance, conductance, -conductance, -conductance])))

    def mean_link(self, a: tuple[Ints, Floats], b: tuple[Ints, Floats], conductance: float) -> None:
        """A link between two weighted means: K += G v vᵀ with v = weights of a less weights of b."""
        states, v = np.concatenate([a[0], b[0]]), np.concatenate([a[1], -b[1]])
        outer = conductance * np.outer(v, v)
        self.conductance.append((np.repeat(states, len(states)), np.tile(states, len(states)), outer.ravel()))

    def column(self, name: str) -> Floats:
        return self.columns.setdefault(name, np.zeros(self.states))

    def matrix(self, parts: list[Any]) -> sp.csc_matrix:
        rows, cols, data = (np.concatenate([np.asarray(p[i]) for p in parts]) for i in range(3))
        return sp.csc_matrix(sp.coo_matrix((data, (rows, cols)), shape=(self.states, self.states)))


def assemble_machine(
    description: Description, meshes: Mapping[str, BodyMesh], spaces: Mapping[str, Scalar]
) -> ThermalSystem:
    """Assemble bodies, lumps, rods, contacts, convection and sources of the description."""
    size = {body.name: len(meshes[body.name].points_m) for body in description.bodies}
    size |= {f"{body.name} cavity": 1 for body in description.bodies}
    size |= {lump.name: 1 for lump in description.lumps}
    size |= {rod.name: rod.segments for rod in description.rods}
    work = _Assembly(size)
    for source in description.sources:
        work.column(source.name)
    for name in (COOLING_INPUT, *AIR_INPUTS, GROUND_INPUT):
        work.column(name)
    for body in description.bodies:
        _add_body(work, body, description, meshes[body.name], spaces[body.name])
    for lump in description.lumps:
        state = np.array([work.offset[lump.name]])
        work.diagonal(state, lump.capacity_kJ_per_K * 1e3, lump.to_air_W_per_K)
        _add_air(work, state, np.array([lump.to_air_W_per_K]), np.array([lump.at_mm]) * 1e-3, description.air)
    for rod in description.rods:
        _add_rod(work, rod, description, meshes)
    places = {name: place_weights(description, meshes, work.offset, name) for name in _place_names(description)}
    for contact in description.contacts:
        work.mean_link(places[contact.a], places[contact.b], contact.conductance_W_per_K)
    for source in description.sources:
        for target, share in source.shares.items():
            states, weights = places[target]
            np.add.at(work.column(source.name), states, share * weights)
    work.column(COOLING_INPUT)[work.offset[description.cooling.lump]] = -1.0
    columns = np.stack(list(work.columns.values()), axis=1)
    return ThermalSystem(
        work.matrix(work.capacity), work.matrix(work.conductance), columns, tuple(work.columns), work.offset, work.size
    )


def _place_names(description: Description) -> list[str]:
    return [
        *(p.name for p in description.patches),
        *(x.name for x in description.lumps),
        *(r.name for r in description.rods),
    ]


def body_matrices(material: Material, spaces: Scalar) -> tuple[sp.csc_matrix, sp.csc_matrix]:
    """Capacity and conduction matrix of one body: ∫ ρ c u v and ∫ k ∇u·∇v."""
    mass = BilinearForm(lambda u, v, _: u * v).assemble(spaces.linear)
    laplace = BilinearForm(
        lambda u, v, _: u.grad[0] * v.grad[0] + u.grad[1] * v.grad[1] + u.grad[2] * v.grad[2]
    ).assemble(spaces.linear)
    rho_c = material.density_kg_per_m3 * material.specific_heat_J_per_kg_K
    return sp.csc_matrix(rho_c * mass), sp.csc_matrix(material.conductivity_W_per_m_K * laplace)


def _add_body(work: _Assembly, body: Body, description: Description, mesh: BodyMesh, spaces: Scalar) -> None:
    work.blocks(body.name, *body_matrices(description.materials[body.material], spaces))
    start = work.offset[body.name]
    outer, inner = np.zeros(len(mesh.points_m)), np.zeros(len(mesh.points_m))
    area = np.prod(np.where(mesh.faces.normal != 0, 1.0, mesh.faces.hi_m - mesh.faces.lo_m), axis=1)
    for target, which in ((outer, ~mesh.faces.inner), (inner, mesh.faces.inner)):
        np.add.at(target, mesh.faces.corners[which].ravel(), np.repeat(area[which] / 4, 4))
    grounds = [p for p in description.patches if p.name in description.ground and p.body == body.name]
    for patch in grounds:
        weights = patch_weights(mesh, patch)
        np.subtract.at(outer, weights.nodes, weights.weight_m2)
        conductance = description.ground_conductance_W_per_m2_K * weights.weight_m2
        work.diagonal(start + weights.nodes, 0.0, conductance)
        work.column(GROUND_INPUT)[start + weights.nodes] += conductance
    states = start + np.arange(len(mesh.points_m))
    # Ground patches were integrated exactly, faces lumped: rounding must not leave a negative area.
    to_air = body.to_air_W_per_m2_K * np.maximum(outer, 0.0)
    work.diagonal(states, 0.0, to_air)
    _add_air(work, states, to_air, mesh.points_m, description.air)
    wet = np.flatnonzero(inner)
    cavity = np.full(len(wet), work.offset[f"{body.name} cavity"])
    work.diagonal(cavity[:1] if len(wet) else np.array([work.offset[f"{body.name} cavity"]]), _CAVITY_CAPACITY_J_PER_K)
    if len(wet) and body.to_cavity_W_per_m2_K > 0:
        work.link(start + wet, cavity, body.to_cavity_W_per_m2_K * inner[wet])
    else:
        # An empty cavity must not make the conductance singular: it follows the hall.
        work.diagonal(np.array([work.offset[f"{body.name} cavity"]]), 0.0, 1.0)


def air_pattern(air: Air, points_m: Floats) -> Floats:
    """What one unit of each air input does to the air at points: (points, inputs), order of AIR_INPUTS."""
    height = points_m[:, 1] - air.level_height_mm * 1e-3
    fade = (points_m - np.array(air.door_mm) * 1e-3) / (np.array(air.door_fade_mm) * 1e-3)
    draught = -np.exp(-0.5 * np.sum(fade**2, axis=1))
    return np.stack([np.ones(len(points_m)), height, points_m[:, 2], points_m[:, 0], draught], axis=1)


def _add_air(work: _Assembly, states: Ints, conductance: Floats, points_m: Floats, air: Air) -> None:
    pattern = air_pattern(air, points_m)
    for k, name in enumerate(AIR_INPUTS):
        np.add.at(work.column(name), states, conductance * pattern[:, k])


def rod_axis(rod: Rod) -> int:
    """Along which of X, Y, Z the rod lies. Raises AnalysisError for a slanting rod."""
    along = np.flatnonzero(np.array(rod.to_mm) != np.array(rod.from_mm))
    if len(along) != 1:
        raise AnalysisError(f"rod {rod.name}: it must lie along one of X, Y, Z. Fix: check from_mm and to_mm.")
    return int(along[0])


def rod_points_m(rod: Rod) -> Floats:
    """Middles of the rod's segments, (segments, 3)."""
    ends = np.array([rod.from_mm, rod.to_mm]) * 1e-3
    s = (np.arange(rod.segments) + 0.5) / rod.segments
    return np.asarray(ends[0] + s[:, None] * (ends[1] - ends[0]))


def _add_rod(work: _Assembly, rod: Rod, description: Description, meshes: Mapping[str, BodyMesh]) -> None:
    material = description.materials[rod.material]
    axis = rod_axis(rod)
    states = work.offset[rod.name] + np.arange(rod.segments)
    length = abs(rod.to_mm[axis] - rod.from_mm[axis]) * 1e-3 / rod.segments
    section = rod.section_mm2 * 1e-6
    heat = material.density_kg_per_m3 * material.specific_heat_J_per_kg_K * section * length
    to_air = np.full(rod.segments, rod.to_air_W_per_m_K * length)
    work.diagonal(states, heat, to_air)
    points = rod_points_m(rod)
    _add_air(work, states, to_air, points, description.air)
    along = np.full(rod.segments - 1, material.conductivity_W_per_m_K * section / length)
    work.link(states[:-1], states[1:], along)
    patch = next(p for p in description.patches if p.name == rod.patch)
    for state, middle in zip(states, points, strict=True):
        weights = _strip(meshes[patch.body], patch, axis, middle[axis] - length / 2, middle[axis] + length / 2)
        if len(weights.nodes):
            share = weights.weight_m2 / weights.area_m2
            strip = (work.offset[patch.body] + weights.nodes, share)
            work.mean_link((np.array([state]), np.ones(1)), strip, rod.to_patch_W_per_m_K * length)


def _strip(mesh: BodyMesh, patch: Patch, axis: int, lo_m: float, hi_m: float) -> NodeWeights:
    """The part of a patch between two coordinates along an axis."""
    box = np.array([patch.from_mm, patch.to_mm]) * 1e-3
    box[:, axis] = max(lo_m, box[0, axis]), min(hi_m, box[1, axis])
    if box[1, axis] <= box[0, axis]:
        return NodeWeights(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(3))
    return face_weights(mesh, box[0], box[1], patch.normal)


def place_weights(
    description: Description, meshes: Mapping[str, BodyMesh], offset: Mapping[str, int], name: str
) -> tuple[Ints, Floats]:
    """States and weights (sum 1) whose mean is the temperature of a patch, lump or rod."""
    for patch in description.patches:
        if patch.name == name:
            weights = patch_weights(meshes[patch.body], patch)
            return offset[patch.body] + weights.nodes, weights.weight_m2 / weights.area_m2
    for rod in description.rods:
        if rod.name == name:
            return offset[name] + np.arange(rod.segments), np.full(rod.segments, 1.0 / rod.segments)
    return np.array([offset[name]]), np.ones(1)


def sensor_rows(description: Description, meshes: Mapping[str, BodyMesh], system: ThermalSystem) -> Floats:
    """Temperature under every Pt100 as rows over the states, (sensors, states)."""
    rows = np.zeros((len(description.sensors), system.states))
    patches = {p.name: p for p in description.patches}
    rods = {r.name: r for r in description.rods}
    for row, sensor in zip(rows, description.sensors, strict=True):
        if sensor.place in patches:
            _foot(row, sensor, patches[sensor.place], meshes, system)
        elif sensor.place in rods:
            rod = rods[sensor.place]
            distance = np.linalg.norm(rod_points_m(rod) - np.array(sensor.at_mm) * 1e-3, axis=1)
            row[system.offset[rod.name] + int(np.argmin(distance))] = 1.0
        elif sensor.place in meshes:
            node, _ = nearest_surface_node(meshes[sensor.place], sensor.at_mm)
            row[system.offset[sensor.place] + node] = 1.0
        else:
            row[system.offset[sensor.place]] = 1.0
    return rows


def _foot(row: Floats, sensor: TwinSensor, patch: Patch, meshes: Mapping[str, BodyMesh], system: ThermalSystem) -> None:
    spot = np.array(sensor.at_mm) * 1e-3
    foot = np.full(3, _SENSOR_FOOT_M)
    foot[AXES.index(patch.normal[1])] = 1e-4
    weights = face_weights(meshes[patch.body], spot - foot, spot + foot, patch.normal)
    if weights.area_m2 < 1e-6:
        raise AnalysisError(
            f"sensor {sensor.id}: there is no face of {patch.body} with normal {patch.normal} at {sensor.at_mm} mm."
            " Fix: move at_mm onto the face."
        )
    np.add.at(row, system.offset[patch.body] + weights.nodes, weights.weight_m2 / weights.area_m2)


def transient(
    system: ThermalSystem, inputs: Floats, step_s: float, rows: Floats, start: Floats | None = None
) -> Floats:
    """Outputs (steps + 1, rows) of the full model under inputs (steps, inputs) held constant over each step.

    Two-stage SDIRK of second order, stiffly accurate (Alexander 1977): one factorisation of C + γ h K serves all.
    """
    gamma = 1.0 - np.sqrt(0.5)
    capacity, conductance = system.capacity, system.conductance
    factor = splu(
        sp.csc_matrix(capacity + gamma * step_s * conductance),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    state = np.zeros(system.states) if start is None else start.copy()
    out = np.empty((len(inputs) + 1, len(rows)))
    out[0] = rows @ state
    for k, u in enumerate(inputs):
        load = system.source @ u
        first = factor.solve(load - conductance @ state)
        second = factor.solve(load - conductance @ (state + (1 - gamma) * step_s * first))
        state = state + step_s * ((1 - gamma) * first + gamma * second)
        out[k + 1] = rows @ state
    return out

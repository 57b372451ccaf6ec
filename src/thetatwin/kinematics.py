"""From nodal temperatures to the tool: poses of the guides by elasticity, chained as rigid bodies.

A pose is (u, r): displacement in m of a point P and rotation in rad, as a row of six. Each body is solved in its
own frame. At an axis the lower body shows a pose `L` under the pads, the upper body a pose `U` at its pads; the
tool moves by Σ (L - U) over the axes plus the pose of the spindle nose, each carried over its lever. Rigid motion
of a body cancels between the `U` below it and the `L` above it, so its supports do not matter. Along the axis
itself the measuring scale or screw decides: the lower pose there is that of the scale's datum plus the expansion
of the scale up to the reading head, the upper pose that of the head.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np
import scipy.sparse as sp
from scipy.interpolate import CubicSpline

from thetacomp.arrays import Floats
from thetacomp.errors import AnalysisError
from thetatwin.description import Description, Patch, Rod, TwinAxis
from thetatwin.elastic import ElasticBody, Supported, support_on_springs, support_statically
from thetatwin.mesh import AXES, BodyMesh, NodeWeights, face_weights, patch_weights
from thetatwin.thermal import ThermalSystem, rod_axis

_DIRECTIONS = np.eye(3)

_PIECE_M = 0.15  # guides are looked at in pieces this large, so that the fit does not depend on the mesh


@dataclass(frozen=True)
class Stations:
    """One axis: positions of the stations (m), reference point of each pose at zero position (3,).

    Its rows in the output matrix are `rows` .. `rows + 6 * len(position_m)`, station by station, holding L - U.
    `point_moves` says whether the reference point travels with the axis (long guide below).
    """

    axis: str
    direction: Floats
    position_m: Floats
    point_m: Floats
    point_moves: bool
    rows: int

    @property
    def end(self) -> int:
        """One past the last row."""
        return self.rows + 6 * len(self.position_m)

    def shares(self, position_mm: Floats) -> Floats:
        """Weights (n, stations) of the stations at n positions: a cubic spline through them."""
        return np.asarray(CubicSpline(self.position_m, np.eye(len(self.position_m)))(position_mm * 1e-3))

    def interpolate(self, outputs: Floats, position_mm: Floats) -> Floats:
        """Pose L - U (n, 6) at n positions from this axis' outputs (n, 6 * stations)."""
        return np.asarray(np.einsum("ns,nsi->ni", self.shares(position_mm), outputs.reshape(len(outputs), -1, 6)))


@dataclass(frozen=True)
class ToolMap:
    """How the output rows make the tool error. `nose_m` is the spindle nose, the tool's seat, with all axes at zero."""

    stations: tuple[Stations, ...]
    nose_m: Floats
    nose_rows: int

    @property
    def size(self) -> int:
        """Number of output rows."""
        return self.nose_rows + 6

    def levers_m(
        self, positions_mm: Mapping[str, Floats], tool_length_mm: Floats | float
    ) -> tuple[Floats, dict[str, Floats], Floats]:
        """Tool point (n, 3), lever from each axis' reference point to it (n, 3), and lever from the spindle nose.

        `positions_mm` holds n commanded positions of every axis; the tool sticks out along -Z.
        """
        travel = {s.axis: s.direction * (positions_mm[s.axis][:, None] * 1e-3) for s in self.stations}
        nose = self.nose_m + np.sum(list(travel.values()), axis=0)
        tool = nose.copy()
        tool[:, 2] -= np.broadcast_to(np.asarray(tool_length_mm, dtype=float) * 1e-3, (len(tool),))
        below, levers = np.zeros_like(tool), {}
        for s in self.stations:
            levers[s.axis] = tool - (s.point_m + below + (travel[s.axis] if s.point_moves else 0.0))
            below = below + travel[s.axis]
        return tool, levers, tool - nose

    def weights(self, positions_mm: Mapping[str, Floats], tool_length_mm: Floats | float) -> Floats:
        """Rows (n, 6, size) that turn the outputs into tool displacement (m) and rotation (rad)."""
        tool, levers, from_nose = self.levers_m(positions_mm, tool_length_mm)
        out = np.zeros((len(tool), 6, self.size))
        for s in self.stations:
            share = s.shares(positions_mm[s.axis])
            carry = carry_pose(levers[s.axis])
            for k in range(len(s.position_m)):
                out[:, :, s.rows + 6 * k : s.rows + 6 * k + 6] += share[:, k, None, None] * carry
        out[:, :, self.nose_rows :] += carry_pose(from_nose)
        return out


def carry_pose(lever_m: Floats) -> Floats:
    """(n, 6, 6) matrices that carry a pose over a lever: u + r x lever, r."""
    n = len(lever_m)
    out = np.tile(np.eye(6), (n, 1, 1))
    x, y, z = lever_m.T
    # r x d = [ry dz - rz dy, rz dx - rx dz, rx dy - ry dx]
    out[:, 0, 4], out[:, 0, 5] = z, -y
    out[:, 1, 3], out[:, 1, 5] = -z, x
    out[:, 2, 3], out[:, 2, 4] = y, -x
    return out


def support_bodies(description: Description, elastic: Mapping[str, ElasticBody]) -> dict[str, Supported]:
    """Stand the bodies with feet on the ground's springs and hold the others statically."""
    grounds = [p for p in description.patches if p.name in description.ground]
    springs = description.ground_stiffness_N_per_mm3 * 1e9, description.ground_shear_N_per_mm3 * 1e9
    out = {}
    for name, body in elastic.items():
        pads = [p for p in grounds if p.body == name]
        out[name] = support_on_springs(body, pads, *springs) if pads else support_statically(body)
    return out


def tool_rows(
    description: Description, bodies: Mapping[str, Supported], system: ThermalSystem
) -> tuple[ToolMap, Floats]:
    """The tool map and its output matrix (size, states): poses per K of every temperature in the machine."""
    stations, blocks, row = [], [], 0
    for axis in description.axes:
        station, block = _axis_rows(description, axis, bodies, system, row)
        stations.append(station)
        blocks.append(block)
        row += len(block)
    nose_m, nose_block = _nose_rows(description, bodies, system)
    return ToolMap(tuple(stations), nose_m, row), np.concatenate([*blocks, nose_block])


def _axis_rows(
    description: Description, axis: TwinAxis, bodies: Mapping[str, Supported], system: ThermalSystem, row: int
) -> tuple[Stations, Floats]:
    patches = {p.name: p for p in description.patches}
    along, e = AXES.index(axis.cartesian), axis.sign * _DIRECTIONS[AXES.index(axis.cartesian)]
    lower, upper = bodies[axis.lower], bodies[axis.upper]
    lower_pads, upper_pads = [patches[n] for n in axis.lower_pads], [patches[n] for n in axis.upper_pads]
    position = np.linspace(*axis.travel_mm, axis.stations) * 1e-3
    short = upper_pads if axis.long_guide == "lower" else lower_pads
    point0 = np.mean([_centre(p) for p in short], axis=0)
    head0 = _centre(patches[axis.measuring.head])
    moves = axis.long_guide == "lower"
    datum = patch_weights(lower.body.mesh, patches[axis.measuring.datum])
    nut = patch_weights(upper.body.mesh, patches[axis.measuring.head])
    # The short guide stays where it is in its own body; the long one is met at every station anew.
    if moves:
        guides = [_windows(lower.body.mesh, lower_pads, short, along, (e * p)[along]) for p in position]
        below = [
            _raw_pose(lower, g, point0 + e * p, along, datum, axis.name) for g, p in zip(guides, position, strict=True)
        ]
        above = [_raw_pose(upper, _whole(upper.body.mesh, upper_pads, along), point0, along, nut, axis.name)]
    else:
        feet = [_windows(upper.body.mesh, upper_pads, short, along, -(e * p)[along]) for p in position]
        below = [_raw_pose(lower, _whole(lower.body.mesh, lower_pads, along), point0, along, datum, axis.name)]
        above = [
            _raw_pose(upper, f, point0 - e * p, along, nut, axis.name) for f, p in zip(feet, position, strict=True)
        ]
    # The lever from the pads' point to the reading head, in machine directions.
    levers = [head0 - point0 if moves else head0 + e * p - point0 for p in position]
    block = np.zeros((6 * len(position), system.states))
    for forms, body, name, sign in ((below, lower, axis.lower, 1.0), (above, upper, axis.upper, -1.0)):
        raw = body.outputs(sp.csr_matrix(sp.vstack(forms)))
        columns = slice(system.offset[name], system.offset[name] + system.size[name])
        for k, lever in enumerate(levers):
            pose = raw[6 * k : 6 * k + 6].copy() if len(forms) > 1 else raw.copy()
            # The rigid motion takes the head along with the mark: u_along = mark - (r x lever)_along.
            pose[along] -= carry_pose(lever[None])[0][along, 3:] @ pose[3:]
            block[6 * k : 6 * k + 6, columns] += sign * pose
    rod = next(r for r in description.rods if r.name == axis.measuring.rod)
    for k, p in enumerate(position):
        states = system.offset[rod.name] + np.arange(rod.segments)
        block[6 * k + along, states] += rod_growth(description, rod, (head0 + e * p)[along])
    return Stations(axis.name, e, position, point0, moves, row), block


def _nose_rows(
    description: Description, bodies: Mapping[str, Supported], system: ThermalSystem
) -> tuple[Floats, Floats]:
    patch = next(p for p in description.patches if p.name == description.nose)
    body = bodies[patch.body]
    weights = patch_weights(body.body.mesh, patch)
    rod = next(r for r in description.rods if r.name == description.spindle)
    nose = np.array(rod.to_mm) * 1e-3
    form = _vector_pose(body, weights, nose)
    block = np.zeros((6, system.states))
    columns = slice(system.offset[patch.body], system.offset[patch.body] + system.size[patch.body])
    block[:, columns] = body.outputs(form)
    along = rod_axis(rod)
    block[along, system.offset[rod.name] + np.arange(rod.segments)] += rod_growth(description, rod, nose[along])
    return nose, block


def rod_growth(description: Description, rod: Rod, reach_m: float) -> Floats:
    """Displacement of the rod's mark at a coordinate, in m per K of each segment: α times the length passed.

    Raises AnalysisError where the coordinate lies beyond the rod.
    """
    axis = rod_axis(rod)
    start, end = rod.from_mm[axis] * 1e-3, rod.to_mm[axis] * 1e-3
    sign = 1.0 if end > start else -1.0
    if not -1e-9 <= (reach_m - start) * sign <= abs(end - start) + 1e-9:
        raise AnalysisError(
            f"rod {rod.name}: the head reaches {reach_m * 1e3:.0f} mm, beyond the rod ({start * 1e3:.0f} to"
            f" {end * 1e3:.0f} mm). Fix: make the rod longer or move the head."
        )
    edges = np.linspace(0.0, abs(end - start), rod.segments + 1)
    passed = np.clip((reach_m - start) * sign - edges[:-1], 0.0, np.diff(edges))
    return np.asarray(sign * description.materials[rod.material].expansion_per_K * passed)


def _centre(patch: Patch) -> Floats:
    return np.asarray((np.array(patch.from_mm) + np.array(patch.to_mm)) * 0.5e-3)


def _windows(
    mesh: BodyMesh, long: Sequence[Patch], short: Sequence[Patch], along: int, shift_m: float
) -> list[NodeWeights]:
    """The parts of long guide faces that lie under short pads moved by `shift_m` along the axis, in pieces."""
    spans = sorted({(s.from_mm[along] * 1e-3 + shift_m, s.to_mm[along] * 1e-3 + shift_m) for s in short})
    return [piece for patch in long for span in spans for piece in _pieces(mesh, patch, along, *span)]


def _whole(mesh: BodyMesh, pads: Sequence[Patch], along: int) -> list[NodeWeights]:
    """Whole pads, in pieces."""
    return [piece for pad in pads for piece in _pieces(mesh, pad, along, -np.inf, np.inf)]


def _pieces(mesh: BodyMesh, patch: Patch, along: int, lo_m: float, hi_m: float) -> list[NodeWeights]:
    """The part of a patch between two coordinates along an axis, cut into pieces of at most `_PIECE_M`."""
    box = np.array([patch.from_mm, patch.to_mm]) * 1e-3
    box[0, along], box[1, along] = max(lo_m, box[0, along]), min(hi_m, box[1, along])
    if box[1, along] <= box[0, along]:
        return []
    counts = np.maximum(np.ceil((box[1] - box[0]) / _PIECE_M - 1e-9), 1).astype(int)
    cuts = [np.linspace(box[0, a], box[1, a], counts[a] + 1) for a in range(3)]
    pieces = [
        face_weights(mesh, np.array([x[0], y[0], z[0]]), np.array([x[1], y[1], z[1]]), patch.normal)
        for x, y, z in product(*(list(pairwise(c)) for c in cuts))
    ]
    return [piece for piece in pieces if len(piece.nodes)]


def _raw_pose(
    body: Supported, pads: Sequence[NodeWeights], point_m: Floats, along: int, mark: NodeWeights, axis: str
) -> sp.csr_matrix:
    """Functionals (6, dofs) of the rigid motion that fits the pads' mean normal displacements best, by area.

    Pads only push along their normals, so motion along the axis is open; its row holds the mean displacement of
    the mark (scale datum or head) instead. Raises AnalysisError where the pads leave another motion open.
    """
    elastic = body.body
    design, area = [], np.array([pad.area_m2 for pad in pads])
    means = np.zeros((len(pads), elastic.stiffness.shape[0]))
    for mean, pad in zip(means, pads, strict=True):
        share = pad.weight_m2 / pad.area_m2
        lever = share @ elastic.mesh.points_m[pad.nodes] - point_m
        direction = int(np.argmax(np.abs(pad.normal)))
        design.append(np.concatenate([pad.normal, np.cross(lever, pad.normal)]))
        mean[elastic.vertex_dofs(direction)[pad.nodes]] = share * pad.normal[direction]
    open_dofs = [d for d in range(6) if d != along]
    a = np.array(design)[:, open_dofs]
    normal_matrix = a.T @ (area[:, None] * a)
    if np.linalg.matrix_rank(normal_matrix, tol=1e-6 * float(np.trace(normal_matrix))) < 5:
        raise AnalysisError(
            f"axis {axis}: its pads do not hold all of the five motions that a linear guide must hold."
            " Fix: add pads with other normals, or pads farther apart."
        )
    rows = np.zeros((6, elastic.stiffness.shape[0]))
    rows[open_dofs] = np.linalg.solve(normal_matrix, a.T * area) @ means
    np.add.at(rows[along], elastic.vertex_dofs(along)[mark.nodes], mark.weight_m2 / mark.area_m2)
    return sp.csr_matrix(rows)


def _vector_pose(body: Supported, weights: NodeWeights, point_m: Floats) -> sp.csr_matrix:
    """Functionals (6, dofs) of the rigid motion that fits all displacements of a face best."""
    elastic = body.body
    lever = elastic.mesh.points_m[weights.nodes] - point_m
    carry = carry_pose(lever)[:, :3, :]  # (n, 3, 6)
    w = weights.weight_m2
    normal_matrix = np.einsum("n,nij,nik->jk", w, carry, carry)
    fit = np.linalg.solve(normal_matrix, np.einsum("n,nij->jni", w, carry).reshape(6, -1))
    columns = np.stack([elastic.vertex_dofs(d)[weights.nodes] for d in range(3)], axis=1).ravel()
    rows = np.zeros((6, elastic.stiffness.shape[0]))
    rows[:, columns] = fit
    return sp.csr_matrix(rows)

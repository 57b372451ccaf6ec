"""From boxes to hexahedra: one structured mesh a body, and exact integrals over rectangles on its faces. Metres."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from thetacomp.arrays import Floats, Ints
from thetacomp.errors import AnalysisError
from thetatwin.description import Block, Body, Patch

AXES = "XYZ"
_TOUCH_M = 1e-6  # planes closer than this are the same plane


@dataclass(frozen=True)
class Faces:
    """Boundary faces of a body, each an axis-aligned rectangle, n faces.

    `corners` (n, 4) are node numbers; `lo_m`, `hi_m` (n, 3) the rectangle; `normal` (n, 3) points outwards;
    `inner` says whether the face looks into a cavity.
    """

    corners: Ints
    lo_m: Floats
    hi_m: Floats
    normal: Floats
    inner: NDArray[np.bool_]


@dataclass(frozen=True)
class BodyMesh:
    """`points_m` (nodes, 3), `cells` (cells, 8) in the corner order x fastest, then y, then z; and its faces."""

    name: str
    points_m: Floats
    cells: Ints
    faces: Faces


@dataclass(frozen=True)
class NodeWeights:
    """Integral of each node's shape function over a part of the faces: `weight_m2` at `nodes`, with the normal."""

    nodes: Ints
    weight_m2: Floats
    normal: Floats

    @property
    def area_m2(self) -> float:
        """Area of that part of the faces."""
        return float(self.weight_m2.sum())


def nearest_surface_node(mesh: BodyMesh, at_mm: Sequence[float]) -> tuple[int, float]:
    """The node on a face, outside or inside, that is nearest to a place, and its distance in mm."""
    nodes = np.unique(mesh.faces.corners)
    apart_mm = np.linalg.norm(mesh.points_m[nodes] * 1e3 - np.asarray(at_mm), axis=1)
    best = int(np.argmin(apart_mm))
    return int(nodes[best]), float(apart_mm[best])


def sides(mesh: BodyMesh, nodes: Ints | Sequence[int]) -> list[str]:
    """Where the faces at nodes look, such as "-X" or "-X+Y"."""
    looks = np.zeros((len(mesh.points_m), 6), dtype=bool)
    for column in range(6):
        axis, sign = divmod(column, 2)
        faces = mesh.faces.corners[mesh.faces.normal[:, axis] == (1.0 if sign else -1.0)]
        looks[faces, column] = True
    names = [f"{sign}{axis}" for axis in AXES for sign in "-+"]
    return ["".join(name for name, seen in zip(names, looks[k], strict=True) if seen) for k in nodes]


def mesh_body(body: Body, refinement: float = 1.0) -> BodyMesh:
    """Mesh one body; elements are at most `element_mm / refinement` long. Raises AnalysisError for an empty body."""
    solids = [_solid_parts(block) for block in body.blocks]
    planes = [_grid_planes(body, axis, body.element_mm / refinement) for axis in range(3)]
    centres = [0.5 * (p[1:] + p[:-1]) for p in planes]
    cx, cy, cz = np.meshgrid(*centres, indexing="ij")
    middle = np.stack([cx.ravel(), cy.ravel(), cz.ravel()], axis=1)
    solid = np.zeros(len(middle), dtype=bool)
    for outer, hollow in solids:
        solid |= _inside(middle, *outer) & ~_inside_any(middle, hollow)
    for cut in body.cuts:
        solid &= ~_inside(middle, np.array(cut.from_mm), np.array(cut.to_mm))
    if not solid.any():
        raise AnalysisError(f"body {body.name}: no material is left after the cuts. Fix: check its blocks and cuts.")
    shape = tuple(len(p) for p in planes)
    i, j, k = (index[solid] for index in np.unravel_index(np.arange(len(middle)), tuple(n - 1 for n in shape)))
    corner = [np.ravel_multi_index((i + a, j + b, k + c), shape) for c in (0, 1) for b in (0, 1) for a in (0, 1)]
    used, cells = np.unique(np.stack(corner, axis=1), return_inverse=True)
    grid = np.stack(np.meshgrid(*planes, indexing="ij"), axis=-1).reshape(-1, 3)[used] * 1e-3
    cells = cells.reshape(-1, 8).astype(np.int64)
    hollows = [hollow for _, parts in solids for hollow in parts]
    hollows += [(np.array(cut.from_mm), np.array(cut.to_mm)) for cut in body.cuts]
    return BodyMesh(body.name, grid, cells, _boundary(grid, cells, hollows))


Box = tuple[Floats, Floats]


def _solid_parts(block: Block) -> tuple[Box, list[Box]]:
    """Outer box of a block and the boxes of its cavities, in mm."""
    lo, hi = np.array(block.from_mm), np.array(block.to_mm)
    if block.wall_mm is None:
        return (lo, hi), []
    wall = np.array(block.wall_mm)
    cells: list[Box] = [(lo + wall, hi - wall)]
    for axis, ribs in enumerate((block.ribs_X_mm, block.ribs_Y_mm, block.ribs_Z_mm)):
        for centre in ribs:
            cells = [part for cell in cells for part in _split(cell, axis, centre, block.rib_mm)]
    return (lo, hi), cells


def _split(cell: Box, axis: int, centre: float, thickness: float) -> list[Box]:
    lo, hi = cell
    if not lo[axis] < centre < hi[axis]:
        return [cell]
    below, above = hi.copy(), lo.copy()
    below[axis], above[axis] = centre - thickness / 2, centre + thickness / 2
    return [(lo, below), (above, hi)]


def _grid_planes(body: Body, axis: int, element_mm: float) -> Floats:
    """Planes of every box of the body across one axis, refined to the element size, in mm."""
    marks: list[float] = []
    for block in body.blocks:
        (lo, hi), cavities = _solid_parts(block)
        marks += [lo[axis], hi[axis], *(v for cavity in cavities for v in (cavity[0][axis], cavity[1][axis]))]
    for cut in body.cuts:
        marks += [cut.from_mm[axis], cut.to_mm[axis]]
    planes = np.unique(np.round(marks, 3))
    pieces = [np.linspace(a, b, int(np.ceil((b - a) / element_mm - 1e-9)) + 1)[:-1] for a, b in pairwise(planes)]
    return np.concatenate([*pieces, planes[-1:]])


def _inside(points: Floats, lo: Floats, hi: Floats) -> NDArray[np.bool_]:
    return np.asarray(np.all((points > lo) & (points < hi), axis=1))


def _inside_any(points: Floats, boxes: Iterable[Box]) -> NDArray[np.bool_]:
    found = np.zeros(len(points), dtype=bool)
    for lo, hi in boxes:
        found |= _inside(points, lo, hi)
    return found


# Corners of the six faces of a cell, in the cell's own order, with the outward normal.
_CELL_FACES = (
    ((0, 2, 4, 6), (-1, 0, 0)),
    ((1, 3, 5, 7), (1, 0, 0)),
    ((0, 1, 4, 5), (0, -1, 0)),
    ((2, 3, 6, 7), (0, 1, 0)),
    ((0, 1, 2, 3), (0, 0, -1)),
    ((4, 5, 6, 7), (0, 0, 1)),
)


def _boundary(points_m: Floats, cells: Ints, hollows_mm: list[Box]) -> Faces:
    corners = np.concatenate([cells[:, list(local)] for local, _ in _CELL_FACES])
    normal = np.concatenate([np.tile(np.array(n, dtype=float), (len(cells), 1)) for _, n in _CELL_FACES])
    # A face that two cells share is inside the material: its smallest and largest node occur twice.
    key = np.sort(corners, axis=1)
    _, where, count = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    outside = count[where.ravel()] == 1
    corners, normal = corners[outside], normal[outside]
    lo, hi = points_m[corners].min(axis=1), points_m[corners].max(axis=1)
    # A point just off the face shows what the face looks at.
    probe = 0.5 * (lo + hi) + normal * 1e-4
    inner = _inside_any(probe * 1e3, hollows_mm)
    return Faces(corners.astype(np.int64), lo, hi, normal, inner)


def _hat_integrals(lo: Floats, hi: Floats, a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """∫ of the falling and the rising linear shape function of the interval (lo, hi) over its part in (a, b)."""
    length = hi - lo
    s0 = np.clip((a - lo) / length, 0.0, 1.0)
    s1 = np.clip((b - lo) / length, 0.0, 1.0)
    rising = 0.5 * (s1**2 - s0**2) * length
    return (s1 - s0) * length - rising, rising


def face_weights(mesh: BodyMesh, lo_m: Floats, hi_m: Floats, normal: str = "any") -> NodeWeights:
    """Integrate every node's shape function over the faces inside a box, exactly (the faces are rectangles).

    `normal` such as "+Y" keeps only faces that look that way. Nodes appear once; their normals are those of the
    faces, so a part with several normals is queried normal by normal.
    """
    faces = mesh.faces
    keep = np.ones(len(faces.corners), dtype=bool)
    if normal != "any":
        wanted = np.zeros(3)
        wanted[AXES.index(normal[1])] = 1.0 if normal[0] == "+" else -1.0
        keep &= np.all(faces.normal == wanted, axis=1)
    keep &= np.all((faces.lo_m <= hi_m + _TOUCH_M) & (faces.hi_m >= lo_m - _TOUCH_M), axis=1)
    corners, f_lo, f_hi, f_n = faces.corners[keep], faces.lo_m[keep], faces.hi_m[keep], faces.normal[keep]
    weight = np.ones((len(corners), 4))
    for axis in range(3):
        flat = f_n[:, axis] != 0
        span = np.where(flat, 1.0, f_hi[:, axis] - f_lo[:, axis])
        falling, rising = _hat_integrals(f_lo[:, axis], f_lo[:, axis] + span, lo_m[axis], hi_m[axis])
        at_high = mesh.points_m[corners, axis] > 0.5 * (f_lo[:, axis] + f_hi[:, axis])[:, None]
        factor = np.where(at_high, rising[:, None], falling[:, None])
        weight *= np.where(flat[:, None], 1.0, factor)
    nodes, position = np.unique(corners, return_inverse=True)
    total = np.bincount(position.ravel(), weights=weight.ravel(), minlength=len(nodes))
    touched = total > 1e-15
    mean_normal = f_n[0] if len(f_n) else np.zeros(3)
    return NodeWeights(nodes[touched].astype(np.int64), total[touched].astype(np.float64), mean_normal)


def patch_weights(mesh: BodyMesh, patch: Patch) -> NodeWeights:
    """Node weights of a patch. Raises AnalysisError where no face lies in it."""
    weights = face_weights(mesh, np.array(patch.from_mm) * 1e-3, np.array(patch.to_mm) * 1e-3, patch.normal)
    if len(weights.nodes) == 0:
        raise AnalysisError(
            f"patch {patch.name}: body {patch.body} has no face with normal {patch.normal} inside"
            f" {patch.from_mm} to {patch.to_mm} mm. Fix: check the patch against the body's blocks."
        )
    return weights

"""Faces to pixels: the nearest face wins in every pixel (a depth buffer), with smooth values on each face."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thetacomp.arrays import Floats

# A point may lie this far behind what is drawn in its pixel and still counts as seen.
_NEAR_M = 0.03
# Corners of a quadrilateral on its own square, going round, and the two triangles that fill it without a gap.
_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
_TRIANGLES = ((0, 1, 2), (0, 2, 3))


@dataclass(frozen=True)
class Canvas:
    """A picture of h x w pixels, row 0 lowest: `value` NaN and `depth` -inf where nothing is; larger depth is nearer.

    Pixel (row, column) has its middle at `left_m + (column + 0.5) step_m`, `low_m + (row + 0.5) step_m`.
    """

    value: Floats
    light: Floats
    depth: Floats
    left_m: float
    low_m: float
    step_m: float

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """Left, right, low, high edge."""
        rows, columns = self.value.shape
        return (self.left_m, self.left_m + columns * self.step_m, self.low_m, self.low_m + rows * self.step_m)

    def sees(self, points_m: Floats) -> NDArray[np.bool_]:
        """Which points (n, 3), given as right, up and towards the eye, no face hides."""
        rows, columns = self.value.shape
        i = np.clip(((points_m[:, 1] - self.low_m) / self.step_m).astype(int), 0, rows - 1)
        j = np.clip(((points_m[:, 0] - self.left_m) / self.step_m).astype(int), 0, columns - 1)
        return np.asarray(points_m[:, 2] + _NEAR_M >= self.depth[i, j])


def paint(corners_m: Floats, values: Floats, light: Floats, pixels: int, margin_m: float = 0.0) -> Canvas:
    """Paint quadrilaterals `corners_m` (n, 4, 3), given as right, up, towards the eye, going round.

    `values` (n, 4) at the corners are interpolated bilinearly, `light` (n,) is constant on each. `pixels` is the
    height of the picture.
    """
    flat = corners_m.reshape(-1, 3)
    (left, low), (right, high) = flat[:, :2].min(axis=0) - margin_m, flat[:, :2].max(axis=0) + margin_m
    step = float(high - low) / pixels
    shape = (pixels, max(1, int(np.ceil((right - left) / step))))
    canvas = Canvas(np.full(shape, np.nan), np.ones(shape), np.full(shape, -np.inf), float(left), float(low), step)
    placed = corners_m.copy()
    placed[..., :2] = (placed[..., :2] - np.array([left, low])) / step - 0.5
    for corners, value, shade in zip(placed, values, light, strict=True):
        for triangle in _TRIANGLES:
            _fill(canvas, corners[list(triangle)], corners[:, 2], value, shade, _CORNERS[list(triangle)])
    return canvas


def _fill(canvas: Canvas, points: Floats, depths: Floats, values: Floats, shade: float, square: Floats) -> None:
    """Paint one triangle of a quadrilateral: `points` (3, 3) in pixels, `square` (3, 2) its corners on the square."""
    (x0, y0), (x1, y1), (x2, y2) = points[:, :2]
    area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
    rows, columns = canvas.value.shape
    j0, j1 = max(0, int(np.ceil(points[:, 0].min()))), min(columns - 1, int(points[:, 0].max()))
    i0, i1 = max(0, int(np.ceil(points[:, 1].min()))), min(rows - 1, int(points[:, 1].max()))
    if abs(area) < 1e-9 or j1 < j0 or i1 < i0:
        return
    x, y = np.arange(j0, j1 + 1)[None, :], np.arange(i0, i1 + 1)[:, None]
    second = ((x - x0) * (y2 - y0) - (x2 - x0) * (y - y0)) / area
    third = ((x1 - x0) * (y - y0) - (x - x0) * (y1 - y0)) / area
    first = 1.0 - second - third
    inside = (first >= -1e-9) & (second >= -1e-9) & (third >= -1e-9)
    if not inside.any():
        return
    weights = np.stack([first[inside], second[inside], third[inside]], axis=1)
    u, v = (weights @ square).T
    shares = np.stack([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v], axis=1)
    depth = shares @ depths
    i, j = np.nonzero(inside)
    nearer = depth > canvas.depth[i + i0, j + j0]
    at = (i[nearer] + i0, j[nearer] + j0)
    canvas.depth[at], canvas.light[at] = depth[nearer], shade
    canvas.value[at] = (shares @ values)[nearer]


def contour_lines(canvas: Canvas, step: float) -> NDArray[np.bool_]:
    """Pixels (h, w) where the value passes a multiple of `step` inside one surface."""
    level = np.floor(np.nan_to_num(canvas.value, nan=0.0) / step)
    line = np.zeros(level.shape, dtype=bool)
    for axis in (0, 1):
        ahead, here = [slice(None)] * 2, [slice(None)] * 2
        ahead[axis], here[axis] = slice(1, None), slice(None, -1)
        a, b = tuple(ahead), tuple(here)
        with np.errstate(invalid="ignore"):  # both empty: -inf less -inf
            same = np.abs(canvas.depth[a] - canvas.depth[b]) < 4 * canvas.step_m
        # A jump by more than one level is an edge between faces, not a line on one.
        passes = same & (np.abs(level[a] - level[b]) == 1) & np.isfinite(canvas.value[a] + canvas.value[b])
        line[a] |= passes
        line[b] |= passes
    return line


def smaller(image: Floats, factor: int) -> Floats:
    """Mean over blocks of factor x factor pixels of an RGBA picture (h, w, 4); colours count by their opacity."""
    rows, columns = (n // factor * factor for n in image.shape[:2])
    blocks = image[:rows, :columns].reshape(rows // factor, factor, columns // factor, factor, 4)
    alpha = blocks[..., 3:]
    total = alpha.sum(axis=(1, 3))
    colour = (blocks[..., :3] * alpha).sum(axis=(1, 3)) / np.maximum(total, 1e-9)
    return np.concatenate([colour, total / factor**2], axis=-1)

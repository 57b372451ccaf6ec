"""Geometry `G(p)`: candidate curves and their choice by hold-out of whole sweeps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.interpolate import BSpline

from thetacomp.arrays import Floats, Ints

MAX_DEGREE = 9
SPLINE_PENALTIES = (1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0, 100.0)
MAX_SPLINE_INTERVALS = 60
# A simpler curve is preferred while its hold-out error is within one percent of the best.
TOLERANCE = 1.01


@dataclass(frozen=True)
class Curve:
    """A linear basis of `G(p)` for one approach direction, with a roughness penalty (zero for polynomials)."""

    name: str
    p_min_mm: float
    p_max_mm: float
    degree: int
    knots: Floats | None
    penalty: Floats

    def basis(self, position_mm: Floats) -> Floats:
        """Basis functions at `position_mm`, shape (n, size)."""
        x = 2.0 * (position_mm - self.p_min_mm) / (self.p_max_mm - self.p_min_mm) - 1.0
        if self.knots is None:
            return np.asarray(legvander(x, self.degree), dtype=float)
        return np.asarray(BSpline.design_matrix(np.clip(x, -1.0, 1.0), self.knots, self.degree).toarray())

    @property
    def size(self) -> int:
        """Number of basis functions."""
        return len(self.penalty)


def polynomial(degree: int, p_min_mm: float, p_max_mm: float) -> Curve:
    """A polynomial in Legendre form over the measured range."""
    size = degree + 1
    return Curve(f"polynomial of degree {degree}", p_min_mm, p_max_mm, degree, None, np.zeros((size, size)))


def smoothing_spline(penalty: float, intervals: int, p_min_mm: float, p_max_mm: float) -> Curve:
    """A cubic P-spline: equidistant knots and a penalty on second differences (Eilers and Marx 1996)."""
    step = 2.0 / intervals
    knots = np.asarray(-1.0 + step * np.arange(-3, intervals + 4), dtype=float)
    size = intervals + 3
    second = np.diff(np.eye(size), n=2, axis=0)
    name = f"smoothing spline, penalty {penalty:g}"
    return Curve(name, p_min_mm, p_max_mm, 3, knots, penalty * second.T @ second)


def candidates(position_mm: Floats) -> tuple[Curve, ...]:
    """Curves that the measured positions can support, from simple to flexible."""
    distinct = np.unique(position_mm)
    p_min_mm, p_max_mm = float(distinct[0]), float(distinct[-1])
    top = min(MAX_DEGREE, len(distinct) - 1)
    curves = [polynomial(degree, p_min_mm, p_max_mm) for degree in range(1, top + 1)]
    if len(distinct) >= 6:
        intervals = min(MAX_SPLINE_INTERVALS, len(distinct) - 1)
        curves += [smoothing_spline(penalty, intervals, p_min_mm, p_max_mm) for penalty in reversed(SPLINE_PENALTIES)]
    return tuple(curves)


def flexible_curve(position_mm: Floats) -> Curve:
    """A curve that follows any smooth geometry: a lightly smoothed spline, or the top polynomial for few positions."""
    curves = candidates(position_mm)
    splines = [curve for curve in curves if curve.knots is not None]
    return splines[len(splines) // 2 + 1] if splines else curves[-1]


def direction_design(curve: Curve, position_mm: Floats, direction: Ints, directions: Sequence[int]) -> Floats:
    """Basis of all approach directions side by side: each direction has a curve of its own."""
    basis = curve.basis(position_mm)
    return np.hstack([basis * (direction == sign)[:, None] for sign in directions])


def direction_penalty(curve: Curve, directions: Sequence[int]) -> Floats:
    """Roughness penalty that belongs to `direction_design`."""
    return np.asarray(np.kron(np.eye(len(directions)), curve.penalty))


def choose_curve(position_mm: Floats, direction: Ints, sweep: Ints, error_um: Floats) -> Curve:
    """The curve whose shape predicts left-out sweeps best.

    Every sweep keeps a free line of its own (that is what heat changes), so only the shape is judged. With a single
    sweep the positions are left out in turn instead: every third point.
    """
    directions = tuple(int(d) for d in np.unique(direction))
    curves = candidates(position_mm)
    best: tuple[float, Curve] | None = None
    for family in ([c for c in curves if c.knots is None], [c for c in curves if c.knots is not None]):
        if not family:
            continue
        widest = family[-1]
        design = direction_design(widest, position_mm, direction, directions)
        products = _fold_products(design, error_um, position_mm, sweep)
        for curve in family:
            # Polynomials are nested: a lower degree is a choice of columns of the highest.
            columns = np.concatenate([k * widest.size + np.arange(curve.size) for k in range(len(directions))])
            score = _held_out_score(products, columns, direction_penalty(curve, directions))
            if best is None or score * TOLERANCE < best[0]:
                best = (score, curve)
    assert best is not None
    return best[1]


@dataclass(frozen=True)
class _Products:
    """Cross products of every fold: gram (K, q, q), right (K, q), power (K,), and the degrees of freedom in all."""

    gram: Floats
    right: Floats
    power: Floats
    freedom: int


def _fold_products(design: Floats, error_um: Floats, position_mm: Floats, sweep: Ints) -> _Products:
    numbers = np.unique(sweep)
    by_sweep = len(numbers) > 1
    fold = np.searchsorted(numbers, sweep) if by_sweep else np.arange(len(sweep)) % 3
    gram, right, power, freedom = [], [], [], 0
    for number in np.unique(fold):
        rows = fold == number
        part, target = design[rows], error_um[rows]
        if by_sweep:
            line = np.column_stack([np.ones(len(part)), position_mm[rows] - position_mm[rows].mean()])
            q, _ = np.linalg.qr(line)
            part, target = part - q @ (q.T @ part), target - q @ (q.T @ target)
        gram.append(part.T @ part)
        right.append(part.T @ target)
        power.append(target @ target)
        freedom += max(len(part) - (2 if by_sweep else 0), 1)
    return _Products(np.array(gram), np.array(right), np.array(power), freedom)


def _held_out_score(products: _Products, columns: Ints, penalty: Floats) -> float:
    """Mean squared error of left-out folds per degree of freedom, from the cross products alone."""
    gram = products.gram[:, columns[:, None], columns]
    right = products.right[:, columns]
    total = gram.sum(axis=0)
    # Removing lines leaves directions of the basis undetermined; a tiny ridge picks the shortest solution.
    tiny = 1e-9 * max(float(np.trace(total)) / len(total), 1e-12) * np.eye(len(total))
    others = total - gram + penalty + tiny
    coefficients = np.linalg.solve(others, (right.sum(axis=0) - right)[..., None])[..., 0]
    error = (
        products.power
        - 2.0 * np.einsum("ki,ki->k", coefficients, right)
        + np.einsum("ki,kij,kj->k", coefficients, gram, coefficients)
    )
    return float(error.sum()) / products.freedom

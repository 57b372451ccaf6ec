"""Where sensors are most informative: greedy choice by low-rank updates, exact for small cases, what is left unknown.

The thermal field is x in r modes with mean zero and unit covariance. A sensor reads a x plus noise of standard
deviation σ, the tool moves by C x. After readings of rows A the covariance of x is
P = (I + Aᵀ A / σ²)⁻¹ = I - Aᵀ (A Aᵀ + σ² I)⁻¹ A (Kalman 1960, the measurement update), that of the tool C P Cᵀ.
D-optimal: largest log det(I + Aᵀ A / σ²). A-optimal for the tool: smallest trace of C P Cᵀ.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, islice
from math import comb
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from thetacomp.arrays import Floats, Ints
from thetacomp.errors import AnalysisError

Goal = Literal["information", "displacement"]
_MOST_SUBSETS = 2_000_000
_BATCH = 4096


@dataclass(frozen=True)
class Field:
    """Places and tool in r modes of unit variance: temperature `rows_K` (n, r), displacement `outputs_um` (q, r)."""

    rows_K: Floats
    outputs_um: Floats


@dataclass(frozen=True)
class Spacing:
    """Chosen places stand at least `apart_mm` from each other; `points_mm` (n, 3)."""

    points_mm: Floats
    apart_mm: float

    def near(self, index: int) -> NDArray[np.bool_]:
        """Which candidates are too near to one of them, (n,)."""
        return np.asarray(np.linalg.norm(self.points_mm - self.points_mm[index], axis=1) < self.apart_mm)


def field_of_modes(rows_K: Floats, outputs_um: Floats, covariance: Floats, modes: int) -> Field:
    """The field in its strongest shared modes.

    `rows_K` (n, R) and `outputs_um` (q, R) act on R coordinates of this `covariance` (R, R). Temperatures and
    displacements are each scaled to unit total variance, so that neither decides alone which modes count.
    """
    size, turn = np.linalg.eigh(covariance)
    root = turn * np.sqrt(np.maximum(size, 0.0))
    heat = root.T @ (rows_K.T @ rows_K) @ root
    motion = root.T @ (outputs_um.T @ outputs_um) @ root
    combined = sum(part / np.trace(part) for part in (heat, motion) if np.trace(part) > 0)
    _, vectors = np.linalg.eigh(np.asarray(combined))
    lead = root @ vectors[:, ::-1][:, :modes]
    return Field(np.ascontiguousarray(rows_K @ lead), np.asarray(outputs_um @ lead))


def greedy(field: Field, noise_K: float, count: int, goal: Goal, spacing: Spacing | None = None) -> Ints:
    """Places (count,) one after the other, each time the one that helps the goal most with those already chosen.

    Each step costs O(n (r + min(q, r))). For "information" the result holds at least 1 - 1/e of the best
    log det (Nemhauser, Wolsey, Fisher 1978, when no spacing is required); for "displacement" there is no such bound.
    Raises AnalysisError where fewer than `count` places are left.
    """
    rows, outputs = field.rows_K, _compact(field.outputs_um)
    covariance = np.eye(rows.shape[1])
    variance = np.einsum("ij,ij->i", rows, rows)
    # Variance of the tool that each place would explain: |C P a|², kept up to date along with aᵀ P a.
    cross = rows @ outputs.T if goal == "displacement" else np.zeros((len(rows), 0))
    free = np.ones(len(rows), dtype=bool)
    chosen = np.empty(count, dtype=np.int64)
    for k in range(count):
        if goal == "displacement":
            gain = np.einsum("ij,ij->i", cross, cross) / (variance + noise_K**2)
        else:
            gain = variance.copy()  # log(1 + variance / σ²) grows with the variance
        best = chosen[k] = _best(gain, free, k, count)
        direction = covariance @ rows[best]
        total = direction @ rows[best] + noise_K**2
        seen = rows @ direction
        if goal == "displacement":
            cross -= np.outer(seen, outputs @ (direction / total))
        variance = np.maximum(variance - seen**2 / total, 0.0)
        covariance -= np.outer(direction, direction) / total
        _block(free, int(best), spacing)
    return chosen


def exchange(field: Field, noise_K: float, chosen: Ints, spacing: Spacing | None = None) -> Ints:
    """Replace one place after the other by the best other one while the tool's error falls; the most useful first.

    The set is at least as good as the one it starts from (Fedorov 1972, for D-optimal designs). O(n (r² + q r)) a try.
    """
    rows, outputs = field.rows_K, _compact(field.outputs_um)
    inside = [int(i) for i in chosen]
    changed = len(inside) > 0
    while changed:
        changed = False
        for k, own in enumerate(inside):
            rest = inside[:k] + inside[k + 1 :]
            seen = rows[rest]
            inner = seen @ seen.T + noise_K**2 * np.eye(len(rest))
            direction = rows - (rows @ seen.T) @ np.linalg.solve(inner, seen)  # rows of A P without this sensor
            gain = np.sum((direction @ outputs.T) ** 2, axis=1) / (np.einsum("ij,ij->i", direction, rows) + noise_K**2)
            free = np.ones(len(rows), dtype=bool)
            for other in rest:
                _block(free, other, spacing)
            best = int(np.argmax(np.where(free, gain, -np.inf)))
            # A gain within rounding is none: otherwise two equal places could take turns for ever.
            if gain[best] > gain[own] * (1.0 + 1e-9):
                inside[k], changed = best, True
    found = np.array(inside, dtype=np.int64)
    return np.asarray(found[greedy(Field(rows[found], outputs), noise_K, len(found), "displacement")])


def by_sensitivity(response: Floats, count: int, spacing: Spacing | None = None) -> Ints:
    """Places (count,) of the largest response per unit of heat, a new source each time while sources are left.

    `response` (n, sources). Without turns all places would crowd round the one source with the largest response.
    """
    free, waiting = np.ones(len(response), dtype=bool), np.ones(response.shape[1], dtype=bool)
    chosen = np.empty(count, dtype=np.int64)
    for k in range(count):
        if not waiting.any():
            waiting[:] = True
        best = chosen[k] = _best(response[:, waiting].max(axis=1), free, k, count)
        sources = np.flatnonzero(waiting)
        waiting[sources[int(np.argmax(response[best, waiting]))]] = False
        _block(free, int(best), spacing)
    return chosen


def _best(gain: Floats, free: NDArray[np.bool_], step: int, count: int) -> np.int64:
    if not free.any():
        raise AnalysisError(
            f"only {step} of {count} sensors find a place. Fix: ask for fewer, or allow more places in the mounting"
            " file (smaller apart_mm, fewer keep-out boxes)."
        )
    return np.int64(np.argmax(np.where(free, gain, -np.inf)))


def _block(free: NDArray[np.bool_], index: int, spacing: Spacing | None) -> None:
    if spacing is not None:
        free &= ~spacing.near(index)
    free[index] = False


def _compact(outputs_um: Floats) -> Floats:
    """Fewer rows with the same Cᵀ C."""
    return np.asarray(np.linalg.qr(outputs_um, mode="r")) if len(outputs_um) > outputs_um.shape[1] else outputs_um


def value(field: Field, noise_K: float, sets: Ints, goal: Goal) -> Floats:
    """What sets (m, k) of places are worth, (m,): log det in nats, or the tool's explained variance in µm²."""
    rows = field.rows_K[sets]
    inner = rows @ rows.transpose(0, 2, 1) + noise_K**2 * np.eye(sets.shape[1])
    if goal == "information":
        return np.asarray(np.linalg.slogdet(inner / noise_K**2)[1])
    seen = rows @ _compact(field.outputs_um).T
    return np.asarray(np.einsum("mkq,mkq->m", seen, np.linalg.solve(inner, seen)))


def best_subset(field: Field, noise_K: float, count: int, goal: Goal) -> tuple[Ints, float]:
    """The best set of that size and its value, by looking at every one. Raises AnalysisError above 2 million sets."""
    n = len(field.rows_K)
    if not 1 <= count <= n or comb(n, count) > _MOST_SUBSETS:
        raise AnalysisError(f"{count} of {n} places are too many sets to look at each. Fix: take fewer candidates.")
    best, highest = np.zeros(count, dtype=np.int64), -np.inf
    for sets in _batches(n, count):
        found = value(field, noise_K, sets, goal)
        if found.max() > highest:
            best, highest = sets[int(np.argmax(found))], float(found.max())
    return best, highest


def _batches(n: int, count: int) -> Iterator[Ints]:
    subsets = combinations(range(n), count)
    while part := list(islice(subsets, _BATCH)):
        yield np.array(part, dtype=np.int64)


def tool_covariance_um2(field: Field, noise_K: float, chosen: Sequence[int] | Ints) -> Floats:
    """Covariance (q, q) of the displacement that readings at the chosen places leave."""
    seen = field.rows_K[np.asarray(chosen, dtype=np.int64)]
    inner = seen @ seen.T + noise_K**2 * np.eye(len(seen))
    cross = seen @ field.outputs_um.T
    return np.asarray(field.outputs_um @ field.outputs_um.T - cross.T @ np.linalg.solve(inner, cross))


def expected_squares_um2(
    rows_K: Floats, outputs_um: Floats, covariance: Floats, noise_K: float, moment: Floats
) -> Floats:
    """Mean squared error (q,) of the linear estimate of the tool on other states than those it was made from.

    The estimate is K = C P Aᵀ (A P Aᵀ + σ² I)⁻¹ with the `covariance` P (R, R) of the states it was made from;
    `moment` (R, R) is the second moment of the other states about the mean of the first. The error is
    diag((C - K A) M (C - K A)ᵀ) + σ² diag(K Kᵀ): the noise is counted exactly, not drawn.
    """
    inner = rows_K @ covariance @ rows_K.T + noise_K**2 * np.eye(len(rows_K))
    gain = np.linalg.solve(inner, rows_K @ covariance @ outputs_um.T).T
    left = outputs_um - gain @ rows_K
    return np.asarray(np.einsum("qi,qi->q", left @ moment, left) + noise_K**2 * np.einsum("qk,qk->q", gain, gain))

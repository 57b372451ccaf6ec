"""One drift for all sweeps of a campaign: their intercepts and the drift record in one least-squares problem.

Unknown are the drift at every heated sweep, at further moments that only the drift record covers, and one constant of
that record: its instrument may have its own zero. The intercepts enter with their full covariance, the means of
the record with the scatter of neighbouring means.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats, Ints
from thetacomp.campaign import Drift
from thetacomp.separation.axis_shares import between_nodes

LOOK_S = 120.0
NODE_S = 600.0
MIN_MEANS = 5


@dataclass(frozen=True)
class DriftMeans:
    """The drift record as n means over two minutes: `error` (n, 3) in µm (or µrad), NaN where it is missing.

    `gross_s` holds the moments of readings that were left out before, one array for each column, and `resolution` the
    division of the instrument in each column, 0 where it is too fine to be seen.
    """

    t_s: Floats
    error: Floats
    at_mm: dict[str, Floats]
    gross_s: tuple[Floats, ...] = ()
    resolution: tuple[float, ...] = ()


@dataclass(frozen=True)
class Nodes:
    """Drift at n moments in order of time: value and standard error; `sweep` is -1 where no sweep was measured."""

    t_s: Floats
    value: Floats
    se: Floats
    sweep: Ints


def drift_means(drift: Drift, error: Floats, at_mm: dict[str, Floats]) -> DriftMeans:
    """Means of what was read in two minutes; a new mean begins where an axis stands elsewhere."""
    moved = np.zeros(len(drift.t_s), dtype=bool)
    for position_mm in at_mm.values():
        moved[1:] |= np.abs(np.diff(position_mm)) > 1e-6
    number, start_s, numbers = -1, -np.inf, []
    for t_s, new in zip(drift.t_s, moved, strict=True):
        if new or t_s - start_s > LOOK_S:
            number, start_s = number + 1, float(t_s)
        numbers.append(number)
    step = np.array(numbers)
    rows = [np.flatnonzero(step == k) for k in range(number + 1)]
    return DriftMeans(
        np.array([drift.t_s[row].mean() for row in rows]),
        np.array([_mean(error[row]) for row in rows]).reshape(-1, error.shape[1]),
        {name: np.array([position_mm[row[0]] for row in rows]) for name, position_mm in at_mm.items()},
    )


def _mean(error: Floats) -> Floats:
    """Mean of each column without its missing values; NaN where all are missing."""
    known = np.isfinite(error)
    total, count = np.where(known, error, 0.0).sum(axis=0), known.sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def scatter(value: Floats) -> float:
    """Standard deviation of the means from the steps between neighbours, gross ones cut; the drift itself counts."""
    step = np.diff(value)
    limit = 3.0 * 1.4826 * float(np.median(np.abs(step)))
    return float(np.sqrt(np.mean(np.clip(step, -limit, limit) ** 2) / 2.0))


def join(
    sweeps: Nodes, covariance: Floats, zero_s: float, mean_s: Floats, mean_value: Floats, mean_arms: Floats, sd: float
) -> Nodes:
    """Drift of the heated sweeps (m,) joined with the two-minute means of a record (n,) of standard deviation `sd`.

    The means have the slopes' share taken off as separated; the errors of these p slopes are unknowns too, since they
    are in the drift of the sweeps as well: `covariance` (m + p, m + p) is that of drift and slopes, `mean_arms` (n, p)
    is what each slope adds to a mean. The drift is zero by definition up to `zero_s`.
    """
    m, p = len(sweeps.t_s), mean_arms.shape[1]
    far_s = _far_bins(mean_s, zero_s, sweeps.t_s)
    t_s = np.concatenate([sweeps.t_s, far_s])
    order = np.argsort(t_s, kind="stable")
    drift = np.zeros((len(mean_s), len(t_s)))
    drift[:, order] = between_nodes(zero_s, t_s[order], mean_s)
    design = np.column_stack([drift[:, :m], mean_arms, drift[:, m:], np.ones(len(mean_s))])
    information = np.linalg.pinv(covariance, hermitian=True)
    normal = design.T @ design / sd**2
    right = design.T @ mean_value / sd**2
    normal[: m + p, : m + p] += information
    right[: m + p] += information @ np.concatenate([sweeps.value, np.zeros(p)])
    inverse = np.linalg.pinv(normal, hermitian=True)
    kept = np.concatenate([np.arange(m), m + p + np.arange(len(far_s))])[order]
    sweep = np.concatenate([sweeps.sweep, np.full(len(far_s), -1)])
    return Nodes(t_s[order], (inverse @ right)[kept], np.sqrt(np.maximum(np.diag(inverse)[kept], 0.0)), sweep[order])


def _far_bins(mean_s: Floats, zero_s: float, sweep_s: Floats) -> Floats:
    """Further nodes: mean times in bins of ten minutes, of what lies more than ten minutes from every heated sweep."""
    distance_s = np.abs(mean_s[:, None] - np.append(sweep_s, zero_s)).min(axis=1)
    far_s: Floats = mean_s[(distance_s > NODE_S) & (mean_s > zero_s)]
    if not len(far_s):
        return far_s
    number = np.floor((far_s - far_s[0]) / NODE_S)
    return np.array([far_s[number == k].mean() for k in np.unique(number)])

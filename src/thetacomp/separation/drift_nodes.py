"""One drift for all sweeps of a campaign: their intercepts and the drift record in one least-squares problem.

Unknown are the drift at every heated sweep, at further moments where only the drift record looked, and one constant of
that record: its instrument may have a zero of its own. The intercepts enter with their full covariance, the looks of
the record with the scatter of neighbouring looks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats, Ints
from thetacomp.campaign import Drift
from thetacomp.separation.axis_shares import between_nodes

LOOK_S = 120.0
NODE_S = 600.0
MIN_LOOKS = 5


@dataclass(frozen=True)
class Looks:
    """The drift record in steps of two minutes, n looks: `error` (n, 3) in µm (or µrad), NaN where it is missing.

    `gross_s` holds the moments of readings that were left out before, one array for each column.
    """

    t_s: Floats
    error: Floats
    at_mm: dict[str, Floats]
    gross_s: tuple[Floats, ...] = ()


@dataclass(frozen=True)
class Nodes:
    """Drift at n moments in order of time: value and standard error; `sweep` is -1 where no sweep was measured."""

    t_s: Floats
    value: Floats
    se: Floats
    sweep: Ints


def looks_of(drift: Drift, error: Floats, at_mm: dict[str, Floats]) -> Looks:
    """Means of what was read in two minutes; a new look begins where an axis stands elsewhere."""
    moved = np.zeros(len(drift.t_s), dtype=bool)
    for position_mm in at_mm.values():
        moved[1:] |= np.abs(np.diff(position_mm)) > 1e-6
    number, start_s, numbers = -1, -np.inf, []
    for t_s, new in zip(drift.t_s, moved, strict=True):
        if new or t_s - start_s > LOOK_S:
            number, start_s = number + 1, float(t_s)
        numbers.append(number)
    look = np.array(numbers)
    rows = [np.flatnonzero(look == k) for k in range(number + 1)]
    return Looks(
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
    """Standard deviation of looks from the steps between neighbours, gross ones cut; the drift itself counts too."""
    step = np.diff(value)
    limit = 3.0 * 1.4826 * float(np.median(np.abs(step)))
    return float(np.sqrt(np.mean(np.clip(step, -limit, limit) ** 2) / 2.0))


def join(
    sweeps: Nodes, covariance: Floats, zero_s: float, look_s: Floats, look_value: Floats, look_arms: Floats, sd: float
) -> Nodes:
    """Drift of the heated sweeps (m,) joined with the looks of a record (n,) of standard deviation `sd`.

    The looks have the slopes' share taken off as separated; the errors of these p slopes are unknowns too, since they
    are in the drift of the sweeps as well: `covariance` (m + p, m + p) is that of drift and slopes, `look_arms` (n, p)
    is what each slope adds to a look. The drift is zero by definition up to `zero_s`.
    """
    m, p = len(sweeps.t_s), look_arms.shape[1]
    far_s = _far_bins(look_s, zero_s, sweeps.t_s)
    t_s = np.concatenate([sweeps.t_s, far_s])
    order = np.argsort(t_s, kind="stable")
    drift = np.zeros((len(look_s), len(t_s)))
    drift[:, order] = between_nodes(zero_s, t_s[order], look_s)
    design = np.column_stack([drift[:, :m], look_arms, drift[:, m:], np.ones(len(look_s))])
    information = np.linalg.pinv(covariance, hermitian=True)
    normal = design.T @ design / sd**2
    right = design.T @ look_value / sd**2
    normal[: m + p, : m + p] += information
    right[: m + p] += information @ np.concatenate([sweeps.value, np.zeros(p)])
    inverse = np.linalg.pinv(normal, hermitian=True)
    kept = np.concatenate([np.arange(m), m + p + np.arange(len(far_s))])[order]
    sweep = np.concatenate([sweeps.sweep, np.full(len(far_s), -1)])
    return Nodes(t_s[order], (inverse @ right)[kept], np.sqrt(np.maximum(np.diag(inverse)[kept], 0.0)), sweep[order])


def _far_bins(look_s: Floats, zero_s: float, sweep_s: Floats) -> Floats:
    """Further nodes: mean times of looks more than ten minutes from every heated sweep, in bins of ten minutes."""
    distance_s = np.abs(look_s[:, None] - np.append(sweep_s, zero_s)).min(axis=1)
    far_s: Floats = look_s[(distance_s > NODE_S) & (look_s > zero_s)]
    if not len(far_s):
        return far_s
    number = np.floor((far_s - far_s[0]) / NODE_S)
    return np.array([far_s[number == k].mean() for k in np.unique(number)])

"""One drift for all sweeps of a campaign: their intercepts and the drift record in one least-squares problem.

Unknown are the drift at every heated sweep, at further moments where only the drift record looked, and one constant of
that record: its instrument may have a zero of its own. The intercepts enter with their full covariance, the looks of
the record with the scatter of neighbouring looks; between the nodes the drift runs straight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thetacomp.campaign import Drift, Floats, Ints

LOOK_S = 120.0
NODE_S = 600.0
MIN_LOOKS = 5


@dataclass(frozen=True)
class Looks:
    """The drift record in steps of two minutes, n looks: `error` (n, 3) in µm (or µrad), NaN where it is missing."""

    t_s: Floats
    error: Floats
    at_mm: dict[str, Floats]


@dataclass(frozen=True)
class Nodes:
    """Drift at n moments in order of time: value and standard error; `sweep` is -1 where no sweep was measured."""

    t_s: Floats
    value: Floats
    se: Floats
    sweep: Ints


def looks_of(drift: Drift, error: Floats, at_mm: dict[str, Floats]) -> Looks:
    """Means over two minutes; a new look begins where an axis stands elsewhere."""
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
        np.array([error[row].mean(axis=0) for row in rows]).reshape(-1, error.shape[1]),
        {name: np.array([position_mm[row[0]] for row in rows]) for name, position_mm in at_mm.items()},
    )


def scatter(value: Floats) -> float:
    """Standard deviation of looks from the steps between neighbours, gross ones cut: what the drift moves counts too."""
    step = np.diff(value)
    limit = 3.0 * 1.4826 * float(np.median(np.abs(step)))
    return float(np.sqrt(np.mean(np.clip(step, -limit, limit) ** 2) / 2.0))


def join(
    sweeps: Nodes, covariance: Floats, cold_s: Floats, look_s: Floats, look_value: Floats, look_variance: Floats
) -> Nodes:
    """Drift of the heated sweeps (m,) with their covariance (m, m), joined with the looks of a record (n,).

    `cold_s` are the moments of the cold sweeps, where the drift is zero by definition. `look_variance` (n,) holds
    what is uncertain in a look.
    """
    far_s = _far_bins(look_s, np.concatenate([cold_s, sweeps.t_s]))
    order = np.argsort(np.concatenate([cold_s, sweeps.t_s, far_s]), kind="stable")
    times = np.concatenate([cold_s, sweeps.t_s, far_s])[order]
    weights = np.zeros((len(look_s), len(times)))
    weights[:, order] = _straight(times, look_s)
    m, q = len(sweeps.t_s), len(far_s)
    design = np.column_stack([weights[:, len(cold_s) :], np.ones(len(look_s))])
    information = np.linalg.pinv(covariance, hermitian=True)
    normal = design.T @ (design / look_variance[:, None])
    right = design.T @ (look_value / look_variance)
    normal[:m, :m] += information
    right[:m] += information @ sweeps.value
    inverse = np.linalg.pinv(normal, hermitian=True)
    value, se = (inverse @ right)[: m + q], np.sqrt(np.maximum(np.diag(inverse), 0.0))[: m + q]
    t_s = np.concatenate([sweeps.t_s, far_s])
    sweep = np.concatenate([sweeps.sweep, np.full(q, -1)])
    sort = np.argsort(t_s, kind="stable")
    return Nodes(t_s[sort], value[sort], se[sort], sweep[sort])


def _far_bins(look_s: Floats, known_s: Floats) -> Floats:
    """Further nodes: mean times of looks more than ten minutes from every sweep, in bins of ten minutes."""
    distance_s = np.abs(look_s[:, None] - known_s).min(axis=1)
    far_s: Floats = look_s[(distance_s > NODE_S) & (look_s > known_s.min())]
    if not len(far_s):
        return far_s
    number = np.floor((far_s - far_s[0]) / NODE_S)
    return np.array([far_s[number == k].mean() for k in np.unique(number)])


def _straight(times: Floats, t_s: Floats) -> Floats:
    """Weights (n, nodes) of straight lines between the nodes, held at the ends."""
    j = np.clip(np.searchsorted(times, t_s, side="right") - 1, 0, max(len(times) - 2, 0))
    share = np.clip((t_s - times[j]) / (times[j + 1] - times[j]), 0.0, 1.0)
    weights = np.zeros((len(t_s), len(times)))
    rows = np.arange(len(t_s))
    weights[rows, j] = 1.0 - share
    weights[rows, j + 1] += share
    return weights

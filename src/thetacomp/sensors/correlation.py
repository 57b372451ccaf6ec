"""Correlations with missing values, and when one is more than chance."""

from __future__ import annotations

import numpy as np
from scipy import special

from thetacomp.arrays import Floats, Ints
from thetacomp.campaign import CorrelationTable

# Below this many states the lag-1 autocorrelation cannot be separated from the warm-up trend itself.
LONG_SERIES = 50
STATES_OF_A_CAMPAIGN = 2


def correlations(a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """Pearson correlation of every column of `a` (n, m) with every column of `b` (n, p), each (m, p).

    Pairs of values with one missing do not count; the second result is the number of pairs. NaN where a column is
    constant or fewer than three pairs exist.
    """
    a_good, b_good = np.isfinite(a), np.isfinite(b)
    u, v = _centred(a, a_good), _centred(b, b_good)
    p, q = a_good.astype(float), b_good.astype(float)
    n = p.T @ q
    safe = np.maximum(n, 1.0)
    mean_u, mean_v = u.T @ q / safe, p.T @ v / safe
    var_u = (u**2).T @ q / safe - mean_u**2
    var_v = p.T @ (v**2) / safe - mean_v**2
    # Relative to the mean square: rounding leaves a tiny variance in a column that is constant on the common rows.
    flat = (var_u <= 1e-12 * (u**2).T @ q / safe) | (var_v <= 1e-12 * p.T @ (v**2) / safe) | (n < 3)
    scale = np.sqrt(np.where(flat, 1.0, var_u * var_v))
    r = np.clip((u.T @ v / safe - mean_u * mean_v) / scale, -1.0, 1.0)
    return np.where(flat, np.nan, r), n


def _centred(x: Floats, good: np.ndarray) -> Floats:
    count = np.maximum(good.sum(axis=0), 1)
    filled = np.where(good, x, 0.0)
    return np.where(good, filled - filled.sum(axis=0) / count, 0.0)


def full_symmetric(table: CorrelationTable, sensors: tuple[str, ...]) -> Floats:
    """Correlations between `sensors`, (p, p), from a table that may hold one triangle only; NaN where not given."""
    p = len(sensors)
    out = np.full((p, p), np.nan)
    for i, a in enumerate(sensors):
        for j, b in enumerate(sensors):
            for row, column in ((a, b), (b, a)):
                if row in table.rows and column in table.columns:
                    value = table.value[table.rows.index(row), table.columns.index(column)]
                    out[i, j] = value if np.isfinite(value) else out[i, j]
    np.fill_diagonal(out, 1.0)
    return out


def lag_one(x: Floats, campaign: Ints) -> Floats:
    """Lag-1 autocorrelation of every column, (columns,), over neighbours in time within the same campaign."""
    good = np.isfinite(x)
    u = _centred(x, good)
    same = (campaign[1:] == campaign[:-1])[:, None]
    pair = good[1:] & good[:-1] & same
    products = (u[1:] * u[:-1] * pair).sum(axis=0) / np.maximum(pair.sum(axis=0), 1)
    variance = (u**2).sum(axis=0) / np.maximum(good.sum(axis=0), 1)
    return np.clip(np.where(variance > 0, products / np.where(variance > 0, variance, 1.0), 0.0), 0.0, 1.0)


def effective_count(a: Floats, b: Floats, count: Floats, campaign: Ints) -> Floats:
    """Number of independent pairs behind each correlation, (m, p).

    n (1 - r1 r2) / (1 + r1 r2) with the lag-1 autocorrelations r1, r2 of the two series: Bretherton et al. 1999,
    "The effective number of spatial degrees of freedom of a time-varying field", J. Climate 12, 1990-2009, eq. (31).
    Series of up to 50 states keep their count: there the formula would count the warm-up itself as autocorrelation.
    For the same reason a campaign counts as two independent states at least, one warming and one cooling, plus one.
    """
    if len(a) <= LONG_SERIES:
        return count
    product = np.outer(lag_one(a, campaign), lag_one(b, campaign))
    least = np.minimum(count, STATES_OF_A_CAMPAIGN * len(np.unique(campaign)) + 1)
    return np.asarray(np.maximum(count * (1.0 - product) / (1.0 + product), least))


def pair_p_value(r: Floats, between: Floats, count: Floats) -> Floats:
    """Chance of what every two sensors explain of a parameter together, (p, p); 1 on the diagonal and where unknown.

    `r` (p,) correlates the sensors with the parameter, `between` (p, p) with each other; `count` (p,) are independent
    states. F-test of a plane: with two inputs the tail at R² is (1 - R²) to the power of half the freedom.
    """
    alone = 1.0 - between**2
    known = np.isfinite(alone) & (alone > 1e-6) & np.isfinite(r)[:, None] & np.isfinite(r)
    together = r[:, None] ** 2 + r**2 - 2.0 * np.outer(r, r) * between
    share = np.clip(np.where(known, together, 0.0) / np.where(known, alone, 1.0), 0.0, 1.0)
    freedom = np.maximum(np.minimum(count[:, None], count) - 3.0, 0.0)
    return np.asarray((1.0 - share) ** (freedom / 2.0))


def p_value(r: Floats, count: Floats) -> Floats:
    """Two-sided p-value of a correlation `r` of `count` independent pairs: t = r sqrt(f / (1 - r²)), f = count - 2.

    1 where there are not more than two independent pairs or no correlation.
    """
    freedom = np.maximum(count - 2.0, 0.0)
    known = np.isfinite(r) & (freedom > 0)
    # For t with f degrees of freedom, P(|t| > t0) = I_{f / (f + t0²)}(f / 2, 1 / 2), and f / (f + t0²) = 1 - r².
    tail = special.betainc(np.where(known, freedom, 1.0) / 2.0, 0.5, 1.0 - np.where(known, r, 0.0) ** 2)
    return np.where(known, tail, 1.0)

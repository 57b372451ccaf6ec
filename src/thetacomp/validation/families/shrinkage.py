"""Lasso, group lasso and partial least squares on rises and lags, all through zero."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
from sklearn.cross_decomposition import PLSRegression
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import lasso_path

from thetacomp.arrays import Floats, Ints
from thetacomp.errors import AnalysisError
from thetacomp.validation.families.family import BUDGET, Family, Forecast, Table, linear, one_by_one, size_of

STRENGTHS = tuple(float(s) for s in np.geomspace(0.5, 1e-4, BUDGET))
"""Penalties as shares of the smallest one that leaves no input."""

_STEPS, _TOLERANCE = 1000, 1e-5


def _lasso(table: Table, settings: Sequence[float]) -> list[Forecast | None]:
    size = size_of(table.rows.x)
    x, y = table.rows.x / size, table.y
    gram, mixed, n = x.T @ x, x.T @ y, len(x)
    coef = np.zeros((len(settings), x.shape[1], y.shape[1]))
    for target in range(y.shape[1]):
        largest = float(np.max(np.abs(mixed[:, target]))) / n
        if not largest > 0.0:
            continue
        with warnings.catch_warnings():
            # The path is compared by its held-out error; the last digit of a coefficient does not matter.
            warnings.simplefilter("ignore", ConvergenceWarning)
            _, path, _ = lasso_path(
                x, y[:, target], alphas=largest * np.array(settings), precompute=gram, Xy=mixed[:, target],
                max_iter=_STEPS, tol=1e-4,
            )  # fmt: skip
        coef[:, :, target] = path.T
    return [linear(c / size[:, None]) for c in coef]


LASSO = Family("lasso", "rises and lags", STRENGTHS, _lasso)


def group_lasso_path(
    gram: Floats, mixed: Floats, group: Ints, penalties: Sequence[float], steps: int = _STEPS
) -> Floats:
    """Coefficients (penalties, k, m) of `min b'Gb/2 - b'c + penalty Σ_g sqrt(k_g) |b_g|`, each target on its own.

    `gram` G = X'X/n (k, k), `mixed` c = X'y/n (k, m), `group` (k,) numbers the groups from 0. Penalties are shares of
    the smallest one that leaves no group. Accelerated proximal gradient (Beck, Teboulle 2009, "A fast iterative
    shrinkage-thresholding algorithm") on the penalty of Yuan, Lin 2006, "Model selection and estimation in regression
    with grouped variables"; the momentum restarts where it points uphill.
    """
    member = np.equal.outer(np.arange(int(group.max()) + 1), group).astype(float)
    weight = np.sqrt(member.sum(axis=1))[:, None]
    largest = np.max(np.sqrt(member @ mixed**2) / np.where(weight > 0.0, weight, 1.0), axis=0)
    step = 1.0 / max(float(np.linalg.eigvalsh(gram)[-1]), 1e-300)
    out = np.zeros((len(penalties), *mixed.shape))
    b = np.zeros_like(mixed)
    for i, penalty in enumerate(penalties):
        limit = step * penalty * largest * weight
        ahead, momentum = b.copy(), 1.0
        for _ in range(steps):
            moved = _block_threshold(ahead - step * (gram @ ahead - mixed), member, limit)
            change = moved - b
            uphill = np.sum((ahead - moved) * change) > 0.0
            following = 1.0 if uphill else 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * momentum**2))
            ahead = moved + (0.0 if uphill else (momentum - 1.0) / following) * change
            b, momentum = moved, following
            if np.max(np.abs(change), initial=0.0) <= _TOLERANCE * np.max(np.abs(b), initial=1e-300):
                break
        out[i] = b
    return out


def _block_threshold(b: Floats, member: Floats, limit: Floats) -> Floats:
    """Every group shortened by its limit (groups, m), to zero where it is shorter."""
    length = np.sqrt(member @ b**2)
    keep = np.maximum(1.0 - limit / np.where(length > 0.0, length, 1.0), 0.0)
    return np.asarray(b * (member.T @ keep))


def _group_lasso(table: Table, settings: Sequence[float]) -> list[Forecast | None]:
    size, scale = size_of(table.rows.x), size_of(table.y)
    x, y, n = table.rows.x / size, table.y / scale, len(table.y)
    _, group = np.unique(table.group, return_inverse=True)
    path = group_lasso_path(x.T @ x / n, x.T @ y / n, group, settings)
    return [linear(b / size[:, None] * scale) for b in path]


GROUP_LASSO = Family("group lasso", "rises and lags", STRENGTHS, _group_lasso)


def _pls(table: Table, components: int) -> Forecast:
    """The rows and their negatives have the mean zero, so that the regression runs through zero."""
    if components > min(len(table.y) - 1, table.rows.x.shape[1]):
        raise AnalysisError("fewer rows or inputs than components.")
    size, scale = size_of(table.rows.x), size_of(table.y)
    x, y = table.rows.x / size, table.y / scale
    coef = []
    for target in range(y.shape[1]):
        both = np.concatenate([y[:, target], -y[:, target]])
        with warnings.catch_warnings():
            # Components beyond what the rows carry are zero; they are compared by their held-out error.
            warnings.simplefilter("ignore", UserWarning)
            model = PLSRegression(components, scale=False).fit(np.vstack([x, -x]), both)
        coef.append(model.coef_[0] / size * scale[target])
    return linear(np.array(coef).T)


PLS = Family("PLS", "rises and lags", tuple(range(1, BUDGET + 1)), one_by_one(_pls))

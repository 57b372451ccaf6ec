"""Linear families on rises: the paper's choice by correlation, stepwise, the exact best subset. All through zero."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.errors import AnalysisError
from thetacomp.moments import Summary, summarise
from thetacomp.sensors.subset import Score, best_subset
from thetacomp.validation.families.family import Family, Forecast, Table, linear, one_by_one, size_of

STEPS = 6


def least_squares_on(table: Table, columns: Sequence[int], target: int) -> Floats:
    """Coefficients (k,) through zero on some columns of one target; AnalysisError where the rows are too few."""
    if len(table.y) <= len(columns):
        raise AnalysisError(f"{len(table.y)} rows cannot determine {len(columns)} coefficients.")
    out = np.zeros(table.rows.x.shape[1])
    out[list(columns)] = np.linalg.lstsq(table.rows.x[:, columns], table.y[:, target], rcond=None)[0]
    return out


def correlations(table: Table) -> Floats:
    """|r| of every target with every input, (m, k); 0 where one of them does not vary."""
    x, y = table.rows.x - table.rows.x.mean(axis=0), table.y - table.y.mean(axis=0)
    norm = np.outer(np.linalg.norm(y, axis=0), np.linalg.norm(x, axis=0))
    return np.asarray(np.abs(y.T @ x) / np.where(norm > 0.0, norm, np.inf))


def _by_correlation(table: Table, setting: tuple[int, float]) -> Forecast:
    """The paper's way: sensors in falling |r| with the error, none that says the same as one taken before."""
    count, most_alike = setting
    x = table.rows.x - table.rows.x.mean(axis=0)
    norm = np.linalg.norm(x, axis=0)
    between = np.abs(x.T @ x) / np.where(np.outer(norm, norm) > 0.0, np.outer(norm, norm), np.inf)
    coef = []
    for target, size in enumerate(correlations(table)):
        chosen: list[int] = []
        for j in np.argsort(-size, kind="stable"):
            if size[j] > 0.0 and len(chosen) < count and all(between[j, i] < most_alike for i in chosen):
                chosen.append(int(j))
        if len(chosen) < count:
            raise AnalysisError(f"there are no {count} sensors that differ.")
        coef.append(least_squares_on(table, chosen, target))
    return linear(np.array(coef).T)


CORRELATION = Family(
    "correlation (the paper)",
    "rises",
    tuple((count, alike) for count in (1, 2, 3, 4) for alike in (0.75, 0.90, 0.95)),
    one_by_one(_by_correlation),
)


def _squares(gram: Floats, mixed: Floats, power: float, columns: Sequence[int]) -> float:
    """Residual sum of squares through zero on some columns."""
    inner, outer = gram[np.ix_(columns, columns)], mixed[list(columns)]
    return power - float(outer @ np.linalg.lstsq(inner, outer, rcond=None)[0])


def step_path(gram: Floats, mixed: Floats, power: float, forward: bool, most: int) -> dict[int, list[int]]:
    """Sets of 1 to `most` columns by one step at a time: taking the best in, or the least needed out."""
    p = len(mixed)
    chosen: list[int] = [] if forward else list(range(p))
    out: dict[int, list[int]] = {}
    while (len(chosen) < min(most, p)) if forward else (len(chosen) > 1):
        tried = (
            [[*chosen, j] for j in range(p) if j not in chosen]
            if forward
            else [[i for i in chosen if i != j] for j in chosen]
        )
        chosen = min(tried, key=lambda columns: _squares(gram, mixed, power, columns))
        if len(chosen) <= most:
            out[len(chosen)] = chosen
    if not forward and p <= most:
        out[p] = list(range(p))
    return out


def _stepwise(table: Table, settings: Sequence[tuple[str, int]]) -> list[Forecast | None]:
    size = size_of(table.rows.x)
    x = table.rows.x / size
    gram, mixed, power = x.T @ x, x.T @ table.y, np.sum(table.y**2, axis=0)
    most = max(count for _, count in settings)
    paths = {
        way: [step_path(gram, mixed[:, t], float(power[t]), way == "forward", most) for t in range(len(power))]
        for way in dict.fromkeys(way for way, _ in settings)
    }
    out: list[Forecast | None] = []
    for way, count in settings:
        if count > x.shape[1] or len(x) <= count:
            out.append(None)
            continue
        coef = [least_squares_on(table, path[count], t) for t, path in enumerate(paths[way])]
        out.append(linear(np.array(coef).T))
    return out


STEPWISE = Family(
    "stepwise",
    "rises",
    tuple((way, count) for way in ("forward", "backward") for count in range(1, STEPS + 1)),
    _stepwise,
)


def summaries_through_zero(table: Table) -> list[Summary]:
    """One summary a campaign of the rows and their negatives: its means are zero, so every fit runs through zero."""
    x, y = table.rows.x, table.y
    inputs, targets = [f"{j}" for j in range(x.shape[1])], [f"{t}" for t in range(y.shape[1])]
    out = []
    for label in np.unique(table.rows.campaign):
        own = table.rows.campaign == label
        out.append(summarise(np.vstack([x[own], -x[own]]), np.vstack([y[own], -y[own]]), inputs, targets, f"{label}"))
    return out


def _best_subset(table: Table, setting: tuple[Score, int]) -> Forecast:
    score, count = setting
    summaries = summaries_through_zero(table)
    if score != "residual" and len(summaries) < 2:
        raise AnalysisError("a score by held-out campaigns needs two of them.")
    coef = []
    for target in range(table.y.shape[1]):
        found = best_subset(summaries, count, score=score, targets=[f"{target}"])
        coef.append(least_squares_on(table, [int(name) for name in found.sensors], target))
    return linear(np.array(coef).T)


BEST_SUBSET = Family(
    "best subset (exact)",
    "rises",
    tuple((score, count) for score in ("residual", "held_out") for count in range(1, STEPS + 1)),
    one_by_one(_best_subset),
)

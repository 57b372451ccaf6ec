"""ARX and the grey model GM(1,n): the next value depends on earlier predictions, never on measured errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.errors import AnalysisError
from thetacomp.validation.families.family import Family, Forecast, Rows, Table, one_by_one, size_of
from thetacomp.validation.families.linear import correlations

GRID = 60
"""Most steps of a campaign: between shorter steps a displacement hardly changes, and a model learns to repeat it."""


@dataclass(frozen=True)
class Course:
    """One campaign on an even grid of time: t_h (g,), x (g, k), y (g, m)."""

    t_h: Floats
    x: Floats
    y: Floats


def step_h(rows: Rows, most: int = GRID) -> float:
    """The grid's step in hours: the usual distance of rows, or what makes `most` steps of the longest campaign."""
    times = [rows.elapsed_h[rows.campaign == label] for label in np.unique(rows.campaign)]
    gaps = np.concatenate([np.diff(t) for t in times])
    gaps = gaps[gaps > 0.0]
    if not len(gaps):
        raise AnalysisError("campaigns of one state have no course over time.")
    return max(float(np.median(gaps)), max(float(np.ptp(t)) for t in times) / most)


def on_grid(rows: Rows, y: Floats, label: int, step: float) -> Course:
    """A campaign interpolated to an even grid from its first to past its last row."""
    own = rows.campaign == label
    t_h = rows.elapsed_h[own]
    grid = t_h[0] + step * np.arange(int(np.ceil(np.ptp(t_h) / step)) + 1)

    def at(values: Floats) -> Floats:
        columns = [np.interp(grid, t_h, column) for column in values[own].T]
        return np.array(columns).T.reshape(len(grid), -1)

    return Course(grid, at(rows.x), at(y))


def run_campaigns(rows: Rows, step: float, models: Sequence[Arx | Grey]) -> Floats:
    """Targets (n, m) of rows: one model a target runs through each campaign from its start, on inputs alone."""
    out = np.empty((len(rows.x), len(models)))
    for label in np.unique(rows.campaign):
        own = rows.campaign == label
        course = on_grid(rows, np.zeros((len(rows.x), 0)), label, step)
        for target, model in enumerate(models):
            out[own, target] = np.interp(rows.elapsed_h[own], course.t_h, model.run(course.x))
    return out


@dataclass(frozen=True)
class Arx:
    """`y_k = Σ past_i y_{k-i} + Σ drive_j · x_{k-j}` of one target: past (na,), drive (nb, inputs)."""

    past: Floats
    drive: Floats

    def run(self, x: Floats) -> Floats:
        """Open loop (g,): the first value is that of rest under the first inputs; then only own values count."""
        na, nb = len(self.past), len(self.drive)
        forced = sum(np.vstack([np.tile(x[:1], (j, 1)), x])[: len(x)] @ self.drive[j] for j in range(nb))
        rest = float(x[0] @ self.drive.sum(axis=0) / (1.0 - self.past.sum()))
        y = np.full(len(x) + na - 1, rest)  # before its start the campaign is at rest
        for k in range(na, len(y)):
            y[k] = float(self.past @ y[k - na : k][::-1]) + forced[k - na + 1]
        return y[na - 1 :]


def fit_arx(courses: list[Course], target: int, na: int, nb: int, strength: float) -> Arx:
    """Least squares of the next value on measured past values and inputs, with a ridge on standardised columns.

    Measured values are used here alone, on training campaigns. AnalysisError where the result is not stable.
    """
    first = max(na, nb - 1)
    design, wanted = [], []
    for course in courses:
        for k in range(first, len(course.y)):
            past = [course.y[k - i - 1, target] for i in range(na)]
            design.append(np.concatenate([past, *(course.x[k - j] for j in range(nb))]))
            wanted.append(course.y[k, target])
    if len(wanted) <= na:
        raise AnalysisError("too few steps for an ARX model.")
    a, b = np.array(design), np.array(wanted)
    size = size_of(a)
    a = a / size
    coef = np.linalg.solve(a.T @ a / len(a) + strength * np.eye(a.shape[1]), a.T @ b / len(a)) / size
    roots = np.roots(np.concatenate([[1.0], -coef[:na]]))
    if np.max(np.abs(roots), initial=0.0) >= 0.999:
        raise AnalysisError("the ARX model is not stable.")
    return Arx(coef[:na], coef[na:].reshape(nb, -1))


def _stable_arx(courses: list[Course], target: int, setting: tuple[int, int, float]) -> Arx:
    """The model of one target; where it is not stable, one that returns NaN, so that this setting is never chosen."""
    try:
        return fit_arx(courses, target, *setting)
    except AnalysisError:
        na, nb, _ = setting
        return Arx(np.full(na, np.nan), np.full((nb, courses[0].x.shape[1]), np.nan))


def _arx(table: Table, setting: tuple[int, int, float]) -> Forecast:
    step = step_h(table.rows)
    courses = [on_grid(table.rows, table.y, label, step) for label in np.unique(table.rows.campaign)]
    models = [_stable_arx(courses, target, setting) for target in range(table.y.shape[1])]
    return lambda rows: run_campaigns(rows, step, models)


ARX = Family(
    "ARX, open loop",
    "rises",
    tuple((na, nb, strength) for na in (1, 2) for nb in (1, 2) for strength in (1e-4, 1e-3, 1e-2)),
    one_by_one(_arx),
    sequential=True,
    remark="own past predictions",
)


SLOWEST = 1.0 / GRID
"""Least a of a grey model: a memory as long as the longest campaign. At zero and below the model is not stable."""


@dataclass(frozen=True)
class Grey:
    """GM(1,n): `y_k + a (w Y_k + (1 - w) Y_{k-1}) = Σ b_j X_jk`, Y and X the running sums of y and the inputs.

    Deng 1982, "Control problems of grey systems"; the sums begin with zero at the reference. Solved for y_k it runs
    forward on its own sums.
    """

    columns: tuple[int, ...]
    a: float
    b: Floats
    w: float

    def run(self, x: Floats) -> Floats:
        """Values (g,) from inputs (g, k) alone."""
        drive = np.cumsum(x[:, self.columns], axis=0) @ self.b
        y, total = np.empty(len(x)), 0.0
        for k in range(len(x)):
            y[k] = (drive[k] - self.a * total) / (1.0 + self.a * self.w)
            total += y[k]
        return y


def fit_grey(courses: list[Course], target: int, columns: tuple[int, ...], w: float) -> Grey:
    """Least squares of the defining equation over all training campaigns, a at least SLOWEST."""
    design, wanted = [], []
    for course in courses:
        y = course.y[:, target]
        total = np.cumsum(y)
        background = w * total + (1.0 - w) * (total - y)
        design.append(np.column_stack([-background, np.cumsum(course.x[:, columns], axis=0)]))
        wanted.append(y)
    a, b = np.vstack(design), np.concatenate(wanted)
    if len(b) <= a.shape[1]:
        raise AnalysisError("too few steps for a grey model.")
    size = size_of(a)
    coef = np.linalg.lstsq(a / size, b, rcond=None)[0] / size
    if coef[0] < SLOWEST:
        # Its running sum would grow without end; the slowest memory that a campaign can show is taken instead.
        rest = np.linalg.lstsq(a[:, 1:] / size[1:], b - SLOWEST * a[:, 0], rcond=None)[0] / size[1:]
        return Grey(columns, SLOWEST, rest, w)
    return Grey(columns, float(coef[0]), coef[1:], w)


def _grey(table: Table, setting: tuple[int, float]) -> Forecast:
    count, w = setting
    if count > table.rows.x.shape[1]:
        raise AnalysisError(f"there are no {count} sensors.")
    step = step_h(table.rows)
    courses = [on_grid(table.rows, table.y, label, step) for label in np.unique(table.rows.campaign)]
    order = np.argsort(-correlations(table), axis=1, kind="stable")[:, :count]
    models = [fit_grey(courses, t, tuple(int(j) for j in columns), w) for t, columns in enumerate(order)]
    return lambda rows: run_campaigns(rows, step, models)


GREY = Family(
    "grey model GM(1,n)",
    "rises",
    tuple((count, w) for count in range(1, 7) for w in (0.5, 1.0)),
    one_by_one(_grey),
    sequential=True,
    remark="own running sum",
)

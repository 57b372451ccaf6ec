"""Before and after of every error component and of the column deviation, with the uncertainty of each percentage."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.verification.applied_share import LIMITS_PERCENT, draws_for, enough_states, fit_run, repeated_runs
from thetacomp.verification.outcome import STATISTICS, BeforeAfter, StateLine, Statistic
from thetacomp.verification.runs import RunPoints

NAN = float("nan")
LEAST_UM = 1e-6
Measure = Callable[[Floats, RunPoints], Floats]


def over_points(value_um: Floats, points: RunPoints) -> Floats:
    """|error| of every point; `value_um` (..., n)."""
    return np.abs(value_um)


def over_states(value_um: Floats, points: RunPoints) -> Floats:
    """The largest |error| over the travel of every state, (..., K): the deviation of validation's column rows."""
    starts = np.searchsorted(points.state, np.arange(len(points.t_s)))
    return np.asarray(np.maximum.reduceat(np.abs(value_um), starts, axis=-1))


def before_after(
    component: str, off: RunPoints, on: RunPoints, measure: Measure, rng: np.random.Generator
) -> BeforeAfter:
    """Maximum, p95 and RMS of one error off and on, as measured and at the same heat, with 95 % bounds."""
    observed = [_figures(measure(run.value_um, run)) for run in (off, on)]
    known = off.explained and on.explained
    ratio = np.full(len(STATISTICS), NAN)
    low = high = ratio
    if known:
        expected = [_figures(measure(run.expected_um, run)) for run in (off, on)]
        ratio = expected[1] / expected[0]
        parts = len(np.unique(off.lever_m)) > 1
        draws = draws_for(off, on)
        drawn = [_figures(measure(repeated_runs(fit_run(run, parts), rng, draws), run)) for run in (off, on)]
        log = _log_ratio(observed[0], observed[1])
        log_drawn = _log_ratio(drawn[0], drawn[1])
        deviation = log_drawn - np.median(log_drawn, axis=0)
        upper_log, lower_log = (log - np.percentile(deviation, q, axis=0) for q in LIMITS_PERCENT)
        # A larger ratio is a smaller reduction.
        if enough_states(off, on):
            low, high = (100.0 * (1.0 - np.exp(bound) / ratio) for bound in (upper_log, lower_log))
    statistics = []
    for k, kind in enumerate(STATISTICS):
        before, after = float(observed[0][k]), float(observed[1][k])
        like = before * float(ratio[k])
        statistics.append(
            Statistic(kind, before, like, after, _percent(before, after), _percent(like, after), low[k], high[k])
        )
    return BeforeAfter(component, len(off.t_s), len(on.t_s), tuple(statistics))


def state_line(component: str, points: RunPoints) -> StateLine:
    """The largest |error| of every state, and the largest expected from its temperatures."""
    return StateLine(
        component, points.t_s, over_states(points.value_um, points), over_states(points.expected_um, points)
    )


def _figures(value_um: Floats) -> Floats:
    """Maximum, p95 and RMS along the last axis, stacked last."""
    return np.stack(
        [value_um.max(axis=-1), np.quantile(value_um, 0.95, axis=-1), np.sqrt(np.mean(value_um**2, axis=-1))], axis=-1
    )


def _log_ratio(before_um: Floats, after_um: Floats) -> Floats:
    """Logarithm of after / before; a figure of exactly zero counts as a thousandth of a nanometre."""
    return np.asarray(np.log(np.maximum(after_um, LEAST_UM)) - np.log(np.maximum(before_um, LEAST_UM)))


def _percent(before_um: float, after_um: float) -> float:
    return 100.0 * (1.0 - after_um / before_um) if before_um > 0 else NAN

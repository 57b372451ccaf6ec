"""Permutation R²: how good the whole procedure looks on states whose order means nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thetacomp.axis_states import AxisStates
from thetacomp.errors import AnalysisError
from thetacomp.fitting.key_point_law import Procedure, input_columns
from thetacomp.validation.outcome import PermutationTest

SHUFFLES = 99
# Beyond this many states neighbours are nearly copies; a thinned series says the same in less time.
MAX_STATES = 200
MIN_STATES = 5


def permutation_test(states: AxisStates, procedure: Procedure, rng: np.random.Generator) -> PermutationTest | None:
    """Choose and fit on the true states and on shuffled ones; None where there are fewer than five states.

    Up to 24 states are shuffled freely. Longer series are shifted round the clock instead, which keeps each series as
    smooth as it is: a free shuffle would break the autocorrelation that makes chance fits look good.
    """
    if len(states) < MIN_STATES:
        return None
    if states.exact_zero:
        states = states.take(np.flatnonzero(~states.cold))
    step = max(1, len(states) // MAX_STATES)
    thin = states.take(np.arange(0, len(states), step))
    true_r2 = _r_squared(thin, procedure)
    if true_r2 is None:
        return None
    chance = []
    for _ in range(SHUFFLES):
        r2 = _r_squared(_shuffled(thin, rng), procedure)
        if r2 is not None:
            chance.append(r2)
    if not chance:
        return None
    values = np.array(chance)
    return PermutationTest(
        axis=states.axis,
        r2=true_r2,
        r2_shuffled_median=float(np.median(values)),
        r2_shuffled_p95=float(np.quantile(values, 0.95)),
        p_value=float((1 + np.sum(values >= true_r2)) / (1 + len(values))),
        shuffles=len(values),
    )


def _shuffled(states: AxisStates, rng: np.random.Generator) -> AxisStates:
    count = len(states)
    if count <= 24:
        order = rng.permutation(count)
    else:
        order = (np.arange(count) + rng.integers(count // 10, count - count // 10)) % count
    shuffled = {name: getattr(states, name)[order] for name in ("intercept_um", "slope_um_per_m", "bend_um_per_m2")}
    return replace(states, **shuffled)


def _r_squared(states: AxisStates, procedure: Procedure) -> float | None:
    """In-sample R² over all parameters, each weighted by its µm at the end of the travel."""
    try:
        model = procedure(states)
    except AnalysisError:
        return None
    X = input_columns(model.inputs, states.sensors, states.rise_K, states.elapsed_h)
    left = spread = 0.0
    for k, component in enumerate(states.components):
        regression = model.regressions[component]
        y = np.column_stack([states.line_intercept_um[:, k], states.slope_um_per_m[:, k] * states.half_travel_m])
        scale = np.array([1.0, states.half_travel_m])
        width = len(regression.intercept_)
        rows = np.isfinite(y).all(axis=1) & np.isfinite(X).all(axis=1)
        target = y[rows, :width]
        predicted = regression.predict(X[rows]).reshape(-1, width) * scale[:width]
        left += float(np.sum((target - predicted) ** 2))
        spread += float(np.sum((target - target.mean(axis=0)) ** 2))
    return _ratio(left, spread)


def _ratio(left: float, spread: float) -> float:
    return 1.0 - left / spread if spread > 0 else 0.0

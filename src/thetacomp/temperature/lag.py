"""The lag of one temperature behind another, as the time constant of a first-order lag."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import optimize, signal

from thetacomp.arrays import Floats

GRID_POINTS = 2000
SEARCH_POINTS = 25


@dataclass(frozen=True)
class LagFit:
    """`lag_s` is the time constant; `gain` the sensor's share of the source's rise; `at_limit`: not determined."""

    lag_s: float
    gain: float
    r_squared: float
    at_limit: bool


def first_order_response(t_s: Floats, source: Floats, lag_s: float) -> Floats:
    """Response of `lag dy/dt = u - y` to a source `u` on an even time grid, (n,), both at rest at the start.

    Exact for a source that runs straight between its samples (ramp-invariant discretisation), so it holds for any
    ratio of step to lag.
    """
    u = source - source[0]
    a = (t_s[1] - t_s[0]) / lag_s
    decay = np.exp(-a)
    mean_decay = -np.expm1(-a) / a
    filtered, _ = signal.lfilter([1.0 - mean_decay, mean_decay - decay], [1.0, -decay], u, zi=[0.0])
    return np.asarray(filtered)


def first_order_lag(t_s: Floats, source: Floats, sensor: Floats) -> LagFit:
    """Fit `sensor = gain × first-order lag of source + constant` by least squares.

    A first-order lag, not a shift in time: heat that reaches a sensor through metal is delayed and rounded off, and a
    shift that aligns the curves depends on the shape of the warm-up. In a steady ramp the two agree. Noise of the
    source is averaged by a lag, which makes short lags look longer: 0.05 K in 15 s samples adds about 40 s to a lag of
    300 s in a warm-up of 2.5 h. Times ascend; all arrays are (n,), without missing values, n at least 3.
    """
    n = len(t_s)
    grid = np.linspace(t_s[0], t_s[-1], int(np.clip(20 * n, 400, max(n, GRID_POINTS))))
    source_grid = np.interp(grid, t_s, source)
    total = float(np.sum((sensor - sensor.mean()) ** 2))

    def fit(log_lag: float) -> tuple[float, float]:
        response = np.interp(t_s, grid, first_order_response(grid, source_grid, float(np.exp(log_lag))))
        centred = response - response.mean()
        power = float(centred @ centred)
        gain = float(centred @ sensor) / power if power > 0 else 0.0
        return float(np.sum((sensor - sensor.mean() - gain * centred) ** 2)), gain

    duration_s = float(t_s[-1] - t_s[0])
    # Below the step of the grid, and beyond the length of the record, a lag makes no difference that could be seen.
    limits = np.log([(grid[1] - grid[0]) / 10.0, duration_s])
    tries = np.linspace(limits[0], limits[1], SEARCH_POINTS)
    loss = [fit(x)[0] for x in tries]
    k = int(np.argmin(loss))
    around = (tries[max(k - 1, 0)], tries[min(k + 1, SEARCH_POINTS - 1)])
    best = optimize.minimize_scalar(lambda x: fit(x)[0], bounds=around, method="bounded", options={"xatol": 1e-4})
    rss, gain = fit(float(best.x))
    return LagFit(
        lag_s=float(np.exp(best.x)) if k > 0 else 0.0,
        gain=gain,
        r_squared=1.0 - rss / total if total > 0 else 0.0,
        at_limit=k == SEARCH_POINTS - 1,
    )

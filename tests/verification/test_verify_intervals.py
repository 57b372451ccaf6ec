"""The stated intervals of a verification hold what they promise, on runs drawn from a known law."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

from thetacomp.verification.applied_share import ALL, INTERCEPT, classify, shares
from thetacomp.verification.before_after import before_after, over_states
from thetacomp.verification.runs import RunPoints, zero_scatter

Floats = NDArray[np.float64]
STATES, POINTS = 10, 7
REST_UM, REST_UM_PER_M, NOISE_UM = 6.0, 4.0, 3.0


def drawn_run(rng: np.random.Generator, gain: float, heat: float, correlation: float) -> RunPoints:
    """A warm-up and cool-down of ten sweeps; what no thermometer knows is correlated from sweep to sweep."""
    t_h = np.arange(1.0, STATES + 1.0)
    warm = heat * (1 - np.exp(-np.minimum(t_h, 6.0) / 2.5)) * np.exp(-np.maximum(t_h - 6.0, 0.0) / 2.5)
    lever = np.tile(np.linspace(-1.0, 1.0, POINTS), STATES)
    state = np.repeat(np.arange(STATES), POINTS)
    rest = rng.standard_normal((STATES, 2)) * (REST_UM, REST_UM_PER_M)
    for k in range(1, STATES):
        rest[k] = correlation * rest[k - 1] + np.sqrt(1 - correlation**2) * rest[k]
    intercept, slope = 80.0 * warm[state], 90.0 * warm[state]
    value = gain * (intercept + slope * lever) + rest[state, 0] + rest[state, 1] * lever
    value += NOISE_UM * rng.standard_normal(len(state))
    campaign = np.zeros(STATES, dtype=np.int64)
    return RunPoints(state, 0.0, lever, value, NOISE_UM, campaign, 3600.0 * t_h, intercept, slope)


def log_ratio(off: RunPoints, on: RunPoints) -> Floats:
    def figures(run: RunPoints) -> Floats:
        worst = over_states(run.value_um, run)
        return np.array([worst.max(), np.quantile(worst, 0.95), np.sqrt(np.mean(worst**2))])

    return np.asarray(np.log(figures(on) / figures(off)))


@pytest.mark.parametrize(("gain_on", "correlation"), [(0.1, 0.0), (0.1, 0.5), (1.0, 0.3)])
def test_intervals_cover_the_truth(gain_on: float, correlation: float) -> None:
    """The truth of a percentage is its median over repeated runs with the same heat; of a share, the share.

    Asked for are 95 %; with 40 pairs of runs the count scatters by 3.4 % (one standard deviation), and the
    correlation of ten sweeps is not known well: fewer than 85 % would be wrong. Few sweeps without any correlation
    are covered more often than promised.
    """
    rng = np.random.default_rng(12)
    truth = np.median([log_ratio(*_pair(rng, gain_on, correlation)) for _ in range(1500)], axis=0)
    hits, share_hits, pairs = np.zeros(3), 0, 40
    for _ in range(pairs):
        off, on = _pair(rng, gain_on, correlation)
        for k, one in enumerate(before_after("EXY", off, on, over_states, rng).statistics):
            percent = 100 * (1 - np.exp(truth[k]) * one.before_um / one.like_before_um)
            hits[k] += one.low_percent <= percent <= one.high_percent
        share = next(s for s in shares("EXY", off, on, 5.0, rng) if s.part == ALL)
        share_hits += share.low <= 1.0 - gain_on <= share.high
    assert (hits / pairs >= 0.85).all(), hits
    assert share_hits / pairs >= 0.85


def test_the_error_of_the_cold_zero_is_in_the_bounds() -> None:
    """All sweeps of a run share the error of their zero, here 8 µm: no rest of a sweep shows it."""
    rng = np.random.default_rng(5)
    hits = {0.0: 0, 8.0: 0}
    for _ in range(60):
        runs = [replace(run, value_um=run.value_um + 8.0 * rng.standard_normal()) for run in _pair(rng, 0.1, 0.0)]
        for known_um in hits:
            off, on = (replace(run, zero_sd=(known_um, 0.0)) for run in runs)
            share = next(s for s in shares("EXY", off, on, 5.0, rng) if s.part == INTERCEPT)
            hits[known_um] += share.low <= 0.9 <= share.high
    assert hits[8.0] >= 54
    assert hits[0.0] < 48


def test_the_scatter_of_the_zero_is_the_part_of_the_cold_sweeps() -> None:
    """Two cold sweeps and heated ones of one quality: a third of the variance of a heated state is the zero's."""
    cold = np.array([True, True, False, False])
    se = np.array([0.0, 0.0, 3.0, 3.0])
    one = SimpleNamespace(component="EXY", campaign="a", cold=cold, intercept_se_um=se, slope_se_um_per_m=2 * se)
    found = zero_scatter([one], "EXY", ["a"])  # type: ignore[list-item]
    assert found == pytest.approx((3.0 / np.sqrt(3.0), 6.0 / np.sqrt(3.0)))
    assert zero_scatter([one], "EYX", ["a"]) == (0.0, 0.0)  # type: ignore[list-item]


def _pair(rng: np.random.Generator, gain_on: float, correlation: float) -> tuple[RunPoints, RunPoints]:
    return drawn_run(rng, 1.0, 1.0, correlation), drawn_run(rng, gain_on, 0.9, correlation)


@pytest.mark.parametrize(
    ("value", "low", "high", "kind"),
    [
        (1.02, 0.9, 1.1, "applied"),
        (0.92, 0.88, 0.96, "applied"),  # no model is right to better than a tenth
        (-1.05, -1.1, -0.98, "reversed"),
        (-0.4, -0.5, -0.3, "reversed"),
        (1.95, 1.8, 2.1, "doubled"),
        (0.05, -0.1, 0.2, "not active"),
        (0.33, -0.07, 0.7, "unclear"),
        (0.4, 0.3, 0.5, "partly"),
        (1.5, 1.4, 1.6, "too strong"),
        (0.9, 0.2, 1.6, "unclear"),
    ],
)
def test_a_share_is_named_only_where_its_interval_tells(value: float, low: float, high: float, kind: str) -> None:
    assert classify(value, low, high) == kind

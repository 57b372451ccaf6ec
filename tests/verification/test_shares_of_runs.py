"""Fits, drawn runs, shares, before and after, and harm, on points whose answer is known in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thetacomp.arrays import Floats
from thetacomp.verification.applied_share import (
    ALL,
    INTERCEPT,
    SLOPE,
    _autocorrelation,
    _freedom,
    _same_heat,
    _transfer,
    classify,
    draws_for,
    enough_states,
    fit_run,
    repeated_runs,
    shares,
)
from thetacomp.verification.before_after import before_after, over_points, over_states, state_line
from thetacomp.verification.harm import MOST_POSITIONS, harm_map
from thetacomp.verification.runs import RunPoints, without_expectation

LEVER_M = np.linspace(-1.0, 1.0, 5)


def run(value: Floats, intercept: Floats, slope: Floats) -> RunPoints:
    """Values (K, 5), expected intercepts and slopes (K,), a state an hour."""
    states, points = value.shape
    return RunPoints(
        state=np.repeat(np.arange(states), points),
        p0_mm=500.0,
        lever_m=np.tile(LEVER_M, states),
        value_um=value.ravel(),
        noise_sd_um=0.0,
        campaign=np.zeros(states, dtype=np.int64),
        t_s=3600.0 * np.arange(1.0, states + 1),
        intercept_um=np.repeat(intercept, points),
        slope_um_per_m=np.repeat(slope, points),
    )


def warm(states: int, gain: tuple[float, float] = (1.0, 1.0), heat: float = 1.0) -> RunPoints:
    """Expected intercept 10 … µm and slope of another shape; the measured error is `gain` times its two parts."""
    intercept = heat * 10.0 * np.arange(1.0, states + 1)
    slope = heat * np.where(np.arange(states) % 2, 8.0, 20.0)
    value = gain[0] * intercept[:, None] + gain[1] * slope[:, None] * LEVER_M
    return run(value, intercept, slope)


# --- fits and drawn runs ----------------------------------------------------------------------------------------------


def test_gains_are_those_of_the_parts() -> None:
    fit = fit_run(warm(6, (0.5, -1.5)), separate_parts=True)
    assert fit.parts == (INTERCEPT, SLOPE)
    np.testing.assert_allclose(fit.gains, [0.5, -1.5])
    np.testing.assert_allclose(fit.explained_um, fit.points.value_um, atol=1e-9)
    assert fit.rest_um == pytest.approx(0.0, abs=1e-9)
    whole = fit_run(warm(6, (0.5, 0.5)), separate_parts=False)
    assert (whole.parts, whole.gains.tolist()) == ((ALL,), [pytest.approx(0.5)])


def test_the_rest_is_a_line_a_state_and_its_size_is_taken_over_the_points() -> None:
    """Lines of ±3 µm and ±4 µm/m that are orthogonal to what is expected; their RMS is √(9 + 16 · 0.5)."""
    one = warm(4)
    signs = np.array([1.0, -1.0, -1.0, 1.0])  # orthogonal to 10, 20, 30, 40 as to 20, 8, 20, 8
    rest = np.column_stack([3.0 * signs, 4.0 * signs * np.array([1.0, 1.0, 1.0, 1.0])])
    value = one.value_um + rest[one.state, 0] + rest[one.state, 1] * one.lever_m
    fit = fit_run(replace(one, value_um=value), separate_parts=True)
    np.testing.assert_allclose(fit.gains, 1.0)
    np.testing.assert_allclose(fit.rest, rest, atol=1e-9)
    assert fit.rest_um == pytest.approx(np.sqrt(9.0 + 16.0 * np.mean(LEVER_M**2)))


def test_without_an_expected_error_every_state_stands_for_itself() -> None:
    one = without_expectation(warm(4, (0.3, 2.0)))
    fit = fit_run(one, separate_parts=True)
    assert (fit.parts, fit.gains.size, fit.rest_um) == ((), 0, 0.0)
    np.testing.assert_allclose(fit.explained_um, one.value_um)
    assert not fit.rest.any()


def test_drift_at_one_place_has_a_mean_and_no_slope() -> None:
    one = warm(4)
    still = replace(one, lever_m=np.zeros(20), value_um=np.repeat([11.0, 18.0, 33.0, 41.0], 5))
    fit = fit_run(still, separate_parts=False)
    assert not fit.rest[:, 1].any()
    expected = np.array([11.0, 18.0, 33.0, 41.0]) - fit.gains[0] * np.array([10.0, 20.0, 30.0, 40.0])
    np.testing.assert_allclose(fit.rest[:, 0], expected)


def scattered(states: int, seed: int, correlation: float = 0.0) -> RunPoints:
    rng = np.random.default_rng(seed)
    rest = rng.standard_normal((states, 2)) * (6.0, 2.0)
    for k in range(1, states):
        rest[k] = correlation * rest[k - 1] + np.sqrt(1 - correlation**2) * rest[k]
    one = warm(states)
    return replace(one, value_um=one.value_um + rest[one.state, 0] + rest[one.state, 1] * one.lever_m)


def test_drawn_runs_scatter_as_the_rest_does_with_the_degrees_of_freedom_of_the_fit() -> None:
    """The variance of a draw is that of Student's t: rest² / ν · ν / (ν - 2), with ν states less gains."""
    one = scattered(30, 1)
    fit = fit_run(one, separate_parts=True)
    draws = repeated_runs(fit, np.random.default_rng(2), 4000)
    assert draws.shape == (4000, 150)
    middle = np.array(LEVER_M == 0.0)
    found = (draws - fit.explained_um).reshape(4000, 30, 5)[:, :, middle]
    assert np.mean(found**2) == pytest.approx(np.sum(fit.rest[:, 0] ** 2) / 28 * 28 / 26, rel=0.05)
    spread = (draws - fit.explained_um).reshape(4000, 30, 5) @ LEVER_M / (LEVER_M @ LEVER_M)
    assert np.mean(spread**2) == pytest.approx(np.sum(fit.rest[:, 1] ** 2) / 28 * 28 / 26, rel=0.05)


def test_drawn_runs_carry_the_noise_of_the_instrument_point_by_point() -> None:
    fit = fit_run(replace(warm(6), noise_sd_um=3.0), separate_parts=True)
    noise = repeated_runs(fit, np.random.default_rng(3), 3000) - fit.explained_um
    assert noise.std() == pytest.approx(3.0, rel=0.02)
    assert abs(np.corrcoef(noise[:, 0], noise[:, 1])[0, 1]) < 0.06


def test_the_zero_of_a_campaign_is_drawn_once_for_all_of_its_states() -> None:
    one = replace(warm(6), campaign=np.array([0, 0, 0, 4, 4, 4]), zero_sd=(5.0, 2.0))
    fit = fit_run(one, separate_parts=True)
    drawn = (repeated_runs(fit, np.random.default_rng(4), 5000) - fit.explained_um).reshape(5000, 6, 5)
    middle = drawn[:, :, 2]
    np.testing.assert_allclose(middle[:, :3], middle[:, :1].repeat(3, axis=1))
    np.testing.assert_allclose(middle[:, 3:], middle[:, 3:4].repeat(3, axis=1))
    assert middle.std(axis=0) == pytest.approx(np.full(6, 5.0), rel=0.05)
    assert abs(np.corrcoef(middle[:, 0], middle[:, 3])[0, 1]) < 0.05
    assert (drawn[:, :, 4] - middle).std() == pytest.approx(2.0, rel=0.05)


def test_drawn_rests_follow_each_other_within_a_campaign_only() -> None:
    one = replace(scattered(40, 5, correlation=0.8), campaign=np.repeat([0, 1], 20))
    fit = fit_run(one, separate_parts=True)
    known = _autocorrelation(fit)
    assert 0.4 < known <= 0.9
    drawn = (repeated_runs(fit, np.random.default_rng(6), 6000) - fit.explained_um).reshape(6000, 40, 5)[:, :, 2]
    within = [np.corrcoef(drawn[:, k], drawn[:, k + 1])[0, 1] for k in range(39) if k != 19]
    assert np.abs(np.array(within) - known).max() < 0.08
    assert abs(np.corrcoef(drawn[:, 19], drawn[:, 20])[0, 1]) < 0.06
    # A stationary sequence: the last state scatters as the first.
    assert drawn[:, 19].std() == pytest.approx(drawn[:, 0].std(), rel=0.06)


def test_the_correlation_of_the_rest_by_hand() -> None:
    """Rests 1, 1, -1, -1 µm: products 1, -1, 1 over a power of 4 are 0.25; Kendall adds (1 + 0.75) / 4, clipped."""
    one = replace(warm(4), lever_m=np.zeros(20), intercept_um=np.full(20, 1e-30), slope_um_per_m=np.zeros(20))
    fit = fit_run(replace(one, value_um=np.repeat([1.0, 1.0, -1.0, -1.0], 5)), separate_parts=False)
    assert _autocorrelation(fit) == pytest.approx(0.25 + 1.75 / 4)
    apart = replace(fit, points=replace(fit.points, campaign=np.array([0, 0, 1, 1])))
    # The product across the border of two campaigns does not count: 2 over 4, and (1 + 1.5) / 4 more, at most 0.9.
    assert _autocorrelation(apart) == pytest.approx(0.9)
    alone = replace(fit, points=replace(fit.points, campaign=np.arange(4)))
    assert _autocorrelation(alone) == 0.0
    turning = replace(fit, rest=np.array([[1.0, 0.0], [-1.0, 0.0], [1.0, 0.0], [-1.0, 0.0]]))
    assert _autocorrelation(turning) == 0.0  # -0.75 and -0.31 more: no negative correlation is claimed
    assert _autocorrelation(replace(fit, rest=fit.rest[:2])) == 0.0
    assert _autocorrelation(replace(fit, rest=0.0 * fit.rest)) == 0.0


def test_a_long_run_may_be_correlated_beyond_nine_tenths() -> None:
    rest = np.column_stack([np.cos(np.arange(200) / 200.0), np.zeros(200)])
    one = replace(warm(200), intercept_um=np.full(1000, 1e-30), slope_um_per_m=np.zeros(1000))
    fit = replace(fit_run(one, separate_parts=False), rest=rest)
    assert _autocorrelation(fit) == pytest.approx(1.0 - 5.0 / 200.0)


def test_degrees_of_freedom_are_those_of_the_shorter_run_less_its_correlation() -> None:
    """Without correlation K - p; never below one."""
    turning = np.column_stack([np.tile([1.0, -1.0], 5), np.zeros(10)])
    fit, shorter, least = (replace(fit_run(warm(n), separate_parts=True), rest=turning[:n]) for n in (10, 6, 2))
    assert _freedom(fit) == pytest.approx(8.0)
    assert _freedom(fit, shorter) == _freedom(shorter, fit) == pytest.approx(4.0)
    assert _freedom(least) == 1.0
    slow = replace(fit, rest=np.column_stack([np.ones(10), np.zeros(10)]))
    assert _freedom(slow) == 1.0
    long = replace(
        fit_run(warm(60), separate_parts=False), rest=np.column_stack([np.arange(60) % 4 < 2, np.zeros(60)]) - 0.5
    )
    correlation = _autocorrelation(long)
    assert correlation > 0.01
    assert _freedom(long) == pytest.approx(60.0 * (1.0 - correlation) / (1.0 + correlation) - 1.0)


def test_like_heat_is_one_pattern_whatever_its_size() -> None:
    one = warm(6)
    assert _same_heat(one, warm(6, heat=0.3))
    assert not _same_heat(one, warm(5))
    # A part of a tenth of the whole, orthogonal to it, is the limit.
    whole = one.expected_um
    across = np.where(np.arange(30) % 2, 1.0, -1.0)
    across -= whole * (across @ whole) / (whole @ whole)
    across *= np.sqrt(np.mean(whole**2) / np.mean(across**2))
    for part, like in ((0.09, True), (0.12, False)):
        other = replace(one, intercept_um=whole + part * across, slope_um_per_m=np.zeros(30))
        assert _same_heat(one, other) == like


def test_the_miss_of_the_model_counts_where_the_heat_differs() -> None:
    """Rest 2 µm RMS at six states with one gain: 2 · √(6/5), over the RMS of what is expected, both runs as squares."""
    off, on = warm(6), warm(5)
    fits = [replace(fit_run(one, separate_parts=False), rest_um=2.0) for one in (off, on)]
    sizes = [np.sqrt(np.mean(one.expected_um**2)) for one in (off, on)]
    expected = np.hypot(2.0 * np.sqrt(6 / 5) / sizes[0], 2.0 * np.sqrt(5 / 4) / sizes[1])
    np.testing.assert_allclose(_transfer(*fits), [expected])
    assert _transfer(fits[0], fits[0]).tolist() == [0.0]


# --- shares -----------------------------------------------------------------------------------------------------------


def test_a_share_is_the_difference_of_the_gains_with_the_sizes_of_its_parts() -> None:
    found = {s.part: s for s in shares("EXY", warm(6), warm(6, (0.2, -0.5)), 5.0, np.random.default_rng(1))}
    assert list(found) == [ALL, INTERCEPT, SLOPE]
    assert (found[INTERCEPT].value, found[SLOPE].value) == (pytest.approx(0.8), pytest.approx(1.5))
    assert (found[INTERCEPT].size_um, found[SLOPE].size_um) == (60.0, 20.0)
    assert found[ALL].size_um == np.abs(warm(6).expected_um).max()
    assert found[ALL].expected_rms_um == pytest.approx(np.sqrt(np.mean(warm(6).expected_um ** 2)))
    # Intercept and slope free leave nothing, though one share for both would.
    assert found[ALL].unexplained_um == pytest.approx(0.0, abs=1e-9)
    # F of 4 and 4 degrees of freedom (six states less two gains) at 99 %: 15.98 in any table.
    assert found[ALL].chance == pytest.approx(np.sqrt(15.977), rel=1e-3)
    assert all(s.material for s in found.values())


@pytest.mark.parametrize(("least_um", "parts"), [(20.0, 3), (20.1, 1)])
def test_parts_are_judged_apart_where_both_are_large_enough(least_um: float, parts: int) -> None:
    found = shares("EXY", warm(6), warm(6, (0.0, 0.0)), least_um, np.random.default_rng(1))
    assert len(found) == parts
    assert all(s.material for s in found)
    assert not shares("EXY", warm(6), warm(6), 80.1, np.random.default_rng(1))[0].material


def test_one_gain_leaves_more_than_two_and_the_usual_rest_is_not_flattered() -> None:
    """Off: the rest of one gain to six states is that of the fit times √(6 / 5)."""
    off, on = warm(6, (1.0, 0.4)), warm(6, (0.1, 0.1))
    (found,) = shares("EXY", off, on, 50.0, np.random.default_rng(1))
    assert found.usual_um == pytest.approx(fit_run(off, False).rest_um * np.sqrt(6 / 5))
    assert found.unexplained_um == pytest.approx(0.0, abs=1e-9)


def test_shares_need_four_states_in_either_run_and_an_expected_error() -> None:
    rng = np.random.default_rng(1)
    assert shares("EXY", without_expectation(warm(6)), warm(6), 5.0, rng) == ()
    assert shares("EXY", warm(6), without_expectation(warm(6)), 5.0, rng) == ()
    for states, known in ((3, False), (4, True)):
        (found,) = shares("EXY", warm(6), warm(states, (0.0, 0.0)), 1e3, rng)
        assert np.isfinite([found.low, found.high]).all() == known
        assert (found.kind == "applied") == known
    assert enough_states(warm(4), warm(9))
    assert not enough_states(warm(9), warm(3))


def test_draws_are_fewer_for_long_records() -> None:
    class Long:
        def __init__(self, n: int) -> None:
            self.value_um = range(n)

    for sizes, draws in (((10,), 1000), ((4000, 10), 1000), ((10, 8000), 500), ((400_000,), 100)):
        assert draws_for(*map(Long, sizes)) == draws  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("value", "low", "high", "kind"),
    [
        (1.0, 0.5, 1.5, "applied"),
        (1.0, 0.49, 1.51, "unclear"),  # wider than 1
        (0.7, 0.65, 0.91, "unclear"),  # 1 is possible, yet 0.3 away
        (0.8, 0.75, 0.91, "applied"),
        (0.8, 0.75, 0.89, "partly"),
        (1.2, 1.11, 1.3, "too strong"),
        (1.2, 1.09, 1.3, "applied"),
        (-0.1, -0.3, -0.11, "reversed"),
        (0.5, 0.05, 0.92, "unclear"),  # 0 and 1 are both possible
        (2.2, 2.11, 2.3, "too strong"),
        (-1.2, -1.3, -1.11, "reversed"),
        # -1, 0 and 2 are possible, yet 0.3 away
        (-0.7, -0.95, -0.6, "unclear"),
        (0.3, 0.05, 0.5, "unclear"),
        (1.7, 1.65, 1.95, "unclear"),
    ],
)
def test_the_name_of_a_share_at_the_edges(value: float, low: float, high: float, kind: str) -> None:
    assert classify(value, low, high) == kind


# --- before and after -------------------------------------------------------------------------------------------------


def test_before_and_after_of_runs_without_scatter_in_closed_form() -> None:
    """On has half the heat and a tenth of its error remains: 95 % as measured, 90 % at like heat, surely."""
    off, on = warm(6), warm(6, (0.1, 0.1), heat=0.5)
    result = before_after("EXY", off, on, over_points, np.random.default_rng(1))
    assert (result.component, result.states_off, result.states_on) == ("EXY", 6, 6)
    value = np.abs(off.value_um)
    expected = {"max": value.max(), "p95": np.quantile(value, 0.95), "rms": np.sqrt(np.mean(value**2))}
    for kind, before_um in expected.items():
        one = result.of(kind)
        assert (one.before_um, one.like_before_um, one.after_um) == pytest.approx(
            (before_um, 0.5 * before_um, 0.05 * before_um)
        )
        assert (one.reduction_percent, one.like_reduction_percent) == pytest.approx((95.0, 90.0))
        assert (one.low_percent, one.high_percent) == pytest.approx((90.0, 90.0))


def test_bounds_of_a_percentage_lie_on_the_right_sides_of_it() -> None:
    off, on = scattered(12, 8), scattered(12, 9)
    on = replace(on, value_um=on.value_um - 0.9 * on.expected_um)
    one = before_after("EXY", off, on, over_points, np.random.default_rng(1)).of("rms")
    assert one.low_percent < one.like_reduction_percent < one.high_percent < 100.0


def test_without_an_expected_error_the_runs_are_compared_as_measured() -> None:
    off, on = without_expectation(warm(6)), without_expectation(warm(6, (0.25, 0.25)))
    for pair in ((off, on), (warm(6), on), (off, warm(6, (0.25, 0.25)))):
        one = before_after("EXY", *pair, over_points, np.random.default_rng(1)).of("max")
        assert one.reduction_percent == pytest.approx(75.0)
        assert np.isnan([one.like_before_um, one.like_reduction_percent, one.low_percent, one.high_percent]).all()


def test_few_states_have_a_percentage_without_bounds_and_no_error_has_none() -> None:
    one = before_after("EXY", warm(6), warm(3, (0.5, 0.5)), over_points, np.random.default_rng(1)).of("rms")
    assert np.isfinite(one.like_reduction_percent)
    assert np.isnan([one.low_percent, one.high_percent]).all()
    nothing = before_after("EXY", warm(6, (0.0, 0.0)), warm(6), over_points, np.random.default_rng(1)).of("max")
    assert np.isnan(nothing.reduction_percent)


def test_the_largest_of_every_state() -> None:
    one = warm(3, (1.0, -1.0))
    np.testing.assert_allclose(over_points(one.value_um, one), np.abs(one.value_um))
    np.testing.assert_allclose(over_states(one.value_um, one), [30.0, 28.0, 50.0])
    np.testing.assert_allclose(over_states(np.stack([one.value_um, -2.0 * one.value_um]), one)[1], [60.0, 56.0, 100.0])
    line = state_line("EXY", replace(one, value_um=0.5 * one.value_um))
    assert (line.component, line.t_s.tolist()) == ("EXY", [3600.0, 7200.0, 10800.0])
    np.testing.assert_allclose(line.largest_um, [15.0, 14.0, 25.0])
    np.testing.assert_allclose(line.expected_um, [30.0, 28.0, 50.0])


# --- harm -------------------------------------------------------------------------------------------------------------


def test_harm_is_the_residual_beyond_what_the_machine_would_do_alone() -> None:
    """Off shows twice what is expected; on 30 µm stand at -0.5 m in the second state, where 2 × 16 were to be."""
    off, on = warm(3, (2.0, 2.0)), warm(3, (0.0, 0.0))
    value = on.value_um.copy()
    value[6] = -37.0
    found = harm_map("EXY", off, replace(on, value_um=value), 4.0)
    assert found is not None
    expected = 2.0 * np.abs(on.expected_um.reshape(3, 5))
    np.testing.assert_allclose(found.harm_um, np.abs(value.reshape(3, 5)) - expected)
    assert found.largest_um == pytest.approx(37.0 - 2.0 * (20.0 - 4.0))
    assert (found.largest_at_s, found.largest_at_mm) == (7200.0, pytest.approx(0.0))
    np.testing.assert_allclose(found.position_mm, 500.0 + 1000.0 * LEVER_M)
    assert (found.component, found.limit_um, found.t_s.tolist()) == ("EXY", 4.0, on.t_s.tolist())


def test_approaches_to_one_position_are_averaged_and_gaps_stay_gaps() -> None:
    one = warm(2, (0.0, 0.0))
    lever = np.array([0.0, 0.0004, 0.5, 0.5, 1.0, 0.0, 0.0, 0.5, 0.5, 0.5])
    value = np.array([4.0, 8.0, -3.0, 1.0, 7.0, 1.0, 1.0, 9.0, 3.0, 0.0])
    on = replace(one, lever_m=lever, value_um=value, intercept_um=np.full(10, 1.0), slope_um_per_m=np.zeros(10))
    found = harm_map("EXY", on_gain(on), on, 1.0)
    assert found is not None
    np.testing.assert_allclose(found.harm_um, [[5.0, 0.0, 6.0], [0.0, 3.0, np.nan]])
    assert found.largest_at_mm == pytest.approx(1500.0)


def on_gain(on: RunPoints) -> RunPoints:
    """A run off that shows just what is expected."""
    return replace(on, value_um=on.expected_um)


def test_many_positions_are_put_together_in_forty_of_equal_width() -> None:
    lever = np.linspace(0.0, 1.0, 81)
    on = RunPoints(
        np.zeros(81, dtype=np.int64), 0.0, lever, np.zeros(81), 0.0, np.zeros(1, dtype=np.int64), np.array([60.0]),
        np.full(81, 1.0), np.zeros(81),
    )  # fmt: skip
    value = np.zeros(81)
    value[-3:] = 31.0  # the last of the forty holds the last three points
    value[40:42] = 20.0  # 0.5 and 0.5125 m are the two points of the twenty-first
    found = harm_map("EXY", on_gain(on), replace(on, value_um=value), 1.0)
    assert found is not None
    assert found.harm_um.shape == (1, MOST_POSITIONS)
    np.testing.assert_allclose(found.position_mm, 1000.0 * (np.arange(40) + 0.5) / 40)
    assert found.harm_um[0, 39] == pytest.approx(30.0)
    assert found.harm_um[0, 20] == pytest.approx(19.0)
    np.testing.assert_allclose(np.delete(found.harm_um[0], [20, 39]), -1.0)
    few = harm_map("EXY", on_gain(on), replace(on, lever_m=np.round(lever * 39) / 39, value_um=value), 1.0)
    assert few is not None
    assert few.harm_um.shape == (1, 40)
    np.testing.assert_allclose(few.position_mm, np.round(1000.0 * np.arange(40) / 39))


def test_no_harm_can_be_told_without_an_expected_error() -> None:
    for pair in ((warm(3), without_expectation(warm(3))), (without_expectation(warm(3)), warm(3))):
        assert harm_map("EXY", *pair, 1.0) is None

"""Lags against closed forms; recursion, vector form and resumed state are one and the same."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from thetacomp.errors import AnalysisError
from thetacomp.model.filters import (
    FilterState,
    InputLayout,
    history_inputs,
    recorded_inputs,
    run_filters,
    start_filters,
    step_filters,
)
from thetacomp.model.temperatures import Duty, Temperatures


def one_lag(t_s, u, tau_s):
    return run_filters(t_s, np.asarray(u, float)[:, None], (tau_s,))[0][:, 0, 0]


def stepped(t_s, u, taus_s):
    state = start_filters(t_s[0], u[0], taus_s)
    out = [state.lag]
    for time_s, row in zip(t_s[1:], u[1:], strict=True):
        state = step_filters(state, time_s, row, taus_s)
        out.append(state.lag)
    return np.array(out), state


def test_step_is_one_minus_exponential_at_any_spacing():
    rng = np.random.default_rng(1)
    t_s = np.concatenate([[0.0, 10.0], 10.0 + np.cumsum(rng.uniform(0.1, 900.0, 300))])
    u = np.where(t_s >= 10.0, 5.0, 0.0)
    # the step is held from 10 s on, so the lag is 5 (1 - exp(-(t - 10) / τ)) exactly
    expected = np.where(t_s >= 10.0, 5.0 * -np.expm1(-(t_s - 10.0) / 600.0), 0.0)
    np.testing.assert_allclose(one_lag(t_s, u, 600.0), expected, rtol=1e-12, atol=1e-12)


def test_ramp_follows_behind_by_time_constant():
    dt_s, tau_s, slope = 2.0, 600.0, 0.01
    t_s = np.arange(0.0, 20 * tau_s, dt_s)
    a = np.exp(-dt_s / tau_s)
    k = np.arange(len(t_s))
    # solution of x_k = a x_{k-1} + (1-a) s (k-1) dt: s dt (k - 1/(1-a) + a^k/(1-a))
    exact = slope * dt_s * (k - (1 - a**k) / (1 - a))
    lag = one_lag(t_s, slope * t_s, tau_s)
    np.testing.assert_allclose(lag, exact, rtol=1e-9, atol=1e-10)
    # a continuous lag trails a ramp by slope x τ; holding the input adds half a sample
    assert slope * t_s[-1] - lag[-1] == pytest.approx(slope * (tau_s + dt_s / 2), rel=1e-4)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([0.5, 30.0, 900.0, 28800.0]), st.floats(0.0, 0.3))
def test_vector_form_equals_recursion_with_gaps_and_irregular_time(seed, tau_s, missing):
    rng = np.random.default_rng(seed)
    t_s = np.cumsum(rng.exponential(60.0, 80)) + rng.choice([0.0, 1e9])
    u = 25.0 + rng.normal(size=(80, 3)).cumsum(axis=0)
    u[rng.random(u.shape) < missing] = np.nan
    taus_s = (tau_s, 3.0 * tau_s)
    expected, last = stepped(t_s, u, taus_s)
    lags, state = run_filters(t_s, u, taus_s)
    # 1e9 s is 32 years: its last digit is 1e-7 s, far below what 1e-6 asks
    np.testing.assert_allclose(lags, expected, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(state.lag, last.lag, rtol=1e-6)
    np.testing.assert_array_equal(state.signal, last.signal)


def test_a_gap_of_days_does_not_overflow():
    t_s = np.array([0.0, 1.0, 1e6, 1e6 + 1.0, 3e9])
    lag = one_lag(t_s, [20.0, 30.0, 40.0, 40.0, 50.0], 10.0)
    # the 20 is held for 1 s, the 30 for days, the 40 for 1 s and then for years
    np.testing.assert_allclose(lag, [20.0, 20.0, 30.0, 30.0 + 10.0 * -np.expm1(-0.1), 40.0])


def test_going_on_from_an_exported_state_changes_nothing():
    rng = np.random.default_rng(2)
    t_s = np.cumsum(rng.exponential(15.0, 500))
    u = rng.normal(size=(500, 2)).cumsum(axis=0)
    u[:20, 1] = np.nan
    taus_s = (120.0, 7200.0)
    whole, _ = run_filters(t_s, u, taus_s)
    for cut in (10, 300):
        _, state = run_filters(t_s[:cut], u[:cut], taus_s)
        again = FilterState.from_dict(json.loads(json.dumps(state.to_dict())))
        rest, end = run_filters(t_s[cut:], u[cut:], taus_s, again)
        np.testing.assert_allclose(rest, whole[cut:], rtol=1e-9, atol=1e-10)
        assert end.t_s == t_s[-1]


def test_missing_start_waits_for_first_good_value():
    u = np.array([[np.nan], [np.nan], [30.0], [31.0]])
    lags, _ = run_filters(np.array([0.0, 60.0, 120.0, 180.0]), u, (60.0,))
    np.testing.assert_allclose(lags[:, 0, 0], [np.nan, np.nan, 30.0, 30.0])
    lags, state = run_filters(np.array([0.0, 60.0]), u[:2], (60.0,))
    assert np.isnan(lags).all()
    assert np.isnan(state.signal).all()


def test_time_that_runs_backward_is_refused():
    with pytest.raises(AnalysisError, match="backward at sample 2"):
        one_lag(np.array([0.0, 10.0, 5.0]), [1.0, 1.0, 1.0], 60.0)
    with pytest.raises(AnalysisError, match="sort samples"):
        step_filters(start_filters(10.0, np.ones(1), (60.0,)), 9.0, np.ones(1), (60.0,))
    with pytest.raises(AnalysisError, match="no samples"):
        run_filters(np.empty(0), np.empty((0, 1)), (60.0,))


def test_columns_are_what_their_names_say():
    layout = InputLayout(sensors=("theta_1", "theta_2"), time_constants_s=(600.0, 7200.0), base_degC=20.0)
    rng = np.random.default_rng(3)
    t_s = np.arange(0.0, 3600.0, 15.0)
    theta = 20.0 + rng.normal(size=(len(t_s), 2)).cumsum(axis=0)
    speed_rpm = np.where(t_s > 900.0, -3000.0, 0.0)
    column = dict(
        zip(
            [name for names in layout.blocks.values() for name in names],
            history_inputs(layout, t_s, theta, speed_rpm).T,
            strict=True,
        )
    )
    np.testing.assert_array_equal(column["theta_2"], theta[:, 1])
    lag = one_lag(t_s, theta[:, 0], 7200.0)
    np.testing.assert_allclose(column["theta_1 - lag 7200 s"], theta[:, 0] - lag)
    # speed counts in 1000 rpm, whatever the direction of rotation
    heat = one_lag(t_s, np.where(t_s > 900.0, 9.0, 0.0), 600.0)
    np.testing.assert_allclose(column["speed^2 lag 600 s"], heat)
    np.testing.assert_allclose(column["speed^1 lag 600 s"], heat / 3.0)
    np.testing.assert_allclose(column["speed^2 lag 600 s x mean rise"], heat * (theta.mean(axis=1) - 20.0))


def test_layout_without_speed_and_wrong_layouts():
    layout = InputLayout(sensors=("a",), time_constants_s=(60.0,), speed_powers=(), base_degC=20.0)
    assert history_inputs(layout, np.arange(3.0), np.full((3, 1), 21.0)).shape == (3, 2)
    with pytest.raises(AnalysisError, match="2 temperatures found, 1 expected"):
        layout.signals(np.zeros((3, 2)))
    with pytest.raises(AnalysisError, match="spindle speed"):
        InputLayout(sensors=("a",), base_degC=20.0).signals(np.zeros((3, 1)))
    with pytest.raises(ValidationError, match="above zero and differ"):
        InputLayout(sensors=("a",), time_constants_s=(60.0, 60.0), base_degC=20.0)


def test_a_layout_says_from_which_temperature_its_mean_rise_counts() -> None:
    """Plain temperatures have no product with the rise, and are written with 0; any other layout has to name it."""
    assert InputLayout.plain(("a",)) == InputLayout(sensors=("a",), time_constants_s=(), speed_powers=(), base_degC=0.0)
    with pytest.raises(ValidationError, match="base_degC"):
        InputLayout.model_validate({"sensors": ["a"]})


@pytest.mark.parametrize("columns", [None, {}, {"feed_mm_min": np.ones(3)}])
def test_a_layout_with_speeds_needs_a_duty_that_has_them(columns: dict[str, np.ndarray] | None) -> None:
    heat = Temperatures(60.0 * np.arange(3.0), ("a",), np.full((3, 1), 21.0))
    duty = None if columns is None else Duty(heat.t_s, columns)
    with pytest.raises(AnalysisError, match=r"there is no spindle_rpm\. Fix: give a duty table"):
        recorded_inputs(InputLayout(sensors=("a",), base_degC=20.0), heat, duty)
    still = InputLayout(sensors=("a",), speed_powers=(), base_degC=20.0)
    names = [name for block in still.blocks.values() for name in block]
    assert recorded_inputs(still, heat, duty)[1].shape == (3, len(names))


def test_a_speed_holds_until_the_next_entry_and_before_the_first_one_the_first() -> None:
    layout = InputLayout(sensors=("a",), time_constants_s=(600.0,), speed_powers=(1,), base_degC=21.0)
    heat = Temperatures(60.0 * np.arange(5.0), ("a",), np.full((5, 1), 21.0))
    duty = Duty(np.array([60.0, 130.0, 240.0]), {"spindle_rpm": np.array([2000.0, np.nan, 1000.0])})
    speed_rpm = np.array([2000.0, 2000.0, 2000.0, 0.0, 1000.0])  # an empty cell counts as standstill
    expected = history_inputs(layout, heat.t_s, heat.value_degC, speed_rpm)
    np.testing.assert_allclose(recorded_inputs(layout, heat, duty)[1], expected)


def test_filters_bridge_a_gap_and_plain_temperatures_keep_it() -> None:
    heat = Temperatures(60.0 * np.arange(3.0), ("b", "a"), np.array([[0.0, 20.0], [0.0, np.nan], [0.0, 22.0]]))
    lagged = InputLayout(sensors=("a",), time_constants_s=(600.0,), speed_powers=(), base_degC=0.0)
    np.testing.assert_allclose(recorded_inputs(lagged, heat, None)[1][:, 0], [20.0, 21.0, 22.0])
    np.testing.assert_allclose(recorded_inputs(InputLayout.plain(("a",)), heat, None)[1][:, 0], [20.0, np.nan, 22.0])

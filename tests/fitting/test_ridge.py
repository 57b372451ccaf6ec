"""The averaged block ridge: equal to scikit-learn's ridge, blind to what is held out, able to learn a known machine."""

from __future__ import annotations

import json

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.linear_model import Ridge

from thetacomp.errors import AnalysisError
from thetacomp.fitting.ridge import (
    OUTLYING_CAMPAIGNS,
    WHOLE_CAMPAIGNS,
    BlockUse,
    HistoryRidge,
    Stretches,
    history_candidates,
)
from thetacomp.model.filters import LEVEL_CAMPAIGNS, InputLayout, history_inputs

LAYOUT = InputLayout(sensors=("theta_1", "theta_2", "theta_3"), base_degC=20.0)


def machine(seed=0):
    """Five campaigns of 6 h: two bodies warmed by speed² and the room; only the room and one body carry sensors."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(0.0, 5 * 21600.0, 60.0)
    campaign = (t_s // 21600.0).astype(int)
    speed_rpm = np.where(t_s % 21600.0 < 10800.0, np.array([1500.0, 3000.0, 2000.0, 4000.0, 2500.0])[campaign], 0.0)
    room_K = 2.0 * np.sin(t_s / 9000.0)
    heat = np.zeros((len(t_s), 2))
    for k in range(1, len(t_s)):
        target = 0.4 * (speed_rpm[k - 1] / 1000.0) ** 2 + room_K[k - 1]
        heat[k] = heat[k - 1] + (target - heat[k - 1]) * -np.expm1(-60.0 / np.array([1800.0, 7200.0]))
    theta = 20.0 + np.column_stack([room_K, heat[:, 0], 0.5 * room_K + 0.5 * heat[:, 0]])
    theta += rng.normal(0.0, 0.05, theta.shape)
    y_um = np.column_stack([6.0 * heat[:, 1] - 2.0 * heat[:, 0], 3.0 * room_K])
    inputs = history_inputs(LAYOUT, t_s, theta, speed_rpm)
    return inputs - inputs[0], y_um - y_um[0], campaign


def procedure():
    return HistoryRidge(LAYOUT.blocks, history_candidates(LAYOUT, 3))


def errors_by_refitting(x, y, together, strength):
    """Errors on what is left out together, by scikit-learn's ridge fitted anew, inputs in their standard deviations."""
    sd, error = x.std(axis=0), np.empty_like(y)
    for label in np.unique(together):
        rows = together != label
        ridge = Ridge(alpha=strength * len(x), fit_intercept=False).fit(x[rows] / sd, y[rows])
        error[~rows] = ridge.predict(x[~rows] / sd) - y[~rows]
    return error


@pytest.mark.parametrize("columns", [4, 30])
def test_strengths_are_chosen_on_campaigns_left_out_as_refitting_would(columns):
    """With more columns than rows left, too: the decomposition then is that of the kernel."""
    rng = np.random.default_rng(5)
    groups = np.repeat(np.arange(WHOLE_CAMPAIGNS), 5)
    x = rng.normal(size=(len(groups), columns))
    y = x[:, :4] @ [1.0, -1.0, 0.5, 0.0] + rng.normal(size=len(x))
    strengths = (1e-3, 1e-1, 1.0, 100.0)
    blocks, candidate = {"a": tuple(f"x{k}" for k in range(columns))}, (BlockUse("a", 1.0, "each"),)
    model = HistoryRidge(blocks, (candidate,), strengths).fit(x, y, groups)

    def mean_square(strength):
        return np.mean(errors_by_refitting(x, y, groups, strength) ** 2)

    best = min(strengths, key=mean_square)
    assert model.strengths_ == best
    assert model.held_out_rmse_um_[0, 0] == pytest.approx(np.sqrt(mean_square(best)), rel=1e-6)
    sd = x.std(axis=0)
    expected = Ridge(alpha=best * len(x), fit_intercept=False).fit(x / sd, y).coef_ / sd
    np.testing.assert_allclose(model.coef_, expected, rtol=1e-7)
    rest = groups != 1
    without = Ridge(alpha=best * len(x), fit_intercept=False).fit(x[rest] / sd, y[rest]).coef_ / sd
    np.testing.assert_allclose(model.left_out_coef_[1], without, rtol=1e-5, atol=1e-9)


def test_of_few_campaigns_halves_are_left_out():
    rng = np.random.default_rng(7)
    groups = np.repeat(np.arange(WHOLE_CAMPAIGNS - 1), 10)
    x = rng.normal(size=(len(groups), 3))
    y = x @ [1.0, -1.0, 0.5] + rng.normal(size=len(x))
    model = HistoryRidge({"a": ("p", "q", "r")}, ((BlockUse("a", 1.0, "each"),),), (0.1,)).fit(x, y, groups)
    halves = 2 * groups + (np.arange(len(groups)) % 10 >= 5)
    expected = np.sqrt(np.mean(errors_by_refitting(x, y, halves, 0.1) ** 2))
    assert model.held_out_rmse_um_[0, 0] == pytest.approx(expected, rel=1e-6)


def test_rows_are_means_over_stretches_and_every_campaign_has_the_same_number():
    x = np.arange(1000.0)[:, None]
    groups = np.repeat([0, 1], [900, 100])
    rows = Stretches.of(x, 2.0 * x, groups)
    assert np.bincount(rows.campaign).tolist() == [80, 80]
    np.testing.assert_allclose(rows.y, 2.0 * rows.x)
    assert rows.x[0, 0] == np.arange(12).mean()
    sparse = Stretches.of(x[:5], x[:5], np.array([0, 0, 0, 1, 1]))
    np.testing.assert_array_equal(sparse.x, x[:5])


def test_an_outlying_campaign_counts_less_where_campaigns_are_many():
    rng = np.random.default_rng(8)
    groups = np.repeat(np.arange(12), 10)
    x = rng.normal(size=(len(groups), 2))
    truth = np.array([3.0, -2.0])
    y = x @ truth + 0.1 * rng.normal(size=len(x))
    y[groups == 4] = x[groups == 4] @ [-10.0, 10.0]
    one = {"a": ("p", "q")}, ((BlockUse("a", 1.0, "each"),),), (1e-6,)
    model = HistoryRidge(*one).fit(x, y, groups)
    assert model.group_weights_[4] < 0.05
    assert np.delete(model.group_weights_, 4).tolist() == [1.0] * 11
    np.testing.assert_allclose(model.coef_, truth, atol=0.1)
    few = groups < OUTLYING_CAMPAIGNS - 1
    assert (HistoryRidge(*one).fit(x[few], y[few], groups[few]).group_weights_ == 1.0).all()


def test_the_level_is_offered_to_many_campaigns_only():
    layout = LAYOUT.model_copy(update={"products": ("median", "level")})

    def blocks(campaigns):
        return {use.block for candidate in history_candidates(layout, campaigns) for use in candidate}

    assert "rise x level" in blocks(LEVEL_CAMPAIGNS)
    assert "rise x level" not in blocks(LEVEL_CAMPAIGNS - 1)
    assert "rise x median" in blocks(2)


def test_a_machine_that_answers_by_its_level_is_learnt():
    """`error = rise × (2 + level / 5 K)`: without the level no linear law in rises can follow it."""
    rng = np.random.default_rng(9)
    groups = np.repeat(np.arange(14), 20)
    start_degC = rng.uniform(15.0, 30.0, 14)[groups]
    rise_K = rng.uniform(0.0, 10.0, len(groups)) * (np.arange(len(groups)) % 20 > 0)
    y = rise_K * (2.0 + (start_degC - 20.0) / 5.0)
    held_out = {}
    for products in ((), ("level",)):
        layout = InputLayout(
            sensors=("t",), time_constants_s=(900.0,), speed_powers=(), base_degC=20.0, products=products
        )
        x = np.zeros((len(groups), sum(map(len, layout.blocks.values()))))
        for label in np.unique(groups):
            own = groups == label
            degC = (start_degC + rise_K)[own]
            running = np.column_stack([degC, np.zeros(len(degC))])
            x[own] = layout.since(running, running[0])
        model = HistoryRidge(layout.blocks, history_candidates(layout, 14)).fit(x, y, groups)
        held_out[products] = model.held_out_rmse_um_.min()
    assert held_out[("level",)] < 0.05 * held_out[()]


def test_a_fit_like_another_takes_its_strengths_and_weights():
    x, y_um, campaign = machine()
    full = procedure().fit(x, y_um, campaign)
    again = procedure().fit(x, y_um, campaign, like=full)
    np.testing.assert_allclose(again.coef_, full.coef_, rtol=1e-12)
    np.testing.assert_allclose(again.left_out_coef_, full.left_out_coef_, rtol=1e-12)
    other = procedure().fit(x, 2.0 * y_um[:, ::-1], campaign, like=full)
    np.testing.assert_array_equal(other.strengths_, full.strengths_)
    np.testing.assert_allclose(other.weights_, full.weights_)


def test_a_common_scale_is_the_root_mean_square_of_the_inputs_scales():
    """One block, one strength: the ridge on inputs that are divided by √(mean of their variances) over the width."""
    rng = np.random.default_rng(6)
    x, groups = rng.normal(size=(60, 3)) * [1.0, 5.0, 0.1], np.repeat([0, 1, 2], 20)
    y = x @ [1.0, -1.0, 30.0] + rng.normal(size=60)
    candidate = (BlockUse("a", 2.0, "common"),)
    model = HistoryRidge({"a": ("p", "q", "r")}, (candidate,), (0.1,)).fit(x, y, groups)
    scale = np.sqrt(np.mean(x.var(axis=0))) / 2.0
    expected = Ridge(alpha=0.1 * 60, fit_intercept=False).fit(x / scale, y).coef_ / scale
    np.testing.assert_allclose(model.coef_, expected, rtol=1e-9)


def test_learns_a_body_without_sensor_and_forgets_no_target():
    x, y_um, campaign = machine()
    train = campaign != 3  # the fastest campaign: extrapolation in speed
    error_um = procedure().fit(x[train], y_um[train], campaign[train]).predict(x[~train]) - y_um[~train]
    only_theta = HistoryRidge(LAYOUT.blocks, ((BlockUse("temperature", 1.0, "each"),),))
    theta_um = only_theta.fit(x[train], y_um[train], campaign[train]).predict(x[~train]) - y_um[~train]

    def rms(e_um):
        return np.sqrt((e_um**2).mean(axis=0))

    # the slow body moves by tens of µm; temperatures alone cannot see it, heat history can
    assert rms(error_um)[0] < 0.35 * rms(theta_um)[0]
    assert rms(error_um)[0] < 0.1 * rms(y_um[~train])[0]
    assert rms(error_um)[1] < 0.1 * rms(y_um[~train])[1]
    alone = procedure().fit(x[train], y_um[train, 1], campaign[train])
    both = procedure().fit(x[train], y_um[train], campaign[train])
    np.testing.assert_allclose(alone.coef_, both.coef_[1], rtol=1e-9)


def test_a_useless_candidate_gets_next_to_no_weight():
    x, y_um, campaign = machine()
    good = (BlockUse("temperature", 1.0, "each"),)
    useless = (BlockUse("speed^1 900 s", 1.0, "each"),)
    model = HistoryRidge(LAYOUT.blocks, (good, useless)).fit(x, y_um[:, 1], campaign)
    assert model.weights_[0, 1] < 0.01
    assert model.weights_.sum() == pytest.approx(1.0)


def test_candidates_are_the_fixed_list():
    candidates = history_candidates(LAYOUT, 3)
    assert len(candidates) == len(set(candidates)) == 52
    assert {use.block for candidate in candidates for use in candidate} == set(LAYOUT.blocks)
    without_speed = InputLayout(sensors=("a",), speed_powers=(), base_degC=20.0)
    assert len(set(history_candidates(without_speed, 3))) == 4
    single = InputLayout(sensors=("a",), speed_powers=(2,), time_constants_s=(600.0,), base_degC=20.0)
    assert len(set(history_candidates(single, 3))) == 20


def test_a_constant_input_gets_no_coefficient_and_missing_rows_are_left_out():
    x, y_um, campaign = machine()
    x[:, 0] = 0.0
    y_um[5, 1] = np.nan
    y_um[6, 1] = np.nan
    x[7, 3] = np.nan
    model = procedure().fit(x, y_um, campaign)
    assert (model.coef_[:, 0] == 0.0).all()
    keep = np.ones(len(x), dtype=bool)
    keep[[5, 6, 7]] = False
    np.testing.assert_array_equal(model.coef_, procedure().fit(x[keep], y_um[keep], campaign[keep]).coef_)


def test_parameters_are_json_and_predict_the_same():
    x, y_um, campaign = machine()
    model = clone(procedure()).fit(x, y_um, campaign)
    stored = json.loads(json.dumps(model.parameters()))
    assert stored["inputs"][3] == "theta_1 - lag 900 s"
    np.testing.assert_allclose(x @ np.array(stored["coefficients"]).T, model.predict(x))


def test_nothing_is_told_of_a_model_that_is_not_fitted():
    with pytest.raises(ValueError, match="not fitted yet"):
        procedure().parameters()
    with pytest.raises(ValueError, match="not fitted yet"):
        procedure().predict(np.zeros((1, 24)))


def test_too_few_campaigns_and_wrong_shapes_are_said():
    x, y_um, campaign = machine()
    with pytest.raises(AnalysisError, match="at least 2 training campaigns"):
        procedure().fit(x, y_um, np.zeros(len(x)))
    with pytest.raises(AnalysisError, match=r"inputs of 24 columns"):
        procedure().fit(x[:, :5], y_um, campaign)


def test_targets_groups_and_inputs_that_do_not_fit_together_are_said():
    model = HistoryRidge({"a": ("p", "q")}, ((BlockUse("a", 1.0, "each"),),))
    with pytest.raises(AnalysisError, match=r"4 targets need as many groups .* 2 columns; found \(4,\) .*\(4, 3\)"):
        model.fit(np.ones((4, 3)), np.ones(4), np.arange(4))
    with pytest.raises(AnalysisError, match=r"found \(3,\) groups and \(4, 2\) inputs"):
        model.fit(np.ones((4, 2)), np.ones(4), np.arange(3))

"""The averaged block ridge: equal to scikit-learn's ridge, blind to what is held out, able to learn a known machine."""

from __future__ import annotations

import json

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.linear_model import Ridge

from thetacomp.errors import AnalysisError
from thetacomp.fitting.ridge import (
    BlockUse,
    CampaignMoments,
    HistoryRidge,
    history_candidates,
    ridge_path,
    rise_since,
)
from thetacomp.model.filters import InputLayout, history_inputs

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
    return rise_since(inputs, inputs[0]), y_um - y_um[0], campaign


def procedure():
    return HistoryRidge(LAYOUT.blocks, history_candidates(LAYOUT, 3))


def test_path_equals_scikit_learns_ridge():
    rng = np.random.default_rng(4)
    x, y, groups = rng.normal(size=(90, 5)), rng.normal(size=(90, 2)), np.repeat([0, 1, 2], 30)
    width = np.array([1.0, 0.3, 2.0, 0.5, 1.0])
    moments = CampaignMoments.of(x, y, groups)
    strengths = np.array([1e-3, 0.1, 10.0])
    path = ridge_path(moments, [0, 2], np.arange(5), width, strengths)
    rows = groups != 1
    for a, strength in enumerate(strengths):
        reference = Ridge(alpha=strength * rows.sum(), fit_intercept=False).fit(x[rows] * width, y[rows])
        np.testing.assert_allclose(path[:, :, a], (reference.coef_ * width).T, rtol=1e-9)
    direct = ((y[groups == 1][:, :, None] - np.einsum("nk,kma->nma", x[groups == 1], path)) ** 2).sum(axis=0)
    np.testing.assert_allclose(moments.square_error(1, np.arange(5), path), direct, rtol=1e-9)
    np.testing.assert_allclose(moments.spread([0, 2]), x[rows].std(axis=0), rtol=1e-9)


def test_one_candidate_takes_the_strength_that_brute_force_takes():
    rng = np.random.default_rng(5)
    x, groups = rng.normal(size=(60, 4)), np.repeat([0, 1, 2], 20)
    y = x @ [1.0, -1.0, 0.5, 0.0] + rng.normal(size=60)
    strengths = (1e-3, 1e-1, 1.0, 100.0)
    model = HistoryRidge({"a": ("p", "q", "r", "s")}, ((BlockUse("a", 1.0, "each"),),), strengths).fit(x, y, groups)

    def squares(strength):
        total = 0.0
        for held_out in range(3):
            rows = groups != held_out
            sd = x[rows].std(axis=0)
            ridge = Ridge(alpha=strength * rows.sum(), fit_intercept=False).fit(x[rows] / sd, y[rows])
            total += ((ridge.predict(x[~rows] / sd) - y[~rows]) ** 2).sum()
        return total

    best = min(strengths, key=squares)
    assert model.strengths_ == best
    assert model.held_out_rmse_um_[0, 0] == pytest.approx(np.sqrt(squares(best) / 60))
    sd = x.std(axis=0)
    expected = Ridge(alpha=best * 60, fit_intercept=False).fit(x / sd, y).coef_ / sd
    np.testing.assert_allclose(model.coef_, expected, rtol=1e-9)


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


def test_campaign_held_out_inside_is_not_seen():
    x, y_um, campaign = machine()
    poisoned_x, poisoned_y = x.copy(), y_um.copy()
    poisoned_x[campaign == 2] = 1e6
    poisoned_y[campaign == 2] = -1e6
    clean, poisoned = (CampaignMoments.of(*data, campaign) for data in ((x, y_um), (poisoned_x, poisoned_y)))
    rest, columns, strengths = [0, 1, 3, 4], np.arange(30), np.array([0.1])
    np.testing.assert_array_equal(clean.spread(rest), poisoned.spread(rest))
    width = 1.0 / clean.spread(rest)[columns]
    np.testing.assert_array_equal(
        ridge_path(clean, rest, columns, width, strengths), ridge_path(poisoned, rest, columns, width, strengths)
    )


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
    useless = (BlockUse("speed^1 480 s", 1.0, "each"),)
    model = HistoryRidge(LAYOUT.blocks, (good, useless)).fit(x, y_um[:, 1], campaign)
    assert model.weights_[0, 1] < 0.01
    assert model.weights_.sum() == pytest.approx(1.0)


def test_candidates_are_the_fixed_list():
    candidates = history_candidates(LAYOUT)
    assert len(candidates) == len(set(candidates)) == 144
    assert {use.block for candidate in candidates for use in candidate} == set(LAYOUT.blocks)
    without_speed = InputLayout(sensors=("a",), speed_powers=(), base_degC=20.0)
    assert len(set(history_candidates(without_speed))) == 8
    single = InputLayout(sensors=("a",), speed_powers=(2,), time_constants_s=(600.0,), base_degC=20.0)
    assert len(set(history_candidates(single))) == 16


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
    assert stored["inputs"][3] == "theta_1 - lag 480 s"
    np.testing.assert_allclose(x @ np.array(stored["coefficients"]).T, model.predict(x))


def test_too_few_campaigns_and_wrong_shapes_are_said():
    x, y_um, campaign = machine()
    with pytest.raises(AnalysisError, match="at least 2 training campaigns"):
        procedure().fit(x, y_um, np.zeros(len(x)))
    with pytest.raises(AnalysisError, match=r"inputs of 52 columns"):
        procedure().fit(x[:, :5], y_um, campaign)


def test_targets_groups_and_inputs_that_do_not_fit_together_are_said():
    model = HistoryRidge({"a": ("p", "q")}, ((BlockUse("a", 1.0, "each"),),))
    with pytest.raises(AnalysisError, match=r"4 targets need as many groups .* 2 columns; found \(4,\) .*\(4, 3\)"):
        model.fit(np.ones((4, 3)), np.ones(4), np.arange(4))
    with pytest.raises(AnalysisError, match=r"found \(3,\) groups and \(4, 2\) inputs"):
        model.fit(np.ones((4, 2)), np.ones(4), np.arange(3))

"""Separation against machines whose geometry, slope and intercept are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from known_machine import MACHINE, TRAVEL_MM, measured_campaign
from scipy import stats

from thetacomp.campaign import Campaign, CampaignSettings, Drift, Parameters, SweepPoints
from thetacomp.errors import AnalysisError
from thetacomp.model.temperatures import Temperatures
from thetacomp.separation import separate_campaign
from thetacomp.separation.geometry import choose_curve, polynomial, smoothing_spline
from thetacomp.separation.reference import cold_block_change_K, reference_time_s
from thetacomp.separation.sweep_fit import rate_matrix


@pytest.mark.timeout(400)
@pytest.mark.parametrize("both_directions", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_stated_95_percent_intervals_cover_95_percent(both_directions: bool) -> None:
    """200 random machines, 3 directions, 8 hot states each: known truth, so the coverage has a closed expectation.

    White noise, an angle error common to each sweep and 0.5 % gross outliers. The acceptance is 93 to 97 % for every
    parameter.
    """
    rng = np.random.default_rng(20260302)
    inside: dict[str, list[bool]] = {}
    for _ in range(200):
        campaign, truth = measured_campaign(rng, both_directions=both_directions)
        for j, s in enumerate(separate_campaign(MACHINE, campaign)):
            hot = ~s.cold
            factor = stats.t.ppf(0.975, s.dof)
            for name, value, se, true in (
                ("I", s.intercept_um, s.intercept_se_um, truth.intercept(s.t_s, j)),
                ("S", s.slope_um_per_m, s.slope_se_um_per_m, truth.slope(s.t_s, j)),
            ):
                hits = np.abs(value - true)[hot] <= factor * se[hot]
                inside.setdefault(f"{name} d{'XYZ'[j]}", []).extend(hits.tolist())
    coverage = {name: 100.0 * np.mean(hits) for name, hits in inside.items()}
    print(f"coverage of the 95 % intervals: {coverage}")
    pooled = {kind: np.mean([c for name, c in coverage.items() if name[0] == kind]) for kind in "IS"}
    assert all(93.0 <= value <= 97.0 for value in pooled.values()), coverage


def test_ignoring_the_angle_error_would_make_the_intervals_too_narrow() -> None:
    rng = np.random.default_rng(1)
    hits = []
    for _ in range(20):
        campaign, truth = measured_campaign(rng)
        told = campaign.settings.model_copy(update={"instrument_u_um_per_m": 0.0})
        for j, s in enumerate(separate_campaign(MACHINE, replace(campaign, settings=told))):
            z = (s.slope_um_per_m - truth.slope(s.t_s, j))[~s.cold] / s.slope_se_um_per_m[~s.cold]
            hits.extend((np.abs(z) < 1.96).tolist())
    assert np.mean(hits) < 0.6


def test_gross_outliers_are_marked_and_cost_nothing() -> None:
    rng = np.random.default_rng(7)
    campaign, _ = measured_campaign(rng, outlier_share=0.0)
    assert campaign.sweeps is not None
    clean = separate_campaign(MACHINE, campaign)[0]
    spoilt_error = campaign.sweeps.error_um.copy()
    spoilt_error[[30, 100, 200], 0] += [800.0, -400.0, 150.0]
    spoilt = separate_campaign(MACHINE, replace(campaign, sweeps=replace(campaign.sweeps, error_um=spoilt_error)))[0]
    assert spoilt.points is not None
    assert set(np.flatnonzero(spoilt.points.outlier)) == {30, 100, 200}
    assert np.abs(spoilt.intercept_um - clean.intercept_um).max() < 1.0
    assert np.abs(spoilt.slope_um_per_m - clean.slope_um_per_m).max() < 1.0


def test_geometry_and_reversal_come_back() -> None:
    """Noise-free: the geometry is a parabola plus a reversal of 12 µm, both exact in a polynomial of degree 2."""
    position = np.tile(np.concatenate([np.linspace(0, 3000, 16), np.linspace(3000, 0, 16)]), 4)
    direction = np.tile(np.repeat([1, -1], 16), 4)
    sweep = np.repeat(np.arange(4), 32)
    lever = (position - 1500.0) / 1000.0
    geometry = 5.0 * lever**2 - 12.0 * (direction < 0)
    error = geometry + sweep * (20.0 + 10.0 * lever)
    rng = np.random.default_rng(3)
    error = error + rng.normal(0, 0.01, len(error))
    campaign = _sweeps(position, sweep, error, direction)
    s = separate_campaign(MACHINE, campaign)[0]
    assert s.reversal_um == pytest.approx(12.0, abs=0.1)
    assert s.intercept_um == pytest.approx([0, 20, 40, 60], abs=0.05)
    assert s.slope_um_per_m == pytest.approx([0, 10, 20, 30], abs=0.05)
    curve = next(c for c in s.geometry if c.direction == 1)
    expected = 5.0 * ((curve.position_mm - 1500.0) / 1000.0) ** 2
    assert curve.value_um == pytest.approx(expected, abs=0.1)


def test_every_point_has_its_own_time() -> None:
    """A one-way sweep of 40 minutes while the tool drifts 60 µm/h: a fit at the mean time would show a false slope.

    Truth: pure drift, linear in time, no slope. Over 3 m and 40 minutes it looks like 40 µm / 3 m = 13 µm/m.
    """
    position = np.tile(np.linspace(0, 3000, 21), 5)
    sweep = np.repeat(np.arange(5), 21)
    t_s = sweep * 3600.0 + np.tile(np.linspace(0, 2400, 21), 5)
    error = 60.0 * np.maximum(t_s - 2400.0, 0.0) / 3600.0 + np.random.default_rng(0).normal(0, 0.1, len(t_s))
    s = separate_campaign(MACHINE, _sweeps(position, sweep, error, np.ones(len(t_s)), t_s))[0]
    assert np.abs(s.slope_um_per_m).max() < 0.3
    assert s.intercept_um[1:] == pytest.approx(60.0 * (s.t_s[1:] - 2400.0) / 3600.0, abs=0.3)


def test_rate_is_that_of_a_parabola() -> None:
    times = np.array([0.0, 1.0, 2.5, 4.0])
    parabola = 3.0 + 2.0 * times - 0.5 * times**2
    assert rate_matrix(times) @ parabola == pytest.approx(2.0 - times)


def test_a_bend_is_error_and_never_geometry() -> None:
    """The mean bend of the heated sweeps must not count as geometry: the whole bend stands in the thermal points."""
    rng = np.random.default_rng(12)
    found, expected = [], []
    for _ in range(12):
        campaign, truth = measured_campaign(rng, bend_um=60.0, outlier_share=0.0, angle_u_um_per_m=0.0)
        s = separate_campaign(MACHINE, campaign)[0]
        assert s.points is not None
        assert any("heat bends the curve" in note for note in s.notes)
        last = s.points.sweep == s.sweep[-1]
        p, t_s = s.points.position_mm[last], s.points.t_s[last]
        basis = np.column_stack([np.ones(len(p)), p])
        for values, out in (
            (s.points.thermal_um[last], found),
            (60.0 * truth.warmth(t_s) * np.sin(np.pi * p / 3000.0), expected),
        ):
            bend = values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0]
            middle = np.abs(p - 1500.0) < 400.0
            out.append(float(bend[middle].mean()))
    # closed form: 60 µm times the warmth, less the best line; with the geometry of all sweeps a seventh would be left
    assert np.mean(found) == pytest.approx(np.mean(expected), rel=0.12)


def test_a_bend_is_found_and_told_in_um() -> None:
    rng = np.random.default_rng(11)
    bent = [separate_campaign(MACHINE, measured_campaign(rng, bend_um=40.0)[0])[0] for _ in range(5)]
    straight = [separate_campaign(MACHINE, measured_campaign(rng)[0])[0] for _ in range(40)]
    for s in bent:
        assert s.linearity is not None
        assert not s.linearity.holds
        # A half sine of 40 µm less its best line leaves at most 25 µm (2/pi of it below, 1 - 2/pi above).
        assert 10.0 < s.linearity.cost_um < 40.0
    false_alarms = sum(not s.linearity.holds for s in straight if s.linearity is not None)
    assert false_alarms <= 3  # level 1 %: 3 of 40 has a chance of 0.7 %


def test_periodic_screw_error_chooses_a_spline_and_a_straight_axis_a_low_degree() -> None:
    rng = np.random.default_rng(5)
    position = np.tile(np.linspace(0, 2000, 101), 4)
    sweep = np.repeat(np.arange(4), 101)
    direction = np.ones(len(position), dtype=int)
    periodic = 15.0 * np.sin(2 * np.pi * position / 200.0) + rng.normal(0, 2, len(position))
    assert "spline" in choose_curve(position, direction, sweep, periodic).name
    straight = 0.01 * position + rng.normal(0, 2, len(position))
    chosen = choose_curve(position, direction, sweep, straight)
    assert chosen.knots is None
    assert chosen.degree <= 2


def test_bases_reproduce_lines() -> None:
    """Both bases contain every straight line exactly, so the thermal line is never bent by the choice of G."""
    p = np.linspace(100.0, 900.0, 50)
    for curve in (polynomial(3, 100.0, 900.0), smoothing_spline(1e6, 10, 100.0, 900.0)):
        basis = curve.basis(p)
        normal = basis.T @ basis + curve.penalty
        fitted = basis @ np.linalg.solve(normal, basis.T @ (3.0 + 0.2 * p))
        assert fitted == pytest.approx(3.0 + 0.2 * p, rel=1e-6)


def test_reference_is_the_end_of_the_cold_block() -> None:
    axes = ("X", "X", "Y", "Y", "W", "W", "X", "X", "Y", "Y")
    points = SweepPoints(
        t_s=np.arange(10) * 100.0,
        axis=axes,
        sweep=np.repeat(np.arange(5), 2),
        position_mm=np.tile([0.0, 100.0], 5),
        direction=np.ones(10, dtype=np.int64),
        error_um=np.zeros((10, 3)),
    )
    campaign = Campaign("c", CampaignSettings(), _temperatures(), sweeps=points)
    assert reference_time_s(campaign) == 500.0
    stated = replace(campaign, settings=CampaignSettings(reference_s=300.0))
    assert reference_time_s(stated) == 300.0


@pytest.mark.parametrize("reference_s", [1200.0, 2400.0, 3500.0])
def test_the_end_of_the_cold_block_does_not_move_the_zero(reference_s: float) -> None:
    """The zero was measured by the cold sweep; a later reference_s names the same cold sweep and the same answer."""
    campaign, truth = measured_campaign(np.random.default_rng(9), sweeps=4, outlier_share=0.0)
    plain = separate_campaign(MACHINE, campaign)[0]
    told = campaign.settings.model_copy(update={"reference_s": reference_s})
    later = separate_campaign(MACHINE, replace(campaign, settings=told))[0]
    assert later.intercept_um == pytest.approx(plain.intercept_um)
    assert later.zero_t_s.mean() == pytest.approx(600.0)
    assert truth.reference_s == 1200.0


def test_a_reference_inside_a_sweep_is_refused() -> None:
    campaign, _ = measured_campaign(np.random.default_rng(9), sweeps=4)
    told = campaign.settings.model_copy(update={"reference_s": 4000.0})
    with pytest.raises(AnalysisError, match=r"reference_s = 4000 lies inside a sweep of axis Y \(3600 to 4800 s\)"):
        separate_campaign(MACHINE, replace(campaign, settings=told))


def test_stations_and_a_common_datum_are_refused_for_sweeps() -> None:
    campaign, _ = measured_campaign(np.random.default_rng(9), sweeps=3)
    assert campaign.sweeps is not None
    n = len(campaign.sweeps.t_s)
    moved = replace(campaign.sweeps, station=("A",) * (n // 2) + ("B",) * (n - n // 2))
    with pytest.raises(AnalysisError, match="come from the stations A, B"):
        separate_campaign(MACHINE, replace(campaign, sweeps=moved))
    common = campaign.settings.model_copy(update={"datum": "common"})
    with pytest.raises(AnalysisError, match="cannot be kept by sweeps"):
        separate_campaign(MACHINE, replace(campaign, settings=common))


def test_rows_with_another_p0_are_the_same_line() -> None:
    table = Parameters(
        t_s=np.array([0.0, 3600.0]),
        component=("EXX", "EXX"),
        intercept_um=np.array([0.0, 30.0]),
        slope_um_per_m=np.array([0.0, 10.0]),
        p0_mm=np.array([0.0, 1000.0]),
        p_min_mm=np.zeros(2),
        p_max_mm=np.full(2, 2000.0),
    )
    (exx,) = separate_campaign(MACHINE, Campaign("c", CampaignSettings(), _temperatures(), parameters=table))
    assert exx.line_um(1, np.array([1000.0])) == pytest.approx([30.0])
    common = CampaignSettings(datum="common")
    shifted = replace(table, intercept_um=np.array([5.0, 30.0]))
    (kept,) = separate_campaign(MACHINE, Campaign("c", common, _temperatures(), parameters=shifted))
    assert kept.intercept_um[0] == 5.0


def test_a_gap_in_the_temperatures_stays_a_gap() -> None:
    t_s = np.arange(0.0, 7200.0, 60.0)
    value = np.column_stack([t_s / 100.0, t_s / 100.0])
    value[(t_s > 1000) & (t_s < 3000), 0] = np.nan
    value[30, 1] = np.nan
    at = Temperatures(t_s, ("a", "b"), value).at(np.array([500.0, 2000.0, 1800.0, 7150.0, 9000.0]))
    assert at[0] == pytest.approx([5.0, 5.0])
    assert np.isnan(at[1, 0])
    assert at[2, 1] == pytest.approx(18.0)
    assert at[3] == pytest.approx([71.4, 71.4])
    assert np.isnan(at[4]).all()


def test_parameters_are_referred_to_the_cold_state() -> None:
    table = Parameters(
        t_s=np.array([0.0, 3600.0, 0.0, 3600.0]),
        component=("EXX", "EXX", "DX", "DX"),
        intercept_um=np.array([5.0, 25.0, 1.0, 4.0]),
        slope_um_per_m=np.array([-50.0, -60.0, np.nan, np.nan]),
        p0_mm=np.zeros(4),
        p_min_mm=np.zeros(4),
        p_max_mm=np.full(4, 1000.0),
    )
    campaign = Campaign("c", CampaignSettings(), _temperatures(), parameters=table)
    exx, dx = separate_campaign(MACHINE, campaign)
    assert exx.intercept_um.tolist() == [0.0, 20.0]
    assert exx.slope_um_per_m.tolist() == [0.0, -10.0]
    assert (exx.cold_intercept_um, exx.cold_slope_um_per_m) == (5.0, -50.0)
    assert dx.axis is None
    assert dx.intercept_um.tolist() == [0.0, 3.0]


def test_drift_keeps_its_zero_with_a_common_datum() -> None:
    drift = Drift(np.array([0.0, 10.0, 20.0]), np.array([[7.0, np.nan, 0.0], [9.0, 1.0, 0.0], [np.nan, 2.0, 0.0]]))
    own = Campaign("c", CampaignSettings(), _temperatures(), drift=drift)
    dx, dy, _ = separate_campaign(MACHINE, own)
    assert dx.intercept_um.tolist() == [0.0, 2.0]
    assert dy.sweep.tolist() == [1, 2]
    common = replace(own, settings=CampaignSettings(datum="common"))
    assert separate_campaign(MACHINE, common)[0].intercept_um.tolist() == [7.0, 9.0]


def test_too_few_points_are_refused_with_the_sweep_named() -> None:
    campaign = _sweeps(np.array([0.0, 1.0, 2.0, 0.0, 1.0]), np.array([0, 0, 0, 1, 1]), np.zeros(5), np.ones(5))
    with pytest.raises(AnalysisError, match="sweep 1 of axis Y has 2 points"):
        separate_campaign(MACHINE, campaign)


def test_a_cold_block_that_warms_up_is_measured() -> None:
    campaign, _ = measured_campaign(np.random.default_rng(6), sweeps=3)
    heat = Temperatures(np.array([0.0, 1200.0, 9000.0]), ("t1",), np.array([[20.0], [22.5], [30.0]]))
    assert cold_block_change_K(replace(campaign, temperatures=heat), 1200.0) == pytest.approx([2.5])


def test_no_cold_sweep_is_told() -> None:
    rng = np.random.default_rng(2)
    campaign, _ = measured_campaign(rng, sweeps=3)
    late = replace(campaign, settings=campaign.settings.model_copy(update={"reference_s": 0.0}))
    s = separate_campaign(MACHINE, late)[0]
    assert s.cold.tolist() == [True, False, False]
    assert any("serves as the cold state" in note for note in s.notes)


def test_more_scatter_than_the_instrument_states_is_told() -> None:
    campaign, _ = measured_campaign(np.random.default_rng(4), sweeps=4)
    optimistic = replace(
        campaign, settings=campaign.settings.model_copy(update={"instrument_u_um": 2.0, "instrument_u_um_per_m": 0.0})
    )
    notes = separate_campaign(MACHINE, optimistic)[0].notes
    assert any("more than twice" in note for note in notes)


def _temperatures() -> Temperatures:
    return Temperatures(np.array([0.0, 20000.0]), ("t1",), np.array([[20.0], [30.0]]))


def _sweeps(position, sweep, error, direction, t_s=None) -> Campaign:  # type: ignore[no-untyped-def]
    t_s = sweep * 3600.0 + np.arange(len(sweep)) if t_s is None else t_s
    points = SweepPoints(
        t_s=np.asarray(t_s, dtype=float),
        axis=("Y",) * len(sweep),
        sweep=np.asarray(sweep, dtype=np.int64),
        position_mm=np.asarray(position, dtype=float),
        direction=np.asarray(direction, dtype=np.int64),
        error_um=np.column_stack([error, np.full(len(sweep), np.nan), np.full(len(sweep), np.nan)]),
    )
    assert position.max() <= TRAVEL_MM
    return Campaign("c", CampaignSettings(instrument_u_um_per_m=0.0), _temperatures(), sweeps=points)

"""The parts of the separation one by one, on data small enough to be followed by hand."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from known_machine import MACHINE, measured_campaign

from thetacomp.arrays import Floats
from thetacomp.campaign import Campaign, CampaignSettings, Drift, Parameters, SweepPoints
from thetacomp.cold_block import cold_block_length
from thetacomp.errors import AnalysisError
from thetacomp.model.temperatures import Temperatures
from thetacomp.separation import separate_campaign
from thetacomp.separation.axis_shares import AxisFit, axis_share_um, between_nodes
from thetacomp.separation.component import mean_square_m2
from thetacomp.separation.drift_nodes import Nodes, drift_means, join, scatter
from thetacomp.separation.drift_outliers import gross_means, gross_readings, least_sd
from thetacomp.separation.form_choice import bent_components, separate_all
from thetacomp.separation.geometry import (
    candidates,
    choose_curve,
    direction_design,
    direction_penalty,
    flexible_curve,
    polynomial,
    smoothing_spline,
)
from thetacomp.separation.reference import cold_block_change_K, drift_window, reference_time_s
from thetacomp.separation.sweep_fit import ComponentData, find_outliers, fit_component, shape_change, state_weights


def heat(*rows: tuple[float, float]) -> Temperatures:
    table = np.array(rows or [(0.0, 20.0), (90000.0, 20.0)])
    return Temperatures(table[:, 0], ("t1",), table[:, 1:])


# --- the cold block ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("axes", "length"),
    [("X", 1), ("XXX", 1), ("XY", 2), ("XYX", 2), ("XXYYX", 4), ("XYYWWXY", 5), ("XYWYXW", 3), ("XYXX", 2)],
)
def test_the_cold_block_ends_where_an_axis_comes_back(axes: str, length: int) -> None:
    assert cold_block_length(tuple(axes)) == length


def test_the_zero_of_a_drift_are_the_five_minutes_up_to_the_reference_or_the_nearest_reading() -> None:
    t_s = np.array([0.0, 300.0, 599.0, 600.0, 601.0, 2000.0])
    assert drift_window(t_s, 600.0).tolist() == [False, True, True, True, False, False]
    assert drift_window(t_s, 599.0).tolist() == [False, True, True, False, False, False]
    assert drift_window(t_s, 1500.0).tolist() == [False, False, False, False, False, True]
    assert drift_window(t_s, -50.0).tolist() == [True, False, False, False, False, False]


def test_without_sweeps_the_reference_is_the_first_sample_of_what_there_is() -> None:
    drift = Drift(np.array([60.0, 120.0]), np.zeros((2, 3)))
    table = parameters([(30.0, "EXX", 1.0, 1.0)])
    assert reference_time_s(Campaign("c", CampaignSettings(), heat(), drift=drift)) == 60.0
    assert reference_time_s(Campaign("c", CampaignSettings(), heat(), drift=drift, parameters=table)) == 30.0
    with pytest.raises(AnalysisError, match="there are no sweeps, parameters or drift"):
        reference_time_s(Campaign("c", CampaignSettings(), heat()))


def test_the_cold_block_warms_from_its_first_point_to_the_reference() -> None:
    rising = heat((0.0, 20.0), (10000.0, 30.0))  # 1 K in 1000 s
    campaign, _ = measured_campaign(np.random.default_rng(1), sweeps=3)
    later = replace(campaign.sweeps, t_s=campaign.sweeps.t_s + 500.0)  # type: ignore[union-attr, type-var]
    assert cold_block_change_K(replace(campaign, temperatures=rising, sweeps=later), 1700.0) == pytest.approx([1.2])
    assert cold_block_change_K(replace(campaign, temperatures=rising, sweeps=later), 100.0) == pytest.approx([0.0])
    drift = Campaign("c", CampaignSettings(), rising, drift=Drift(np.array([0.0]), np.zeros((1, 3))))
    assert cold_block_change_K(drift, 900.0) == pytest.approx([0.0])


@pytest.mark.parametrize(("reference_s", "refused"), [(3600.0, False), (3601.0, True), (4798.9, True), (4799.0, False)])
def test_a_reference_may_touch_a_sweep_but_not_cut_it(reference_s: float, refused: bool) -> None:
    """Sweeps run from 0 to 1200 and from 3600 to 4800 s; one second belongs to rounding."""
    campaign, _ = measured_campaign(np.random.default_rng(9), sweeps=4)
    told = replace(campaign, settings=campaign.settings.model_copy(update={"reference_s": reference_s}))
    if refused:
        with pytest.raises(AnalysisError, match="lies inside a sweep"):
            separate_campaign(MACHINE, told)
    else:
        cold = separate_campaign(MACHINE, told)[0].cold
        assert cold.tolist() == [True, reference_s > 4000.0, False, False]


# --- interpolation between sweeps -------------------------------------------------------------------------------------


def test_one_node_is_a_line_from_zero_and_goes_on() -> None:
    found = between_nodes(10.0, np.array([20.0]), np.array([5.0, 10.0, 12.5, 20.0, 40.0]))
    np.testing.assert_allclose(found[:, 0], [0.0, 0.0, 0.25, 1.0, 3.0])


def test_behind_the_last_node_the_last_rate_goes_on() -> None:
    """(t - 1)² at 2, 3, 5 s: the parabola's rate at 5 s is 8, so at 7 s it is 16 + 2 × 8."""
    node_s = np.array([2.0, 3.0, 5.0])
    found = between_nodes(1.0, node_s, np.array([5.0, 7.0])) @ (node_s - 1.0) ** 2
    np.testing.assert_allclose(found, [16.0, 32.0])


def data(
    position_mm: Floats, sweep: Floats, error_um: Floats, t_s: Floats | None = None, **changes: Any
) -> ComponentData:
    """Points of an axis of 0 to 1000 mm, P0 in the middle; sweep 0 is cold, a sweep an hour."""
    number = sweep.astype(np.int64)
    count = int(number.max()) + 1
    time = 3600.0 * number if t_s is None else t_s
    given: dict[str, Any] = {
        "position_mm": position_mm, "t_s": time, "direction": np.ones(len(number), dtype=np.int64), "sweep": number,
        "error_um": error_um, "middle_s": np.array([time[number == k].mean() for k in range(count)]),
        "cold": np.arange(count) == 0, "p0_mm": 500.0, "angle_sd_urad": 0.0,
    }  # fmt: skip
    return ComponentData(**(given | changes))


def test_a_point_has_the_value_of_its_sweep_and_the_rate_times_its_own_time() -> None:
    """Cold until 100 s; middles at 300 and 700 s. Values (t - 100)² at nodes give the parabola's tangent at a sweep."""
    t_s = np.array([50.0, 100.0, 290.0, 310.0, 680.0, 720.0])
    one = data(np.zeros(6), np.array([0, 0, 1, 1, 2, 2]), np.zeros(6), t_s)
    weights = state_weights(one, np.array([1, 2]))
    value = weights @ (np.array([300.0, 700.0]) - 100.0) ** 2
    np.testing.assert_allclose(value, [0.0, 0.0, 4e4 - 4e3, 4e4 + 4e3, 36e4 - 24e3, 36e4 + 24e3])


# --- geometry ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("positions", "degrees", "splines"), [(3, 2, 0), (5, 4, 0), (6, 5, 7), (10, 9, 7), (40, 9, 7)])
def test_curves_are_those_that_the_positions_can_carry(positions: int, degrees: int, splines: int) -> None:
    place = np.repeat(np.linspace(100.0, 900.0, positions), 2)
    found = candidates(place)
    polynomials = [curve for curve in found if curve.knots is None]
    smooth = [curve for curve in found if curve.knots is not None]
    assert [curve.degree for curve in polynomials] == list(range(1, degrees + 1))
    assert len(smooth) == splines
    assert all((curve.p_min_mm, curve.p_max_mm) == (100.0, 900.0) for curve in found)
    assert [curve.size for curve in polynomials] == list(range(2, degrees + 2))
    assert all(curve.size == min(60, positions - 1) + 3 for curve in smooth)
    # From stiff to flexible.
    stiffness = [float(np.trace(curve.penalty)) for curve in smooth]
    assert stiffness == sorted(stiffness, reverse=True)
    flexible = flexible_curve(place)
    assert flexible is not None
    assert (flexible.name == "smoothing spline, penalty 0.01") if splines else (flexible.degree == degrees)


def test_a_spline_is_penalised_for_second_differences_only() -> None:
    curve = smoothing_spline(3.0, 8, 0.0, 100.0)
    size = curve.size
    assert size == 11
    line, square = np.arange(float(size)), np.arange(float(size)) ** 2
    assert line @ curve.penalty @ line == pytest.approx(0.0, abs=1e-9)
    assert square @ curve.penalty @ square == pytest.approx(3.0 * 4.0 * (size - 2))
    basis = curve.basis(np.array([0.0, 37.0, 100.0, 130.0]))
    np.testing.assert_allclose(basis.sum(axis=1), 1.0)
    np.testing.assert_allclose(basis[2], basis[3])  # held beyond the end


def test_each_approach_has_its_own_curve_and_its_own_penalty() -> None:
    curve = smoothing_spline(1.0, 5, 0.0, 100.0)
    place, direction = np.array([10.0, 60.0]), np.array([1, -1])
    design = direction_design(curve, place, direction, (-1, 1))
    np.testing.assert_allclose(design[0], np.concatenate([np.zeros(8), curve.basis(place[:1])[0]]))
    np.testing.assert_allclose(design[1], np.concatenate([curve.basis(place[1:])[0], np.zeros(8)]))
    penalty = direction_penalty(curve, (-1, 1))
    np.testing.assert_allclose(penalty[:8, :8], curve.penalty)
    np.testing.assert_allclose(penalty[8:, 8:], curve.penalty)
    assert not penalty[:8, 8:].any()


@pytest.mark.parametrize("sweeps", [1, 4])
@pytest.mark.parametrize("degree", [2, 3])
def test_the_chosen_degree_is_that_of_the_geometry(sweeps: int, degree: int) -> None:
    """Noise of 0.01 µm on a curve of 10 µm: no lower degree follows it, and no higher one is worth a percent."""
    place = np.tile(np.linspace(0.0, 1000.0, 16), sweeps)
    sweep = np.repeat(np.arange(sweeps), 16)
    x = place / 500.0 - 1.0
    rng = np.random.default_rng(8)
    error = 10.0 * x**degree + 30.0 * sweep * x + 7.0 * sweep + rng.normal(0.0, 0.01, len(place))
    chosen = choose_curve(place, np.ones(len(place), dtype=np.int64), sweep, error)
    assert (chosen.knots, chosen.degree) == (None, degree)


def test_a_bend_over_the_travel_has_this_mean_square() -> None:
    """∫u² du / length: about the middle of 2 m 1/3 m², about the end 4/3 m²."""
    assert mean_square_m2(1000.0, 0.0, 2000.0) == pytest.approx(1.0 / 3.0)
    assert mean_square_m2(0.0, 0.0, 2000.0) == pytest.approx(4.0 / 3.0)
    u = np.linspace(-0.3, 1.2, 100001)
    assert mean_square_m2(500.0, 200.0, 1700.0) == pytest.approx(float(np.mean(u**2)), rel=1e-4)


# --- the joint fit of a component -------------------------------------------------------------------------------------

PLACE = np.tile(np.linspace(0.0, 1000.0, 11), 4)
SWEEP = np.repeat(np.arange(4), 11)
LEVER = (PLACE - 500.0) / 1000.0


def noisy(scale: float = 1.0, seed: int = 2, **changes: Any) -> ComponentData:
    noise = scale * np.random.default_rng(seed).normal(0.0, 1.0, 44)
    return data(PLACE, SWEEP, 5.0 * LEVER**2 + SWEEP * (10.0 + 4.0 * LEVER) + noise, **changes)


def test_standard_errors_are_those_of_plain_least_squares() -> None:
    """Without an angle error and outliers: the covariance of an ordinary regression on the same design."""
    one = noisy()
    fit = fit_component(one)
    assert not fit.outlier.any()
    assert (fit.curve.knots, fit.states.tolist(), fit.directions) == (None, [1, 2, 3], (1,))
    geometry = fit.curve.basis(PLACE)
    weights = state_weights(one, fit.states)
    design = np.hstack([geometry, weights, weights * LEVER[:, None]])
    coefficients, rss, *_ = np.linalg.lstsq(design, one.error_um)
    freedom = 44 - design.shape[1]
    covariance = rss[0] / freedom * np.linalg.inv(design.T @ design)
    g = geometry.shape[1]
    np.testing.assert_allclose(fit.intercept_um, coefficients[g : g + 3], atol=1e-6)
    np.testing.assert_allclose(fit.slope_um_per_m, coefficients[g + 3 :], atol=1e-6)
    np.testing.assert_allclose(fit.intercept_se_um, np.sqrt(np.diag(covariance))[g : g + 3], rtol=1e-4)
    np.testing.assert_allclose(fit.slope_se_um_per_m, np.sqrt(np.diag(covariance))[g + 3 :], rtol=1e-4)
    np.testing.assert_allclose(fit.line_covariance, covariance[g:, g:], rtol=1e-3, atol=1e-9)
    np.testing.assert_allclose(fit.geometry_um, geometry @ coefficients[:g], atol=1e-6)
    assert fit.noise_sd_um == pytest.approx(np.sqrt(rss[0] / freedom), rel=1e-4)
    assert (fit.dof, fit.rss_um2) == (pytest.approx(freedom, rel=1e-4), pytest.approx(rss[0], rel=1e-4))
    assert not fit.bend_um_per_m2.any()


def test_an_angle_error_of_the_instrument_widens_slopes_as_squares_and_leaves_intercepts() -> None:
    """One heated sweep against a cold one: the slope's variance gains both angle errors, 2 · 9 µrad²."""
    rows = slice(0, 22)
    plain = data(PLACE[rows], SWEEP[rows], noisy().error_um[rows])
    fits = [fit_component(replace(plain, angle_sd_urad=sd)) for sd in (0.0, 3.0)]
    gain = fits[1].slope_se_um_per_m[0] ** 2 - fits[0].slope_se_um_per_m[0] ** 2
    assert gain == pytest.approx(18.0, rel=0.05)
    assert fits[1].intercept_se_um[0] == pytest.approx(fits[0].intercept_se_um[0], rel=0.05)


def test_a_tie_widens_intercepts_and_slopes_by_what_each_sweep_has_in_common() -> None:
    """Offsets of 2 µm and slopes of 5 µm/m in both sweeps, and 3 µrad of angle: 2 · 4 and 2 · (25 + 9)."""
    rows = slice(0, 22)
    plain = data(PLACE[rows], SWEEP[rows], noisy().error_um[rows])
    tie = np.tile(np.diag([4.0, 25.0]), (2, 1, 1))
    free, tied = fit_component(plain), fit_component(replace(plain, tie=tie, angle_sd_urad=3.0))
    assert tied.intercept_se_um[0] ** 2 - free.intercept_se_um[0] ** 2 == pytest.approx(8.0, rel=0.05)
    assert tied.slope_se_um_per_m[0] ** 2 - free.slope_se_um_per_m[0] ** 2 == pytest.approx(68.0, rel=0.05)


def test_a_point_without_weight_says_nothing() -> None:
    spoilt = noisy()
    error = spoilt.error_um.copy()
    error[[15, 16]] += 3.0  # far from gross
    weight = np.where(np.isin(np.arange(44), [15, 16]), 1e-9, 1.0)
    plain, weighted = (
        fit_component(replace(spoilt, error_um=error)),
        fit_component(replace(spoilt, error_um=error, weight=weight)),
    )
    clean = fit_component(replace(spoilt, weight=weight))
    np.testing.assert_allclose(weighted.intercept_um, clean.intercept_um, atol=0.02)
    assert np.abs(plain.intercept_um - clean.intercept_um).max() > 0.1


@pytest.mark.parametrize(("size_sd", "found"), [(3.0, False), (8.0, True)])
def test_an_outlier_is_judged_by_robust_standard_deviations(size_sd: float, found: bool) -> None:
    one = noisy(2.0, seed=4)
    error = one.error_um.copy()
    error[20] += 2.0 * size_sd - (error[20] - 5.0 * LEVER[20] ** 2 - 10.0 - 4.0 * LEVER[20])
    outlier = find_outliers(replace(one, error_um=error), polynomial(2, 0.0, 1000.0), (1,), np.array([1, 2, 3]))
    assert np.flatnonzero(outlier).tolist() == ([20] if found else [])


def test_a_change_of_shape_is_fitted_with_its_error_and_the_geometry_stays_that_of_the_cold_block() -> None:
    """Heated sweeps bend by 0.4 µm times the second Legendre term; three sweeps with two terms each."""
    one = noisy(0.1)
    x = 2.0 * LEVER
    bend = 0.4 * (1.5 * x**2 - 0.5) * (SWEEP > 0)
    bent = replace(one, error_um=one.error_um + bend)
    fit = fit_component(bent)
    shape = shape_change(bent, fit)
    assert shape.terms == 6
    miss = np.abs(shape.change_um - bend)[SWEEP > 0] / shape.se_um[SWEEP > 0]
    assert 0.3 < np.sqrt(np.mean(miss**2)) < 2.0
    assert shape.se_um.max() < 0.2
    assert shape.rss_um2 < 0.7 * fit.rss_um2
    assert not shape.change_um[SWEEP == 0].any()
    curve_um = shape.geometry_um[SWEEP == 0]
    line = np.column_stack([np.ones(11), LEVER[:11]])
    rest = curve_um - 5.0 * LEVER[:11] ** 2
    assert np.abs(rest - line @ np.linalg.lstsq(line, rest)[0]).max() < 0.15
    turned = replace(bent, direction=np.where(np.arange(44) % 2, 1, -1))
    assert shape_change(turned, fit_component(turned)).terms == 9
    assert shape_change(replace(bent, bent=True), fit_component(replace(bent, bent=True))).terms == 3


def test_what_an_axis_adds_at_any_place_and_time() -> None:
    """G(p) - G(P0) + S u + C u²; at the middle of sweep 2 S = 8 and C = 6, and beyond the ends the geometry holds."""
    bend = 3.0 * SWEEP * LEVER**2
    clean = noisy(1e-3, bent=True)
    fit = fit_component(replace(clean, error_um=clean.error_um + bend))
    separation = SimpleNamespace(direction="Y", reference_s=0.0)
    fitted = AxisFit(clean, fit, separation)  # type: ignore[arg-type]
    place = np.array([0.0, 250.0, 500.0, 1000.0, 1300.0])
    share = axis_share_um([fitted], "XYZ", np.full(5, clean.middle_s[2]), place)
    u = (place - 500.0) / 1000.0
    geometry = 5.0 * np.minimum(np.abs(u), 0.5) ** 2
    np.testing.assert_allclose(share[:, 1], geometry + 8.0 * u + 6.0 * u**2, atol=0.02)
    assert not share[:, [0, 2]].any()
    assert fitted.constant_um == pytest.approx(0.0, abs=0.01)


# --- separated campaigns ----------------------------------------------------------------------------------------------


def swept(error_um: Floats, *, direction: Floats | None = None, letters: int = 1, **settings: Any) -> Campaign:
    """Four sweeps of 11 points of the axis Y, 0 to 1000 mm of its 3 m; the numbers of the sweeps are 0, 2, 4, 6."""
    columns = np.full((44, 3), np.nan)
    columns[:, :letters] = error_um[:, None]
    points = SweepPoints(
        t_s=3600.0 * SWEEP + np.tile(np.arange(11.0), 4), axis=("Y",) * 44, sweep=2 * SWEEP, position_mm=PLACE,
        direction=np.ones(44, dtype=np.int64) if direction is None else direction.astype(np.int64), error_um=columns,
    )  # fmt: skip
    given = {"instrument_u_um_per_m": 0.0, "instrument_u_um": 15.0} | settings
    return Campaign("c", CampaignSettings.model_validate(given), heat(), sweeps=points)


def test_what_is_stated_of_a_component() -> None:
    error = noisy().error_um
    (s,) = separate_campaign(MACHINE, swept(error))
    assert (s.component, s.axis, s.direction, s.campaign) == ("EXY", "Y", "X", "c")
    assert (s.p0_mm, s.p_min_mm, s.p_max_mm, s.reference_s) == (1500.0, 0.0, 1000.0, 10.0)
    assert (s.sweep.tolist(), s.cold.tolist()) == ([0, 2, 4, 6], [True, False, False, False])
    assert s.zero_t_s.tolist() == list(range(11))
    np.testing.assert_allclose(s.t_s, 3600.0 * np.arange(4) + 5.0)
    points = s.points
    assert points is not None
    np.testing.assert_array_equal(points.error_um, error)
    np.testing.assert_allclose(points.residual_um, error - points.geometry_um - points.line_um)
    expected = [np.sqrt(np.mean(points.residual_um[k : k + 11] ** 2)) for k in range(0, 44, 11)]
    np.testing.assert_allclose(s.rms_um, expected)
    assert (s.intercept_um[0], s.slope_um_per_m[0], s.intercept_se_um[0]) == (0.0, 0.0, 0.0)
    assert s.reversal_um is None
    assert s.notes == ()
    (curve,) = s.geometry
    assert (curve.position_mm[0], curve.position_mm[-1], len(curve.position_mm)) == (0.0, 1000.0, 101)
    assert (curve.se_um > 0).all()


def test_a_direction_that_was_not_measured_hides_none_behind_it() -> None:
    campaign = swept(noisy().error_um, letters=3)
    points = campaign.sweeps
    assert points is not None
    error = points.error_um.copy()
    error[:, 1] = np.nan
    found = separate_campaign(MACHINE, replace(campaign, sweeps=replace(points, error_um=error)))
    assert [s.component for s in found] == ["EXY", "EZY"]


def test_an_outlier_does_not_count_in_the_rms_of_its_sweep() -> None:
    error = noisy().error_um
    error[25] += 80.0
    (s,) = separate_campaign(MACHINE, swept(error))
    assert s.points is not None
    assert np.flatnonzero(s.points.outlier).tolist() == [25]
    assert s.rms_um.max() < 2.5


def test_reversal_is_positive_minus_negative_approach() -> None:
    direction = np.where(np.arange(44) % 2, 1, -1)
    error = noisy(0.05).error_um + np.where(direction > 0, 4.0, -3.0)
    (s,) = separate_campaign(MACHINE, swept(error, direction=direction))
    assert s.reversal_um == pytest.approx(7.0, abs=0.3)


@pytest.mark.parametrize(
    ("stated_um", "per_m", "scatter_um", "told"),
    [
        (2.0, 0.0, 1.5, False),
        (2.0, 0.0, 2.6, True),
        (2.0, 1.0, 2.6, False),
        (2.0, 1.0, 3.6, True),
        (None, 1.0, 9.0, False),
    ],
)
def test_scatter_beyond_the_expanded_uncertainty_is_told(
    stated_um: float | None, per_m: float, scatter_um: float, told: bool
) -> None:
    """The points lie along 1 m, so `per_m` is what the far end adds to the stated uncertainty."""
    error = noisy(1e-6).error_um + scatter_um * np.where(np.arange(44) % 2, 1.0, -1.0) * 0.95
    notes = separate_campaign(MACHINE, swept(error, instrument_u_um=stated_um, instrument_u_um_per_m=per_m))[0].notes
    scatter = [note for note in notes if "points scatter by" in note]
    assert bool(scatter) == told
    if told and stated_um is not None:
        assert f"uncertainty of {stated_um + per_m:g} µm (expanded, at the far end of the travel) allows" in scatter[0]


def test_an_unstated_angle_error_is_told_unless_the_sweeps_are_tied() -> None:
    campaign = swept(noisy().error_um, instrument_u_um_per_m=None)
    assert "instrument_u_um_per_m is not stated" in separate_campaign(MACHINE, campaign)[0].notes[0]
    assert campaign.sweeps is not None
    tie = np.tile(np.diag([1.0, 1.0]), (7, 3, 1, 1))
    tied = replace(campaign, sweeps=replace(campaign.sweeps, tie_covariance=tie))
    assert separate_campaign(MACHINE, tied)[0].notes == ()
    widened = separate_campaign(MACHINE, tied)[0].intercept_se_um[1]
    assert widened > separate_campaign(MACHINE, campaign)[0].intercept_se_um[1]


def test_three_points_make_a_line_and_three_positions_an_axis() -> None:
    campaign = swept(noisy().error_um)
    points = campaign.sweeps
    assert points is not None
    error = points.error_um.copy()
    error[14:22, 0] = np.nan
    assert len(separate_campaign(MACHINE, replace(campaign, sweeps=replace(points, error_um=error)))) == 1
    error[13, 0] = np.nan
    with pytest.raises(AnalysisError, match="sweep 2 of axis Y has 2 points with dX_um"):
        separate_campaign(MACHINE, replace(campaign, sweeps=replace(points, error_um=error)))
    two = replace(points, position_mm=np.where(PLACE < 500.0, 0.0, 1000.0))
    with pytest.raises(AnalysisError, match="fewer than 3 positions"):
        separate_campaign(MACHINE, replace(campaign, sweeps=two))
    three = replace(points, position_mm=np.round(PLACE / 500.0) * 500.0)
    assert len(separate_campaign(MACHINE, replace(campaign, sweeps=three))) == 1


def test_the_test_of_shape_needs_degrees_of_freedom() -> None:
    """Four sweeps of three points: nothing is left to test with."""
    points = swept(noisy().error_um).sweeps
    assert points is not None
    rows = np.flatnonzero(np.isin(PLACE, [0.0, 500.0, 1000.0]))
    few = SweepPoints(
        points.t_s[rows], ("Y",) * 12, points.sweep[rows], points.position_mm[rows], points.direction[rows],
        points.error_um[rows],
    )  # fmt: skip
    campaign = Campaign("c", CampaignSettings(instrument_u_um_per_m=0.0), heat(), sweeps=few)
    assert separate_campaign(MACHINE, campaign)[0].linearity is None
    linearity = separate_campaign(MACHINE, swept(noisy().error_um))[0].linearity
    assert linearity is not None
    assert linearity.holds
    assert linearity.p_value >= 0.01
    assert linearity.f_statistic > 0.0


def parameters(rows: list[tuple[float, str, float, float]], p0_mm: Floats | None = None) -> Parameters:
    """Time, component, intercept, slope; travel from 10 k to 1000 + k mm in row k."""
    k = np.arange(float(len(rows)))
    return Parameters(
        t_s=np.array([row[0] for row in rows]), component=tuple(row[1] for row in rows),
        intercept_um=np.array([row[2] for row in rows]), slope_um_per_m=np.array([row[3] for row in rows]),
        p0_mm=np.zeros(len(rows)) if p0_mm is None else p0_mm, p_min_mm=10.0 * k, p_max_mm=1000.0 + k,
    )  # fmt: skip


def test_separated_parameters_come_in_order_of_time_less_their_cold_mean() -> None:
    """Cold are the moments up to a second behind the reference at 60 s: the mean of 2 and 4 µm, of 1 and 3 µm/m."""
    nan = float("nan")
    rows = [
        (7200.0, "EXY", 33.0, 12.0), (61.0, "EXY", 4.0, 3.0), (0.0, "EXY", 2.0, 1.0), (62.0, "EXY", 5.0, 6.0),
        (0.0, "EYY", nan, 1.0), (7200.0, "EYY", 8.0, 9.0), (3600.0, "DX", 4.0, nan), (3600.0, "EYY", 3.0, 4.0),
    ]  # fmt: skip
    campaign = Campaign("c", CampaignSettings(reference_s=60.0), heat(), parameters=parameters(rows))
    exy, eyy, dx = separate_campaign(MACHINE, campaign)
    assert exy.t_s.tolist() == [0.0, 61.0, 62.0, 7200.0]
    assert exy.intercept_um.tolist() == [-1.0, 1.0, 2.0, 30.0]
    assert exy.slope_um_per_m.tolist() == [-1.0, 1.0, 4.0, 10.0]
    assert exy.cold.tolist() == [True, True, False, False]
    assert exy.zero_t_s.tolist() == [0.0, 61.0]
    assert exy.sweep.tolist() == [0, 1, 2, 4]  # moments of the whole table
    assert (exy.p_min_mm, exy.p_max_mm, exy.axis, exy.direction) == (0.0, 1003.0, "Y", "X")
    # No complete state in the cold block: nothing is subtracted, and it is said.
    assert eyy.intercept_um.tolist()[1:] == [3.0, 8.0]
    assert eyy.slope_um_per_m.tolist() == [1.0, 4.0, 9.0]
    assert (eyy.cold_intercept_um, eyy.cold_slope_um_per_m) == (0.0, 0.0)
    assert "EYY has no complete state at or before the reference" in eyy.notes[0]
    assert (dx.axis, dx.p0_mm, dx.p_min_mm, dx.p_max_mm) == (None, 0.0, 0.0, 0.0)
    assert (dx.zero_t_s.tolist(), dx.slope_um_per_m.tolist(), len(dx.notes)) == ([3600.0], [0.0], 1)
    assert exy.notes == ()


def test_the_drift_of_a_common_datum_has_no_cold_state() -> None:
    drift = Drift(np.array([0.0, 10.0]), np.array([[7.0, 1.0, np.nan], [9.0, 1.0, np.nan]]))
    for datum, cold in (("campaign", [True, False]), ("common", [False, False])):
        campaign = Campaign("c", CampaignSettings.model_validate({"datum": datum}), heat(), drift=drift)
        dx, dy = separate_campaign(MACHINE, campaign)
        assert dx.cold.tolist() == cold
        assert dx.zero_t_s.tolist() == [0.0]
        assert (dx.cold_intercept_um, dy.component) == ((7.0 if datum == "campaign" else 0.0), "DY")
        assert (dx.p0_mm, dx.p_min_mm, dx.p_max_mm) == (0.0, 0.0, 0.0)


# --- bent components --------------------------------------------------------------------------------------------------


def a_test_of(component: str, holds: bool | None, positions: int = 5) -> Any:
    linearity = None if holds is None else SimpleNamespace(holds=holds)
    place = SimpleNamespace(position_mm=np.repeat(np.arange(float(positions)), 2))
    return SimpleNamespace(component=component, linearity=linearity, points=place)


def test_a_component_is_bent_where_more_than_half_of_its_tests_fail() -> None:
    for fails, tests, bent in ((1, 1, True), (1, 2, False), (2, 3, True), (2, 4, False), (3, 4, True), (0, 2, False)):
        given = [a_test_of("EXY", k >= fails) for k in range(tests)] + [a_test_of("EXY", None), a_test_of("EYY", True)]
        assert bent_components(given) == (("EXY",) if bent else ())
    assert bent_components([a_test_of("EXY", False, 4)]) == ()
    given = [a_test_of("EXY", False)]
    given[0].points = None
    assert bent_components(given) == ()


def test_the_size_of_a_bend_is_told_at_the_farther_end_of_the_travel() -> None:
    """20 µm/m² times the square of 1.5 m, RMS over three heated sweeps of 1, 2 and 3 times that: √(14 / 3)."""
    place = np.tile(np.linspace(0.0, 2400.0, 13), 4)
    sweep = np.repeat(np.arange(4), 13)
    u = (place - 1500.0) / 1000.0
    error = 20.0 * sweep * u**2 + np.random.default_rng(2).normal(0.0, 0.05, 52)
    points = SweepPoints(
        3600.0 * sweep + np.tile(np.arange(13.0), 4), ("Y",) * 52, sweep, place, np.ones(52, dtype=np.int64),
        np.column_stack([error, np.full(52, np.nan), np.full(52, np.nan)]),
    )  # fmt: skip
    campaign = Campaign("c", CampaignSettings(instrument_u_um_per_m=0.0), heat(), sweeps=points)
    found = separate_all(MACHINE, [campaign])
    (s,) = found.components
    assert s.bend_um_per_m2 is not None
    np.testing.assert_allclose(s.bend_um_per_m2, [0.0, 20.0, 40.0, 60.0], atol=0.5)
    # The best line of C u² over -1.5 to 0.9 m is higher at P0 by C times the mean of u².
    lift_um = s.bend_um_per_m2 * (1.5**2 - 1.5 * 0.9 + 0.9**2) / 3.0
    np.testing.assert_allclose(s.line_intercept_um - s.intercept_um, lift_um)
    size_um = 20.0 * np.sqrt(14.0 / 3.0) * 1.5**2
    assert f"EXY: heat bends the line, by {size_um:.0f} µm at the ends" in found.notes[-1]
    assert found.form == "separate"


# --- the drift record -------------------------------------------------------------------------------------------------


def test_a_look_is_two_minutes_long_and_ends_where_an_axis_moves() -> None:
    t_s = np.array([0.0, 60.0, 120.0, 121.0, 240.0, 300.0, 301.0])
    error = np.column_stack([np.arange(7.0)] * 3)
    at_mm = {"X": np.array([5.0, 5.0, 5.0, 5.0, 5.0, 5.0, 6.0])}
    means = drift_means(Drift(t_s, error), error, at_mm)
    np.testing.assert_allclose(means.t_s, [60.0, 180.5, 300.0, 301.0])
    np.testing.assert_allclose(means.error[:, 0], [1.0, 3.5, 5.0, 6.0])
    assert means.at_mm["X"].tolist() == [5.0, 5.0, 5.0, 6.0]


def test_the_scatter_of_looks_is_that_of_their_steps() -> None:
    """Steps of ±3: √(9 / 2). A gross step is cut at three robust standard deviations."""
    value = np.array([0.0, 3.0, 0.0, 3.0, 0.0])
    assert scatter(value) == pytest.approx(3.0 / np.sqrt(2.0))
    limit = 3.0 * 1.4826 * 3.0
    gross = np.array([0.0, 3.0, 0.0, 3.0, 0.0, 900.0])
    assert scatter(gross) == pytest.approx(np.sqrt((4 * 9.0 + limit**2) / 5 / 2.0))


def test_sweeps_and_looks_are_weighed_by_their_variances() -> None:
    """Two means before the heat and two at the sweep: their difference has 4 · (1/2 + 1/2) µm², the sweep 9 µm².

    The record's own zero falls out: it says 30 + 5 µm, the sweep 40.
    """
    sweeps = Nodes(np.array([1000.0]), np.array([40.0]), np.array([3.0]), np.array([7]))
    mean_s, value = np.array([100.0, 200.0, 1000.0, 1000.0]), np.array([101.0, 99.0, 134.0, 136.0])
    nodes = join(sweeps, np.array([[9.0]]), 500.0, mean_s, value, np.zeros((4, 0)), 2.0)
    assert nodes.value.tolist() == [pytest.approx((40.0 / 9.0 + 35.0 / 4.0) / (1 / 9.0 + 1 / 4.0))]
    assert nodes.se.tolist() == [pytest.approx(1.0 / np.sqrt(1 / 9.0 + 1 / 4.0))]
    assert (nodes.sweep.tolist(), nodes.t_s.tolist()) == ([7], [1000.0])


def test_an_error_of_a_slope_is_in_the_looks_too() -> None:
    """A slope with 5 µm/m of error and an arm of 1 m on the means at the sweep: their variance gains 25 µm²."""
    sweeps = Nodes(np.array([1000.0]), np.array([40.0]), np.array([3.0]), np.array([0]))
    mean_s, value = np.array([100.0, 200.0, 1000.0, 1000.0]), np.array([101.0, 99.0, 134.0, 136.0])
    arms = np.array([[0.0], [0.0], [1.0], [1.0]])
    nodes = join(sweeps, np.diag([9.0, 25.0]), 500.0, mean_s, value, arms, 2.0)
    assert nodes.value[0] == pytest.approx((40.0 / 9.0 + 35.0 / 29.0) / (1 / 9.0 + 1 / 29.0))
    assert nodes.se[0] == pytest.approx(1.0 / np.sqrt(1 / 9.0 + 1 / 29.0))


def test_moments_far_from_sweeps_and_zero_become_nodes_of_ten_minutes() -> None:
    """Sweeps at 1000 and 5000 s, zero at 0: of means each 100 s those from 1700 to 4300 s are far, and from 5700 on."""
    sweeps = Nodes(np.array([1000.0, 5000.0]), np.array([10.0, 50.0]), np.ones(2), np.array([0, 1]))
    mean_s = np.arange(0.0, 6001.0, 100.0)
    nodes = join(sweeps, np.eye(2), 0.0, mean_s, mean_s / 100.0, np.zeros((61, 0)), 0.5)
    added = nodes.t_s[nodes.sweep < 0]
    expected = [np.mean(np.arange(a, min(a + 600.0, 4301.0), 100.0)) for a in np.arange(1700.0, 4301.0, 600.0)]
    expected += [np.mean(np.arange(5700.0, 5900.0, 100.0)), np.mean(np.arange(5900.0, 6001.0, 100.0))]
    np.testing.assert_allclose(added, expected)
    np.testing.assert_allclose(nodes.value, nodes.t_s / 100.0, atol=0.2)
    assert (np.diff(nodes.t_s) > 0).all()


def test_the_least_scatter_of_a_reading() -> None:
    def campaign(u_um: float | None) -> Campaign:
        return Campaign("c", CampaignSettings(instrument_u_um=u_um), heat())

    assert [least_sd(campaign(u)) for u in (None, 1.0, 2.0, 9.0)] == [1.0, 1.0, 1.0, 4.5]
    assert least_sd(campaign(9.0), is_angle=True) == 1.0


@pytest.mark.parametrize("column", [0, 2])
def test_each_column_of_a_record_is_judged_alone_and_a_missing_value_is_never_gross(column: int) -> None:
    t_s = 60.0 * np.arange(30.0)
    error = np.zeros((30, 3))
    error[12, column] = 50.0
    error[20, column] = np.nan
    found = gross_readings(t_s, error, {}, 1.0)
    assert np.argwhere(found).tolist() == [[12, column]]


def test_two_looks_cannot_tell_and_the_worst_of_many_goes_first() -> None:
    sweep_s, drift = np.array([0.0, 6000.0]), np.zeros(2)
    mean_s = np.array([100.0, 200.0])
    assert not gross_means(mean_s, np.array([0.0, 900.0]), sweep_s, drift, np.zeros(2), 1.0, 1.0).any()
    mean_s = 100.0 * np.arange(1.0, 21.0)
    value = np.where(np.arange(20) % 2, 0.5, -0.5)
    value[[7, 8]] = 60.0, 200.0
    value[3] = np.nan
    assert np.flatnonzero(gross_means(mean_s, value, sweep_s, drift, np.zeros(20), 1.0, 1.0)).tolist() == [7, 8]

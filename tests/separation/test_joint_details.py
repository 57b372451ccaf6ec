"""The joint form on machines so plain that each figure and each refusal can be said beforehand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rigid_machine import AXES, MACHINE, NAMES, P0_MM, REFERENCE_S, ROUND_S, STAND_MM, Rigid, draw_rigid, measure

from thetacomp.campaign import Campaign, Drift, Parameters, SweepPoints
from thetacomp.separation import ComponentSeparation, separate_all
from thetacomp.separation.joint_form import separate_joint, why_not_joint

TAU_S = 7200.0
DRIFT_UM = np.array([80.0, -50.0, 30.0])


def drifting(tilt_um_per_m: float = 0.0) -> Rigid:
    """A machine that only drifts as a whole; `tilt` lets the bed turn the ways of X, so that Z changes with x."""
    geometry = {name: np.zeros((4, 6)) for name in NAMES}
    heat = {name: np.zeros((2, 2, 6)) for name in NAMES}
    heat["X"][0, 0, :3] = DRIFT_UM
    heat["X"][0, 1, 2] = tilt_um_per_m
    return Rigid(geometry, heat, (TAU_S, TAU_S))


def quiet(rigid: Rigid, **changes: object) -> Campaign:
    return measure(rigid, np.random.default_rng(1), point_sd_um=0.3, **changes)  # type: ignore[arg-type]


def points_of(campaign: Campaign) -> SweepPoints:
    assert campaign.sweeps is not None
    return campaign.sweeps


def by_name(campaign: Campaign) -> dict[str, ComponentSeparation]:
    found = separate_joint(MACHINE, campaign)
    return {s.component: s for s in (*found.components, *found.angles)}


def test_drift_of_a_machine_that_only_drifts() -> None:
    found = by_name(quiet(drifting()))
    assert list(found) == ["EXX", "EYX", "EZX", "EXY", "EYY", "EZY", "EXW", "EYW", "EZW", "DX", "DY", "DZ"]
    for k, letter in enumerate("XYZ"):
        drift = found[f"D{letter}"]
        true = DRIFT_UM[k] * (1.0 - np.exp(-np.maximum(drift.t_s - REFERENCE_S, 0.0) / TAU_S))
        np.testing.assert_allclose(drift.intercept_um, true, atol=1.2)
        assert drift.sweep.tolist() == list(range(21))
        assert drift.cold.tolist() == [True] * 3 + [False] * 18
        assert (np.diff(drift.t_s) > 0).all()
        assert (drift.reference_s, drift.form, drift.axis) == (REFERENCE_S, "joint", None)
        assert not np.any([drift.slope_um_per_m, drift.slope_se_um_per_m])
        np.testing.assert_allclose(drift.zero_t_s, points_of(quiet(drifting())).t_s[:42])
        # Three intercepts hold the drift three times: two too many.
        wrong_um = float(drift.notes[0].split("by up to ")[1].split(" µm")[0])
        assert wrong_um == pytest.approx(2.0 * np.abs(drift.intercept_um).max(), abs=2.0)
        assert "along X, Y and W differ by up to " in drift.notes[1]
        for axis in NAMES:
            own = found[f"E{letter}{axis}"]
            assert not own.intercept_um.any()
            np.testing.assert_allclose(own.slope_um_per_m, 0.0, atol=1.2)
            assert own.points is not None
            at = own.points.t_s
            np.testing.assert_allclose(
                own.points.drift_um, DRIFT_UM[k] * (1 - np.exp(-np.maximum(at - REFERENCE_S, 0) / TAU_S)), atol=2.5
            )
            np.testing.assert_allclose(own.points.error_um, 0.0, atol=2.5)
            np.testing.assert_allclose(own.points.residual_um, 0.0, atol=2.5)


def test_constants_of_the_axes_are_told_by_their_spread_and_the_geometry_has_their_mean() -> None:
    """Every sweep along Y stands 12 µm higher in X, cold and warm: 12 µm of spread, 4 µm of mean, no drift."""
    campaign = quiet(drifting())
    points = points_of(campaign)
    error = points.error_um.copy()
    error[np.array(points.axis) == "Y", 0] += 12.0
    plain, moved = by_name(campaign), by_name(replace(campaign, sweeps=replace(points, error_um=error)))
    assert moved["DX"].cold_intercept_um - plain["DX"].cold_intercept_um == pytest.approx(4.0, abs=0.2)
    spread = float(moved["DX"].notes[1].split("by up to ")[1].split(" µm")[0])
    assert spread == pytest.approx(12.0, abs=1.0)
    np.testing.assert_allclose(moved["DX"].intercept_um, plain["DX"].intercept_um, atol=0.3)
    lifted, curve = moved["EXY"].points, moved["EXY"].geometry[0]
    assert lifted is not None
    np.testing.assert_allclose(lifted.error_um, lifted.geometry_um + lifted.line_um, atol=2.5)
    np.testing.assert_allclose(curve.value_um, 0.0, atol=0.5)


def test_an_axis_whose_sweeps_see_another_drift_is_named_with_both_figures() -> None:
    """X of the sweeps along Y is off by 20 µm in the heat alone; between its neighbours that is 20 µm RMS."""
    campaign = quiet(drifting())
    points = points_of(campaign)
    error = points.error_um.copy()
    error[(np.array(points.axis) == "Y") & (points.t_s > REFERENCE_S), 0] += 20.0
    notes = by_name(replace(campaign, sweeps=replace(points, error_um=error)))["DX"].notes
    (told,) = (note for note in notes if note.startswith("the sweeps along Y see a drift"))
    assert float(told.split("other sweeps by ")[1].split(" µm")[0]) == pytest.approx(20.0, abs=2.0)
    assert "(RMS; chance alone: 0)" in told
    assert sum("see a drift" in note for note in notes) <= 3
    assert not any("see a drift" in note for note in by_name(campaign)["DX"].notes)
    coarse = measure(drifting(), np.random.default_rng(1), point_sd_um=8.0)
    points = points_of(coarse)
    error = points.error_um.copy()
    error[(np.array(points.axis) == "Y") & (points.t_s > REFERENCE_S), 0] += 90.0
    drift = by_name(replace(coarse, sweeps=replace(points, error_um=error)))["DX"]
    (told,) = (note for note in drift.notes if note.startswith("the sweeps along Y see a drift"))
    chance_um = np.sqrt(2.0 * np.mean(drift.intercept_se_um[~drift.cold] ** 2))
    assert f"chance alone: {chance_um:.0f})" in told
    assert chance_um > 3.0


def test_a_tilt_is_a_slope_of_its_axis_and_no_drift() -> None:
    """40 µm/m of Z along X: the other axes were swept with X half a metre from P0, and see 20 µm of it."""
    found = by_name(quiet(drifting(40.0)))
    warmth = 1.0 - np.exp(-np.maximum(found["EZX"].t_s - REFERENCE_S, 0.0) / TAU_S)
    np.testing.assert_allclose(found["EZX"].slope_um_per_m, 40.0 * warmth, atol=0.8)
    drift = found["DZ"]
    true = 30.0 * (1.0 - np.exp(-np.maximum(drift.t_s - REFERENCE_S, 0.0) / TAU_S))
    np.testing.assert_allclose(drift.intercept_um, true, atol=1.0)
    # The naive sum holds two drifts more, and the tilt twice: it is in the intercepts of Y and W.
    naive = float(drift.notes[0].split("by up to ")[1].split(" µm")[0])
    half_m = (STAND_MM["X"] - P0_MM["X"]) / 1000.0
    last = 1.0 - np.exp(-(drift.t_s[-1] - REFERENCE_S) / TAU_S)
    assert naive == pytest.approx((2.0 * 30.0 + 2.0 * half_m * 40.0) * last, rel=0.03)


def test_the_drift_holds_the_errors_of_the_slopes_that_were_taken_off() -> None:
    """Seen in a sweep of Y: its own intercept, and the slopes of X and W over 0.5 and 0.25 m, as squares."""
    campaign = measure(drifting(), np.random.default_rng(3), rounds=5)
    points = points_of(campaign)
    alone = {
        s.component: s for s in separate_all(MACHINE, [replace(campaign, sweeps=replace(points, at_mm={}))]).components
    }
    found = by_name(campaign)
    drift, own = found["DX"], alone["EXY"]
    for k in (2, 3):  # between other rounds
        row = int(np.flatnonzero(drift.sweep == own.sweep[k])[0])
        arms = [((STAND_MM[n] - P0_MM[n]) / 1000.0, found[f"EX{n}"].slope_se_um_per_m[k]) for n in ("X", "W")]
        expected = np.sqrt(own.intercept_se_um[k] ** 2 + sum((arm * se) ** 2 for arm, se in arms))
        assert drift.intercept_se_um[row] == pytest.approx(expected, rel=0.06)


@pytest.mark.parametrize("zero_um", [0.0, 300.0])
def test_a_record_between_the_sweeps_adds_states_with_numbers_of_their_own(zero_um: float) -> None:
    """A look each three minutes at the standing place, with a zero of its own; sweeps end 40 min after each hour."""
    rigid = drifting()
    campaign = quiet(rigid, rounds=5)
    t_s = np.arange(60.0, 5 * ROUND_S, 180.0)
    error = np.array([rigid.tool(STAND_MM, warmth)[:3] for warmth in rigid.warmth(t_s)]) + zero_um
    record = Drift(t_s, error, None, {name: np.full(len(t_s), p) for name, p in STAND_MM.items()})
    plain, found = by_name(campaign)["DX"], by_name(replace(campaign, drift=record))["DX"]
    assert len(found.t_s) > len(plain.t_s) + 3
    assert len(set(found.sweep.tolist())) == len(found.sweep)
    added = found.sweep[~np.isin(found.sweep, plain.sweep)]
    assert sorted(added.tolist()) == list(range(15, 15 + len(added)))
    assert (np.diff(found.t_s) > 0).all()
    true = DRIFT_UM[0] * (1.0 - np.exp(-np.maximum(found.t_s - REFERENCE_S, 0.0) / TAU_S))
    np.testing.assert_allclose(found.intercept_um, true, atol=0.8)
    assert found.cold.tolist() == [True] * 3 + [False] * (len(found.t_s) - 3)


def test_angles_come_back_with_a_drift_of_their_own() -> None:
    """The whole machine turns by 30 µrad about Y: no angle changes along an axis, and a record of angles agrees."""
    rigid = drifting()
    rigid.heat["X"][0, 0, 4] = 30.0
    campaign = measure(rigid, np.random.default_rng(1), point_sd_um=0.3, angle_sd_urad=0.3)
    found = by_name(campaign)
    drift = found["DB"]
    np.testing.assert_allclose(
        drift.intercept_um, 30.0 * (1.0 - np.exp(-np.maximum(drift.t_s - REFERENCE_S, 0.0) / TAU_S)), atol=0.5
    )
    assert drift.notes == ()  # what a naive sum would cost is a matter of displacements
    assert [name for name in found if name[1] in "ABC"][-3:] == ["DA", "DB", "DC"]
    for axis in NAMES:
        np.testing.assert_allclose(found[f"EB{axis}"].slope_um_per_m, 0.0, atol=1.2)
    points = points_of(campaign)
    assert points.rotation_urad is not None
    blind = points.rotation_urad.copy()
    blind[np.array(points.axis) == "Y", 1] = np.nan
    assert not separate_joint(MACHINE, replace(campaign, sweeps=replace(points, rotation_urad=blind))).angles


def test_too_few_good_looks_leave_the_sweeps_alone() -> None:
    """Five looks, one of them off by 300 µm: four are left, and the drift is that of the sweeps."""
    rigid = drifting()
    campaign = quiet(rigid, rounds=6)
    t_s = ROUND_S * np.arange(1.0, 6.0) + 2100.0
    error = np.array([rigid.tool(STAND_MM, warmth)[:3] for warmth in rigid.warmth(t_s)])
    error[2] += 300.0
    record = Drift(t_s, error, None, {name: np.full(5, p) for name, p in STAND_MM.items()})
    plain, found = by_name(campaign)["DX"], by_name(replace(campaign, drift=record))["DX"]
    np.testing.assert_array_equal(found.intercept_um, plain.intercept_um)
    assert "drift.csv is left out: 4 good readings are left, at least 5 are needed" in found.notes


def test_every_campaign_says_its_own_reason() -> None:
    """One has no positions, the other another tool: the first keeps its reason, the second gets that of the tool."""
    rigid = drifting()
    without, longer = quiet(rigid, name="a", at=False, rounds=3), quiet(rigid, name="b", rounds=3)
    longer = replace(longer, settings=longer.settings.model_copy(update={"tool_length_mm": 500.0}))
    note = next(n for n in separate_all(MACHINE, [without, longer]).notes if n.startswith("positions of other axes"))
    assert "(a: at_X_mm is not given at every point of the other axes; b: the tool lengths differ" in note


def test_a_record_whose_places_are_missing_in_part_is_left_out() -> None:
    campaign = measure(draw_rigid(np.random.default_rng(1)), np.random.default_rng(1), drift_zero_um=0.0)
    assert campaign.drift is not None
    at_mm = dict(campaign.drift.at_mm)
    at_mm["Y"] = np.where(np.arange(len(at_mm["Y"])) == 3, np.nan, at_mm["Y"])
    (note,) = separate_joint(MACHINE, replace(campaign, drift=replace(campaign.drift, at_mm=at_mm))).notes
    assert note.endswith("(at_Y_mm)")
    assert separate_joint(MACHINE, campaign).notes == ()


def test_each_reason_against_the_joint_form() -> None:
    campaign = quiet(drifting())
    points = points_of(campaign)
    moving = np.array(points.axis)
    assert why_not_joint(MACHINE, campaign) is None
    assert why_not_joint(MACHINE, replace(campaign, sweeps=None)) == "it has no sweeps"
    alone = replace(points, axis=("X",) * len(moving))
    assert why_not_joint(MACHINE, replace(campaign, sweeps=alone)) == "only axis X was swept"
    common = campaign.settings.model_copy(update={"datum": "common"})
    table = Parameters(np.zeros(1), ("EXX",), *(np.zeros(1) for _ in range(5)))
    for changed in (replace(campaign, settings=common), replace(campaign, parameters=table)):
        assert why_not_joint(MACHINE, changed) == "its errors were separated already, or count from a common datum"
    for lacking in ({n: p for n, p in points.at_mm.items() if n != "W"}, at_gap(points, "W")):
        given = replace(campaign, sweeps=replace(points, at_mm=lacking))
        assert why_not_joint(MACHINE, given) == "at_W_mm is not given at every point of the other axes"


def at_gap(points: SweepPoints, name: str) -> dict[str, np.ndarray]:
    """The positions with one of an axis missing, at a point where another axis moves."""
    row = int(np.flatnonzero(np.array(points.axis) != name)[5])
    return {n: np.where((np.arange(len(p)) == row) & (n == name), np.nan, p) for n, p in points.at_mm.items()}


@pytest.mark.parametrize(("off_mm", "refused"), [(0.0, False), (1.0, False), (1.01, True), (-1.01, True)])
def test_a_direction_that_an_axis_lacks_matters_where_the_axis_stood_off_its_middle(
    off_mm: float, refused: bool
) -> None:
    campaign = quiet(drifting())
    points = points_of(campaign)
    moving = np.array(points.axis)
    error = points.error_um.copy()
    error[moving == "W", 1] = np.nan
    at_mm = {n: np.where(np.isfinite(p) & (n == "W"), P0_MM["W"] + off_mm, p) for n, p in points.at_mm.items()}
    why = why_not_joint(MACHINE, replace(campaign, sweeps=replace(points, error_um=error, at_mm=at_mm)))
    expected = "dY_um was not measured along W, which stood off the middle of its travel"
    assert why == (expected if refused else None)
    # Where no other axis measured that direction either, nothing is lost.
    error[:, 1] = np.nan
    assert why_not_joint(MACHINE, replace(campaign, sweeps=replace(points, error_um=error, at_mm=at_mm))) is None


def test_axes_stand_in_the_order_of_the_machine_not_of_the_sweeps() -> None:
    assert [axis.name for axis in AXES] == list(NAMES)
    campaign = quiet(drifting())
    points = points_of(campaign)
    order = np.argsort(-points.t_s, kind="stable")[::-1]  # by time, but the table may stand in any order
    rows = np.concatenate([order[::2], order[1::2]])
    mixed = SweepPoints(
        points.t_s[rows], tuple(np.array(points.axis)[rows].tolist()), points.sweep[rows], points.position_mm[rows],
        points.direction[rows], points.error_um[rows], at_mm={n: p[rows] for n, p in points.at_mm.items()},
    )  # fmt: skip
    one, other = by_name(campaign), by_name(replace(campaign, sweeps=mixed))
    for name in one:
        np.testing.assert_allclose(other[name].intercept_um, one[name].intercept_um, atol=1e-6)
        np.testing.assert_allclose(other[name].slope_um_per_m, one[name].slope_um_per_m, atol=1e-6)

"""The joint form: a machine of rigid bodies comes back within the stated intervals, the drift is counted once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rigid_machine import AXES, MACHINE, P0_MM, REFERENCE_S, STAND_MM, draw_rigid, measure

from thetacomp.axis_states import axis_states
from thetacomp.campaign import MachineFolder
from thetacomp.separation import ComponentSeparation, separate_all
from thetacomp.separation.axis_shares import between_nodes
from thetacomp.separation.drift_nodes import Nodes, drift_means, join
from thetacomp.separation.joint_form import separate_joint, why_not_joint

LETTERS = "XYZABC"


def _misses(separation: ComponentSeparation, rigid) -> np.ndarray:
    """Deviation of every heated state from the truth of the transforms, in standard errors."""
    k, heated = LETTERS.index(separation.direction), np.flatnonzero(~separation.cold)
    if separation.axis is None:
        true = np.array([rigid.thermal(P0_MM, t_s)[k] for t_s in separation.t_s[heated]])
        return (separation.intercept_um[heated] - true) / separation.intercept_se_um[heated]
    true = np.array([rigid.slope(separation.axis, t_s)[k] for t_s in separation.t_s[heated]])
    return (separation.slope_um_per_m[heated] - true) / separation.slope_se_um_per_m[heated]


@pytest.mark.parametrize(
    ("seeds", "angle_sd_urad", "drift_zero_um"),
    [(12, None, None), (8, 1.0, None), (12, None, 50.0)],
    ids=["tilts only, no angles", "twisting guides, angles measured", "drift record with a zero of its own"],
)
def test_intervals_hold_the_truth(seeds: int, angle_sd_urad: float | None, drift_zero_um: float | None) -> None:
    """95 % intervals, pooled over machines: measured 94.8 (drift) and 95.1 (slopes) with 24 seeds."""
    pooled: dict[bool, list[np.ndarray]] = {True: [], False: []}
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        rigid = draw_rigid(rng, turning=angle_sd_urad is not None)
        campaign = measure(rigid, rng, angle_sd_urad=angle_sd_urad, drift_zero_um=drift_zero_um)
        found = separate_joint(MACHINE, campaign)
        assert bool(found.angles) == (angle_sd_urad is not None)
        for separation in (*found.components, *found.angles):
            pooled[separation.axis is None].append(_misses(separation, rigid))
    for parts in pooled.values():
        inside = 100.0 * float(np.mean(np.abs(np.concatenate(parts)) < 1.96))
        assert 93.0 <= inside <= 97.0


def test_without_noise_the_transforms_come_back() -> None:
    """Drift to 1.5 µm and slopes to 1 µm/m of values up to hundreds; the rest is curvature between hourly rounds."""
    rng = np.random.default_rng(3)
    rigid = draw_rigid(rng)
    found = separate_joint(MACHINE, measure(rigid, rng, point_sd_um=0.01, angle_sd_urad=0.01))
    for s in found.components:
        heated = np.flatnonzero(s.t_s > REFERENCE_S + 3600.0)
        k = LETTERS.index(s.direction)
        if s.axis is None:
            true = np.array([rigid.thermal(P0_MM, t_s)[k] for t_s in s.t_s[heated]])
            np.testing.assert_allclose(s.intercept_um[heated], true, atol=1.5)
        else:
            true = np.array([rigid.slope(s.axis, t_s)[k] for t_s in s.t_s[heated]])
            np.testing.assert_allclose(s.slope_um_per_m[heated], true, atol=1.5)
            assert not s.intercept_um.any()


def test_the_naive_sum_is_wrong_by_the_drift() -> None:
    """Three intercepts hold the drift three times: their sum exceeds the drift by about twice the drift."""
    rng = np.random.default_rng(5)
    rigid = draw_rigid(rng, turning=False)
    campaign = measure(rigid, rng)
    joint = {s.component: s for s in separate_joint(MACHINE, campaign).components}
    no_positions = replace(campaign, sweeps=replace(campaign.sweeps, at_mm={}))
    alone = {s.component: s for s in separate_all(MACHINE, [no_positions]).components}
    for k, letter in enumerate("XYZ"):
        drift = joint[f"D{letter}"]
        t_s = drift.t_s[-1]
        true_um = rigid.thermal(P0_MM, t_s)[k]
        naive_um = sum(alone[f"E{letter}{axis.name}"].intercept_um[-1] for axis in AXES)
        # What the sum holds on top by construction: two drifts, and every axis' tilt seen by the two others.
        tilt_um = sum(2.0 * rigid.slope(n, t_s)[k] * (STAND_MM[n] - P0_MM[n]) / 1000.0 for n in P0_MM)
        assert naive_um - true_um == pytest.approx(2.0 * true_um + tilt_um, abs=15.0)
        assert drift.intercept_um[-1] == pytest.approx(true_um, abs=8.0)
        assert any("naive sum of the intercepts of the sweeps along X, Y and W" in note for note in drift.notes)


def test_the_note_states_by_how_much_the_naive_sum_is_wrong() -> None:
    rng = np.random.default_rng(5)
    campaign = measure(draw_rigid(rng, turning=False), rng)
    joint = separate_joint(MACHINE, campaign)
    drift = next(s for s in joint.components if s.component == "DZ")
    note = next(note for note in drift.notes if "naive sum" in note)
    stated_um = float(note.split("by up to ")[1].split(" µm")[0])
    # With the shares of the other axes taken off, three intercepts are three drifts, or two too many.
    assert stated_um == pytest.approx(2.0 * np.abs(drift.intercept_um).max(), rel=0.5)


def test_geometry_has_one_constant_a_direction() -> None:
    """All curves are zero at P0 and the constant stands with the drift: the cold error of the tool at P0."""
    rng = np.random.default_rng(7)
    rigid = draw_rigid(rng, turning=False)
    found = separate_joint(MACHINE, measure(rigid, rng))
    cold = rigid.tool(P0_MM, np.zeros(2))
    for s in found.components:
        if s.axis is None:
            assert s.cold_intercept_um == pytest.approx(cold[LETTERS.index(s.direction)], abs=4.0)
        else:
            at_p0 = [np.interp(P0_MM[s.axis], c.position_mm, c.value_um) for c in s.geometry]
            assert np.mean(at_p0) == pytest.approx(0.0, abs=0.3)


def test_the_form_is_one_for_all_campaigns_and_says_why() -> None:
    rng = np.random.default_rng(1)
    rigid = draw_rigid(rng)
    with_at, without = measure(rigid, rng, "a"), measure(rigid, rng, "b", at=False)
    assert separate_all(MACHINE, [with_at]).form == "joint"
    mixed = separate_all(MACHINE, [with_at, without])
    assert mixed.form == "separate"
    assert not any(s.form == "joint" for s in mixed.components)
    assert "b: at_X_mm is not given at every point of the other axes" in mixed.notes[0]
    longer = replace(with_at, name="c", settings=with_at.settings.model_copy(update={"tool_length_mm": 500.0}))
    assert "the tool lengths differ (a: 200 mm, c: 500 mm)" in separate_all(MACHINE, [with_at, longer]).notes[0]
    assert separate_all(MACHINE, [without]).notes == ()


def test_what_cannot_be_joined_is_named() -> None:
    rng = np.random.default_rng(1)
    campaign = measure(draw_rigid(rng), rng, drift_zero_um=0.0)
    points = campaign.sweeps
    blind = points.error_um.copy()
    blind[np.array(points.axis) == "W", 1] = np.nan
    lacking = replace(campaign, sweeps=replace(points, error_um=blind))
    assert why_not_joint(MACHINE, lacking) == (
        "dY_um was not measured along W, which stood off the middle of its travel"
    )
    lost = replace(campaign, drift=replace(campaign.drift, at_mm={}))
    found = separate_joint(MACHINE, lost)
    assert found.notes == (
        "campaign warm-up: drift.csv is left out, it lacks the positions of the axes (at_X_mm, at_Y_mm, at_W_mm)",
    )


def test_states_of_the_joint_form_are_exact_at_zero_and_carry_the_drift() -> None:
    rng = np.random.default_rng(2)
    campaigns = tuple(measure(draw_rigid(rng), rng, name) for name in ("a", "b"))
    separated = separate_all(MACHINE, campaigns)
    states = axis_states(MachineFolder(MACHINE, campaigns), separated.components, ["a", "b"])
    assert [s.axis for s in states] == ["X", "Y", "W", ""]
    assert all(s.exact_zero for s in states)
    assert len(states[-1]) == 2 * 7 * 3  # a state at every sweep of every axis
    assert not states[-1].samples[0].drift_um.any()
    assert np.abs(states[0].samples[0].drift_um).max() > 1.0


def test_a_drift_record_adds_states_where_no_sweep_looked() -> None:
    """Straight drift of 10 µm/h: means between two sweeps become nodes, and the record's own zero falls out."""
    t_s = np.array([3600.0, 14400.0])
    sweeps = Nodes(t_s, np.array([10.0, 40.0]), np.ones(2), np.array([0, 1]))
    mean_s = np.arange(0.0, 14401.0, 300.0)
    nodes = join(sweeps, np.eye(2), 0.0, mean_s, 500.0 + mean_s / 360.0, np.zeros((len(mean_s), 0)), 0.1)
    assert len(nodes.t_s) > 10
    assert list(nodes.sweep[np.isin(nodes.t_s, t_s)]) == [0, 1]
    np.testing.assert_allclose(nodes.value, nodes.t_s / 360.0, atol=0.05)


def test_looks_begin_anew_where_an_axis_moves() -> None:
    rng = np.random.default_rng(1)
    drift = measure(draw_rigid(rng), rng, drift_zero_um=0.0).drift
    dense = replace(drift, t_s=np.arange(float(len(drift.t_s))))
    at_mm = {"X": np.repeat([0.0, 100.0], [10, len(drift.t_s) - 10])}
    means = drift_means(dense, dense.error_um, at_mm)
    assert means.at_mm["X"].tolist() == [0.0, 100.0]
    np.testing.assert_allclose(means.error[0], dense.error_um[:10].mean(axis=0))


def test_interpolation_follows_a_parabola_and_is_zero_before_the_heat() -> None:
    node_s = np.array([2.0, 3.0, 5.0])
    t_s = np.array([0.0, 1.0, 1.5, 2.5, 4.0])
    found = between_nodes(1.0, node_s, t_s) @ (node_s - 1.0) ** 2
    np.testing.assert_allclose(found, [0.0, 0.0, 0.25, 2.25, 9.0], atol=1e-12)


def test_sweeps_that_do_not_see_the_same_drift_are_named() -> None:
    """A frame that moves by 30 µm at the sweeps of Y alone: their drift cannot be that of X and W."""
    rng = np.random.default_rng(4)
    campaign = measure(draw_rigid(rng, turning=False), rng)
    points = campaign.sweeps
    moved = points.error_um.copy()
    moved[(np.array(points.axis) == "Y") & (points.t_s > REFERENCE_S), 0] += 30.0
    clean, bad = (
        next(s for s in separate_joint(MACHINE, c).components if s.component == "DX").notes
        for c in (campaign, replace(campaign, sweeps=replace(points, error_um=moved)))
    )
    assert not any("see a drift that differs" in note for note in clean)
    assert any(note.startswith("the sweeps along Y see a drift that differs") for note in bad)

"""What the machine passed through between its sweeps: the spindle stands while it is measured, the border knows."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from thetacomp.arrays import Floats
from thetacomp.axis_states import AxisStates, axis_states
from thetacomp.campaign import Campaign, CampaignSettings, MachineFolder, SweepPoints
from thetacomp.fitting.border import calibrate_validity
from thetacomp.fitting.calibrated import calibrated_history
from thetacomp.machine import Axis, Machine, Sensor
from thetacomp.model.document import AxisLaw
from thetacomp.model.filters import run_filters
from thetacomp.model.temperatures import Duty, Temperatures
from thetacomp.separation import separate_all
from thetacomp.temperature.history_track import history_track
from thetacomp.temperature.trajectory import LONGEST_STEP_S, measured_trajectory

MACHINE = Machine(
    name="stops to be measured",
    axes=(Axis(name="Y", direction="+Y", travel_mm=(0.0, 2000.0)),),
    sensors=(Sensor(id="a", role="bearing", axis="Y"), Sensor(id="b", role="structure", axis="Y")),
)
POSITIONS_MM = np.linspace(0.0, 2000.0, 5)
MINUTES = 12 * 60


def campaign(seed: int) -> Campaign:
    """Two hours cold, then work that changes each hour; each hour it stops 20 minutes and is measured at their end."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(0.0, 60.0 * MINUTES, 60.0)
    minute = np.arange(MINUTES)
    speed_rpm = rng.uniform(0.3, 1.0, 12)[minute // 60] * 2000.0
    speed_rpm[(minute < 120) | (minute % 60 >= 40)] = 0.0
    heat_K = run_filters(t_s, 8e-3 * speed_rpm[:, None], (1500.0,))[0][:, 0, 0]
    value = 20.0 + np.column_stack([heat_K, 0.5 * heat_K]) + rng.normal(0, 0.02, (MINUTES, 2))
    begin_s = 60.0 * np.arange(56, MINUTES, 60)
    point_s = (begin_s[:, None] + 30.0 * np.arange(5)).ravel()
    position = np.tile(POSITIONS_MM, len(begin_s))
    error = np.full((len(point_s), 3), np.nan)
    error[:, 1] = 6.0 * np.interp(point_s, t_s, heat_K) + rng.normal(0, 1.0, len(point_s))
    return Campaign(
        f"c{seed}",
        CampaignSettings(instrument="laser", reference_s=7200.0),
        Temperatures(t_s, ("a", "b"), value),
        SweepPoints(
            point_s,
            ("Y",) * len(point_s),
            np.repeat(np.arange(len(begin_s)), 5),
            position,
            np.ones(len(point_s), dtype=np.int64),
            error,
        ),
        duty=Duty(t_s, {"spindle_rpm": speed_rpm}),
    )


def states_of(*seeds: int) -> AxisStates:
    folder = MachineFolder(MACHINE, tuple(campaign(seed) for seed in seeds))
    separated = separate_all(MACHINE, folder.campaigns)
    (states,) = axis_states(folder, separated.components, [c.name for c in folder.campaigns])
    return states


@pytest.fixture(scope="module")
def states() -> AxisStates:
    return states_of(*range(1, 9))


@pytest.fixture(scope="module")
def document(states: AxisStates) -> AxisLaw:
    return calibrated_history(states).document


def every_minute(document: AxisLaw, one: Campaign) -> tuple[Floats, Floats]:
    """Inputs of the border at every minute from the first to the last sweep, and the speed of the spindle."""
    track = history_track(one, document.layout, np.array([3360.0, 6960.0]) + 60.0)
    own = (track.t_s >= 3420.0) & (track.t_s <= 60.0 * (MINUTES - 4))
    absolute = track.inputs[own]
    assert one.duty is not None
    inputs = np.hstack([track.since(absolute), absolute[:, : len(document.layout.sensors)]])
    return inputs, one.duty.columns["spindle_rpm"][own]


def test_the_flag_is_quiet_while_cutting_though_no_sweep_showed_it(states: AxisStates, document: AxisLaw) -> None:
    at_sweeps_alone = calibrate_validity(
        np.hstack([states.history, states.rise_K + states.reference_degC]), states.campaign
    )
    on, on_before = [], []
    for seed in range(20, 40):
        inputs, speed_rpm = every_minute(document, campaign(seed))
        cutting = speed_rpm > 0
        assert cutting.sum() > 300
        on.append((~document.border.distance.inside(inputs))[cutting].mean())
        on_before.append((~at_sweeps_alone.inside(inputs))[cutting].mean())
    # eight campaigns: 8/9 of their like never raise it (m / (m + 1)), the others for a small part of their minutes
    assert np.mean(on) < 0.05
    # what the border was blind to: seen from the sweeps alone ordinary work is unseen (98 % of its minutes)
    assert np.mean(on_before) > 0.9


def test_work_of_twice_the_speed_is_still_flagged(document: AxisLaw) -> None:
    flagged = []
    for seed in range(20, 40):
        inputs, speed_rpm = every_minute(document, campaign(seed))
        p = len(document.layout.sensors)
        twice = np.hstack([2.0 * inputs[:, :-p], inputs[:, -p:] + inputs[:, :p]])
        flagged.append((~document.border.distance.inside(twice))[speed_rpm > 0].any())
    assert np.mean(flagged) >= 0.9


def test_the_leverage_counts_from_the_fitted_moments_and_the_range_from_all(
    states: AxisStates, document: AxisLaw
) -> None:
    sweeps = np.hstack([states.history, states.rise_K + states.reference_degC])
    np.testing.assert_allclose(document.border.distance.leverage.centre, sweeps.mean(axis=0), atol=1e-9)
    low, high = states.trajectory.inputs.min(axis=0), states.trajectory.inputs.max(axis=0)
    np.testing.assert_allclose(document.border.distance.middle, (low + high) / 2)
    # the lag of 900 s of the speed has decayed to exp(-960 / 900) by the sweeps, 16 minutes after the stop
    fast = [name for block in document.layout.blocks.values() for name in block].index("speed^1 lag 900 s")
    assert high[fast] > 0.9 * np.exp(960 / 900) * sweeps[:, fast].max()


def test_trajectory_has_every_state_and_no_long_step(states: AxisStates) -> None:
    for label in range(len(states.campaigns)):
        passed_s = states.trajectory.t_s[states.trajectory.campaign == label]
        own_s = states.t_s[states.campaign == label]
        assert set(own_s) <= set(passed_s)
        assert (passed_s[0], passed_s[-1]) == (own_s.min(), own_s.max())
        assert max(b - a for a, b in pairwise(passed_s)) <= LONGEST_STEP_S + 1e-6
    at = np.searchsorted(states.trajectory.t_s[states.trajectory.campaign == 0], states.t_s[states.campaign == 0])
    k = states.history.shape[1]
    np.testing.assert_allclose(states.trajectory.inputs[at, :k], states.history[states.campaign == 0])


def test_where_every_moment_is_measured_nothing_is_added_and_nothing_changes() -> None:
    rng = np.random.default_rng(0)
    dense = states_of(1, 2)
    minutes_s = np.arange(0.0, 3600.0, 15.0)
    track = history_track(campaign(1), dense.layout, np.array([3400.0]))  # type: ignore[arg-type]
    one = measured_trajectory(track, 0, rng.permutation(minutes_s))
    np.testing.assert_array_equal(one.t_s, minutes_s)


def test_a_held_out_campaign_leaves_no_moment_behind(states: AxisStates) -> None:
    rest = states.take(np.flatnonzero(states.campaign != 3))
    assert set(rest.trajectory.campaign) == set(range(8)) - {3}
    # where the last states of a campaign leave, what lay after the ones that stay leaves with them
    early = states.take(np.flatnonzero((states.campaign == 0) & (states.elapsed_h < 5.0)))
    assert early.trajectory.t_s.max() == early.t_s.max() < states.trajectory.t_s.max()

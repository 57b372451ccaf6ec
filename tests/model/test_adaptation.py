"""Adaptation by sparse probes: offset at once, slope slowly, outliers gated, every change logged and undone exactly."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from thetacomp.arrays import Floats
from thetacomp.model.adaptation import (
    Adaptation,
    Change,
    Limits,
    Probe,
    acknowledge,
    correction_um,
    probe_due,
    revert,
    start_adaptation,
    take_probe,
    uncertainty_um,
)

LIMITS = Limits(
    probe_sd_um=0.5,
    offset_walk_um=1.5,
    offset_step_um=10.0,
    offset_most_um=60.0,
    slope_walk=(0.02,),
    slope_step=(0.15,),
    slope_most=(1.5,),
)
BAND_UM = 8.0
HALF_HOUR_S = 1800.0


def rise_K(t_s: Floats) -> Floats:
    """The feature: a rise that comes and goes with the shifts."""
    return 6.0 - 6.0 * np.cos(2 * np.pi * np.asarray(t_s) / 57600.0)


def life(probes: int, truth_um: Floats, seed: int = 0) -> list[Change]:
    """A probe every half hour of an error that the model, which says zero, has `truth_um` (probes,) wrong."""
    rng = np.random.default_rng(seed)
    state, log = start_adaptation(0.0, LIMITS), []
    for k in range(probes):
        t_s = (k + 1) * HALF_HOUR_S
        measured = truth_um[k] + rng.normal(0, 0.5)
        state, change = take_probe(state, Probe(t_s, measured, 0.0, BAND_UM, (float(rise_K(t_s)),)), LIMITS)
        log.append(change)
    return log


TIMES_S = HALF_HOUR_S * np.arange(1, 201)


def test_a_step_of_the_offset_is_followed_at_once() -> None:
    truth = np.where(np.arange(200) < 100, 0.0, 9.0)
    log = life(200, truth)
    # one probe takes up most of the step, the second the rest; 1 µm is two standard deviations of a probe
    assert log[100].after.offset_um - log[100].before.offset_um > 6.0
    left = [truth[k] - correction_um(log[k].after, rise_K(TIMES_S[k])[None, None])[0] for k in range(101, 200)]
    assert np.sqrt(np.mean(np.square(left))) < 1.0


def test_a_step_beyond_the_limit_is_followed_in_limited_steps() -> None:
    limits = replace(LIMITS, offset_step_um=3.0)
    state, steps = start_adaptation(0.0, limits), []
    for k in range(6):
        before = state.offset_um
        state, change = take_probe(state, Probe((k + 1) * HALF_HOUR_S, 12.0, 0.0, BAND_UM, (0.0,)), limits)
        steps.append(state.offset_um - before)
        assert change.action == ("limited" if k < 3 else "adapted")
    np.testing.assert_allclose(steps[:3], 3.0)
    assert state.offset_um == pytest.approx(12.0, abs=0.5)


def test_a_drifted_slope_is_learnt_slowly_and_to_the_truth() -> None:
    log = life(200, 1.0 * rise_K(TIMES_S))
    slopes = np.array([change.after.slopes[0] for change in log])
    assert np.max(np.abs(np.diff(slopes))) <= LIMITS.slope_step[0] + 1e-12
    assert slopes[-1] == pytest.approx(1.0, abs=0.15)
    # between probes the learnt slope must help: forecast errors of the last day against those without learning
    innovation = np.array([change.innovation_um for change in log])
    change_um = np.diff(rise_K(TIMES_S))
    assert np.sqrt(np.mean(innovation[-48:] ** 2)) < 0.7 * np.sqrt(np.mean(change_um[-48:] ** 2) + 2 * 0.25)


def test_values_stay_inside_their_physical_limits() -> None:
    log = life(200, 5.0 * rise_K(TIMES_S) + 0.5 * np.arange(200))
    assert max(abs(change.after.offset_um) for change in log) <= LIMITS.offset_most_um
    assert max(abs(change.after.slopes[0]) for change in log) <= LIMITS.slope_most[0]


def test_an_outlier_is_gated_logged_and_moves_nothing() -> None:
    truth = np.zeros(20)
    truth[10] = 200.0
    log = life(20, truth)
    assert log[10].action == "gated"
    assert log[10].after.value == log[10].before.value
    assert log[10].after.covariance == log[10].before.covariance
    assert "outside the gate" in log[10].reason
    assert log[10].innovation_um == pytest.approx(200.0, abs=3.0)
    # the next good probe ends the count
    assert (log[10].after.gated, log[11].after.gated) == (1, 0)
    assert abs(log[11].after.offset_um) < 2.0


def test_repeated_outliers_raise_an_alarm_and_adaptation_waits() -> None:
    log = life(16, np.where(np.arange(16) < 10, 0.0, 60.0))
    assert [change.action for change in log[10:]] == ["gated", "gated", "alarm", "blocked", "blocked", "blocked"]
    assert len({change.after.value for change in log[9:]}) == 1
    state, change = acknowledge(log[-1].after, 30000.0, "tool changed")
    assert (state.alarm, state.gated, change.action) == (False, 0, "acknowledged")
    assert state.value == log[-1].after.value
    _, change = take_probe(state, Probe(32000.0, 2.0, 0.0, BAND_UM, (0.0,)), LIMITS)
    assert change.action == "adapted"


def test_every_state_of_the_log_can_be_gone_back_to_exactly() -> None:
    log = life(30, 1.0 * rise_K(TIMES_S[:30]))
    stored = json.loads(json.dumps([asdict(change.after) for change in log]))
    for k in (0, 7, 29):
        raw = stored[k]
        back = Adaptation(**{**raw, "value": tuple(raw["value"]), "covariance": tuple(map(tuple, raw["covariance"]))})
        state, change = revert(log[-1].after, back, 99999.0, "asked for by the operator")
        assert state == log[k].after
        assert (change.action, change.before) == ("reverted", log[-1].after)
    # the life after going back is the life that followed
    state, change = take_probe(log[9].after, log[10].probe, LIMITS)  # type: ignore[arg-type]
    assert state == log[10].after


def test_a_probe_is_asked_for_by_the_band_not_by_the_error() -> None:
    quiet, loud = life(20, np.zeros(20))[-1].after, life(20, 8.0 * np.sin(np.arange(20)))[-1].after
    # the same history of times and bands, other measured errors: the same answer
    for hours in (0.5, 2.0, 8.0):
        at_s = quiet.t_s + 3600 * hours
        assert uncertainty_um(quiet, at_s, 2.0, LIMITS) == pytest.approx(uncertainty_um(loud, at_s, 2.0, LIMITS))
    assert not probe_due(quiet, quiet.t_s, 2.0, LIMITS, most_um=5.0)
    assert probe_due(quiet, quiet.t_s, 6.0, LIMITS, most_um=5.0)
    # the band at rest, but much time gone: the offset may have wandered
    assert probe_due(quiet, quiet.t_s + 12 * 3600, 2.0, LIMITS, most_um=5.0)


def test_wrong_probes_and_limits_are_refused() -> None:
    state = start_adaptation(1000.0, LIMITS)
    with pytest.raises(ValueError, match="older"):
        take_probe(state, Probe(0.0, 1.0, 0.0, BAND_UM, (0.0,)), LIMITS)
    with pytest.raises(ValueError, match="0 features for 1 slopes"):
        take_probe(state, Probe(2000.0, 1.0, 0.0, BAND_UM), LIMITS)
    with pytest.raises(ValueError, match="finite"):
        take_probe(state, Probe(2000.0, float("nan"), 0.0, BAND_UM, (0.0,)), LIMITS)
    with pytest.raises(ValueError, match="one value for each slope"):
        replace(LIMITS, slope_step=())


@pytest.mark.parametrize(
    "change",
    [
        *({name: value} for name in ("probe_sd_um", "offset_walk_um", "offset_step_um", "offset_most_um", "gate")
          for value in (0.0, -1.0)),
        *({name: (value,)} for name in ("slope_step", "slope_most") for value in (0.0, -1.0)),
        {"slope_walk": (-1e-9,)},
    ],
)  # fmt: skip
def test_limits_that_allow_nothing_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="must be above zero"):
        replace(LIMITS, **change)


def test_a_slope_may_stand_still_and_there_may_be_none() -> None:
    assert replace(LIMITS, slope_walk=(0.0,)).slope_walk == (0.0,)
    alone = Limits(probe_sd_um=1e-9, offset_walk_um=1e-9, offset_step_um=1e-9, offset_most_um=1e-9, gate=1e-9)
    assert start_adaptation(0.0, alone).slopes == ()


def test_a_probe_at_the_moment_of_the_last_one_counts_and_limits_must_fit_the_state() -> None:
    state = start_adaptation(1000.0, LIMITS)
    _, change = take_probe(state, Probe(1000.0, 1.0, 0.0, BAND_UM, (0.0,)), LIMITS)
    assert change.action == "adapted"
    none = replace(LIMITS, slope_walk=(), slope_step=(), slope_most=())
    with pytest.raises(ValueError, match="0 features for 1 slopes"):
        take_probe(state, Probe(2000.0, 1.0, 0.0, BAND_UM), none)


@pytest.mark.parametrize(("half_width_um", "probe_sd_um"), [(8.0, 3.0), (0.0, 2.0)])
def test_the_gate_stands_at_its_half_widths_of_band_and_probe(half_width_um: float, probe_sd_um: float) -> None:
    """Two half widths of √(8² + (2 · 3)²) = 10 µm make 20 µm; of 2 · 2 µm alone 8 µm."""
    limits = replace(LIMITS, probe_sd_um=probe_sd_um)
    gate_um = 2.0 * np.hypot(half_width_um, 2.0 * probe_sd_um)
    state = start_adaptation(0.0, limits)
    for error_um, gated in ((gate_um * 0.999, False), (gate_um * 1.001, True), (-gate_um * 1.001, True)):
        _, change = take_probe(state, Probe(60.0, error_um + 5.0, 5.0, half_width_um, (0.0,)), limits)
        assert (change.action == "gated") is gated
        assert change.innovation_um == pytest.approx(error_um)


def test_one_probe_sets_the_offset_as_the_filter_of_kalman_does() -> None:
    """Offset alone: variance 10² at first, 1.5²/h of walk; gain = P / (P + 0.5²), variance left P (1 - gain)."""
    limits = replace(LIMITS, slope_walk=(), slope_step=(), slope_most=())
    state, _ = take_probe(start_adaptation(0.0, limits), Probe(7200.0, 4.0, 1.0, BAND_UM), limits)
    variance = 100.0 + 2.0 * 1.5**2
    gain = variance / (variance + 0.25)
    assert state.offset_um == pytest.approx(3.0 * gain)
    assert state.covariance[0][0] == pytest.approx(variance * (1.0 - gain))
    band_um = uncertainty_um(state, 7200.0 + 3600.0, 2.0, limits)
    assert band_um == pytest.approx(np.hypot(2.0, 1.96 * np.sqrt(state.covariance[0][0] + 1.5**2)))
    # never more than what the bounds leave possible: 60 µm
    assert uncertainty_um(state, 1e9, 0.0, limits) == pytest.approx(1.96 * 60.0)

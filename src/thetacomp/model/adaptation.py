"""Learning from sparse probes on the machine: the offset at once, the slopes slowly, nothing beyond limits.

A probe is a measured error `y` where the model says `f`. The correction is `offset + Σ slope_j u_j`, with features u
that the caller chooses (the model's own prediction, the rise of a key sensor in K). Offset and slopes are the state of
a Kalman filter whose states walk at random (Anderson and Moore, *Optimal Filtering*, 1979, ch. 3): the offset walks
fast, so a probe sets it at once; the slopes walk slowly, and they learn from what the error did between two probes.
Every step is clipped, every value is bounded, outliers are gated, and each change is a record that can be undone.
Numpy only; time is an argument. All state is plain numbers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from thetacomp.arrays import Floats

Action = Literal["adapted", "limited", "gated", "alarm", "blocked", "acknowledged", "reverted"]


@dataclass(frozen=True)
class Limits:
    """What adaptation may do.

    `offset_walk_um` is how far the offset wanders in an hour (standard deviation), `slope_walk` how far each slope
    wanders in the square root of an hour. `offset_step_um` and `slope_step` bound one probe, `offset_most_um` and
    `slope_most` bound the value. A probe further off than `gate` half widths of the band is gated; after `alarm_after`
    gated probes in a row an alarm stops adaptation until somebody acknowledges it.
    """

    probe_sd_um: float
    offset_walk_um: float
    offset_step_um: float
    offset_most_um: float
    slope_walk: tuple[float, ...] = ()
    slope_step: tuple[float, ...] = ()
    slope_most: tuple[float, ...] = ()
    gate: float = 2.0
    alarm_after: int = 3

    def __post_init__(self) -> None:
        if not len(self.slope_walk) == len(self.slope_step) == len(self.slope_most):
            raise ValueError("slope_walk, slope_step and slope_most must have one value for each slope")
        numbers = (self.probe_sd_um, self.offset_walk_um, self.offset_step_um, self.offset_most_um, self.gate)
        if min(*numbers, *self.slope_step, *self.slope_most) <= 0.0 or min(self.slope_walk, default=0.0) < 0.0:
            raise ValueError("walks, steps, bounds, the gate and the probe's uncertainty must be above zero")


@dataclass(frozen=True)
class Adaptation:
    """What has been learnt: `value` is the offset in µm and the slopes, `covariance` their uncertainty.

    `gated` counts gated probes in a row. Time in seconds. JSON-able by `dataclasses.asdict`.
    """

    t_s: float
    value: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    gated: int = 0
    alarm: bool = False

    @property
    def offset_um(self) -> float:
        """The offset in µm."""
        return self.value[0]

    @property
    def slopes(self) -> tuple[float, ...]:
        """The slopes, in µm per unit of their features."""
        return self.value[1:]


@dataclass(frozen=True)
class Probe:
    """One measurement: the error `measured_um`, what the bare model says, the features and the band at that moment."""

    t_s: float
    measured_um: float
    model_um: float
    half_width_um: float
    features: tuple[float, ...] = ()


@dataclass(frozen=True)
class Change:
    """One line of the log. `before` and `after` are whole states, so that any line can be gone back to exactly."""

    t_s: float
    action: Action
    reason: str
    probe: Probe | None
    innovation_um: float | None
    before: Adaptation
    after: Adaptation


def start_adaptation(t_s: float, limits: Limits, slope_sd: Sequence[float] = ()) -> Adaptation:
    """Nothing learnt yet: zero offset and slopes. `slope_sd` is how far each slope may be off, default a step."""
    sds = [limits.offset_step_um, *(slope_sd or limits.slope_step)]
    return Adaptation(t_s, (0.0,) * len(sds), _rows(np.diag(np.square(sds))))


def correction_um(state: Adaptation, features: Floats) -> Floats:
    """`offset + Σ slope_j u_j` (n,) for features (n, slopes): what is added to the model's prediction."""
    correction: Floats = state.offset_um + np.asarray(features, dtype=np.float64) @ np.array(state.slopes)
    return correction


def take_probe(state: Adaptation, probe: Probe, limits: Limits) -> tuple[Adaptation, Change]:
    """The state after a probe and the line for the log. A gated probe moves nothing but the count of gated ones.

    Raises ValueError for a probe before the state, with other features than the limits, or that is not a number.
    """
    _check(state, probe, limits)
    h = np.array([1.0, *probe.features])
    before = np.array(state.value)
    innovation = probe.measured_um - probe.model_um - float(h @ before)

    def change(after: Adaptation, action: Action, reason: str) -> tuple[Adaptation, Change]:
        return after, Change(probe.t_s, action, reason, probe, innovation, state, after)

    if state.alarm:
        return change(state, "blocked", "an alarm is on: acknowledge it before probes are used again")
    gate_um = limits.gate * math.hypot(probe.half_width_um, 2.0 * limits.probe_sd_um)
    if abs(innovation) > gate_um:
        count = state.gated + 1
        alarm = count >= limits.alarm_after
        reason = f"{innovation:+.1f} µm lies outside the gate of ±{gate_um:.1f} µm, probe {count} in a row"
        return change(replace(state, gated=count, alarm=alarm), "alarm" if alarm else "gated", reason)
    value, covariance = _update(before, _walked(state, probe.t_s, limits), h, innovation, limits)
    bounded = _bounded(before, value, limits)
    limited = bool(np.any(bounded != value))
    # the covariance goes on as if nothing had been cut: what asks for the next probe must not depend on the error
    after = Adaptation(probe.t_s, tuple(float(v) for v in bounded), _rows(covariance))
    reason = f"{innovation:+.1f} µm inside the gate of ±{gate_um:.1f} µm" + (", step limited" if limited else "")
    return change(after, "limited" if limited else "adapted", reason)


def revert(state: Adaptation, to: Adaptation, t_s: float, reason: str) -> tuple[Adaptation, Change]:
    """Back to a state of the log, exactly as it was, and the line that says so."""
    return to, Change(t_s, "reverted", reason, None, None, state, to)


def acknowledge(state: Adaptation, t_s: float, reason: str) -> tuple[Adaptation, Change]:
    """End an alarm: probes count again. What was learnt before the alarm stays."""
    after = replace(state, gated=0, alarm=False)
    return after, Change(t_s, "acknowledged", reason, None, None, state, after)


def uncertainty_um(state: Adaptation, t_s: float, half_width_um: float, limits: Limits) -> float:
    """Half width in µm now: the band since the last probe and the offset's own 95 %, as root sum of squares.

    `half_width_um` is the band of what the model has predicted since the last probe (a band calibrated on changes
    since a probe, at inputs counted from it). No measured error enters.
    """
    return math.hypot(half_width_um, 1.96 * math.sqrt(_walked(state, t_s, limits)[0, 0]))


def probe_due(state: Adaptation, t_s: float, half_width_um: float, limits: Limits, most_um: float) -> bool:
    """Whether a probe is due: the uncertainty has grown beyond `most_um`."""
    return uncertainty_um(state, t_s, half_width_um, limits) > most_um


def _check(state: Adaptation, probe: Probe, limits: Limits) -> None:
    if probe.t_s < state.t_s:
        raise ValueError(f"the probe at {probe.t_s:g} s is older than the last one at {state.t_s:g} s")
    if not len(probe.features) == len(limits.slope_step) == len(state.slopes):
        raise ValueError(f"{len(probe.features)} features for {len(state.slopes)} slopes")
    numbers = (probe.t_s, probe.measured_um, probe.model_um, probe.half_width_um, *probe.features)
    if not all(math.isfinite(number) for number in numbers):
        raise ValueError(f"a probe must be made of finite numbers, found {numbers}")


def _walked(state: Adaptation, t_s: float, limits: Limits) -> Floats:
    """Covariance at `t_s`: the random walks since the state. It never exceeds what the bounds leave possible."""
    hours = (t_s - state.t_s) / 3600.0
    walk = np.array([limits.offset_walk_um, *limits.slope_walk])
    covariance = np.array(state.covariance) + np.diag(walk**2 * hours)
    most = np.array([limits.offset_most_um, *limits.slope_most])
    # scaling rows and columns by the same factors keeps the matrix a covariance
    shrink = np.minimum(1.0, most / np.sqrt(np.maximum(np.diag(covariance), 1e-300)))
    walked: Floats = covariance * np.outer(shrink, shrink)
    return walked


def _update(value: Floats, covariance: Floats, h: Floats, innovation: float, limits: Limits) -> tuple[Floats, Floats]:
    """One Kalman update in Joseph's form, which keeps the covariance symmetric and positive."""
    noise = limits.probe_sd_um**2
    gain = covariance @ h / (float(h @ covariance @ h) + noise)
    keep = np.eye(len(h)) - np.outer(gain, h)
    return value + gain * innovation, keep @ covariance @ keep.T + noise * np.outer(gain, gain)


def _bounded(before: Floats, after: Floats, limits: Limits) -> Floats:
    step = np.array([limits.offset_step_um, *limits.slope_step])
    most = np.array([limits.offset_most_um, *limits.slope_most])
    bounded: Floats = np.clip(before + np.clip(after - before, -step, step), -most, most)
    return bounded


def _rows(matrix: Floats) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(value) for value in row) for row in matrix)

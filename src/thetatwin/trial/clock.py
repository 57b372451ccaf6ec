"""The clock as a baseline: the error of the tool predicted from elapsed time alone, no thermometer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from thetacomp.arrays import CARTESIAN, Floats
from thetacomp.axis_states import AxisStates, Samples
from thetacomp.fitting.key_point_law import clock


def clock_error_um(trained_on: Sequence[AxisStates], hours: Floats, positions_mm: Mapping[str, Floats]) -> Floats:
    """The error of the tool by the clock, (n, 3) in µm, after `hours` (n,) at positions of the axes, (n,) each.

    In the joint form it has parts, each by a clock of its own: the drift, counted once, and what every axis of
    `trained_on` adds. The hours of the states count as `hours` do.
    """
    out = np.zeros((len(hours), 3))
    for states in trained_on:
        timed = clock(states)
        lever_m = np.zeros(len(hours)) if states.is_drift else (positions_mm[states.axis] - states.p0_mm) / 1000.0
        samples = _at_hours(states, hours, lever_m)
        for name in states.components:
            out[:, CARTESIAN.index(name[1])] += timed.predict(name, states, samples)[0]
    return out


def _at_hours(states: AxisStates, hours: Floats, lever_m: Floats) -> Samples:
    """Rows for the clock: hours (n,) and the distance from P0 (n,), nothing else."""
    n = len(hours)
    nothing = np.zeros(n)
    return Samples(
        state=np.zeros(n, dtype=np.int64),
        lever_m=lever_m,
        value_um=nothing,
        elapsed_h=hours,
        rise_K=np.zeros((n, len(states.sensors))),
        noise_sd_um=nothing,
        history=np.zeros((n, 0)),
        drift_um=nothing,
    )

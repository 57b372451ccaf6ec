"""The inputs of a machine between its measured states: validity is checked there, too, not only at the states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats, Ints
from thetacomp.temperature.history_track import HistoryTrack

# below the shortest lag of 900 s, so that no swing of it is missed
LONGEST_STEP_S = 300.0


@dataclass(frozen=True)
class Trajectory:
    """Moments from the first to the last measured state of each campaign, m in all; the states are among them.

    `campaign` (m,) is the number of the campaign and `t_s` (m,) the time in it. `inputs` (m, k + p) are those of the
    layout as differences from the reference, then the temperatures of its p sensors in °C; none is missing.
    """

    campaign: Ints
    t_s: Floats
    inputs: Floats

    def between_states(self, campaign: Ints, t_s: Floats) -> Trajectory:
        """Only what lies between the first and the last of some states, `campaign` (n,) and `t_s` (n,)."""
        kept = np.zeros(len(self.t_s), dtype=np.bool_)
        for label in np.unique(campaign):
            own_s = t_s[campaign == label]
            kept |= (self.campaign == label) & (self.t_s >= own_s.min()) & (self.t_s <= own_s.max())
        return Trajectory(self.campaign[kept], self.t_s[kept], self.inputs[kept])


def measured_trajectory(track: HistoryTrack, campaign: int, measured_s: Floats) -> Trajectory:
    """One campaign with states at `measured_s` (n,): those moments, and others so that no step is above 300 s."""
    t_s = _filled(np.unique(measured_s))
    absolute = track.absolute(t_s)
    sensors = len(track.layout.sensors) if track.layout is not None else 0
    inputs = np.hstack([track.since(absolute), absolute[:, :sensors]])
    known = np.isfinite(inputs).all(axis=1)
    return Trajectory(np.full(int(known.sum()), campaign), t_s[known], inputs[known])


def concatenated(parts: Sequence[Trajectory]) -> Trajectory:
    """The trajectories of several campaigns, one after another."""
    return Trajectory(
        campaign=np.concatenate([part.campaign for part in parts]),
        t_s=np.concatenate([part.t_s for part in parts]),
        inputs=np.vstack([part.inputs for part in parts]),
    )


def _filled(t_s: Floats) -> Floats:
    """Ascending times with equal steps put between them where a step is above LONGEST_STEP_S."""
    steps = np.ceil(np.diff(t_s) / LONGEST_STEP_S).astype(np.int64)
    parts = [np.linspace(a, b, k, endpoint=False) for a, b, k in zip(t_s[:-1], t_s[1:], steps, strict=True)]
    return np.concatenate([*parts, t_s[-1:]])

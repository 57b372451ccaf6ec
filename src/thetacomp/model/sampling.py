"""The sampling of one sensor: its own interval, and which of its pauses are gaps. Numpy only.

Sensors of one table may be read at different intervals, and a logger that reports on change is silent while nothing
changes. So a pause is judged by what that sensor does otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Bools, Floats

GAP_INTERVALS = 3.0
GAP_S = 600.0
# A logger that reports on change: hardly ever the same value twice, and no usual interval.
FEWEST_REPORTS = 20
REPEATED_SHARE = 0.02
NEAR_USUAL, NEAR_SHARE = 0.25, 0.8
REPORTED_STEP = 1.5  # times the step that nine of ten reports stay below: a larger one hides what nobody logged


@dataclass(frozen=True)
class Sampling:
    """Readings of one sensor at `t_s` (n,): the usual interval, `limit_s` for a pause at the ends, and where gaps are.

    `is_gap` (n - 1,) marks the pauses between two readings that nothing must bridge, `is_held` those in which a logger
    that reports on change had nothing to report.
    """

    t_s: Floats
    interval_s: float
    limit_s: float
    is_gap: Bools
    is_held: Bools

    def between(self, value: Floats, t_s: Floats) -> Floats:
        """Readings `value` (n,) at other times: linear; where none was reported the last one holds up to the next."""
        held = np.flatnonzero(self.is_held)
        until_s = self.t_s[held + 1] - self.interval_s
        known_s, known = np.insert(self.t_s, held + 1, until_s), np.insert(value, held + 1, value[held])
        return np.interp(t_s, known_s, known)


def sampling_of(t_s: Floats, value: Floats) -> Sampling:
    """The sampling of a sensor with readings `value` (n,), none missing, n at least 1.

    A pause of more than three intervals and ten minutes is a gap, unless the sensor reports on change and has changed
    by no more than a usual report.
    """
    pause_s = np.diff(t_s)
    interval_s = float(np.median(pause_s)) if len(pause_s) else 0.0
    limit_s = max(GAP_INTERVALS * interval_s, GAP_S)
    is_gap = pause_s > limit_s
    is_held = np.zeros(len(pause_s), dtype=bool)
    if is_gap.any() and _reports_on_change(pause_s, value):
        step = np.abs(np.diff(value))
        is_held = is_gap & (step <= REPORTED_STEP * np.quantile(step, 0.9))
        is_gap &= ~is_held
        limit_s = max(limit_s, float(pause_s[~is_gap].max(initial=0.0)))
    return Sampling(t_s, interval_s, limit_s, is_gap, is_held)


def _reports_on_change(pause_s: Floats, value: Floats) -> bool:
    usual = np.abs(pause_s - np.median(pause_s)) <= NEAR_USUAL * np.median(pause_s)
    same = float(np.mean(np.diff(value) == 0.0))
    return len(value) >= FEWEST_REPORTS and same <= REPEATED_SHARE and float(np.mean(usual)) < NEAR_SHARE

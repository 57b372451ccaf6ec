"""Channels that give no reading of the machine: none at all, a word for none, or one reading for too long."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Bools, Floats, Ints
from thetacomp.model.temperatures import Temperatures
from thetacomp.screening.grid import plausible

FEWEST_MISSING = 3  # fewer missing samples in a row are bridged in time
SENTINEL_K = 5.0  # a constant reading that far from those before and after it is a word: 85, 0, full scale
SHORTEST_S = 600.0
FEWEST = 8
LONGER = 3.0  # times the longest run of equal readings that is usual elsewhere
FAR_LONGER = 5.0  # so long that nothing else needs to speak against it
NOISE_LOG = 25.0  # a run of equal readings this improbable (e^-25) for a sensor of that noise
WINDOW = 30


@dataclass(frozen=True)
class Silence:
    """Sensor j shows nothing, or one reading, in the samples [begin, end), for `length_s`; `usual_s` is healthy."""

    j: int
    begin: int
    end: int
    length_s: float
    usual_s: float = 0.0


def read_values(table: Temperatures) -> Floats:
    """Readings (n, p) with NaN for all that is none: implausible ones, and constants that stand for no reading."""
    value = np.where(plausible(table.value_degC), table.value_degC, np.nan)
    for j in range(value.shape[1]):
        begin, end = _runs_of_equal(value[:, j])
        level = value[begin, j]
        step = np.abs(np.diff(level, prepend=np.nan, append=np.nan))
        before, after = step[:-1], step[1:]
        same_side = (np.roll(level, 1) - level) * (np.roll(level, -1) - level) > 0.0
        inside = (before > SENTINEL_K) & (after > SENTINEL_K) & same_side
        edge = np.isnan(before) & (after > SENTINEL_K) | np.isnan(after) & (before > SENTINEL_K)
        for a, b in zip(begin[inside | edge], end[inside | edge], strict=True):
            if b - a <= max(FEWEST, len(value) // 10):
                value[a:b, j] = np.nan
    return value


def missing(table: Temperatures, value: Floats) -> list[Silence]:
    """Stretches in which a sensor has no reading while others have: more than single samples."""
    running = np.isfinite(value).any(axis=1)
    found = []
    for j in range(value.shape[1]):
        gone = np.isnan(value[:, j]) & running
        edges = np.flatnonzero(np.diff(np.concatenate([[0], gone.astype(int), [0]])))
        for a, b in zip(edges[::2], edges[1::2], strict=True):
            if b - a >= FEWEST_MISSING:
                found.append(Silence(j, int(a), int(b), float(table.t_s[b - 1] - table.t_s[a]) + table.interval_s))
    return found


def longest_s(t_s: Floats, value: Floats) -> Floats:
    """The longest run of equal readings of each sensor (p,), in s."""
    out = np.zeros(value.shape[1])
    for j in range(len(out)):
        begin, end = _runs_of_equal(value[:, j])
        out[j] = float(np.max(t_s[end - 1] - t_s[begin], initial=0.0))
    return out


def held(t_s: Floats, value: Floats, others_s: Sequence[Floats]) -> list[Silence]:
    """Runs that last far longer than is usual: for this sensor in the other campaigns, and for the others in this one.

    `others_s` are `longest_s` of the other campaigns.
    """
    own_s = longest_s(t_s, value)
    found = []
    for j in range(len(own_s)):
        usual_s = float(np.median([o[j] for o in others_s])) if others_s else 0.0
        usual_s = max(usual_s, float(np.median(np.delete(own_s, j))) if len(own_s) > 1 else 0.0)
        begin, end = _runs_of_equal(value[:, j])
        length_s = t_s[end - 1] - t_s[begin]
        for k in np.flatnonzero((length_s >= max(SHORTEST_S, LONGER * usual_s)) & (end - begin >= FEWEST)):
            found.append(Silence(j, int(begin[k]), int(end[k]), float(length_s[k]), usual_s))
    return found


def noise_forbids(run: Silence, column: Floats, elsewhere: Sequence[Floats]) -> bool:
    """Whether a reading that changes as often as this one does, in its quietest stretch, could not repeat so long."""
    share = 0.0
    for x in (column[: run.begin], column[run.end :], *elsewhere):
        x = x[np.isfinite(x)]
        if len(x) > WINDOW:
            repeats: Bools = np.diff(x) == 0
            share = max(share, float(np.convolve(repeats, np.ones(WINDOW) / WINDOW, "valid").max()))
    return 0.0 < share < 1.0 and -(run.end - run.begin - 1) * float(np.log(share)) > NOISE_LOG


def resolution_K(column: Floats) -> float:
    """The smallest change of a column's readings."""
    change = np.abs(np.diff(column[np.isfinite(column)]))
    return float(np.min(change[change > 0.0], initial=1.0))


def _runs_of_equal(x: Floats) -> tuple[Ints, Ints]:
    """Runs [begin, end) of equal readings, as two arrays of indices; missing readings are bridged."""
    good = np.flatnonzero(np.isfinite(x))
    if not len(good):
        return good, good
    starts = np.concatenate([[0], np.flatnonzero(np.diff(x[good]) != 0) + 1])
    ends = np.concatenate([starts[1:], [len(good)]]) - 1
    return good[starts], good[ends] + 1

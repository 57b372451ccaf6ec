"""Whole-campaign faults: a drift, an offset standing from the start, two sensors that carry each other's course.

All of them compare a campaign with what its sensors say of each other in the other campaigns. What the others merely
cannot predict, as the drive of an axis that only this campaign fed, is no fault: a fault has a shape that no heat has.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Bools, Floats
from thetacomp.screening.grid import Course
from thetacomp.screening.others import Teachers

SMALLEST_K = 1.5  # a departure that is worth a word
CLEAR = 5.0  # times the usual error of the prediction
STRAIGHT = 0.9  # share of a drift's course that a straight ramp explains
STRAIGHTEST = 0.995
COOLED = 0.15  # the machine loses this share of its heat meanwhile, at one go or in pauses
FAR_CLEAR = 10.0
FAR_STRAIGHT = 0.95
FEWEST_WITNESSES = 8
AGREE = 3.0  # times its usual error, a sensor still agrees with the others
COOLING = 0.1  # of the campaign, at least, it cools
GROWS = 0.6  # of what a ramp would grow while the machine cools
FLOOR_K = 0.1  # errors of readings, in a misfit
MOST_PAIRED = 25  # pairs that are tried in detail
REST_K = 1.5
REST_CLEAR = 3.0  # times the usual scatter of a sensor's level at rest
ALONE = 0.5  # where another sensor is off by this share, the machine itself is still warm
STANDS = 0.2  # an offset keeps its size to within this share
COOLS_PER_H = 0.12  # a body warmer than all others at rest loses at least this share of it in an hour
COLD_K = 0.4  # the machine is at rest until a sensor has moved by this much


@dataclass(frozen=True)
class Departure:
    """Sensor j leaves what the others say: course `off_K` (n,), usual error, and the ramp that fits best.

    `onset` is the row where the ramp begins, `size_K` its end, `explained` its share of the mean square.
    """

    j: int
    off_K: Floats
    usual_K: float
    onset: int
    size_K: float
    explained: float

    @property
    def limit_K(self) -> float:
        """A smaller ramp says nothing."""
        return max(SMALLEST_K, CLEAR * self.usual_K)


def departure(own: Course, taught: Teachers, j: int, excluded: Collection[int] = ()) -> Departure:
    """How sensor j leaves the prediction from all others but `excluded`."""
    off_K = own.rise_K[:, j] - own.inputs_K @ taught.weights(j, excluded)
    n = len(off_K)
    best = (np.inf, 0, 0.0)
    for onset in range(0, max(7 * n // 10, 1), max(1, n // 24)):
        ramp = np.maximum(np.arange(n) - onset, 0.0) / max(n - 1 - onset, 1)
        size = float(ramp @ off_K / max(float(ramp @ ramp), 1e-12))
        best = min(best, (float(np.sum((off_K - size * ramp) ** 2)), onset, size))
    power = float(np.sum(off_K**2))
    return Departure(j, off_K, taught.usual_K(j, excluded), best[1], best[2], 1.0 - best[0] / max(power, 1e-12))


def grows_while_cooling(found: Departure, own: Course) -> bool:
    """A departure that grows steadily and goes on growing while the machine cools: heat comes to an end."""
    beyond = abs(found.size_K) >= found.limit_K and found.explained >= STRAIGHT
    # So straight a course is no heat's, even where the others say little of the sensor.
    if not beyond and (abs(found.size_K) < SMALLEST_K or found.explained < STRAIGHTEST):
        return False
    read = own.read.copy()
    read[found.j] = False
    heat = own.rise_K[:, read].mean(axis=1)
    span = max(1, len(heat) // 20)
    fallen = heat[:-span] - heat[span:]
    cooling = (fallen > 0.0) & (np.arange(len(fallen)) >= found.onset)
    if fallen[cooling].sum() / span < COOLED * (heat.max() - heat[0]) or cooling.mean() < COOLING:
        return False
    grown = (found.off_K[span:] - found.off_K[:-span])[cooling].mean() * np.sign(found.size_K)
    expected = abs(found.size_K) * span / max(len(heat) - found.onset, 1)
    return bool(grown > (GROWS if beyond else 1.25 * GROWS) * expected)


def is_far_and_straight(found: Departure, own: Course, taught: Teachers) -> bool:
    """A departure so far beyond what is usual, and so straight, that it needs no cooling to be told from heat."""
    witnesses = own.read.sum() - 1 >= FEWEST_WITNESSES and len(taught.courses) > 1
    beyond = abs(found.size_K) >= max(SMALLEST_K, FAR_CLEAR * found.usual_K)
    return bool(witnesses and beyond and found.explained >= FAR_STRAIGHT)


def departs_alone(found: Departure, own: Course, taught: Teachers) -> bool:
    """Whether no other sensor leaves its prediction: a new source of heat would show in several of them."""
    rest = [k for k in np.flatnonzero(own.read).tolist() if k != found.j]
    gone = [departure(own, taught, k, (found.j,)) for k in rest]
    return all(float(np.sqrt(np.mean(d.off_K**2))) < AGREE * max(d.usual_K, FLOOR_K) for d in gone)


def rest_K(own: Course, steady: Bools) -> Floats:
    """Level of each sensor (p,) at the start against the median of the `steady` ones that were read."""
    return np.asarray(own.first_degC - np.nanmedian(own.first_degC[own.read & steady]))


@dataclass(frozen=True)
class Standing:
    """Sensor j starts `size_K` off its level in the other campaigns, where `limit_K` would be usual."""

    j: int
    size_K: float
    limit_K: float


def standing(own: Course, others: Sequence[Course], taught: Teachers, steady: Bools) -> Standing | None:
    """An offset that stands from the start: off the usual level at rest, and no heat that leaves with time.

    A body that is still warm from yesterday warms its neighbours and cools; an offset does neither. None of heat
    makes a sensor colder than the machine at rest.
    """
    rest = rest_K(own, steady)
    usual = np.array([np.where(c.read, rest_K(c, steady), np.nan) for c in others])
    judged = own.read & steady & np.isfinite(usual).any(axis=0)
    if judged.sum() < 3:
        return None
    middle = np.nanmedian(usual[:, judged], axis=0)
    off = np.zeros(len(rest))
    off[judged] = rest[judged] - middle
    scatter = np.nanmedian(np.abs(usual[:, judged] - middle), axis=0)
    j = int(np.argmax(np.abs(off)))
    size_K = float(off[j])
    others_K = np.delete(np.abs(off), j)
    usual_K = max(float(scatter[np.flatnonzero(judged).tolist().index(j)]), float(np.median(others_K)))
    limit = max(REST_K, REST_CLEAR * usual_K)
    # Of two campaigns that differ, the one farther from the machine at rest is the faulty one.
    farther = abs(rest[j]) > abs(rest[j] - size_K) + 0.6 * abs(size_K)
    if abs(size_K) < limit or others_K.max() > ALONE * abs(size_K) or not farther:
        return None
    if size_K > 0.0:
        slope, error = _slope_at_rest(own, j)
        keeps = -slope + 2.0 * error < COOLS_PER_H * size_K
        cools = -slope > 2.0 * error
        if not keeps and (cools or not _lasts(own, taught, j, size_K)):
            return None
    return Standing(j, size_K, limit)


def _lasts(own: Course, taught: Teachers, j: int, size_K: float) -> bool:
    """Whether the sensor rises as the others say, so that the offset is there to the end."""
    if taught.usual_K(j) > STANDS * abs(size_K):
        return False
    late = departure(own, taught, j).off_K[len(own.t_s) // 3 :]
    return abs(float(late.mean())) < STANDS * abs(size_K)


def _slope_at_rest(own: Course, j: int) -> tuple[float, float]:
    """Slope of sensor j in K/h before the machine warms, with its standard error; the error infinite where the time
    is too short to tell.
    """
    others = own.read.copy()
    others[j] = False
    rise = np.abs(own.early_degC[:, others] - np.nanmean(own.early_degC[:3, others], axis=0))
    moved = np.nan_to_num(rise).max(axis=1, initial=0.0) > COLD_K
    cold = np.arange(len(moved)) < (np.argmax(moved) if moved.any() else len(moved))
    cold &= np.isfinite(own.early_degC[:, j])
    if cold.sum() < 5:
        return 0.0, np.inf
    t_h = own.early_s[cold] / 3600.0
    t_h = t_h - t_h.mean()
    x = own.early_degC[cold, j] - own.early_degC[cold, j].mean()
    power = float(t_h @ t_h)
    slope = float(t_h @ x) / power
    return slope, float(np.sqrt(np.sum((x - slope * t_h) ** 2) / (len(x) - 2) / power))


@dataclass(frozen=True)
class Swap:
    """Sensors j and k carry each other's course: exchanged back, their misfit falls `clear` times (the smaller of the
    two), and that of the whole machine `whole` times.
    """

    j: int
    k: int
    clear: float
    whole: float
    size_K: float


def swap(own: Course, taught: Teachers) -> Swap | None:
    """The pair of sensors that carry each other's course, where there is one beyond doubt."""
    p = len(own.read)
    known = [j for j in np.flatnonzero(own.read).tolist() if taught.usual_K(j) < np.inf]
    weights = np.stack([taught.weights(j) for j in range(p)], axis=1)
    size = 1.0 / np.array([taught.usual_K(j) ** 2 + FLOOR_K**2 for j in known])
    x = own.inputs_K

    def misfit(inputs: Floats) -> float:
        return float(np.sum(np.mean((inputs[:, :p] - inputs @ weights)[:, known] ** 2, axis=0) * size))

    before = misfit(x)
    tried = []
    for n, j in enumerate(known):
        for k in known[n + 1 :]:
            order = np.arange(2 * p)
            order[[j, k, p + j, p + k]] = [k, j, p + k, p + j]
            tried.append((before / misfit(x[:, order]), j, k))
    tried.sort(reverse=True)
    found = [_pair(own, taught, j, k, whole) for whole, j, k in tried[:MOST_PAIRED] if whole > 1.5]
    return max((s for s in found if s is not None), key=lambda s: s.whole * s.clear**2, default=None)


def _pair(own: Course, taught: Teachers, j: int, k: int, whole: float) -> Swap | None:
    ratio, straight, beyond = [], [], []
    for a, b in ((j, k), (k, j)):
        predicted = own.inputs_K @ taught.weights(a, (j, k))
        as_is, crossed = (float(np.hypot(np.sqrt(np.mean((own.rise_K[:, i] - predicted) ** 2)), 0.02)) for i in (a, b))
        ratio.append(as_is / crossed)
        straight.append(as_is)
        beyond.append(as_is / max(taught.usual_K(a, (j, k)), 0.05))
    clear = min(ratio)
    sure = (clear > 5.0 and whole > 5.0 and max(beyond) > 3.0) or clear > 12.0 or (whole > 15.0 and clear > 1.5)
    return Swap(j, k, clear, whole, max(straight)) if sure and min(straight) > 0.4 else None

"""Gross readings of a drift record: far from what their neighbours say, and from the drift of the sweeps.

A reading is judged by what the two readings before and the two behind it say, held or carried on along their line, and
in the joint form also by the sweeps. Everything between these values is accepted: the machine may have warmed up
fast, turned to cooling, or jumped and stayed. A reading beyond all of them by 4.5 robust standard deviations is gross.
A coarse gauge repeats itself, so most errors of interpolation are zero: its scatter is at least one division.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from thetacomp.arrays import Bools, Floats, Ints
from thetacomp.campaign import Campaign
from thetacomp.instrument import resolution
from thetacomp.separation.sweep_fit import OUTLIER_SIGMA

# µm or µrad. Below it a display's last digit decides; such a reading does no harm to a model of a machine tool.
LEAST_SD = 1.0
# The scatter of fewer errors of interpolation is chance; then the readings themselves cannot decide.
MIN_ERRORS = 6
# With fewer means their own scatter is not trusted alone; that of the sweeps' points is used as well.
FEW_MEANS = 12
MAD_TO_SD = 1.4826
SURCHARGE = 6.0
# Heat that has just set in moves a machine this much faster than one step later, at readings 1.4 time constants apart.
ONSET = 4.0
_LISTED = 12


def least_sd(campaign: Campaign, *, is_angle: bool = False) -> float:
    """Smallest standard deviation that a reading is given: what is stated for the instrument, at least 1 µm (µrad)."""
    stated_um = campaign.settings.instrument_u_um
    return LEAST_SD if is_angle or stated_um is None else max(LEAST_SD, stated_um / 2.0)


def gross_readings(t_s: Floats, error: Floats, at_mm: Mapping[str, Floats], least: float) -> Bools:
    """Gross readings (n, k) of a record `error` (n, k): each column on its own, among readings at one position.

    `least` is the smallest standard deviation of a reading, or the resolution of its column where that is larger.
    Fewer than nine readings cannot decide, so none of them is gross. A missing value is never gross.
    """
    gross = np.zeros(error.shape, dtype=bool)
    least_of = [max(least, resolution(column)) for column in error.T]
    stood = np.column_stack([np.zeros(len(t_s)), *(np.round(p, 3) for p in at_mm.values())])
    _, place = np.unique(stood, axis=0, return_inverse=True)
    for number in range(int(place.max(initial=-1)) + 1):
        for k in range(error.shape[1]):
            rows = np.flatnonzero((place.ravel() == number) & np.isfinite(error[:, k]))
            gross[rows, k] = _gross_in_time(t_s[rows], error[rows, k], least_of[k])
    return gross


def gross_means(
    mean_s: Floats, value: Floats, sweep_s: Floats, sweep_drift: Floats, expected: Floats, least: float, sweep_sd: float
) -> Bools:
    """Gross two-minute means (n,) of a drift record, by their neighbours and by the drift of the sweeps.

    `expected` (n,) is the sweeps' drift at the means; `sweep_s`, `sweep_drift` (m,) its nodes, in order of time and
    with the zero. The record may have its own constant. `sweep_sd` is the scatter of a point of the sweeps.
    """
    last = np.searchsorted(sweep_s, mean_s, side="right") - 1
    by_sweeps = np.vstack(_estimates(sweep_s, sweep_drift, mean_s, last, last + 1)) - expected
    left = np.flatnonzero(np.isfinite(value))
    while len(left) > 2:
        rest = (value - expected)[left]
        constant = float(np.median(rest))
        own = np.arange(len(left))
        by_neighbours = _estimates(mean_s[left], rest, mean_s[left], own - 1, own + 1)
        estimates = np.vstack([*by_neighbours, constant + by_sweeps[:, left]])
        beyond = _beyond(rest, estimates)
        worst = int(np.argmax(beyond))
        others = np.delete(rest, worst)
        count = len(others)
        sd = MAD_TO_SD * float(np.median(np.abs(others - np.median(others)))) * np.sqrt(count / (count - 1))
        sd = max(sd, least, sweep_sd if len(left) < FEW_MEANS else 0.0)
        if beyond[worst] <= OUTLIER_SIGMA * sd:
            break
        left = np.delete(left, worst)
    gross = np.isfinite(value)
    gross[left] = False
    return gross


def gross_note(moments_s: Floats, by: str) -> str:
    """What is left out of a drift record, and when; `by` says who contradicts it."""
    listed = ", ".join(f"{t_s:.0f}" for t_s in np.sort(moments_s)[:_LISTED])
    more = f" and {len(moments_s) - _LISTED} more" if len(moments_s) > _LISTED else ""
    noun = "moment" if len(moments_s) == 1 else "moments"
    return (
        f"drift.csv: gross readings at {len(moments_s)} {noun} are left out, more than {OUTLIER_SIGMA:g} robust"
        f" standard deviations beyond all that {by} say: t_s = {listed}{more}"
    )


def _gross_in_time(t_s: Floats, value: Floats, least: float) -> Bools:
    """Gross readings (n,) by their neighbours in time alone, in turns: a gross reading may hide its neighbour.

    The worst one is kept out of the scatter by which all are judged: among few readings it would excuse itself.
    """
    left = np.arange(len(t_s))
    while len(left) > MIN_ERRORS + 2:
        times, rest, own = t_s[left], value[left], np.arange(len(left))
        by_neighbours = _estimates(times, rest, times, own - 1, own + 1)
        beyond = _beyond(rest, np.vstack([*by_neighbours, *_carried_on(times, rest)]))
        worst = int(np.argmax(beyond))
        scales: dict[int, float] = {}
        out = []
        for i in np.flatnonzero(beyond > OUTLIER_SIGMA * least):
            reach_s = float(np.min(np.abs(np.diff(times[max(i - 1, 0) : i + 2]))))
            step = int(np.floor(np.log(reach_s) / np.log(1.1)))
            if step not in scales:
                scales[step] = _scale(np.delete(times, worst), np.delete(rest, worst), 1.1**step)
            if beyond[i] > OUTLIER_SIGMA * max(scales[step], least):
                out.append(i)
        if not out:
            break
        left = np.delete(left, out)
    gross = np.ones(len(t_s), dtype=bool)
    gross[left] = False
    return gross


def _carried_on(t_s: Floats, value: Floats) -> Floats:
    """Where heat that just sets in may have the first and the last reading, which nothing behind confirms, (2, n).

    As fast as the record moved anywhere, or four times as fast as next to the reading.
    """
    out = np.full((2, len(t_s)), np.nan)
    rate = np.abs(np.diff(value) / np.diff(t_s))
    for end, near, others in ((0, 1, rate[1:]), (-1, -2, rate[-2::-1])):
        reach = max(ONSET * others[0], others.max()) * abs(t_s[end] - t_s[near])
        out[:, end] = value[near] - reach, value[near] + reach
    return out


def _scale(t_s: Floats, value: Floats, reach_s: float) -> float:
    """Robust standard deviation of a reading from its line between neighbours at least `reach_s` away.

    What the drift does within that time counts as scatter, so a reading behind a gap is judged by errors over gaps.
    Infinite where fewer than six readings have such neighbours.
    """
    before = np.searchsorted(t_s, t_s - reach_s, side="right") - 1
    behind = np.searchsorted(t_s, t_s + reach_s, side="left")
    rows = np.flatnonzero((before >= 0) & (behind < len(t_s)))
    if len(rows) < MIN_ERRORS:
        return float("inf")
    a, b = before[rows], behind[rows]
    share = (t_s[rows] - t_s[a]) / (t_s[b] - t_s[a])
    error = value[rows] - (1.0 - share) * value[a] - share * value[b]
    spread = np.abs(error) / np.sqrt(1.0 + share**2 + (1.0 - share) ** 2)
    # Few errors may agree by chance: the surcharge keeps false rejections of white noise below one record in a hundred.
    return MAD_TO_SD * float(np.median(spread)) * (1.0 + SURCHARGE / len(rows))


def _beyond(value: Floats, estimates: Floats) -> Floats:
    """How far values (n,) lie outside the range of their estimates (k, n); zero inside. NaN is no estimate."""
    low, high = np.fmin.reduce(estimates, axis=0), np.fmax.reduce(estimates, axis=0)
    return np.asarray(np.fmax(np.fmax(low - value, value - high), 0.0))


def _estimates(known_s: Floats, known: Floats, t_s: Floats, last: Ints, first: Ints) -> tuple[Floats, Floats]:
    """What known values say of moments (n,), from before (3, n) and from behind (3, n); NaN where there are none.

    `last` and `first` (n,) are the nearest known values on either side; -1 or the length where there is none.
    """
    count = len(known_s)
    return _said_before(known_s, known, t_s, last), _said_before(-known_s[::-1], known[::-1], -t_s, count - 1 - first)


def _said_before(known_s: Floats, known: Floats, t_s: Floats, last: Ints) -> Floats:
    """The last two values, held, and their line, which needs a base as long as its step: a short one carries noise."""
    out = np.full((3, len(t_s)), np.nan)
    one, two = last >= 0, last >= 1
    out[0, one] = known[last[one]]
    out[1, two] = known[last[two] - 1]
    end = last[two]
    base = np.searchsorted(known_s, 2.0 * known_s[end] - t_s[two], side="right") - 1
    base = np.clip(base, 0, end - 1)
    rate = (known[end] - known[base]) / (known_s[end] - known_s[base])
    out[2, two] = known[end] + rate * (t_s[two] - known_s[end])
    return out

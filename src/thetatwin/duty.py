"""What the machine does: the paper's run, random shifts, and a year of weeks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thetacomp.arrays import Floats
from thetatwin import conditions
from thetatwin.operation import Work

PAPER_RPM, PAPER_FEED_M_MIN = 650.0, 1.0
MINUTES_A_DAY = 1440


def idle(n: int, axes: Sequence[str], on: float = 0.0) -> Work:
    """n minutes without movement, switched off or on."""
    return Work(np.full(n, on), np.zeros(n), {a: np.zeros(n) for a in axes}, np.zeros(n))


def paper_run(n: int, axes: Sequence[str]) -> Work:
    """The published run: 650 rpm, 1000 mm/min on all axes, no load."""
    return Work(np.ones(n), np.full(n, PAPER_RPM), {a: np.full(n, PAPER_FEED_M_MIN) for a in axes}, np.zeros(n))


def random_shift(rng: np.random.Generator, n: int, axes: Sequence[str], limits: conditions.Work) -> Work:
    """n minutes of jobs: each 15 to 120 minutes at its own speed and feeds, with pauses between."""
    rpm = np.zeros(n)
    feed = {a: np.zeros(n) for a in axes}
    k = 0
    while k < n:
        long = int(rng.integers(15, 121))
        # Roughing is slow, finishing fast: speeds spread over a decade.
        speed = limits.rpm_max * 10 ** rng.uniform(-1.0, 0.0)
        rpm[k : k + long] = speed
        for a in axes:
            feed[a][k : k + long] = limits.feed_m_min_max * rng.uniform(0.0, 1.0) * (rng.random() < 0.75)
        k += long + int(rng.integers(0, 26))
    return Work(np.ones(n), rpm, feed, np.zeros(n))


def weeks(
    rng: np.random.Generator, days: int, axes: Sequence[str], limits: conditions.Work, first_weekday: int = 0
) -> Work:
    """`days` whole days from midnight: two shifts on weekdays, some Saturdays, Sundays off (0 is Monday)."""
    parts = [_day(rng, axes, limits, (first_weekday + d) % 7) for d in range(days)]
    return join(parts)


def _day(rng: np.random.Generator, axes: Sequence[str], limits: conditions.Work, weekday: int) -> Work:
    busy = weekday < 5 or (weekday == 5 and rng.random() < 0.4)
    if not busy:
        return idle(MINUTES_A_DAY, axes)
    begin = 360 + int(rng.integers(-15, 16))
    end = (1320 if weekday < 5 and rng.random() < 0.7 else 840) + int(rng.integers(-30, 31))
    return join([idle(begin, axes), random_shift(rng, end - begin, axes, limits), idle(MINUTES_A_DAY - end, axes)])


def join(parts: Sequence[Work]) -> Work:
    """One after the other."""
    return Work(
        np.concatenate([p.on for p in parts]),
        np.concatenate([p.rpm for p in parts]),
        {a: np.concatenate([p.feed_m_min[a] for p in parts]) for a in parts[0].feed_m_min},
        np.concatenate([p.chiller for p in parts]),
    )


def part(work: Work, first: int, end: int) -> Work:
    """The minutes from `first` up to `end`."""
    feeds = {axis: feed[first:end] for axis, feed in work.feed_m_min.items()}
    return Work(work.on[first:end], work.rpm[first:end], feeds, work.chiller[first:end])


def with_chiller(work: Work, chiller: Floats) -> Work:
    """The same work with the chiller switched as given (n,); it runs only while the machine is on."""
    return Work(work.on, work.rpm, work.feed_m_min, chiller * work.on)

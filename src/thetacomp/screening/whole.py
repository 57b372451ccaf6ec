"""Faults of whole courses, each with the campaign put right: what a verdict chooses from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thetacomp.arrays import Bools
from thetacomp.screening.courses import (
    departs_alone,
    departure,
    grows_while_cooling,
    is_far_and_straight,
    standing,
    swap,
)
from thetacomp.screening.faults import Finding
from thetacomp.screening.others import Teachers, teachers
from thetacomp.screening.record import Record

BLAME = 0.8  # without the sensor that is to blame the others agree about as well, or better


@dataclass(frozen=True)
class Mended:
    """A campaign before and after a repair, with the finding; `weight` is how clear the finding is."""

    weight: float
    finding: Finding
    before: Record
    after: Record


def swapped(record: Record, others: Sequence[Record], steady: Bools) -> Mended | None:
    """Two sensors that carry each other's course for the whole campaign."""
    found = swap(record.course, teachers([o.course for o in others]))
    if found is None:
        return None
    ids = record.table.sensor_ids
    told = _finding(record, found.j, "swapped", found.size_K, found.clear, 1.5)
    told = replace(told, repair="swapped back", partner=ids[found.k])
    return Mended(found.whole * found.clear**2, told, record, record.exchanged(told, found.j, found.k))


def offset(record: Record, others: Sequence[Record], steady: Bools) -> Mended | None:
    """A sensor that is off from the start of the campaign, by the same to its end."""
    found = standing(record.course, [o.course for o in others], teachers([o.course for o in others]), steady)
    if found is None:
        return None
    told = _finding(record, found.j, "offset", found.size_K, abs(found.size_K), found.limit_K)
    told = replace(told, repair="shifted back", repair_u_K=found.limit_K / 4.0)
    return Mended(abs(found.size_K) / found.limit_K, told, record, record.shifted(told, found.j, found.size_K))


def drift(record: Record, others: Sequence[Record], steady: Bools) -> Mended | None:
    """A sensor that departs steadily, the machine warm or cooling; without it the others agree at least as well."""
    own, taught = record.course, teachers([o.course for o in others])
    out = frozenset(np.flatnonzero(~own.read).tolist())
    gone = [departure(own, taught, j, out) for j in np.flatnonzero(own.read & steady).tolist()]
    suspects = [
        d for d in gone
        if (grows_while_cooling(d, own) or is_far_and_straight(d, own, taught)) and departs_alone(d, own, taught)
    ]  # fmt: skip
    if not suspects:
        return None
    eased = [(_eased(record, taught, [g.j for g in gone if g.j != d.j], d.j, out), d) for d in suspects]
    best, worst = max(eased, key=lambda pair: pair[0])
    if best < BLAME:
        return None
    onset_s = float(own.t_s[worst.onset])
    told = _finding(record, worst.j, "drift", worst.size_K, abs(worst.size_K), worst.limit_K)
    told = replace(told, start_s=onset_s, repair="reconstructed")
    return Mended(abs(worst.size_K) / worst.limit_K, told, record, record.silenced(told, worst.j))


def _eased(record: Record, taught: Teachers, sensors: Sequence[int], j: int, out: frozenset[int]) -> float:
    """How many times the misfit of the other sensors falls when sensor j no longer helps to predict them."""
    before, after = (
        sum(
            float(np.mean(d.off_K**2)) / max(d.usual_K, 0.1) ** 2
            for d in (departure(record.course, taught, k, gone) for k in sensors)
        )
        for gone in (out, out | {j})
    )
    return before / max(after, 1e-9)


def _finding(record: Record, j: int, kind: str, size_K: float, statistic: float, threshold: float) -> Finding:
    end_s = float(record.table.t_s[-1])
    return Finding(
        record.table.sensor_ids[j], kind, record.first_s, end_s, None, size_K, statistic, threshold, "none"  # type: ignore[arg-type]
    )  # fmt: skip

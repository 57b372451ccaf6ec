"""The sweeps of a campaign in order of time, and which of them are the cold block."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats, Ints
from thetacomp.campaign import SweepPoints


@dataclass(frozen=True)
class SweepTable:
    """One row a sweep, in order of time: its number, axis, first and last moment."""

    sweep: Ints
    axis: tuple[str, ...]
    start_s: Floats
    end_s: Floats


def sweep_table(points: SweepPoints) -> SweepTable:
    """Start and end of every sweep."""
    numbers = np.unique(points.sweep)
    rows = [np.flatnonzero(points.sweep == number) for number in numbers]
    return SweepTable(
        sweep=numbers,
        axis=tuple(points.axis[row[0]] for row in rows),
        start_s=np.array([points.t_s[row].min() for row in rows]),
        end_s=np.array([points.t_s[row].max() for row in rows]),
    )


def cold_block_length(axes: tuple[str, ...]) -> int:
    """How many sweeps open the campaign before an axis comes back after another axis was measured."""
    if len(set(axes)) == 1:
        return 1
    done: set[str] = set()
    for index, axis in enumerate(axes):
        if index and axis != axes[index - 1]:
            done.add(axes[index - 1])
        if axis in done:
            return index
    return len(axes)

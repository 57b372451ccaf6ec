"""Where one sweep ends and the next begins, and from which side every point was approached."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats, Ints


@dataclass(frozen=True)
class _Stop:
    """Readings `first` to `last` (exclusive) that were taken at one position."""

    first: int
    last: int
    position_mm: float


def segment(
    axis: Sequence[str], position_mm: Floats, run: Sequence[str] | None, direction: Ints | None
) -> tuple[Ints, Ints]:
    """Number of the sweep of every point, from 0, and its approach (+1, -1; 0 for a single position).

    With `run` a sweep ends where run or axis changes. Without, it ends where the axis changes or the approach turns
    for the second time: out and back are one sweep. A single move back is the return to the start of the next sweep.
    Where `direction` is given (no zeros) it is the approach; else the motion inside the sweep is, and the turning
    point belongs to the way out unless it was read twice as often as the other points.
    """
    sweep = np.zeros(len(axis), dtype=np.int64)
    approach = np.zeros(len(axis), dtype=np.int64)
    count = 0
    for block in _blocks(axis, run):
        position = position_mm[block]
        starts, moved = _walk(position)
        if direction is not None and np.all(direction[block] != 0):
            starts, moved = _starts_by_direction(position, direction[block]), direction[block]
        elif direction is not None:
            moved = np.where(direction[block] != 0, direction[block], moved)
        if run is not None:
            starts = [0]
        sweep[block] = count + np.searchsorted(starts, np.arange(len(position)), side="right") - 1
        approach[block] = moved
        count += len(starts)
    return sweep, approach


def _blocks(axis: Sequence[str], run: Sequence[str] | None) -> Iterator[slice]:
    """Neighbouring points of one axis (and one run)."""
    first = 0
    for i in range(1, len(axis) + 1):
        if i == len(axis) or axis[i] != axis[first] or (run is not None and run[i] != run[first]):
            yield slice(first, i)
            first = i


def _at_rest_mm(position: Floats) -> float:
    """Moves below this are the scatter of readings at one position: 1 % of a usual step."""
    steps = np.abs(np.diff(position))
    return 0.01 * float(np.quantile(steps, 0.9)) if len(steps) else 0.0


def _stops(position: Floats) -> list[_Stop]:
    at_rest = _at_rest_mm(position)
    stops: list[_Stop] = []
    first = 0
    for i in range(1, len(position) + 1):
        if i == len(position) or abs(position[i] - position[first]) > at_rest:
            stops.append(_Stop(first, i, float(position[first])))
            first = i
    return stops


def _walk(position: Floats) -> tuple[list[int], Ints]:
    """First readings of the sweeps of one block, and the approach of every reading, from the motion alone."""
    stops = _stops(position)
    approach = np.zeros(len(position), dtype=np.int64)
    if len(stops) < 2:
        return [0], approach
    moves = np.sign(np.diff([stop.position_mm for stop in stops])).astype(np.int64)
    turns = {i for i in range(1, len(stops) - 1) if moves[i - 1] != moves[i]}
    readings = _usual_readings(stops, turns)
    starts, turned, returned_to = [0], False, -1
    for i, stop in enumerate(stops):
        approach[stop.first : stop.last] = moves[max(i - 1, 0)]
        if i == returned_to:
            approach[stop.first : stop.last] = moves[i]
            continue
        if i not in turns:
            continue
        read_both_ways = stop.last - stop.first == 2 * readings
        way_back = stop.first + readings if read_both_ways else stop.last
        approach[way_back : stop.last] = moves[i]
        if turned:
            starts.append(way_back)
            turned = False
        elif i + 1 in turns and not read_both_ways:
            returned_to = i + 1
            starts.append(stops[i + 1].first)
        else:
            turned = True
    return starts, approach


def _usual_readings(stops: Sequence[_Stop], turns: set[int]) -> int:
    """How often a position that is no turning point is read on one way."""
    counts = [stop.last - stop.first for i, stop in enumerate(stops) if i not in turns]
    return int(np.median(counts))


def _starts_by_direction(position: Floats, direction: Ints) -> list[int]:
    at_rest = _at_rest_mm(position)
    starts, turned = [0], False
    for i in range(1, len(position)):
        if direction[i] != direction[i - 1]:
            if turned:
                starts.append(i)
            turned = not turned
        elif (position[i] - position[i - 1]) * direction[i] < -at_rest:
            starts.append(i)  # went back without measuring: the next sweep in the same approach
            turned = False
    return starts

"""The steps of a program, one after the other. Times and NC programs are both made from them, so they cannot differ."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from thetacomp.planning.setup import AxisPlan, Setup

TARGETS = ("F1", "F2", "F3", "F4")
FOUNDATION_S = 20.0
"""Time to aim at one foundation target and to read it."""
SPIN_UP_S = 5.0
LONGEST_WAIT_S = 600.0
APPROACH = {1: "P", -1: "M"}


@dataclass(frozen=True)
class Note:
    """A comment: words for a reader, or `KEY value` for a program."""

    text: str


@dataclass(frozen=True)
class Move:
    """One axis moves alone to a machine position."""

    axis: str
    to_mm: float
    feed_mm_min: float


@dataclass(frozen=True)
class Read:
    """Stand still for the tracker. `name` is the point; `target` counts positions from the lowest, from 1."""

    name: str
    axis: str
    target: int
    direction: int
    position_mm: float


@dataclass(frozen=True)
class Halt:
    """Program stop: the operator measures the foundation targets and goes on. `end` is False at a round's begin."""

    round: str
    end: bool


@dataclass(frozen=True)
class Wait:
    """Stand still for a time, whatever the reason."""

    seconds: float


@dataclass(frozen=True)
class Spindle:
    """Spindle on at a speed, or off at 0."""

    rpm: float


Step = Note | Move | Read | Halt | Wait | Spindle


def round_name(number: int) -> str:
    """`R03` for the third round after the first, `R00`."""
    return f"R{number:02d}"


def foundation_point(round_: str, target: str, end: bool) -> str:
    """`R03_F1_B` at the beginning of a round, `R03_F1_E` at its end."""
    return f"{round_}_{target}_{'E' if end else 'B'}"


def to_rest(setup: Setup) -> tuple[Step, ...]:
    """All axes to rest, one at a time, in the safe order."""
    feed = setup.options.sweep_feed_mm_min
    return tuple(Move(axis.name, axis.park_mm, feed) for axis in setup.clear)


def sweep_steps(setup: Setup, axis: AxisPlan, prefix: str = "") -> tuple[Step, ...]:
    """Out and back over all positions, each approached from one side alone; then back to rest."""
    feed = setup.options.sweep_feed_mm_min
    numbered = list(enumerate(axis.target_mm, start=1))
    steps: list[Step] = [Note(f"SWEEP {prefix}{axis.name}")]
    for direction, order, turn in ((1, numbered, axis.turn_mm[0]), (-1, numbered[::-1], axis.turn_mm[1])):
        steps.append(Move(axis.name, turn, feed))
        for number, position in order:
            name = f"{prefix}{axis.name}_{number:03d}_{APPROACH[direction]}"
            steps += [
                Move(axis.name, position, feed),
                Read(name, axis.name, number, direction, position),
            ]
    return (*steps, Move(axis.name, axis.park_mm, feed))


def round_steps(setup: Setup, round_: str) -> tuple[Step, ...]:
    """One round: foundation targets, a sweep of every axis, foundation targets. The spindle stands."""
    sweeps = (step for axis in setup.axes for step in sweep_steps(setup, axis, f"{round_}_"))
    return (Note(f"ROUND {round_}"), Spindle(0.0), Halt(round_, False), *sweeps, Halt(round_, True))


def duty_steps(setup: Setup, seconds: float, moved_s: dict[str, float]) -> tuple[Step, ...]:
    """`seconds` of warm-up: the axis that has moved least goes out and back, then the next; one moves at a time.

    `moved_s` (by axis) is carried from block to block and changed here, so that all axes get the same share of time.
    The last stroke of a block is as long as the time that is left.
    """
    options = setup.options
    steps: list[Step] = [Spindle(options.speed_rpm), Wait(SPIN_UP_S)] if options.speed_rpm > 0 else []
    left_s = seconds - (SPIN_UP_S if options.speed_rpm > 0 else 0.0)
    while left_s > 0.5:
        axis = min(setup.axes, key=lambda one: moved_s[one.name])
        low, high = axis.turn_mm
        reach = left_s * options.feed_mm_min / 60.0 / 2.0
        if reach < high - low:
            high = min(high, axis.park_mm + reach / 2.0)
            low = max(low, high - reach)
            high = low + reach
        # A rest position beyond the turns, or beyond a short stroke, would make the way longer than planned.
        low, high = min(low, axis.park_mm), max(high, axis.park_mm)
        stroke = [round(low, 3), round(high, 3), axis.park_mm]
        steps += [Move(axis.name, to_mm, options.feed_mm_min) for to_mm in stroke]
        used_s = 2.0 * (high - low) / options.feed_mm_min * 60.0
        moved_s[axis.name] += used_s
        left_s -= used_s
    return tuple(steps)


def rest_steps(seconds: float) -> tuple[Step, ...]:
    """`seconds` without any movement, spindle off, in pieces of ten minutes at most."""
    return (Spindle(0.0), *(Wait(piece) for piece in _pieces(seconds)))


def _pieces(seconds: float) -> Iterator[float]:
    while seconds > 0.05:
        piece = min(seconds, LONGEST_WAIT_S)
        yield round(piece, 1)
        seconds -= piece


@dataclass(frozen=True)
class Timed:
    """A step with its begin and end, and where all axes stand at its end."""

    step: Step
    begin_s: float
    end_s: float
    position_mm: dict[str, float]


def timed(setup: Setup, steps: Iterable[Step], begin_s: float = 0.0) -> list[Timed]:
    """Times of the steps, beginning with all axes at rest. Acceleration is left out."""
    position = setup.park_mm
    now, out = begin_s, []
    for step in steps:
        begin = now
        if isinstance(step, Move):
            now += abs(step.to_mm - position[step.axis]) / step.feed_mm_min * 60.0
            position = {**position, step.axis: step.to_mm}
        elif isinstance(step, Read):
            now += setup.options.settle_s + setup.options.dwell_s
        elif isinstance(step, Halt):
            now += FOUNDATION_S * len(TARGETS)
        elif isinstance(step, Wait):
            now += step.seconds
        out.append(Timed(step, begin, now, position))
    return out

"""The day of a campaign: cold block, warm-up, cool-down, and every planned reading with its time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from thetacomp.errors import InputError, Problem
from thetacomp.machine import Machine
from thetacomp.planning.options import PlanOptions, problem
from thetacomp.planning.setup import Setup, make_setup
from thetacomp.planning.steps import (
    FOUNDATION_S,
    TARGETS,
    Halt,
    Move,
    Read,
    Spindle,
    Step,
    Timed,
    duty_steps,
    foundation_point,
    rest_steps,
    round_name,
    round_steps,
    sweep_steps,
    timed,
    to_rest,
)

COLD_ROUNDS = 2  # the zero of everything: two rounds halve its variance and show whether the machine was at rest
LOG_LEAD_S = 1800.0  # temperatures are logged this long before the first round
REST_H = 12.0  # heavy castings need a night to come to rest
REST_CHANGE_K = 0.2
LARGEST_ROUND_SHARE, BUSY_ROUND_SHARE = 0.75, 0.4
MOST_ROUNDS = 99

Kind = Literal["log", "round", "duty", "rest"]
Part = Literal["cold block", "warm-up", "cool-down"]


@dataclass(frozen=True)
class Block:
    """A stretch of the day. `round` is its name where something is measured, else empty."""

    part: Part
    kind: Kind
    round: str
    steps: tuple[Timed, ...]
    begin_s: float
    end_s: float

    @property
    def length_s(self) -> float:
        """Length in s."""
        return self.end_s - self.begin_s


@dataclass(frozen=True)
class Point:
    """A planned reading. `axis` is empty and `target` F1 to F4 for the foundation; positions are those of all axes."""

    name: str
    round: str
    part: Part
    axis: str
    target: str
    direction: int
    t_s: float
    position_mm: dict[str, float]


@dataclass(frozen=True)
class Program:
    """One NC program: its name, what it does in a line, and its steps."""

    name: str
    title: str
    steps: tuple[Step, ...]


@dataclass(frozen=True)
class Timetable:
    """Everything in its order. Time counts from the start of the temperature log."""

    setup: Setup
    blocks: tuple[Block, ...]
    points: tuple[Point, ...]
    programs: tuple[Program, ...]
    notes: tuple[str, ...]

    @property
    def rounds(self) -> tuple[Block, ...]:
        """The measuring rounds."""
        return tuple(block for block in self.blocks if block.kind == "round")

    @property
    def reference_s(self) -> float:
        """Planned end of the cold block: the moment of zero."""
        return max(block.end_s for block in self.blocks if block.part == "cold block")


def make_timetable(machine: Machine, options: PlanOptions) -> Timetable:
    """Plan one campaign. Raises InputError where the rounds leave no time for heat, or something cannot be measured."""
    setup = make_setup(machine, options)
    round_s = _length(setup, round_steps(setup, round_name(0)))
    warm, cool = _count(options.duration_h, options), _count(options.cool_h, options)
    _refuse_crowded(options, round_s, warm, cool)
    day = _Day(setup)
    for _ in range(COLD_ROUNDS):
        day.add_round("cold block")
    moved_s = dict.fromkeys(setup.park_mm, 0.0)
    for _ in range(warm):
        seconds = options.duration_h * 3600.0 / warm - round_s
        day.add("warm-up", "duty", duty_steps(setup, seconds, moved_s))
        day.add_round("warm-up")
    for _ in range(cool):
        day.add("cool-down", "rest", rest_steps(options.cool_h * 3600.0 / cool - round_s))
        day.add_round("cool-down")
    blocks = tuple(day.blocks)
    return Timetable(
        setup=setup,
        blocks=blocks,
        points=tuple(point for block in blocks for point in _points(setup, block)),
        programs=_programs(setup, blocks),
        notes=tuple(_notes(setup, blocks, round_s)),
    )


def _count(hours: float, options: PlanOptions) -> int:
    """Rounds in a part of the day: one each interval, evenly spread, at least one where the part exists."""
    return max(1, round(hours * 60.0 / options.interval_min)) if hours > 0 else 0


def _length(setup: Setup, steps: Sequence[Step]) -> float:
    return timed(setup, steps)[-1].end_s


class _Day:
    """Blocks as they are added, and the clock."""

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self.blocks: list[Block] = [Block("cold block", "log", "", (), 0.0, LOG_LEAD_S)]
        self.rounds = 0

    def add(self, part: Part, kind: Kind, steps: Sequence[Step], round_: str = "") -> None:
        begin_s = self.blocks[-1].end_s
        made = tuple(timed(self.setup, steps, begin_s))
        self.blocks.append(Block(part, kind, round_, made, begin_s, made[-1].end_s))

    def add_round(self, part: Part) -> None:
        name = round_name(self.rounds)
        self.add(part, "round", round_steps(self.setup, name), name)
        self.rounds += 1


def _refuse_crowded(options: PlanOptions, round_s: float, warm: int, cool: int) -> None:
    problems: list[Problem] = []
    for option, hours, count in (("duration", options.duration_h, warm), ("cool", options.cool_h, cool)):
        if count and round_s > LARGEST_ROUND_SHARE * hours * 3600.0 / count:
            problems.append(
                problem(
                    f"a measuring round takes {round_s / 60:.0f} min, and there would be one each"
                    f" {hours * 60 / count:.0f} min (--{option}-h {hours:g}, --interval-min {options.interval_min:g}):"
                    " hardly any time is left in between.",
                    "fewer --points, a shorter --dwell-s, a higher --sweep-feed-mm-min, or a longer --interval-min.",
                    "plan-crowded",
                )
            )
    if COLD_ROUNDS + warm + cool > MOST_ROUNDS:
        problems.append(
            problem(f"the plan would have {COLD_ROUNDS + warm + cool} rounds.", "choose a longer --interval-min.")
        )
    if problems:
        raise InputError(problems)


def _points(setup: Setup, block: Block) -> list[Point]:
    points: list[Point] = []
    for entry in block.steps:
        step = entry.step
        if isinstance(step, Read):
            # The reading belongs to the middle of the time after the machine has come to rest.
            t_s = entry.begin_s + setup.options.settle_s + setup.options.dwell_s / 2.0
            points.append(
                Point(
                    name=step.name,
                    round=block.round,
                    part=block.part,
                    axis=step.axis,
                    target=f"{step.target:03d}",
                    direction=step.direction,
                    t_s=t_s,
                    position_mm=entry.position_mm,
                )
            )
        elif isinstance(step, Halt):
            points += [
                Point(
                    name=foundation_point(step.round, target, step.end),
                    round=block.round,
                    part=block.part,
                    axis="",
                    target=target,
                    direction=0,
                    t_s=entry.begin_s + (k + 0.5) * FOUNDATION_S,
                    position_mm=entry.position_mm,
                )
                for k, target in enumerate(TARGETS)
            ]
    return points


def _programs(setup: Setup, blocks: Sequence[Block]) -> tuple[Program, ...]:
    rest = to_rest(setup)
    made = [
        Program(f"SWEEP_{axis.name}", f"one measuring sweep of axis {axis.name}", (*rest, *sweep_steps(setup, axis)))
        for axis in setup.axes
    ]
    titles: tuple[tuple[Part, str], ...] = (
        ("cold block", "sweeps of all axes before any heat"),
        ("warm-up", "spindle and axes at work, with measuring rounds"),
        ("cool-down", "machine at rest, with measuring rounds"),
    )
    for part, title in titles:
        steps = [entry.step for block in blocks if block.part == part for entry in block.steps]
        if steps:
            made.append(Program(part.upper().replace(" ", "_").replace("-", "_"), title, (*rest, *steps, Spindle(0.0))))
    return tuple(made)


def _notes(setup: Setup, blocks: Sequence[Block], round_s: float) -> list[str]:
    """What is right by the rules and still worth a second thought."""
    notes, options = [], setup.options
    duty = [block for block in blocks if block.kind == "duty"]
    share = round_s / (duty[0].length_s + round_s)
    if share > BUSY_ROUND_SHARE:
        notes.append(
            f"The machine spends {100 * share:.0f} % of the warm-up on measuring, with the spindle at rest, and warms"
            " up less than in production. Shorter rounds: fewer points, a shorter dwell, a higher sweep feed."
        )
    for axis in setup.axes:
        stroke_s = 2.0 * (axis.turn_mm[1] - axis.turn_mm[0]) / options.feed_mm_min * 60.0
        if stroke_s > duty[0].length_s:
            notes.append(
                f"Axis {axis.name} needs {stroke_s / 60:.0f} min at {options.feed_mm_min:g} mm/min for its travel out"
                f" and back, and there are {duty[0].length_s / 60:.0f} min between two rounds: in the warm-up it moves"
                " over a part of its travel only. Choose a higher --feed-mm-min or a longer --interval-min."
            )
    return notes


def sweep_span_s(block: Block, axis: str) -> tuple[float, float]:
    """Begin and end of the sweep of one axis in a round, from leaving its rest position to its return."""
    mine = [entry for entry in block.steps if isinstance(entry.step, Move | Read) and entry.step.axis == axis]
    return mine[0].begin_s, mine[-1].end_s


def moved_mm(setup: Setup, block: Block, axis: str) -> float:
    """How far an axis travels in a block, there and back counted."""
    before, moved = setup.of(axis).park_mm, 0.0
    for entry in block.steps:
        moved += abs(entry.position_mm[axis] - before)
        before = entry.position_mm[axis]
    return moved

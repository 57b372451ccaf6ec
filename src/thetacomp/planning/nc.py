"""The steps of a program as NC text: ISO G-code as LinuxCNC reads it, and SINUMERIK."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from thetacomp import __version__
from thetacomp.controllers.ascii_text import ascii_text
from thetacomp.planning.setup import Setup
from thetacomp.planning.steps import (
    TARGETS,
    Halt,
    Move,
    Note,
    Read,
    Spindle,
    Step,
    Wait,
    foundation_point,
)
from thetacomp.planning.timetable import Program, Timetable

LONGEST_COMMENT = 200

_SAFETY = (
    "SAFETY. This program moves axes and turns the spindle.",
    "Who starts it is responsible for people, machine and tracker.",
    "1. Read the whole program through. Compare axes, positions and feeds with this machine.",
    "2. Take out tool and workpiece. Lead the cable of the tracker clear of all axes. Nobody in the working area.",
    "3. Reference all axes. All positions are machine coordinates inside travel_mm of machine.toml.",
    "4. Dry run first: reflector taken off, single block, feed override at 10 percent or less, hand on feed hold.",
    "5. Check the rest positions and the order in which the axes move: one axis at a time, axes along Z first.",
    "6. Reflector off and door closed before the spindle turns. The spindle stands in every measuring round.",
    "Coolant is neither switched on nor off by any word of this program.",
)


@dataclass(frozen=True)
class NcFile:
    """One NC program as text: its path below the folder of the plan."""

    path: str
    text: str


@dataclass(frozen=True)
class Dialect:
    """The dialect of a control: comments, messages, moves, waits, and the lines at begin and end."""

    name: str
    folder: str
    ending: str
    comment: Callable[[str], str]
    message: Callable[[str], str]
    move: Callable[[str, float, float], str]
    wait: Callable[[float], str]
    first: str
    begin: tuple[str, ...]
    end: tuple[str, ...]


def _iso_comment(text: str) -> str:
    # Round brackets end a comment, and a second pair inside is an error.
    return f"({text.replace('(', '[').replace(')', ']')})"


ISO = Dialect(
    name="ISO G-code, as LinuxCNC reads it. G4 P counts seconds; other controls may take milliseconds",
    folder="nc/iso",
    ending=".ngc",
    comment=_iso_comment,
    message=lambda text: f"(MSG,{text})",
    move=lambda letter, to_mm, feed: f"G53 G1 {letter}{to_mm:.3f} F{feed:g}",
    wait=lambda seconds: f"G4 P{_seconds(seconds)}",
    first="%",
    begin=("G21 G90 G94 G17 G40 G49 G80 G61", "M5"),
    # A percent sign ends the program without M30, which would switch the coolant off.
    end=("%",),
)


def sinumerik(setup: Setup) -> Dialect:
    """SINUMERIK: SUPA leaves out every offset for one block; FGROUP lets the feed hold for secondary axes too."""
    return Dialect(
        name="SINUMERIK. What M30 does to the coolant is decided by the builder of the machine",
        folder="nc/sinumerik",
        ending=".mpf",
        comment=lambda text: f"; {text}",
        message=lambda text: f'MSG("{text}")',
        move=lambda letter, to_mm, feed: f"SUPA G1 {letter}{to_mm:.3f} F{feed:g}",
        wait=lambda seconds: f"G4 F{_seconds(seconds)}",
        first="",
        begin=(
            "G710 G90 G94 G17 G40 G60 D0",
            "TRAFOOF",
            f"FGROUP({','.join(axis.letter for axis in setup.axes)})",
            "M5",
        ),
        end=("MSG()", "FGROUP()", "M30"),
    )


def _seconds(seconds: float) -> str:
    return f"{seconds:.3f}".rstrip("0").rstrip(".")


def nc_files(timetable: Timetable) -> tuple[NcFile, ...]:
    """Every program in both dialects."""
    return tuple(
        NcFile(
            f"{dialect.folder}/{program.name.lower()}{dialect.ending}", program_text(timetable.setup, program, dialect)
        )
        for dialect in (ISO, sinumerik(timetable.setup))
        for program in timetable.programs
    )


def program_text(setup: Setup, program: Program, dialect: Dialect) -> str:
    """One program: safety text, settings, steps. Plain ASCII."""
    lines = [dialect.first] if dialect.first else []
    lines += [dialect.comment(_plain(text)) for text in (*_head(setup, program, dialect), *_SAFETY)]
    lines += dialect.begin
    for step in program.steps:
        lines += _lines(setup, step, dialect)
    return "\n".join([*lines, *dialect.end]) + "\n"


def _plain(text: str) -> str:
    """ASCII without quotes or controls that a comment or a message could stumble over."""
    kept = "".join(letter if letter.isprintable() else " " for letter in ascii_text(text))
    return kept.replace('"', "'").replace(";", ",")[:LONGEST_COMMENT]


def _head(setup: Setup, program: Program, dialect: Dialect) -> tuple[str, ...]:
    park = " ".join(f"{axis.letter}{axis.park_mm:.3f}" for axis in setup.clear)
    moves = ", ".join(
        f"{axis.letter}: {axis.name} {axis.turn_mm[0]:.3f} to {axis.turn_mm[1]:.3f} mm" for axis in setup.axes
    )
    return (
        f"{program.name}: {program.title}. Machine {setup.machine.name}",
        f"thetacomp {__version__} measuring plan. {dialect.name}",
        f"Axes and the range they move in - {moves}",
        f"Rest positions in the order in which they are taken up - {park}",
    )


def _lines(setup: Setup, step: Step, dialect: Dialect) -> list[str]:
    options = setup.options
    if isinstance(step, Note):
        return [dialect.comment(_plain(step.text))]
    if isinstance(step, Move):
        return [dialect.move(setup.of(step.axis).letter, step.to_mm, step.feed_mm_min)]
    if isinstance(step, Read):
        where = f"{setup.of(step.axis).letter}={step.position_mm:.3f} DIR={'+' if step.direction > 0 else '-'}"
        return [dialect.comment(f"POINT {step.name} {where}"), dialect.wait(options.settle_s + options.dwell_s)]
    if isinstance(step, Wait):
        return [dialect.wait(step.seconds)]
    if isinstance(step, Spindle):
        return [f"S{step.rpm:g} M3" if step.rpm > 0 else "M5"]
    return _halt(step, dialect)


def _halt(step: Halt, dialect: Dialect) -> list[str]:
    names = [foundation_point(step.round, target, step.end) for target in TARGETS]
    words = (
        f"{step.round} ends: measure {' '.join(TARGETS)}, then take the reflector off, then cycle start"
        if step.end
        else f"{step.round} begins: put the reflector on, measure {' '.join(TARGETS)}, then cycle start"
    )
    return [*(dialect.comment(f"FOUNDATION {name}") for name in names), dialect.message(words), "M0"]

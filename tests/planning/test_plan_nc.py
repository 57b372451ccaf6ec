"""The NC programs of a plan, run through interpreters that know nothing of the plan."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from linuxcnc_canon import LETTERS, Walk, by_front_end, by_rs274
from plan_machines import SHORT, boring_machine, mill, three

from thetacomp.machine import Axis, Machine
from thetacomp.planning.nc import LONGEST_COMMENT, nc_files
from thetacomp.planning.options import PlanOptions
from thetacomp.planning.timetable import Timetable, make_timetable

PARTS = {"cold_block": "cold block", "warm_up": "warm-up", "cool_down": "cool-down"}


def write(timetable: Timetable, folder: Path) -> dict[str, Path]:
    """All programs of a plan as files; by path below the plan's folder."""
    made = {}
    for file in nc_files(timetable):
        made[file.path] = folder / file.path
        made[file.path].parent.mkdir(parents=True, exist_ok=True)
        made[file.path].write_text(file.text, encoding="ascii", newline="\n")
    return made


def check_walk(walk: Walk, timetable: Timetable, part: str) -> None:
    """Every reading happens at its planned place, in order; nothing leaves the travel; one axis at a time."""
    setup = timetable.setup
    letter = {axis.name: axis.letter for axis in setup.axes}
    planned = [point for point in timetable.points if point.part == part]
    assert [name for name, *_ in walk.readings] == [point.name for point in planned if point.axis]
    assert walk.foundation == [point.name for point in planned if not point.axis]
    for point, (_, seconds, position, rpm) in zip([p for p in planned if p.axis], walk.readings, strict=True):
        assert seconds == setup.options.settle_s + setup.options.dwell_s
        assert {name: position[letter[name]] for name in letter} == pytest.approx(point.position_mm, abs=1e-6)
        assert rpm == 0.0
    idle = {axis.letter for axis in setup.axes} ^ set(LETTERS)
    for number, (begin, end, feed) in enumerate(walk.moves):
        moving = [one for one in LETTERS if abs(begin[one] - end[one]) > 1e-6]
        assert len(moving) <= 1
        assert not idle.intersection(moving)
        assert feed in (pytest.approx(setup.options.feed_mm_min), pytest.approx(setup.options.sweep_feed_mm_min))
        for axis in setup.axes:
            known = number >= len(setup.axes) - 1  # before that, axes stand where they were left
            if known or axis.letter in moving:
                assert axis.axis.travel_mm[0] <= end[axis.letter] <= axis.axis.travel_mm[1]


def check_times(walk: Walk, timetable: Timetable, part: str) -> None:
    """Way over feed, plus the waits: the length of the program is that of the timetable."""
    setup = timetable.setup
    blocks = [block for block in timetable.blocks if block.part == part and block.kind != "log"]
    first = sum(abs(axis.park_mm) for axis in setup.axes) / setup.options.sweep_feed_mm_min * 60.0
    stopped_s = walk.stops * 80.0  # four foundation targets of 20 s
    assert walk.moving_s() - first + walk.dwell_s + stopped_s == pytest.approx(
        blocks[-1].end_s - blocks[0].begin_s, abs=0.5
    )


@pytest.mark.needs("linuxcnc-uspace")
@pytest.mark.parametrize("program", PARTS)
def test_rs274_reaches_exactly_the_planned_points(program: str, tmp_path: Path) -> None:
    timetable = make_timetable(mill(), SHORT)
    walk = by_rs274(write(timetable, tmp_path)[f"nc/iso/{program}.ngc"], tmp_path)
    check_walk(walk, timetable, PARTS[program])
    rounds = [block for block in timetable.rounds if block.part == PARTS[program]]
    assert walk.stops == 2 * len(rounds)
    assert walk.told_rpm == ({0.0, 650.0} if program == "warm_up" else {0.0})
    assert walk.rpm == 0.0
    check_times(walk, timetable, PARTS[program])


@pytest.mark.needs("linuxcnc-uspace")
@pytest.mark.parametrize("program", PARTS)
def test_linuxcnc_reaches_exactly_the_planned_points_with_the_secondary_axis_w(program: str, tmp_path: Path) -> None:
    timetable = make_timetable(boring_machine(), SHORT)
    walk = by_front_end(write(timetable, tmp_path)[f"nc/iso/{program}.ngc"], tmp_path)
    check_walk(walk, timetable, PARTS[program])
    swept = {name.split("_")[1] for name, *_ in walk.readings}
    assert swept == {"X", "Y", "Z", "W"}


@pytest.mark.needs("linuxcnc-uspace")
@pytest.mark.parametrize("axis", "XYZ")
def test_the_sweep_of_one_axis_runs_alone(axis: str, tmp_path: Path) -> None:
    timetable = make_timetable(mill(), SHORT)
    walk = by_rs274(write(timetable, tmp_path)[f"nc/iso/sweep_{axis.lower()}.ngc"], tmp_path)
    plan = timetable.setup.of(axis)
    wanted = [(f"{axis}_{k:03d}_P", p) for k, p in enumerate(plan.target_mm, 1)]
    wanted += [(f"{axis}_{k:03d}_M", p) for k, p in reversed(list(enumerate(plan.target_mm, 1)))]
    assert [(name, position[axis]) for name, _, position, _ in walk.readings] == wanted


@pytest.mark.needs("linuxcnc-uspace")
def test_every_position_is_approached_from_the_side_that_its_name_says(tmp_path: Path) -> None:
    timetable = make_timetable(mill(), SHORT)
    walk = by_rs274(write(timetable, tmp_path)["nc/iso/cold_block.ngc"], tmp_path)
    # A position is visible_changes from both sides: the moves are taken in their order.
    moves = iter(walk.moves)
    for name, _, position, _ in walk.readings:
        begin, end, _ = next(move for move in moves if move[1] == position)
        letter = name.split("_")[1]
        assert (end[letter] > begin[letter]) == name.endswith("P"), name


@pytest.mark.needs("linuxcnc-uspace")
def test_the_interpreters_see_a_wrong_word_and_a_wrong_position(tmp_path: Path) -> None:
    timetable = make_timetable(mill(), SHORT)
    program = write(timetable, tmp_path)["nc/iso/cold_block.ngc"]
    good = program.read_text()
    program.write_text(good.replace("M5\n", "M5 Q\n", 1))
    with pytest.raises(AssertionError):
        by_rs274(program, tmp_path)
    with pytest.raises(AssertionError):
        by_front_end(program, tmp_path)
    first = timetable.setup.of("X").target_mm[1]
    program.write_text(good.replace(f"X{first:.3f} F", f"X{first + 0.001:.3f} F", 1))
    with pytest.raises(AssertionError):
        check_walk(by_rs274(program, tmp_path), timetable, "cold block")


@pytest.mark.needs("linuxcnc-uspace")
def test_hostile_names_stay_inside_comments(tmp_path: Path) -> None:
    hostile = mill().model_copy(update={"name": 'Fräse (neu) "A"; M3 S9000\n%\nG0 X99999 – 重型 ' + "long " * 60})
    timetable = make_timetable(hostile, SHORT)
    made = write(timetable, tmp_path)
    check_walk(by_rs274(made["nc/iso/cold_block.ngc"], tmp_path), timetable, "cold block")
    for path in made.values():
        assert max(map(len, path.read_text(encoding="ascii").splitlines())) <= LONGEST_COMMENT + 2


# --- SINUMERIK --------------------------------------------------------------------------------------------------------
# No interpreter of Siemens is available: a strict grammar of the words that are used stands in for it.
# Words after the programming manual: SUPA leaves out all offsets for a block, G4 F waits seconds, MSG shows a text,
# FGROUP names the axes that the feed belongs to, TRAFOOF ends transformations, D0 takes the tool offset away.

_GRAMMAR = {
    "comment": re.compile(r"; [ -~]*"),
    "message": re.compile(r'MSG\("[ !#-~]+"\)'),
    "move": re.compile(r"SUPA G1 ([XYZUVW])(-?\d+\.\d{3}) F(\d+(?:\.\d+)?)"),
    "wait": re.compile(r"G4 F(\d+(?:\.\d+)?)"),
    "spindle": re.compile(r"S(\d+(?:\.\d+)?) M3"),
    "spindle off": re.compile(r"M5"),
    "stop": re.compile(r"M0"),
}
_BEGIN = ("G710 G90 G94 G17 G40 G60 D0", "TRAFOOF")
_END = ("MSG()", "FGROUP()", "M30")


def by_grammar(text: str, letters: list[str]) -> Walk:
    """Read a SINUMERIK program line by line; AssertionError where a line is not in the grammar."""
    assert text.endswith("M30\n")
    lines = text.splitlines()
    head = next(k for k, line in enumerate(lines) if not line.startswith(";"))
    assert all(_GRAMMAR["comment"].fullmatch(line) for line in lines[:head])
    assert tuple(lines[head : head + 2]) == _BEGIN
    assert lines[head + 2] == f"FGROUP({','.join(letters)})"
    assert tuple(lines[-3:]) == _END
    walk = Walk()
    for line in lines[head + 3 : -3]:
        kind, match = next(((k, m) for k, p in _GRAMMAR.items() if (m := p.fullmatch(line))), ("", None))
        assert match is not None, line
        if kind == "comment":
            walk.comment(line[2:])
        elif kind == "move":
            walk.feed_mm_min = float(match[3])
            walk.move({match[1]: float(match[2])})
        elif kind == "wait":
            walk.dwell(float(match[1]))
        elif kind == "stop":
            walk.stops += 1
        elif kind.startswith("spindle"):
            walk.spindle(float(match[1]) if match.groups() else 0.0)
    return walk


@pytest.mark.parametrize("machine", [mill(), boring_machine()], ids=["mill", "boring machine"])
@pytest.mark.parametrize("program", PARTS)
def test_sinumerik_programs_keep_to_the_grammar_and_reach_the_planned_points(machine: Machine, program: str) -> None:
    timetable = make_timetable(machine, SHORT)
    text = {file.path: file.text for file in nc_files(timetable)}[f"nc/sinumerik/{program}.mpf"]
    walk = by_grammar(text, [axis.letter for axis in timetable.setup.axes])
    check_walk(walk, timetable, PARTS[program])
    check_times(walk, timetable, PARTS[program])
    assert walk.told_rpm == ({0.0, 650.0} if program == "warm_up" else {0.0})


def test_the_grammar_refuses_what_a_control_would() -> None:
    timetable = make_timetable(mill(), SHORT)
    good = {file.path: file.text for file in nc_files(timetable)}["nc/sinumerik/cold_block.mpf"]
    by_grammar(good, list("XYZ"))
    for old, new in (("SUPA G1 X", "G1 X"), ("G4 F6", "G4 P6"), ("M5\n", "M5 M8\n"), ("M30\n", "M30")):
        with pytest.raises(AssertionError):
            by_grammar(good.replace(old, new), list("XYZ"))


# --- both dialects ----------------------------------------------------------------------------------------------------


def test_no_program_touches_the_coolant_and_all_carry_the_safety_text() -> None:
    for file in nc_files(make_timetable(boring_machine(), PlanOptions())):
        code = [line for line in file.text.splitlines() if not line.startswith(("(", ";"))]
        assert not [line for line in code if re.search(r"\bM0?[789]\b", line)], file.path
        for words in ("responsible", "Read the whole program through", "Dry run", "override at 10 percent", "Coolant"):
            assert words in file.text, file.path


def test_axes_along_z_retract_first_and_the_axes_of_a_round_end_where_they_rest() -> None:
    timetable = make_timetable(boring_machine(), SHORT)
    lines = {file.path: file.text for file in nc_files(timetable)}["nc/iso/sweep_x.ngc"].splitlines()
    moves = [line.split()[2] for line in lines if line.startswith("G53")]
    assert moves[:4] == ["Z990.000", "W990.000", "X1500.000", "Y1500.000"]
    assert moves[-1] == "X1500.000"


def test_a_control_that_calls_an_axis_otherwise_gets_its_own_letter() -> None:
    axes = (Axis(name="X1", direction="+X", travel_mm=(0.0, 800.0)), *three()[1:])
    timetable = make_timetable(mill(*axes), replace(SHORT, nc_axis={"X1": "u"}))
    text = {file.path: file.text for file in nc_files(timetable)}["nc/iso/cold_block.ngc"]
    assert "G53 G1 U8.000 F3000" in text
    assert "(POINT R00_X1_001_P U=8.000 DIR=+)" in text

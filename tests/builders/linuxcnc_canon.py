"""LinuxCNC's interpreter as two tests see it: what a program makes the machine do, call by call, in mm and s.

`rs274` is the stand-alone interpreter; it knows no axes U, V, W. LinuxCNC's own front end reads programs through the
same library (`librs274`) by its Python module `gcode`, which does know them, but says nothing of the spindle.
"""

from __future__ import annotations

import json
import re
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

LETTERS = "XYZABCUVW"
INCH_MM = 25.4

# Runs under the Python that Debian's module is built for.
_READER = """
import gcode, json, sys
class Canon:
    def next_line(self, state): pass
    def get_axis_mask(self): return 0x1FF
    def get_external_angular_units(self): return 1.0
    def get_external_length_units(self): return 1.0
    def get_block_delete(self): return 0
    def get_tool(self, pocket): return (-1,) + (0,) * 13
    def check_abort(self): return False
    def __getattr__(self, name):
        if name.startswith("_"): raise AttributeError(name)
        return lambda *args: calls.append([name, *[a for a in args if isinstance(a, (int, float, str))]])
calls = []
canon = Canon()
canon.parameter_file = sys.argv[2]
result, line = gcode.parse(sys.argv[1], canon, "", "")
print(json.dumps({"error": gcode.strerror(result) if result > gcode.MIN_ERROR else "", "line": line, "calls": calls}))
"""


@dataclass
class Walk:
    """What a program did. Readings are (name, dwell in s, position of every letter, rpm) in order."""

    readings: list[tuple[str, float, dict[str, float], float]] = field(default_factory=list)
    moves: list[tuple[dict[str, float], dict[str, float], float]] = field(default_factory=list)  # from, to, mm/min
    foundation: list[str] = field(default_factory=list)
    stops: int = 0
    dwell_s: float = 0.0
    rpm: float = 0.0
    told_rpm: set[float] = field(default_factory=set)
    feed_mm_min: float = 0.0
    position_mm: dict[str, float] = field(default_factory=lambda: dict.fromkeys(LETTERS, 0.0))
    waiting_for: str = ""

    def move(self, target_mm: dict[str, float]) -> None:
        to = {**self.position_mm, **target_mm}
        self.moves.append((self.position_mm, to, self.feed_mm_min))
        self.position_mm = to

    def dwell(self, seconds: float) -> None:
        self.dwell_s += seconds
        if self.waiting_for:
            self.readings.append((self.waiting_for, seconds, self.position_mm, self.rpm))
            self.waiting_for = ""

    def comment(self, text: str) -> None:
        words = text.split()
        if words[0] == "POINT":
            assert not self.waiting_for, "a point without a reading"
            self.waiting_for = words[1]
        elif words[0] == "FOUNDATION":
            self.foundation.append(words[1])

    def spindle(self, rpm: float) -> None:
        self.rpm = rpm
        self.told_rpm.add(rpm)

    def moving_s(self) -> float:
        """Time of all moves but the first of each letter, which starts from an unknown place."""
        return sum(max(abs(b[a] - f[a]) for a in LETTERS) / feed * 60.0 for f, b, feed in self.moves)


def by_rs274(program: Path, folder: Path) -> Walk:
    """Run the stand-alone interpreter. AssertionError with its words where it refuses a line."""
    done = subprocess.run(
        ["rs274", "-g", str(program)], capture_output=True, text=True, cwd=folder, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr.split() == ["executing"], done.stderr
    walk, speed = Walk(), 0.0
    for line in done.stdout.splitlines():
        match = re.fullmatch(r"\s*\d+ N\S+\s+(\w+)\((.*)\)", line)
        assert match, line
        call, text = match[1], match[2]
        if call == "COMMENT":
            walk.comment(text.strip('"'))
        elif call in ("STRAIGHT_FEED", "STRAIGHT_TRAVERSE"):
            assert call == "STRAIGHT_FEED", "no rapid moves"
            walk.move(dict(zip(LETTERS, map(float, text.split(",")), strict=False)))
        elif call == "SET_FEED_RATE":
            walk.feed_mm_min = float(text)
        elif call == "DWELL":
            walk.dwell(float(text))
        elif call == "PROGRAM_STOP":
            walk.stops += 1
        elif call == "SET_SPINDLE_SPEED":
            speed = float(text.split(",")[-1])
        elif call == "START_SPINDLE_CLOCKWISE":
            walk.spindle(speed)
        elif call == "STOP_SPINDLE_TURNING":
            walk.spindle(0.0)
        else:
            assert call in _HARMLESS, line
    return walk


_HARMLESS = {
    *("USE_LENGTH_UNITS", "SET_G5X_OFFSET", "SET_G92_OFFSET", "SET_XY_ROTATION", "SET_FEED_REFERENCE", "ON_RESET"),
    *("SET_FEED_MODE", "SELECT_PLANE", "USE_TOOL_LENGTH_OFFSET", "SET_MOTION_CONTROL_MODE", "MESSAGE", "FINISH"),
}


def by_front_end(program: Path, folder: Path) -> Walk:
    """Run LinuxCNC's interpreter library through its Python module, as its front end does: all nine letters."""
    done = subprocess.run(
        ["/usr/bin/python3", "-c", _READER, str(program), str(folder / "none.var")],
        capture_output=True,
        text=True,
        cwd=folder,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["error"] == "", f"line {found['line']}: {found['error']}"
    walk = Walk()
    for call, *values in found["calls"]:
        if call == "comment":
            walk.comment(values[0])
        elif call == "straight_feed":
            walk.move({letter: value * INCH_MM for letter, value in zip(LETTERS, values, strict=True)})
        elif call == "set_feed_rate":
            walk.feed_mm_min = values[0] * INCH_MM
        elif call == "dwell":
            walk.dwell(values[0])
        assert call != "straight_traverse", "no rapid moves"
    return walk

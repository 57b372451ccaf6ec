"""Machines to plan for: a plain milling machine, and the published boring machine with its ram W."""

from __future__ import annotations

import csv
import io
from importlib.resources import files
from pathlib import Path

from thetacomp.machine import Axis, Machine, Sensor
from thetacomp.planning.options import PlanOptions
from thetacomp.reading import read_machine

SHORT = PlanOptions(duration_h=2.0, cool_h=1.0, mode="no cooling")
"""Two heated rounds and one of cooling down: enough to test everything."""


def mill(*axes: Axis) -> Machine:
    """A machine with the axes X, Y, Z, or those given, and two sensors."""
    sensors = (Sensor(id="t1", role="drive", location="screw nut"), Sensor(id="t2", role="ambient"))
    return Machine(name="mill", axes=axes or three(), sensors=sensors)


def three(z: str = "+Z") -> tuple[Axis, ...]:
    """X 0 to 800, Y -500 to 0, Z 0 to 600 mm."""
    return (
        Axis(name="X", direction="+X", travel_mm=(0.0, 800.0)),
        Axis(name="Y", direction="-Y", travel_mm=(-500.0, 0.0)),
        Axis(name="Z", direction=z, travel_mm=(0.0, 600.0)),
    )


def boring_machine() -> Machine:
    """The TK6920 with X, Y, Z and the ram W along the same line as Z."""
    return read_machine(Path(str(files("thetacomp.examples"))) / "tk6920" / "machine.toml")


def rows(text: str) -> list[dict[str, str]]:
    """A CSV text row by row."""
    return list(csv.DictReader(io.StringIO(text)))

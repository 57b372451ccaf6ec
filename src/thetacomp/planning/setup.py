"""Where the axes stand and turn in a campaign: measured positions, rest positions, order of the axes, tool point."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import CARTESIAN, Floats
from thetacomp.errors import InputError, Problem
from thetacomp.machine import Axis, Machine
from thetacomp.planning.options import PlanOptions, check_options, problem

NC_LETTERS = ("X", "Y", "Z", "U", "V", "W")
# The turn beyond the first and last position: enough to take up any play, so that both ways approach from one side.
OVERRUN_SHARE, OVERRUN_LEAST_MM, OVERRUN_MOST_MM, OVERRUN_LIMIT = 0.005, 1.0, 10.0, 0.05


@dataclass(frozen=True)
class AxisPlan:
    """One axis in the plan: NC letter, measured positions (rising), the two turns beyond them, and where it rests."""

    axis: Axis
    letter: str
    target_mm: tuple[float, ...]
    turn_mm: tuple[float, float]
    park_mm: float

    @property
    def name(self) -> str:
        """Name of the axis in machine.toml."""
        return self.axis.name


@dataclass(frozen=True)
class Setup:
    """The axes in the order in which they are measured; the first `retract` entries of `clear` move away first."""

    machine: Machine
    options: PlanOptions
    axes: tuple[AxisPlan, ...]

    @property
    def clear(self) -> tuple[AxisPlan, ...]:
        """The order in which axes go to rest: those along Z first, away from the workpiece, then the others."""
        return tuple(sorted(self.axes, key=lambda axis: axis.axis.cartesian != "Z"))

    @property
    def park_mm(self) -> dict[str, float]:
        """Rest position of every axis."""
        return {axis.name: axis.park_mm for axis in self.axes}

    def of(self, name: str) -> AxisPlan:
        """The axis of that name; KeyError where there is none."""
        for axis in self.axes:
            if axis.name == name:
                return axis
        raise KeyError(name)

    def tool_mm(self, position_mm: Mapping[str, float]) -> Floats:
        """Tool point (3,) along X, Y, Z in mm; the origin is the tool with all axes at zero."""
        tool = np.zeros(3)
        for plan in self.axes:
            tool[CARTESIAN.index(plan.axis.cartesian)] += plan.axis.sign * position_mm[plan.name]
        return tool

    def distance_mm(self, point_mm: Floats) -> float:
        """Distance of a point (3,) from the tracker."""
        if self.options.tracker_at_mm is None:
            return self.options.tracker_distance_mm
        return float(np.linalg.norm(point_mm - np.array(self.options.tracker_at_mm)))


def make_setup(machine: Machine, options: PlanOptions) -> Setup:
    """Positions and order for a machine. Raises InputError with everything that keeps a plan from being made."""
    check_options(options)
    problems = _axes_problems(machine, options)
    if problems:
        raise InputError(problems)
    plans = [_axis_plan(axis, options) for axis in machine.axes]
    # Along X and Y first: meanwhile the axes along Z stay retracted.
    return Setup(machine, options, tuple(sorted(plans, key=lambda plan: plan.axis.cartesian == "Z")))


def _axes_problems(machine: Machine, options: PlanOptions) -> list[Problem]:
    if not machine.axes:
        return [
            problem(
                "there are no [[axes]], so there is nothing to move.",
                "describe each linear axis as [[axes]] with name, direction and travel_mm.",
                "no-axes",
                "machine.toml",
            )
        ]
    known = ", ".join(axis.name for axis in machine.axes)
    found = [
        problem(
            f"{option} names the axis '{name}', which is not in machine.toml ({known}).",
            "correct the name.",
        )
        for option, names in (("--park", options.park_mm), ("--nc-axis", options.nc_axis))
        for name in names
        if name not in [axis.name for axis in machine.axes]
    ]
    letters: dict[str, str] = {}
    for axis in machine.axes:
        found += _name_problems(axis, _letter(axis, options), letters)
        park, travel = options.park_mm.get(axis.name), axis.travel_mm
        if park is not None and not travel[0] <= park <= travel[1]:
            found.append(
                problem(
                    f"--park {axis.name}={park:g} lies outside its travel of {travel[0]:g} to {travel[1]:g} mm.",
                    "choose a position inside travel_mm.",
                )
            )
    return found


def _letter(axis: Axis, options: PlanOptions) -> str:
    return options.nc_axis.get(axis.name, axis.name).upper()


def _name_problems(axis: Axis, letter: str, taken: dict[str, str]) -> list[Problem]:
    """An axis needs a letter that the controls know, its own, and a name that fits into the name of a point."""
    if letter not in NC_LETTERS:
        return [
            problem(
                f"the axis '{axis.name}' would be called {letter} in the NC programs, expected one of"
                f" {', '.join(NC_LETTERS)}.",
                f"say which letter the control uses, like --nc-axis {axis.name}={axis.cartesian}.",
                "axis-letter",
            )
        ]
    if letter in taken:
        return [
            problem(
                f"the axes '{taken[letter]}' and '{axis.name}' would both be called {letter} in the NC programs.",
                f"give one of them its own letter with --nc-axis {axis.name}=….",
                "axis-letter",
            )
        ]
    taken[letter] = axis.name
    if not re.fullmatch(r"[A-Za-z0-9]+", axis.name):
        return [
            problem(
                f"the axis name '{axis.name}' cannot be part of the name of a tracker point.",
                "use letters and digits without accents or spaces in machine.toml.",
                "axis-name",
            )
        ]
    return []


def _axis_plan(axis: Axis, options: PlanOptions) -> AxisPlan:
    low, high = axis.travel_mm
    length = high - low
    overrun = min(float(np.clip(OVERRUN_SHARE * length, OVERRUN_LEAST_MM, OVERRUN_MOST_MM)), OVERRUN_LIMIT * length)
    turn = (_mm(low + overrun), _mm(high - overrun))
    targets = np.linspace(low + 2 * overrun, high - 2 * overrun, options.points)
    return AxisPlan(
        axis=axis,
        letter=_letter(axis, options),
        target_mm=tuple(_mm(value) for value in targets),
        turn_mm=turn,
        park_mm=_mm(options.park_mm.get(axis.name, _default_park(axis, overrun))),
    )


def _default_park(axis: Axis, overrun: float) -> float:
    """The middle; an axis along Z stands back, since by ISO 841 positive Z leads away from the workpiece."""
    if axis.cartesian != "Z":
        return 0.5 * (axis.travel_mm[0] + axis.travel_mm[1])
    return axis.travel_mm[1] - 2 * overrun if axis.sign > 0 else axis.travel_mm[0] + 2 * overrun


def _mm(value: float) -> float:
    """Positions as the NC programs write them: whole µm."""
    return round(float(value), 3)


def undetermined_frame(axes: Sequence[AxisPlan]) -> bool:
    """Whether all sweeps lie along one line, about which the tracker's frame could turn freely."""
    return len({plan.axis.cartesian for plan in axes}) < 2

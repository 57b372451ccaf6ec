"""A table of points on moving axes becomes SweepPoints: known axes, plausible positions, separate sweeps."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from thetacomp.arrays import Floats, Ints
from thetacomp.campaign import SweepPoints
from thetacomp.machine import Machine
from thetacomp.reading import checks
from thetacomp.reading.columns import ERRORS, ROTATIONS
from thetacomp.reading.problems import ProblemList, nearest, quoted
from thetacomp.reading.sweeps import segment
from thetacomp.reading.tables import Table

_DIRECTIONS = {"+": 1, "+1": 1, "1": 1, "-": -1, "-1": -1, "−": -1, "": 0}


def rotations(table: Table) -> Floats | None:
    """Angular errors (n, 3), None where the table has none."""
    return table.stacked(ROTATIONS) if any(name in table.numbers for name in ROTATIONS) else None


def at_mm(table: Table, machine: Machine, problems: ProblemList) -> dict[str, Floats]:
    """Positions of the other axes by axis, checked against their travel."""
    at = {
        axis.name: table.numbers[f"at_{axis.name}_mm"] for axis in machine.axes if f"at_{axis.name}_mm" in table.numbers
    }
    for name, values in at.items():
        checks.positions(table, [name] * len(values), {f"at_{name}_mm": values}, machine, problems)
    return at


def sweep_points(table: Table, start_micros: int, machine: Machine, problems: ProblemList) -> SweepPoints | None:
    """Sweeps from a table with axis and position: segmented, checked. None where an axis is not known."""
    t_s = table.t_s(start_micros)
    checks.time_order(table, t_s, problems, strictly=False)
    checks.displacements(table, problems)
    axis, position = table.texts["axis"], table.numbers["position_mm"]
    known = _axes_known(table, axis, machine, problems)
    direction = directions(table, problems)
    if not known:
        return None
    at = at_mm(table, machine, problems)
    _at_is_of_another_axis(table, axis, at, problems)
    checks.positions(table, axis, {table.header("position_mm") or "": position}, machine, problems)
    sweep, approach = segment(axis, position, table.texts.get("run"), direction)
    data = SweepPoints(
        t_s=t_s,
        axis=axis,
        sweep=sweep,
        position_mm=position,
        direction=approach,
        error_um=table.stacked(ERRORS),
        run=table.texts.get("run"),
        station=table.texts.get("station"),
        rotation_urad=rotations(table),
        at_mm=at,
        direction_given=direction is not None and bool(np.all(direction != 0)),
    )
    if np.all(np.diff(t_s) >= 0):
        checks.sweeps(table, data, problems)
    return data


def _axes_known(table: Table, axis: tuple[str, ...], machine: Machine, problems: ProblemList) -> bool:
    """Whether machine.toml knows every axis; the others are noted."""
    names = [a.name for a in machine.axes]
    unknown = [i for i, name in enumerate(axis) if name not in names]
    if unknown:
        name = axis[unknown[0]]
        found = f"found the axis '{name}'{nearest(name, names)}" if name else "the cell is empty"
        expected = f"expected one of {quoted(names)}" if names else "but machine.toml has no [[axes]]"
        problems.error(
            "unknown-axis",
            table.file,
            f"{found}, {expected}.",
            "correct the name, or add the axis to machine.toml as [[axes]] with name, direction and travel_mm.",
            table.rows[unknown].tolist(),
            table.header("axis"),
        )
    return not unknown


def directions(table: Table, problems: ProblemList) -> Ints | None:
    """Approach of every row, +1, -1 or 0 (empty); None where the column is missing or wrong."""
    texts = table.texts.get("direction")
    if texts is None:
        return None
    wrong = [i for i, text in enumerate(texts) if text not in _DIRECTIONS]
    if wrong:
        problems.error(
            "direction",
            table.file,
            f"found '{texts[wrong[0]]}', expected + or - (the side from which the position was approached).",
            "write + where the axis moved towards higher positions, - where towards lower ones, or leave it empty.",
            table.rows[wrong].tolist(),
            table.header("direction"),
        )
        return None
    return np.array([_DIRECTIONS[text] for text in texts], dtype=np.int64)


def _at_is_of_another_axis(
    table: Table, axis: tuple[str, ...], at: Mapping[str, Floats], problems: ProblemList
) -> None:
    names = np.array(axis)
    for name, values in at.items():
        clash = np.flatnonzero((names == name) & np.isfinite(values))
        if len(clash):
            problems.error(
                "at-moving-axis",
                table.file,
                f"axis {name} moves in these rows, and its position also stands in at_{name}_mm.",
                f"leave at_{name}_mm empty where {name} is the moving axis: its position is position_mm.",
                table.rows[clash].tolist(),
                table.header(f"at_{name}_mm"),
            )

"""What no format check can find: numbers that are well formed but implausible."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.campaign import SweepPoints
from thetacomp.instrument import frozen
from thetacomp.machine import Machine
from thetacomp.model.temperatures import Temperatures
from thetacomp.reading.columns import ERRORS, ROTATIONS
from thetacomp.reading.problems import ProblemList
from thetacomp.reading.tables import Table

LARGEST_ERROR_UM = 20_000.0
LARGEST_ANGLE_URAD = 20_000.0
SHORTEST_S, LONGEST_S = 600.0, 14 * 86_400.0
FEWEST_READINGS = 10


def time_order(table: Table, t_s: Floats, problems: ProblemList, strictly: bool = True) -> None:
    """Time must rise from row to row; without `strictly` it may stand still."""
    step = np.diff(t_s)
    header = table.header("t_s")
    back = np.flatnonzero(step < 0) + 1
    if len(back):
        i = int(back[0])
        problems.error(
            "time-backward",
            table.file,
            f"time goes back from {t_s[i - 1]:g} s to {t_s[i]:g} s.",
            "sort the rows by time; if the clock was set or passed midnight, correct the times.",
            table.rows[back].tolist(),
            header,
        )
    same = np.flatnonzero(step == 0) + 1
    if len(same) and strictly:
        problems.error(
            "time-duplicate",
            table.file,
            f"the time {t_s[int(same[0])]:g} s stands twice.",
            "keep one row for each time (a clock without seconds? export the times with seconds).",
            table.rows[same].tolist(),
            header,
        )


def duration(table: Table, t_s: Floats, problems: ProblemList) -> None:
    """Hours are usual. Milliseconds named as seconds give weeks, minutes named as seconds give minutes."""
    span = float(t_s.max() - t_s.min())
    header = table.header("t_s")
    if table.clock is not None or (SHORTEST_S <= span <= LONGEST_S) or len(t_s) < 2:
        return
    if span > LONGEST_S:
        found, unit = f"{span / 86_400:.0f} days", "milliseconds (or seconds in a column of minutes or hours)"
    else:
        found, unit = f"only {span:g} s", "minutes or hours"
    problems.warning(
        "time-unit",
        table.file,
        f"the table covers {found}; a campaign takes hours. Is the time in {unit}?",
        "name the column by its unit: t_s, t_min or t_h.",
        (),
        header,
    )


def displacements(table: Table, problems: ProblemList) -> None:
    """Errors beyond 20 mm, angles beyond 20 mrad, and µm columns that look as if they held mm."""
    largest = 0.0
    for name in (*ERRORS, *ROTATIONS, "intercept_um"):
        values = table.numbers.get(name)
        if values is None or not np.isfinite(values).any():
            continue
        limit, unit = (LARGEST_ANGLE_URAD, "µrad") if name in ROTATIONS else (LARGEST_ERROR_UM, "µm")
        beyond = np.flatnonzero(np.abs(values) > limit)
        header = table.header(name) or name
        if len(beyond):
            problems.error(
                "error-unit",
                table.file,
                f"found {values[beyond[0]]:g} {unit}, expected errors below {limit:g} {unit}: is the unit wrong?",
                "name the column by its unit (_um, _mm, _urad); give errors, not positions.",
                table.rows[beyond].tolist(),
                header,
            )
        if name not in ROTATIONS:
            largest = max(largest, float(np.nanmax(np.abs(values))))
    if 0 < largest < 1:
        problems.warning(
            "error-unit",
            table.file,
            f"the largest error is {largest:.3g} µm: are the errors in mm?",
            "if so, name the columns _mm instead of _um.",
        )
    empty = [name for name in ERRORS if name in table.numbers and not np.isfinite(table.numbers[name]).any()]
    if empty:
        problems.warning(
            "empty-column",
            table.file,
            f"the column {', '.join(table.header(name) or name for name in empty)} holds no value.",
            "delete the column if the direction was not measured.",
            (),
            table.header(empty[0]),
        )


def frozen_displacements(table: Table, t_s: Floats, problems: ProblemList) -> None:
    """Displacements at a fixed position that were repeated instead of measured, and columns that never change."""
    for name in (*ERRORS, *ROTATIONS):
        values = table.numbers.get(name)
        if values is None or np.isfinite(values).sum() < FEWEST_READINGS:
            continue
        rows = np.flatnonzero(frozen(t_s, values))
        header = table.header(name) or name
        if np.nanmax(values) == np.nanmin(values):
            problems.warning(
                "error-constant",
                table.file,
                f"the column never changes ({values[np.isfinite(values)][0]:g}).",
                "check the instrument and its cable; delete the column if the direction was not measured.",
                (),
                header,
            )
        elif len(rows):
            problems.warning(
                "error-frozen",
                table.file,
                f"{len(rows)} readings are repeated for longer than the instrument ever stands still (from"
                f" {t_s[rows[0]] / 3600:.2f} h): they were not measured. An analysis leaves them out.",
                "leave these cells empty; check the instrument and the logger.",
                table.rows[rows].tolist(),
                header,
            )


def positions(
    table: Table, axis: Sequence[str], positions_mm: Mapping[str, Floats], machine: Machine, problems: ProblemList
) -> None:
    """Positions (by header) of the axes named row by row: inside the travel, and over more than 1 % of it."""
    names = np.array(axis)
    for name in dict.fromkeys(axis):
        travel = machine.axis(name).travel_mm
        length = travel[1] - travel[0]
        slack = 0.001 * length + 0.1
        for header, values in positions_mm.items():
            mine = (names == name) & np.isfinite(values)
            outside = np.flatnonzero(mine & ((values < travel[0] - slack) | (values > travel[1] + slack)))
            if len(outside):
                worst = float(values[outside[np.argmax(np.abs(values[outside]))]])
                unit = " Are the positions in µm?" if abs(worst) > 10 * max(map(abs, travel)) else ""
                problems.error(
                    "outside-travel",
                    table.file,
                    f"found {values[outside[0]]:g} mm on axis {name}, expected {travel[0]:g} to {travel[1]:g} mm."
                    f"{unit}",
                    "correct the position, or travel_mm of the axis in machine.toml.",
                    table.rows[outside].tolist(),
                    header,
                )
            elif not header.startswith("at_") and mine.sum() > 2 and 0 < np.ptp(values[mine]) < 0.01 * length:
                problems.error(
                    "position-unit",
                    table.file,
                    f"the positions of axis {name} use only {np.ptp(values[mine]):g} mm of {length:g} mm travel:"
                    " are they in metres?",
                    "give positions in mm.",
                    (),
                    header,
                )


def sweeps(table: Table, data: SweepPoints, problems: ProblemList) -> None:
    """Every sweep needs three positions; the same time twice and long pauses inside a sweep are doubtful."""
    short: list[int] = []
    paused: list[int] = []
    for number in range(int(data.sweep.max()) + 1):
        mine = np.flatnonzero(data.sweep == number)
        if len(np.unique(data.position_mm[mine])) < 3:
            short.append(int(mine[0]))
        steps = np.diff(data.t_s[mine])
        long = np.flatnonzero((steps > 600) & (steps > 10 * np.median(steps))) if len(steps) > 2 else np.array([])
        paused.extend(int(mine[k + 1]) for k in long)
    if short:
        problems.error(
            "sweep-too-short",
            table.file,
            f"the sweep of axis {data.axis[short[0]]} that starts here has fewer than 3 different positions.",
            "measure at least 3 positions; if the sweeps are separated wrongly, add a column `run`"
            " with one number for each sweep.",
            table.rows[short].tolist(),
            table.header("position_mm"),
        )
    if paused:
        problems.warning(
            "sweep-pause",
            table.file,
            "the sweep pauses here for more than 10 min: are these two sweeps?",
            "add a column `run` with one number for each sweep.",
            table.rows[paused].tolist(),
            table.header("t_s"),
        )
    _same_times(table, data, problems)


def _same_times(table: Table, data: SweepPoints, problems: ProblemList) -> None:
    still = np.flatnonzero(np.diff(data.t_s) == 0) + 1
    twice = [
        i
        for i in still
        if data.axis[i] == data.axis[i - 1]
        and data.position_mm[i] == data.position_mm[i - 1]
        and data.direction[i] == data.direction[i - 1]  # a clock of whole minutes may see both ways at the turn
    ]
    if twice:
        problems.error(
            "time-duplicate",
            table.file,
            "the same time, axis and position stand twice, approached from one side.",
            "keep one of the rows.",
            table.rows[twice].tolist(),
            table.header("t_s"),
        )
    elif len(still):
        problems.warning(
            "time-duplicate",
            table.file,
            "several points carry the same time; a sweep takes minutes, and every point has its own time.",
            "give each point the time at which it was measured.",
            table.rows[still].tolist(),
            table.header("t_s"),
        )


def covered(table: Table, t_s: Floats, heat: Temperatures, heat_file: str, problems: ProblemList) -> None:
    """Temperatures must exist for the time of every measured error, within one sampling step."""
    step = float(np.median(np.diff(heat.t_s))) if len(heat.t_s) > 1 else 0.0
    first, last = float(heat.t_s[0]), float(heat.t_s[-1])
    slack = max(step, 60.0)
    outside = np.flatnonzero((t_s < first - slack) | (t_s > last + slack))
    if len(outside):
        problems.error(
            "not-covered",
            table.file,
            f"found the time {t_s[outside[0]]:g} s, but {heat_file} covers only {first:g} to {last:g} s.",
            "check that both tables count time from the same moment and in the unit of their header;"
            " log temperatures over the whole campaign.",
            table.rows[outside].tolist(),
            table.header("t_s"),
        )

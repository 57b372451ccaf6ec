"""The tables of one campaign become a Campaign: common clock, known axes and sensors, plausible numbers."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from datetime import datetime
from typing import cast

import numpy as np

from thetacomp.arrays import CARTESIAN
from thetacomp.campaign import Campaign, CampaignSettings, Drift, Parameters
from thetacomp.machine import Machine
from thetacomp.model.temperatures import Duty, Temperatures
from thetacomp.reading import checks, temperature_checks, tracker
from thetacomp.reading.columns import ERRORS
from thetacomp.reading.lead_in import with_lead_in
from thetacomp.reading.problems import ProblemList, quoted
from thetacomp.reading.sweep_table import at_mm, rotations, sweep_points
from thetacomp.reading.tables import Table
from thetacomp.safe_names import name_fault

MEASURED = ("sweeps", "tracker", "drift", "parameters")


def build(
    name: str,
    place: str,
    settings: CampaignSettings,
    tables: Mapping[str, Table],
    machine: Machine,
    problems: ProblemList,
    unread: Collection[str] = (),
) -> Campaign | None:
    """One campaign from its converted tables (by table name). None, with the problems noted, where there are errors.

    `place` names the campaign in messages about more than one table. A table that could not be read is absent here
    and named in `unread`: the others are checked all the same.
    """
    found = ProblemList()
    fault = name_fault(name)
    if fault:
        found.error("name", place, f"{name!r} cannot be the name of a campaign: {fault}.", "give it another name.")
    start_micros, start = _common_start(place, tables, found)
    one_clock = not found.has_errors
    heat = temperatures(tables["temperatures"], start_micros, machine, found) if "temperatures" in tables else None
    sweeps = sweep_points(tables["sweeps"], start_micros, machine, found) if "sweeps" in tables else None
    tie = None
    if "tracker" in tables and "sweeps" not in tables:
        sweeps, tie = tracker.tracker_sweeps(tables["tracker"], place, start_micros, machine, settings, found)
    drift = _drift(tables["drift"], start_micros, machine, found) if "drift" in tables else None
    lines = _parameters(tables["parameters"], start_micros, machine, found) if "parameters" in tables else None
    work = duty(tables["duty"], start_micros, found) if "duty" in tables else None
    if heat is not None and one_clock and not found.has("time-backward"):
        _together(place, settings, tables, start_micros, heat, found, unread)
    problems.extend(found)
    if found.has_errors or heat is None:
        return None
    return with_lead_in(Campaign(name, settings, heat, sweeps, drift, lines, work, start, tracker=tie))


def _common_start(place: str, tables: Mapping[str, Table], problems: ProblemList) -> tuple[int, datetime | None]:
    """Start of the campaign: the earliest absolute time of all its tables (µs since 1970), where they have such."""
    clocks = {name: table.clock for name, table in tables.items() if table.clock is not None}
    if not clocks:
        return 0, None
    if len(clocks) < len(tables):
        problems.error(
            "time-mixed",
            place,
            f"absolute times (`time`) in {quoted(clocks)}, elapsed times in {quoted(sorted(set(tables) - set(clocks)))}"
            ": they cannot be brought together.",
            "use `time` in all tables of a campaign or in none.",
        )
    if len({clock.has_zone for clock in clocks.values()}) > 1:
        problems.error(
            "time-zone",
            place,
            "the times of some tables carry a time zone and those of others do not.",
            "write all times of a campaign in one way.",
        )
    earliest = min(clocks.values(), key=lambda clock: clock.first_micros)
    return earliest.first_micros, earliest.first


def temperatures(table: Table, start_micros: int, machine: Machine | None, problems: ProblemList) -> Temperatures:
    """The temperature table. Sensors come in the order of machine.toml; columns without any value are left out."""
    order = machine.sensor_ids if machine is not None else tuple(table.numbers)
    present = [name for name in order if name in table.numbers]
    empty = [name for name in present if not np.isfinite(table.numbers[name]).any()]
    if empty:
        problems.warning(
            "empty-column",
            table.file,
            f"no value at all in the column of {quoted(empty)}; it counts as absent.",
            "check the logger, or delete the column.",
            (),
            table.header(empty[0]),
        )
    kept = tuple(name for name in present if name not in empty)
    for name in kept:
        fault = name_fault(name)
        if fault:
            message = f"{name!r} cannot be the id of a sensor: {fault}."
            problems.error("name", table.file, message, "rename the column.", (1,), table.header(name))
    if not kept:
        problems.error("empty-table", table.file, "no sensor has a value.", "export the temperatures again.")
    absent = [name for name in order if name not in table.numbers]
    if absent:
        problems.warning(
            "sensor-without-column",
            table.file,
            f"{len(absent)} of the {len(order)} sensors of machine.toml have no column here: {quoted(absent)}.",
            "add their columns, or continue without these sensors.",
        )
    data = Temperatures(table.t_s(start_micros), kept, table.stacked(kept) if kept else np.empty((len(table.rows), 0)))
    checks.time_order(table, data.t_s, problems)
    if kept:
        data = temperature_checks.without_stray_starts(table, data, problems)
        temperature_checks.temperatures(table, data, problems)
    return data


def _drift(table: Table, start_micros: int, machine: Machine, problems: ProblemList) -> Drift:
    t_s = table.t_s(start_micros)
    checks.time_order(table, t_s, problems)
    checks.displacements(table, problems)
    checks.frozen_displacements(table, t_s, problems)
    return Drift(t_s, table.stacked(ERRORS), rotations(table), at_mm(table, machine, problems))


def duty(table: Table, start_micros: int, problems: ProblemList) -> Duty:
    """The duty table: every column is what the machine did, under its own name."""
    t_s = table.t_s(start_micros)
    checks.time_order(table, t_s, problems)
    return Duty(t_s, dict(table.numbers))


def _parameters(table: Table, start_micros: int, machine: Machine, problems: ProblemList) -> Parameters | None:
    components = table.texts["component"]
    axes = [_axis_of(component, machine) for component in components]
    wrong = [i for i, axis in enumerate(axes) if axis is None]
    checks.displacements(table, problems)
    if wrong:
        names = [axis.name for axis in machine.axes]
        problems.error(
            "component",
            table.file,
            f"found the component '{components[wrong[0]]}', expected E + direction of the error (X, Y, Z) + moving axis"
            f" ({quoted(names) if names else 'none in machine.toml'}), like EYX; or DX, DY, DZ.",
            "rename the component; the moving axis comes last and must be in machine.toml.",
            table.rows[wrong].tolist(),
            table.header("component"),
        )
        return None
    data = Parameters(
        t_s=table.t_s(start_micros),
        component=components,
        intercept_um=table.numbers["intercept_um"],
        slope_um_per_m=table.numbers["slope_um_per_m"],
        p0_mm=table.numbers["p0_mm"],
        p_min_mm=table.numbers["p_min_mm"],
        p_max_mm=table.numbers["p_max_mm"],
    )
    _lines_complete(table, data, cast("list[str]", axes), problems)
    _lines_in_order(table, data, problems)
    moving = [i for i, axis in enumerate(axes) if axis]
    if moving and not problems.has_errors:
        _line_positions(table, data, cast("list[str]", axes), machine, problems)
    return data


def _axis_of(component: str, machine: Machine) -> str | None:
    """The moving axis of a component, '' for drift, None where the name is none."""
    if component in tuple(f"D{letter}" for letter in CARTESIAN):
        return ""
    match = re.fullmatch(r"E[XYZ](.+)", component)
    return match[1] if match and match[1] in [axis.name for axis in machine.axes] else None


def _lines_complete(table: Table, data: Parameters, axes: list[str], problems: ProblemList) -> None:
    moves = np.array([bool(axis) for axis in axes])
    for name in ("p0_mm", "p_min_mm", "p_max_mm"):
        empty = np.flatnonzero(moves & np.isnan(getattr(data, name)))
        if len(empty):
            what = {
                "p0_mm": "the position at which the intercept holds",
                "p_min_mm": "the lowest measured position",
                "p_max_mm": "the highest measured position",
            }[name]
            problems.error(
                "missing-value",
                table.file,
                f"the cell is empty, expected {what}, in mm.",
                "fill it in: an intercept and slope mean nothing without it.",
                table.rows[empty].tolist(),
                table.header(name),
            )
    nothing = np.flatnonzero(np.isnan(data.intercept_um) & np.isnan(data.slope_um_per_m))
    if len(nothing):
        problems.error(
            "missing-value",
            table.file,
            "intercept and slope are both empty.",
            "fill in at least one of them, or delete the row.",
            table.rows[nothing].tolist(),
            table.header("intercept_um"),
        )
    reversed_range = np.flatnonzero(data.p_max_mm <= data.p_min_mm)
    if len(reversed_range):
        problems.error(
            "outside-travel",
            table.file,
            "p_max_mm is not above p_min_mm.",
            "write the lowest and the highest measured position.",
            table.rows[reversed_range].tolist(),
            table.header("p_max_mm"),
        )


def _line_positions(table: Table, data: Parameters, axes: list[str], machine: Machine, problems: ProblemList) -> None:
    for name in dict.fromkeys(axis for axis in axes if axis):
        mine = [i for i, axis in enumerate(axes) if axis == name]
        lowest, highest = float(data.p_min_mm[mine].min()), float(data.p_max_mm[mine].max())
        travel = machine.axis(name).travel_mm
        length = travel[1] - travel[0]
        slack = 0.001 * length + 0.1
        if lowest < travel[0] - slack or highest > travel[1] + slack:
            problems.error(
                "outside-travel",
                table.file,
                f"the lines of axis {name} cover {lowest:g} to {highest:g} mm, expected {travel[0]:g} to {travel[1]:g}"
                " mm at most.",
                "correct p_min_mm and p_max_mm, or travel_mm of the axis in machine.toml.",
                table.rows[mine[:1]].tolist(),
                table.header("p_max_mm"),
            )
        elif highest - lowest < 0.01 * length:
            problems.error(
                "position-unit",
                table.file,
                f"the lines of axis {name} cover only {highest - lowest:g} mm of {length:g} mm travel: are p_min_mm and"
                " p_max_mm in metres?",
                "give positions in mm.",
                table.rows[mine[:1]].tolist(),
                table.header("p_max_mm"),
            )


def _lines_in_order(table: Table, data: Parameters, problems: ProblemList) -> None:
    last: dict[str, float] = {}
    backward: list[int] = []
    twice: list[int] = []
    for i, (component, t_s) in enumerate(zip(data.component, data.t_s.tolist(), strict=True)):
        if component in last and t_s <= last[component]:
            (twice if t_s == last[component] else backward).append(i)
        last[component] = t_s
    for code, where, found, fix in (
        ("time-duplicate", twice, "the same component and time stand twice.", "keep one row for each state."),
        (
            "time-backward",
            backward,
            "the time of this component goes back.",
            "sort the rows of each component by time.",
        ),
    ):
        if where:
            problems.error(code, table.file, found, fix, table.rows[where].tolist(), table.header("t_s"))


def _together(
    place: str,
    settings: CampaignSettings,
    tables: Mapping[str, Table],
    start_micros: int,
    heat: Temperatures,
    problems: ProblemList,
    unread: Collection[str],
) -> None:
    """What only shows when all tables of the campaign are seen together."""
    checks.duration(tables["temperatures"], heat.t_s, problems)
    for name in MEASURED:
        if name in tables:
            checks.covered(tables[name], tables[name].t_s(start_micros), heat, "the temperature table", problems)
    names = {"sweeps": "sweeps", "tracker": "tracker points", "parameters": "already separated parameters"}
    over_position = [words for name, words in names.items() if name in tables]
    if len(over_position) > 1:
        problems.error(
            "two-sources",
            place,
            f"there are {' and '.join(over_position)}.",
            "keep one of them: they state the same errors and replace each other.",
        )
    if not set(MEASURED) & {*tables, *unread}:
        problems.warning(
            "nothing-measured",
            place,
            "there are temperatures but no sweeps, tracker points, drift or parameters.",
            "add the measured errors; a model needs more than temperatures.",
        )
    if settings.reference_s is not None and not heat.t_s[0] <= settings.reference_s <= heat.t_s[-1]:
        problems.error(
            "reference",
            place,
            f"reference_s = {settings.reference_s:g} s in campaign.toml is outside the temperatures"
            f" ({heat.t_s[0]:g} to {heat.t_s[-1]:g} s).",
            "name a moment inside the campaign, in seconds from its start.",
        )

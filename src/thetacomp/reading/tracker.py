"""The table of tracker points becomes sweeps: checked, tied to the foundation, carried into the machine frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thetacomp.arrays import Bools
from thetacomp.campaign import CampaignSettings, SweepPoints, TrackerTie
from thetacomp.machine import Machine
from thetacomp.reading import checks
from thetacomp.reading.columns import ERRORS, XYZ, Matched
from thetacomp.reading.problems import ProblemList, quoted
from thetacomp.reading.sweep_table import sweep_points
from thetacomp.reading.tables import Clock, Table
from thetacomp.tracker import Foundation, FrameError, to_machine_frame

ONE_STATION = "1"
NEAREST_MM, FARTHEST_MM = 100.0, 200_000.0


def tracker_sweeps(
    table: Table, place: str, start_micros: int, machine: Machine, settings: CampaignSettings, problems: ProblemList
) -> tuple[SweepPoints | None, TrackerTie | None]:
    """Errors of the machine from the points of a tracker. (None, None), with the problems noted, on any error."""
    found = ProblemList()
    t_s = table.t_s(start_micros)
    checks.time_order(table, t_s, found, strictly=False)
    moving = np.array([bool(axis) for axis in table.texts["axis"]])
    _rows_are_clear(table, moving, found)
    coordinates_are_plausible(table, found)
    if settings.tracker is None:
        found.error(
            "tracker-uncertainty",
            f"{place}/campaign.toml",
            "there are tracker points, but no section [tracker] states how uncertain they are.",
            "add [tracker] with distance_sd_um, horizontal_sd_urad and vertical_sd_urad: standard deviations of one"
            " point, from readings repeated on a fixed target or from the data sheet.",
        )
    points = None
    if moving.any() and not found.has("time-backward"):
        points = sweep_points(subset(table, moving), start_micros, machine, found)
    if points is not None:
        _others_are_known(subset(table, moving), points, machine, found)
    problems.extend(found)
    if points is None or settings.tracker is None or found.has_errors:
        return None, None
    return _tied(table, moving, start_micros, points, machine, settings, problems)


def _tied(
    table: Table,
    moving: Bools,
    start_micros: int,
    points: SweepPoints,
    machine: Machine,
    settings: CampaignSettings,
    problems: ProblemList,
) -> tuple[SweepPoints | None, TrackerTie | None]:
    assert settings.tracker is not None
    xyz_mm = table.stacked(XYZ)
    station = table.texts.get("station", (ONE_STATION,) * len(moving))
    fixed = ~moving & np.isfinite(xyz_mm).all(axis=1)
    foundation = Foundation(
        table.t_s(start_micros)[fixed], _of(station, fixed), _of(table.texts["target"], fixed), xyz_mm[fixed]
    )
    points = replace(points, station=_of(station, moving))
    try:
        sweeps, tie, doubts = to_machine_frame(
            machine, points, xyz_mm[moving], foundation, settings.tracker, settings.reference_s
        )
    except FrameError as exc:
        problems.error(exc.doubt.code, table.file, exc.doubt.message, exc.doubt.fix)
        return None, None
    for doubt in doubts:
        problems.warning(doubt.code, table.file, doubt.message, doubt.fix)
    errors = {name: sweeps.error_um[:, j] for j, name in enumerate(ERRORS)}
    checks.displacements(replace(subset(table, moving), numbers=errors), problems)
    return sweeps, tie


def _of(values: Sequence[str], rows: Bools) -> tuple[str, ...]:
    return tuple(value for value, kept in zip(values, rows, strict=True) if kept)


def subset(table: Table, rows: Bools) -> Table:
    """Some rows of a table; messages keep naming the rows of the file."""
    source = replace(table.matched.source, rows=table.rows[rows])
    return Table(
        name=table.name,
        matched=Matched(source, table.matched.columns),
        elapsed_s=None if table.elapsed_s is None else table.elapsed_s[rows],
        clock=None if table.clock is None else Clock(table.clock.micros[rows], table.clock.first),
        numbers={name: values[rows] for name, values in table.numbers.items()},
        texts={name: _of(values, rows) for name, values in table.texts.items()},
    )


def coordinates_are_plausible(table: Table, problems: ProblemList) -> None:
    """x, y, z together or not at all, and at a distance at which a tracker in the origin can have measured them."""
    xyz_mm = table.stacked(XYZ)
    missing = np.isnan(xyz_mm)
    partly = np.flatnonzero(missing.any(axis=1) & ~missing.all(axis=1))
    if len(partly):
        problems.error(
            "tracker-coordinates",
            table.file,
            "one of x, y, z is empty.",
            "fill in all three, or leave all three empty where the beam was lost.",
            table.rows[partly].tolist(),
            table.header(XYZ[int(np.argmax(missing[partly[0]]))]),
        )
    distance = np.linalg.norm(xyz_mm, axis=1)
    wrong = np.flatnonzero((distance < NEAREST_MM) | (distance > FARTHEST_MM))
    if len(wrong):
        problems.error(
            "tracker-distance",
            table.file,
            f"the point is {distance[wrong[0]]:g} mm from the origin, expected {NEAREST_MM:g} to {FARTHEST_MM:g} mm:"
            " x, y, z must be in the tracker's own frame, the tracker in the origin and z along its standing axis.",
            "export the points in the frame of the instrument, not in that of a part or a machine; check the unit.",
            table.rows[wrong].tolist(),
            table.header("x_mm"),
        )


def _rows_are_clear(table: Table, moving: Bools, problems: ProblemList) -> None:
    """A machine point has an axis and a position, a foundation target a name and neither; a station is always named."""
    position = table.numbers["position_mm"]
    for wrong, column, message, fix in (
        (
            moving & np.isnan(position),
            "position_mm",
            "the cell is empty, expected the commanded position of the axis.",
            "fill it in; a foundation target has no axis either.",
        ),
        (
            ~moving & np.isfinite(position),
            "axis",
            "there is a position but no axis.",
            "name the moving axis; where this is a foundation target, leave position_mm empty.",
        ),
        (
            ~moving & np.array([not name for name in table.texts["target"]]),
            "target",
            "a row without an axis is a foundation target, and this one has no name.",
            "name it like F1, the same in every round; or name the moving axis.",
        ),
        (
            np.array([not name for name in table.texts.get("station", (ONE_STATION,) * len(moving))]),
            "station",
            "the cell is empty, expected the name of the station.",
            "name the station in every row, or leave the column out where the tracker was never moved.",
        ),
    ):
        rows = np.flatnonzero(wrong)
        if len(rows):
            problems.error("missing-value", table.file, message, fix, table.rows[rows].tolist(), table.header(column))
    if not moving.any():
        problems.error(
            "missing-value",
            table.file,
            "no row names an axis: there are no machine points.",
            "name the moving axis and its position for every machine point.",
            (),
            table.header("axis"),
        )


def _others_are_known(table: Table, points: SweepPoints, machine: Machine, problems: ProblemList) -> None:
    """The commanded point needs the position of every axis that moves in this campaign."""
    moving = np.array(points.axis)
    resting = []
    for axis in machine.axes:
        elsewhere = moving != axis.name
        if elsewhere.all() and axis.name not in points.at_mm:
            resting.append(axis.name)
            continue
        known = points.at_mm.get(axis.name, np.full(len(moving), np.nan))
        rows = np.flatnonzero(elsewhere & np.isnan(known))
        if len(rows):
            problems.error(
                "missing-value",
                table.file,
                f"the position of axis {axis.name} is not stated while axis {moving[rows[0]]} moves: the commanded"
                " machine point needs the positions of all axes.",
                f"add the column at_{axis.name}_mm and fill it in for every machine point of another axis.",
                table.rows[rows].tolist(),
                table.header(f"at_{axis.name}_mm"),
            )
    if resting:
        problems.warning(
            "at-missing",
            table.file,
            f"the axes {quoted(resting)} have no positions here; they are assumed not to move during the campaign.",
            "add their columns at_<axis>_mm if they moved between the sweeps.",
        )

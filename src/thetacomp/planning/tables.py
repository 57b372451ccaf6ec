"""The tables of a plan: what is planned, and empty tables to fill in, as a machine folder that `check` reads."""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import timedelta

import numpy as np

from thetacomp.planning.foundation import FoundationTarget, standard_um
from thetacomp.planning.setup import Setup
from thetacomp.planning.timetable import COLD_ROUNDS, Block, Timetable, moved_mm, sweep_span_s
from thetacomp.planning.uncertainty import VisibleChange
from thetacomp.table_file import Cell, csv_text, fixed, free_text


def clock(timetable: Timetable, t_s: float) -> str:
    """The planned time of day (ISO 8601, to the minute) where the start is known, else empty."""
    start = timetable.setup.options.start
    return "" if start is None else (start + timedelta(seconds=t_s)).isoformat(timespec="minutes")


def campaign_name(timetable: Timetable) -> str:
    """Folder of the campaign: the day of its start, or `planned`."""
    start = timetable.setup.options.start
    return "planned" if start is None else start.date().isoformat()


def timetable_csv(timetable: Timetable) -> str:
    """One row a stretch of the day, and one a sweep."""
    rows: list[list[Cell]] = []
    for block in timetable.blocks:
        rows.append(_time_row(timetable, block, block.kind, "", block.begin_s, block.end_s))
        if block.kind == "round":
            for axis in timetable.setup.axes:
                rows.append(_time_row(timetable, block, "sweep", axis.name, *sweep_span_s(block, axis.name)))
    return csv_text(["t_begin_s", "t_end_s", "length_min", "time", "part", "what", "round", "axis"], rows)


def _time_row(timetable: Timetable, block: Block, what: str, axis: str, begin_s: float, end_s: float) -> list[Cell]:
    return [
        round(begin_s),
        round(end_s),
        round((end_s - begin_s) / 60.0, 1),
        clock(timetable, begin_s),
        block.part,
        what,
        block.round,
        axis,
    ]


def points_csv(timetable: Timetable, targets: Sequence[FoundationTarget]) -> str:
    """Every planned reading by its name, with the nominal tool point (or foundation target) in the machine's frame."""
    setup = timetable.setup
    places = {target.name: target.at_mm for target in targets}
    names = [axis.name for axis in setup.axes]
    rows: list[list[Cell]] = []
    for point in timetable.points:
        nominal = setup.tool_mm(point.position_mm) if point.axis else places[point.target]
        rows.append(
            [
                point.name,
                "sweep" if point.axis else "foundation",
                point.round,
                point.part,
                fixed(point.t_s, 1),
                point.axis,
                point.target,
                _sign(point.direction),
                *(fixed(point.position_mm[name], 3) for name in names),
                *(fixed(value, 3) for value in nominal),
            ]
        )
    header = ["point", "kind", "round", "part", "t_s", "axis", "target", "direction"]
    return csv_text([*header, *(f"at_{name}_mm" for name in names), "x_mm", "y_mm", "z_mm"], rows)


def tracker_points_csv(timetable: Timetable) -> str:
    """The same readings as the table `tracker_points` of a campaign: it says what the points of a tracker's file are.

    The name in the tracker's file is `point`. `target` is the place that is read: a nest of the foundation, or an axis
    with the number of its position. One station, so there is no column for it.
    """
    names = [axis.name for axis in timetable.setup.axes]
    rows: list[list[Cell]] = [
        [
            fixed(point.t_s, 1),
            point.name,
            f"{point.axis}_{point.target}" if point.axis else point.target,
            point.axis,
            fixed(point.position_mm[point.axis], 3) if point.axis else None,
            _sign(point.direction),
            point.round if point.axis else None,
            *(fixed(point.position_mm[name], 3) if point.axis not in ("", name) else None for name in names),
        ]
        for point in timetable.points
    ]
    header = ["t_s", "point", "target", "axis", "position_mm", "direction", "run"]
    return csv_text([*header, *(f"at_{name}_mm" for name in names)], rows)


def _sign(direction: int) -> str:
    return {1: "+", -1: "-"}.get(direction, "")


def uncertainty_csv(visible_changes: Sequence[VisibleChange]) -> str:
    """What the plan can see, one row a component."""
    header = [
        "component",
        "p0_mm",
        "end_mm",
        "distance_mm",
        "intercept_se_um",
        "slope_se_um_per_m",
        "drift_se_um",
        "end_points_um",
        "end_angle_um",
        "end_tie_um",
        "end_se_um",
        "visible_um",
    ]
    rows = [[row.component, *(round(getattr(row, name), 2) for name in header[1:])] for row in visible_changes]
    return csv_text(header, rows)


def foundation_csv(targets: Sequence[FoundationTarget]) -> str:
    """Proposed places of the foundation targets, and room for the real ones."""
    header = ["target", "x_mm", "y_mm", "z_mm", "real_x_mm", "real_y_mm", "real_z_mm", "remark"]
    return csv_text(header, [[t.name, *(fixed(value, 0) for value in t.at_mm), "", "", "", ""] for t in targets])


def sensors_csv(setup: Setup) -> str:
    """The sensors to commission, and room for what was seen."""
    header = ["sensor", "location", "role", "axis", "zero_reading_degC", "difference_to_median_K"]
    header += ["rise_by_hand_K", "channel_that_rose", "passed", "date_and_name"]
    blank = [""] * 6
    return csv_text(
        header, [[s.id, free_text(s.location), s.role, s.axis or "", *blank] for s in setup.machine.sensors]
    )


# --- the campaign's folder --------------------------------------------------------------------------------------------


def campaign_files(timetable: Timetable) -> dict[str, str]:
    """File name -> text of the campaign's folder, ready to fill in."""
    return {
        "temperatures.csv": csv_text(["t_s", *timetable.setup.machine.sensor_ids], []),
        "sweeps.csv": sweeps_csv(timetable),
        "duty.csv": duty_csv(timetable),
        "campaign.toml": campaign_toml(timetable),
    }


def sweeps_csv(timetable: Timetable) -> str:
    """The planned sweeps with empty errors. Where an axis moves, its position is `position_mm` and nowhere else."""
    names = [axis.name for axis in timetable.setup.axes]
    rows: list[list[Cell]] = [
        [
            fixed(point.t_s, 1),
            point.axis,
            fixed(point.position_mm[point.axis], 3),
            None,
            None,
            None,
            _sign(point.direction),
            point.round,
            *(None if name == point.axis else fixed(point.position_mm[name], 3) for name in names),
        ]
        for point in timetable.points
        if point.axis
    ]
    header = ["t_s", "axis", "position_mm", "dX_um", "dY_um", "dZ_um", "direction", "run"]
    # A single axis has no other axis to write down.
    at = [f"at_{name}_mm" for name in names]
    if len(names) == 1:
        return csv_text(header, [row[: len(header)] for row in rows])
    return csv_text([*header, *at], rows)


def duty_csv(timetable: Timetable) -> str:
    """Planned spindle speed and mean feeds; a row holds until the next."""
    setup, options = timetable.setup, timetable.setup.options
    rows: list[list[Cell]] = []
    for block in timetable.blocks:
        feeds = [
            60.0 * moved_mm(setup, block, axis.name) / block.length_s if block.length_s else 0.0 for axis in setup.axes
        ]
        speed = options.speed_rpm if block.kind == "duty" else 0.0
        rows.append([round(block.begin_s), f"{speed:g}", fixed(sum(feeds), 0), *(fixed(feed, 0) for feed in feeds)])
    rows.append([round(timetable.blocks[-1].end_s), 0, 0, *(0 for _ in setup.axes)])
    header = ["t_s", "spindle_rpm", "feed_mm_min", *(f"feed_{axis.name}_mm_min" for axis in setup.axes)]
    return csv_text(header, rows)


def campaign_toml(timetable: Timetable) -> str:
    """Settings of the campaign as planned, each line saying what to correct after measuring."""
    options = timetable.setup.options
    across_urad = tracker_angle_sd_urad(timetable)
    return (
        'datum = "campaign"\n'
        f"instrument = {_toml_text(options.instrument)}\n"
        f"instrument_u_um = {options.tracker_u_um!r}                # expanded uncertainty (k = 2) of a point\n"
        f"instrument_u_um_per_m = {options.tracker_u_um_per_m!r}\n"
        'compensation = "off"                  # "on" for a verification run\n'
        'active_tables = []                    # what the control compensated meanwhile, like ["pitch", "sag"]\n'
        f"mode = {_toml_text(options.mode)}  # cooling and operating mode; campaigns of different modes are not mixed\n"
        "tool_length_mm = 0.0                  # from the spindle nose to the reflector: write the real one\n"
        f"reference_s = {timetable.reference_s:.0f}"
        f"                    # end of the cold block ({COLD_ROUNDS} rounds), as planned: write the real one\n"
        "\n[tracker]        # only for tracker points: standard deviations of one point, from the stated uncertainty.\n"
        "# Better: read one fixed target fifty times and write the scatter of its distance and angles.\n"
        f"distance_sd_um = {options.tracker_u_um / 2.0!r}\n"
        f"distance_sd_um_per_m = {options.tracker_u_um_per_m / 2.0!r}\n"
        f"horizontal_sd_urad = {across_urad:.2f}\n"
        f"vertical_sd_urad = {across_urad:.2f}\n"
        'columns = ["target", "x", "y", "z"]   # cells of tracker*.txt in order; also "collection", "t_s", "time"\n'
        'unit = "mm"\n'
    )


def tracker_angle_sd_urad(timetable: Timetable) -> float:
    """Standard deviation of an angle that is `(a + b d) / 2` across the beam at the mean distance d of the sweeps."""
    setup = timetable.setup
    distance_mm = np.mean([setup.distance_mm(setup.tool_mm(p.position_mm)) for p in timetable.points if p.axis])
    return standard_um(setup, float(distance_mm)) / (float(distance_mm) / 1000.0)


def _toml_text(text: str) -> str:
    # A JSON string without escapes for letters beyond ASCII is a TOML basic string as well.
    return json.dumps(text, ensure_ascii=False)

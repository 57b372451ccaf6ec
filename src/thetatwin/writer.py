"""Writes virtual campaigns as a machine folder of format 1, and the truth into a folder that no command reads."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from thetacomp import __version__
from thetacomp.arrays import Floats
from thetacomp.errors import AnalysisError
from thetacomp.files import Files, write_files
from thetacomp.outputs import output_folder
from thetacomp.table_file import csv_text, fixed
from thetatwin.campaigns import NEW_YEAR, START_HOUR, CampaignPlan, Record, Twin, run_campaign
from thetatwin.mesh import AXES

_AXIS_DRIFT = -1
_TRUTH_POSITIONS = 25


def truth_folder(folder: Path) -> Path:
    """Where the truth of a machine folder lies: next to it, never inside."""
    return folder.with_name(folder.name + "-truth")


def refuse_filled(folder: Path) -> None:
    """Raise AnalysisError where the folder or its truth folder holds something: nothing is overwritten."""
    for place in (folder, truth_folder(folder)):
        if place.exists() and (not place.is_dir() or any(place.iterdir())):
            raise AnalysisError(f"{place} already exists and is not empty. Fix: name another folder or remove it.")


def write_twin(
    folder: Path, twin: Twin, plans: Sequence[CampaignPlan], pictures: Callable[[Record], Files] = lambda record: {}
) -> tuple[Record, ...]:
    """Run the planned campaigns and write both folders, each whole; `pictures` of the first campaign go to the truth.

    Raises AnalysisError where one of them is not empty, OutputError where one cannot be written.
    """
    refuse_filled(folder)
    with output_folder(folder) as measured, output_folder(truth_folder(folder)) as truth:
        records = [run_campaign(twin, plan) for plan in plans]
        write_machine_folder(measured, twin, records)
        for record in records:
            write_truth(truth / "campaigns" / record.plan.name, twin, record)
        _text(truth / "truth.toml", _truth_toml(twin, records))
        _table(truth / "geometry.csv", *_geometry_table(twin))
        write_files(truth, pictures(records[0]))
    return tuple(records)


def write_machine_folder(folder: Path, twin: Twin, records: Sequence[Record]) -> None:
    """Write machine and measured campaigns, no truth. Raises AnalysisError where the folder is not empty."""
    refuse_filled(folder)
    _text(folder / "machine.toml", _machine_toml(twin))
    for record in records:
        write_campaign(folder / "campaigns" / record.plan.name, twin, record)


def write_campaign(folder: Path, twin: Twin, record: Record, compensation: str = "off") -> None:
    """Write what was measured in one campaign: temperatures, sweeps, drift, duty and settings."""
    axes = twin.machine.description.axes
    truth = record.truth
    ids = [s.id for s in twin.sensors]
    _table(
        folder / "temperatures.csv",
        ["t_s", *ids],
        [_texts(record.temperature_t_s, 0), *(_texts(column, 2) for column in record.temperature_degC.T)],
    )
    seen = np.isfinite(record.measured_um).all(axis=1)
    at = {f"at_{name}_mm": position for name, position in truth.positions_mm.items()}
    error = {f"d{d}_um": record.measured_um[:, k] for k, d in enumerate(AXES)}
    rows = seen & (truth.axis != _AXIS_DRIFT)
    position = np.choose(np.maximum(truth.axis, 0), list(truth.positions_mm.values()))
    _table(
        folder / "sweeps.csv",
        ["t_s", "axis", "position_mm", *error, "direction", "run", *at],
        [
            _texts(truth.t_s[rows], 1),
            [axes[a].name for a in truth.axis[rows]],
            _texts(position[rows], 3),
            *(_texts(e[rows], 1) for e in error.values()),
            ["+" if d > 0 else "-" for d in truth.direction[rows]],
            [str(s) for s in truth.sweep[rows]],
            # Where an axis moves, its position is position_mm and nowhere else.
            *(_texts(np.where(truth.axis == a, np.nan, p)[rows], 3) for a, p in enumerate(at.values())),
        ],
    )
    rows = seen & (truth.axis == _AXIS_DRIFT)
    _table(
        folder / "drift.csv",
        ["t_s", *error, *at],
        [
            _texts(truth.t_s[rows], 1),
            *(_texts(e[rows], 1) for e in error.values()),
            *(_texts(p[rows], 3) for p in at.values()),
        ],
    )
    work = record.work
    feeds = {f"feed_{name}_mm_min": feed * 1000.0 for name, feed in work.feed_m_min.items()}
    _table(
        folder / "duty.csv",
        ["t_s", "spindle_rpm", "feed_mm_min", *feeds, "hydraulics_on", "chiller_on"],
        [
            _texts(record.work_t_s, 0),
            _texts(work.rpm, 0),
            _texts(np.max(list(feeds.values()), axis=0), 0),
            *(_texts(f, 0) for f in feeds.values()),
            _texts(work.on, 0),
            _texts(work.chiller, 0),
        ],
    )
    _text(folder / "campaign.toml", _campaign_toml(twin, record, compensation))


def write_truth(folder: Path, twin: Twin, record: Record) -> None:
    """Write what was true in one campaign: points without instrument, temperatures, drift, slopes and intercepts."""
    axes, truth = twin.machine.description.axes, record.truth
    names = [*(f"d{d}_um" for d in AXES), *(f"r{r}_urad" for r in "ABC")]
    axis = [axes[a].name if a != _AXIS_DRIFT else "" for a in truth.axis]
    _table(
        folder / "points.csv",
        [
            "t_s",
            "axis",
            "direction",
            *(f"at_{a.name}_mm" for a in axes),
            *(f"thermal_{n}" for n in names),
            *(f"geometry_{n}" for n in names),
        ],
        [
            _texts(truth.t_s, 1),
            axis,
            ["+" if d > 0 else "-" for d in truth.direction],
            *(_texts(truth.positions_mm[a.name], 3) for a in axes),
            *(_texts(c, 3) for c in truth.thermal.T),
            *(_texts(c, 3) for c in truth.geometry.T),
        ],
    )
    from_start = record.history.t_s >= record.begin_s - record.lead_s
    t_s = record.history.t_s[from_start]
    _table(
        folder / "temperatures.csv",
        ["t_s", *(s.id for s in twin.sensors)],
        [_texts(t_s - record.begin_s, 0), *(_texts(c, 4) for c in record.history.sensors_degC[from_start].T)],
    )
    middle = {a.name: np.full(len(t_s), 0.5 * sum(a.travel_mm)) for a in axes}
    poses = record.history.poses(twin.machine, t_s)
    drift = twin.machine.tool_error_um(poses, middle, twin.conditions.work.tool_length_mm)
    _table(folder / "drift.csv", ["t_s", *names], [_texts(t_s - record.begin_s, 0), *(_texts(c, 3) for c in drift.T)])
    _table(folder / "components.csv", *_components(twin, record))


def _components(twin: Twin, record: Record) -> tuple[list[str], list[list[str]]]:
    """Slope and intercept of every component at every sweep: best line of the thermal change since the reference.

    `shape_um` is the largest departure of that change from its line over the travel.
    """
    head = ["t_s", "component", "intercept_um", "slope_um_per_m", "p0_mm", "p_min_mm", "p_max_mm", "shape_um"]
    columns: list[list[str]] = [[] for _ in head]
    axes, truth = twin.machine.description.axes, record.truth
    for sweep in np.unique(truth.sweep[truth.axis != _AXIS_DRIFT]):
        own = truth.sweep == sweep
        axis = axes[int(truth.axis[own][0])]
        t_s = float(truth.t_s[own].mean())
        position = np.linspace(*axis.travel_mm, _TRUTH_POSITIONS)
        middle = 0.5 * sum(axis.travel_mm)
        change = _thermal_along(twin, record, axis.name, position, t_s)
        change = change - _thermal_along(twin, record, axis.name, position, record.reference_s)
        design = np.stack([np.ones(len(position)), (position - middle) / 1000.0], axis=1)
        line = np.linalg.lstsq(design, change[:, :3], rcond=None)[0]
        shape = np.abs(change[:, :3] - design @ line).max(axis=0)
        for d, direction in enumerate(AXES):
            figures = (line[0, d], line[1, d], middle, *axis.travel_mm, shape[d])
            for column, text in zip(
                columns, [fixed(t_s, 1), f"E{direction}{axis.name}", *(fixed(x, 3) for x in figures)], strict=True
            ):
                column.append(text)
    return head, columns


def _thermal_along(twin: Twin, record: Record, axis: str, position_mm: Floats, t_s: float) -> Floats:
    n = len(position_mm)
    positions = {a.name: np.full(n, 0.5 * sum(a.travel_mm)) for a in twin.machine.description.axes}
    positions[axis] = position_mm
    poses = np.repeat(record.history.poses(twin.machine, np.array([record.begin_s + t_s])), n, axis=0)
    return twin.machine.tool_error_um(poses, positions, twin.conditions.work.tool_length_mm)


def _geometry_table(twin: Twin) -> tuple[list[str], list[list[str]]]:
    axes = twin.machine.description.axes
    names = [*(f"d{d}_um" for d in AXES), *(f"r{r}_urad" for r in "ABC")]
    columns: list[list[str]] = [[] for _ in range(3 + len(names))]
    for axis in axes:
        for sign in (1, -1):
            position = np.linspace(*axis.travel_mm, 8 * _TRUTH_POSITIONS + 1)
            at = {a.name: np.full(len(position), 0.5 * sum(a.travel_mm)) for a in axes} | {axis.name: position}
            approach = {a.name: np.ones(len(position)) for a in axes} | {axis.name: np.full(len(position), float(sign))}
            error = twin.geometry.error_um(twin.machine.tool, at, approach, twin.conditions.work.tool_length_mm)
            rows = [[axis.name] * len(position), ["+" if sign > 0 else "-"] * len(position), _texts(position, 3)]
            for column, texts in zip(columns, [*rows, *(_texts(e, 3) for e in error.T)], strict=True):
                column.extend(texts)
    return ["axis", "direction", "position_mm", *names], columns


def _machine_toml(twin: Twin) -> str:
    description = twin.machine.description
    out = [
        "format = 1\n\n[machine]",
        _pairs(
            {"name": description.name, "origin": f"virtual machine, preset {twin.conditions.name}, seed {twin.seed}"}
        ),
    ]
    sections = (
        ("axes", description.machine_axes()),
        ("sensors", description.machine_sensors()),
        ("heat_sources", description.machine_heat_sources()),
    )
    for title, items in sections:
        for item in items:
            out += [f"\n[[{title}]]", _pairs(item.model_dump(exclude_none=True))]
    return "\n".join(out) + "\n"


def _campaign_toml(twin: Twin, record: Record, compensation: str) -> str:
    tracker = twin.conditions.tracker
    modes = {"off": "no cooling", "on": "cooling"}
    start = f"{record.plan.name}T{START_HOUR:02d}:00:00"
    return (
        _pairs(
            {
                "datum": "campaign",
                "instrument": tracker.name,
                "instrument_u_um": tracker.u_um,
                "instrument_u_um_per_m": tracker.u_um_per_m,
                "compensation": compensation,
                "mode": modes.get(record.plan.chiller, f"cooling {record.plan.chiller}"),
                "tool_length_mm": twin.conditions.work.tool_length_mm,
                "reference_s": record.reference_s,
                "origin": f"virtual machine, preset {twin.conditions.name}, seed {twin.seed}, {record.plan.kind} duty,"
                f" started {start}",
            }
        )
        + "\n"
    )


def _truth_toml(twin: Twin, records: Sequence[Record]) -> str:
    out = [
        _pairs(
            {
                "thetacomp": __version__,
                "preset": twin.conditions.name,
                "seed": twin.seed,
                "machine": twin.machine.description.name,
                "new_year": NEW_YEAR.isoformat(),
                "thermal_counts_from_degC": twin.machine.description.reference_degC,
            }
        )
    ]
    for sensor in twin.sensors:
        out += ["\n[[sensors]]", _pairs(vars(sensor))]
    for record in records:
        for fault in record.faults:
            out += ["\n[[faults]]", _pairs({"campaign": record.plan.name, **vars(fault)})]
    return "\n".join(out) + "\n"


def _pairs(values: Mapping[str, object]) -> str:
    return "\n".join(f"{key} = {_toml(value)}" for key, value in values.items())


def _toml(value: object) -> str:
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return f'"{escaped}"'
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return repr(value)


def _texts(values: Floats, decimals: int) -> list[str]:
    """Numbers as text, NaN as an empty cell, never "-0"."""
    return [fixed(v + 0.0, decimals) for v in np.round(np.asarray(values, dtype=float), decimals)]


def _table(path: Path, head: Sequence[str], columns: Sequence[Sequence[str]]) -> None:
    _text(path, csv_text(head, zip(*columns, strict=True)))


def _text(path: Path, text: str) -> None:
    write_files(path.parent, {path.name: text})

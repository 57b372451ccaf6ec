"""Writes small valid machine folders for tests. `valid_files` gives the texts, so that a test can spoil one of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from thetacomp.campaign import Campaign, CampaignSettings
from thetacomp.machine import Machine
from thetacomp.reading import read_frames

HOURS = 8
SENSORS = ("theta_1", "theta_2", "theta_3")
POSITIONS_MM = (0, 250, 500, 750, 1000)

MACHINE_TOML = """\
format = 1

[machine]
name = "small mill"

[[axes]]
name = "X"
direction = "+X"
travel_mm = [0.0, 1000.0]
sensor = "theta_1"

[[axes]]
name = "W"
direction = "+Z"
travel_mm = [0.0, 1000.0]

[[sensors]]
id = "theta_1"
location = "X screw nut"
role = "drive"
axis = "X"

[[sensors]]
id = "theta_2"
location = "ram bearing"
role = "bearing"
axis = "W"

[[sensors]]
id = "theta_3"
location = "hall"
role = "ambient"

[[heat_sources]]
name = "X motor"
sensor = "theta_1"
"""

CAMPAIGN_TOML = """\
datum = "campaign"
instrument = "Leica AT901-B"
instrument_u_um = 15.0
mode = "no cooling"
"""

Rows = list[list[Any]]


def small_machine() -> Machine:
    """The machine of MACHINE_TOML."""
    return Machine.model_validate(
        {
            "name": "small mill",
            "axes": [
                {"name": "X", "direction": "+X", "travel_mm": (0, 1000), "sensor": "theta_1"},
                {"name": "W", "direction": "+Z", "travel_mm": (0, 1000)},
            ],
            "sensors": [
                {"id": "theta_1", "location": "X screw nut", "role": "drive", "axis": "X"},
                {"id": "theta_2", "location": "ram bearing", "role": "bearing", "axis": "W"},
                {"id": "theta_3", "location": "hall", "role": "ambient"},
            ],
            "heat_sources": [{"name": "X motor", "sensor": "theta_1"}],
        }
    )


def temperature_rows(scale: float = 1.0) -> Rows:
    """A warm-up with time constants of 2 and 3 h, one row each 10 min, header first. Values have two decimals."""
    t_s = np.arange(0, HOURS * 3600 + 1, 600)
    rise = [15 * scale * (1 - np.exp(-t_s / 7200)), 8 * scale * (1 - np.exp(-t_s / 10800)), 0.3 * t_s / 28800]
    rows: Rows = [["t_s", *SENSORS]]
    for i, t in enumerate(t_s.tolist()):
        rows.append([t, *(round(20.13 + float(column[i]), 2) for column in rise)])
    return rows


def sweep_rows(scale: float = 1.0) -> Rows:
    """Every two hours X, then W, out and back over five positions, a point each 30 s, header first."""
    rows: Rows = [["t_s", "axis", "position_mm", "dX_um", "dY_um", "dZ_um"]]
    for hour in range(0, HOURS, 2):
        for k, axis in enumerate(("X", "W")):
            for i, position in enumerate((*POSITIONS_MM, *reversed(POSITIONS_MM))):
                heat = scale * hour
                error = [5 * heat + heat * position / 100, -2 * heat, 0.5 + heat * position / 400]
                values = [round(value + 0.25, 2) for value in error]
                rows.append([hour * 3600 + k * 600 + 30 * i, axis, position, *values])
    return rows


def drift_rows() -> Rows:
    """Drift of the tool at a fixed position, one row each 20 min, header first."""
    rows: Rows = [["t_s", "dX_um", "dY_um", "dZ_um"]]
    for t in range(0, HOURS * 3600 + 1, 1200):
        rows.append([t, round(t / 2000 + 0.1, 2), round(-t / 5000 - 0.1, 2), round(t / 1000 + 0.3, 2)])
    return rows


def parameter_rows() -> Rows:
    """Already separated lines of two components, header first."""
    rows: Rows = [["t_h", "component", "intercept_um", "slope_um_per_m", "p0_mm", "p_min_mm", "p_max_mm"]]
    for component, factor in (("EXX", 1.5), ("EYX", -0.5)):
        for hour in range(HOURS):
            rows.append([hour, component, round(hour * factor * 10.5, 2), round(hour * factor, 2), 0, 0, 1000])
    return rows


def duty_rows() -> Rows:
    """Spindle speed and feed, header first."""
    return [["t_s", "spindle_rpm", "feed_mm_min"], [0, 0, 0], [600, 650, 1000], [14400, 650, 1000], [14460, 0, 0]]


def csv_text(rows: Sequence[Sequence[object]], delimiter: str = ",", decimal: str = ".") -> str:
    """Rows as the text of a CSV file; None is an empty cell."""
    lines = [delimiter.join("" if cell is None else _cell(cell, decimal) for cell in row) for row in rows]
    return "\n".join(lines) + "\n"


def _cell(value: object, decimal: str) -> str:
    return str(value).replace(".", decimal) if isinstance(value, float) else str(value)


def valid_files(campaigns: Sequence[str] = ("2026-03-02", "2026-03-09")) -> dict[str, str]:
    """Path inside the folder -> text, of a folder without any problem."""
    files = {"machine.toml": MACHINE_TOML}
    for number, name in enumerate(campaigns):
        scale = 1.0 + 0.2 * number
        files |= {
            f"campaigns/{name}/temperatures.csv": csv_text(temperature_rows(scale)),
            f"campaigns/{name}/sweeps.csv": csv_text(sweep_rows(scale)),
            f"campaigns/{name}/drift.csv": csv_text(drift_rows()),
            f"campaigns/{name}/duty.csv": csv_text(duty_rows()),
            f"campaigns/{name}/campaign.toml": CAMPAIGN_TOML,
        }
    return files


def write_files(root: Path, files: Mapping[str, str | bytes]) -> Path:
    """Write texts (UTF-8) or bytes below `root`, and return it."""
    for name, content in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return root


def small_folder(root: Path) -> Path:
    """A valid machine folder with two campaigns of sweeps, drift and duty."""
    return write_files(root, valid_files())


def campaign_of_frames(
    machine: Machine, name: str, *, settings: CampaignSettings | None = None, **tables: Any
) -> Campaign:
    """One campaign from tables in memory."""
    return read_frames(machine, {name: tables}, {name: settings} if settings else None).campaign(name)


def write_xlsx(path: Path, sheets: Mapping[str, Sequence[Sequence[object]]]) -> Path:
    """A real workbook, a sheet for each table."""
    import openpyxl

    book = openpyxl.Workbook()
    book.remove(book.worksheets[0])
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append(list(row))
    path.parent.mkdir(parents=True, exist_ok=True)
    book.save(path)
    return path

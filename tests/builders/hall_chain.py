"""A plan measured in a simulated hall: heat follows the duty, and a tracker that sinks reads the planned points.

Known truth for the whole chain plan -> measure -> analyze -> verify. What the machine does with heat is a lagged
response of its duty, the temperatures are another; no formula of the analysis is used to make it.
"""

from __future__ import annotations

import csv
import io
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from simulated_hall import INSTRUMENT, Stand, instrument_noise_mm

from thetacomp.machine import Axis, Machine, Sensor
from thetacomp.model.document import ModelDocument
from thetacomp.model.temperatures import Duty, Temperatures
from thetacomp.model.volumetric import VolumePrediction, predict_volume
from thetacomp.planning.options import PlanOptions
from thetacomp.tracker.rigid import rotation_matrix

Floats = NDArray[np.float64]
Positions = Mapping[str, Floats]

MACHINE = Machine(
    name="hall mill",
    axes=(
        Axis(name="X", direction="+X", travel_mm=(0.0, 1500.0)),
        Axis(name="Y", direction="+Y", travel_mm=(0.0, 1200.0)),
        Axis(name="W", direction="+Z", travel_mm=(0.0, 600.0)),
    ),
    sensors=(
        Sensor(id="tx", role="drive", axis="X", location="X screw nut"),
        Sensor(id="ty", role="drive", axis="Y", location="Y screw nut"),
        Sensor(id="tw", role="drive", axis="W", location="W screw nut"),
        Sensor(id="ts", role="bearing", location="front bearing of the spindle"),
        Sensor(id="ta", role="ambient", location="hall"),
    ),
)
P0_MM = {axis.name: float(np.mean(axis.travel_mm)) for axis in MACHINE.axes}
SOURCES = ("X", "Y", "W", "spindle")
PLANNED = PlanOptions(
    points=5, duration_h=5.0, cool_h=2.0, interval_min=45.0, mode="no cooling", instrument="simulated tracker",
    tracker_u_um=5.0, tracker_u_um_per_m=3.0, tracker_at_mm=(-1500.0, 400.0, 3200.0),
)  # fmt: skip
PLAN_ARGUMENTS = (
    "--points", "5", "--duration-h", "5", "--cool-h", "2", "--interval-min", "45", "--mode", "no cooling",
    "--instrument", "simulated tracker", "--tracker-u-um", "5", "--tracker-u-um-per-m", "3",
    "--tracker-at", "-1500,400,3200",
)  # fmt: skip
STAND = Stand(np.array([-1500.0, 400.0, 3200.0]), (0.01, 0.6, -0.015))
SINKING_UM, TILT_URAD = 40.0, 4.0
OFFSET_K = 0.3
NOISE_K = 0.02


@dataclass(frozen=True)
class HeatedMachine:
    """Known truth. Per unit of the lagged heat of each source (4): drift (3, 4) µm, slopes (3, 4) µm/m for each axis.

    `turn` (4,) is the angle about X that the guide of Y twists by, µrad/m: it acts over the arm of the ram.
    `sensor_tau_s`, `body_tau_s` (4,) are the lags of the thermometers and, behind them, of the deformation.
    """

    drift: Floats
    slopes: Mapping[str, Floats]
    turn: Floats
    geometry: Mapping[str, Floats]
    sensor_tau_s: Floats
    body_tau_s: Floats

    def thermal_um(self, day: Day, t_s: Floats, at_mm: Positions) -> Floats:
        """True thermal error (n, 3)."""
        heat = np.stack([np.interp(t_s, day.clock_s, day.body[:, k]) for k in range(len(SOURCES))], axis=1)
        error = heat @ self.drift.T
        for name, slope in self.slopes.items():
            error += (heat @ slope.T) * ((at_mm[name] - P0_MM[name]) / 1000.0)[:, None]
        turned_urad = heat @ self.turn * (at_mm["Y"] - P0_MM["Y"]) / 1000.0
        error[:, 1] -= turned_urad * (at_mm["W"] - P0_MM["W"]) / 1000.0
        return error

    def geometry_um(self, at_mm: Positions) -> Floats:
        """Error of the cold machine (n, 3)."""
        out = np.zeros((len(at_mm["X"]), 3))
        for name, (tilt, bow) in self.geometry.items():
            s = (at_mm[name] - P0_MM[name]) / 1000.0
            out += np.outer(s, tilt) + np.outer(s**2, bow)
        return out


def draw_machine(rng: np.random.Generator) -> HeatedMachine:
    """A drift of some 150 µm, slopes of some 100 µm/m, a twist of some µrad/m at full heat."""
    own = {"X": 0, "Y": 1, "W": 2}
    slopes = {}
    for name, k in own.items():
        slope = rng.normal(0.0, 15.0, (3, 4))
        slope[:, k] += rng.choice([-1.0, 1.0], 3) * rng.uniform(60.0, 120.0, 3)
        slopes[name] = slope
    return HeatedMachine(
        drift=rng.choice([-1.0, 1.0], (3, 1)) * rng.uniform(20.0, 70.0, (3, 4)),
        slopes=slopes,
        turn=rng.normal(0.0, 2.0, 4),
        geometry={name: rng.normal(0.0, 12.0, (2, 3)) for name in own},
        sensor_tau_s=rng.uniform(2500.0, 4500.0, 4),
        body_tau_s=rng.uniform(1200.0, 3600.0, 4),
    )


@dataclass(frozen=True)
class Day:
    """One day's heat on a clock: duty (n, 4) as a share of full heat, and the lagged heat of sensors and body."""

    clock_s: Floats
    duty: Floats
    sensor: Floats
    body: Floats
    hall_K: Floats


def make_day(machine: HeatedMachine, plan: Path, share: Mapping[str, float], rng: np.random.Generator) -> Day:
    """The planned duty, with feeds and speed times `share` (by source)."""
    rows = table(campaign_of(plan) / "duty.csv")
    clock = np.arange(0.0, float(rows[-1]["t_s"]) + 1.0, 60.0)
    held = np.searchsorted([float(row["t_s"]) for row in rows], clock, side="right") - 1
    columns = [*(f"feed_{name}_mm_min" for name in "XYW"), "spindle_rpm"]
    value = np.array([[float(row[column]) for column in columns] for row in rows])
    duty = (value / value.max(axis=0))[held] * [share[name] for name in SOURCES]
    sensor = lagged(duty, machine.sensor_tau_s)
    hall = 0.4 * np.sin(2 * np.pi * clock / 86400.0 + rng.uniform(0.0, 2 * np.pi))
    return Day(clock, duty, sensor, lagged(sensor, machine.body_tau_s), hall - hall[0])


def lagged(value: Floats, tau_s: Floats, step_s: float = 60.0) -> Floats:
    """First-order lag of every column, at rest in the beginning."""
    keep = np.exp(-step_s / tau_s)
    out = np.zeros_like(value)
    for i in range(1, len(value)):
        out[i] = keep * out[i - 1] + (1 - keep) * value[i - 1]
    return out


def measure(
    root: Path,
    name: str,
    plan: Path,
    machine: HeatedMachine,
    day: Day,
    rng: np.random.Generator,
    *,
    model: ModelDocument | None = None,
    offset_K: float = OFFSET_K,
    sinking_um: float = SINKING_UM,
    strength: float = 1.0,
) -> Path:
    """Measure the planned points on one day and fill in the campaign's folder that the plan made.

    With `model` the machine is corrected by minus `strength` times its prediction, made from the temperatures read.
    """
    path = root / "campaigns" / name
    shutil.copytree(campaign_of(plan), path)
    (path / "sweeps.csv").unlink()
    shutil.copy(plan / "tracker_points.csv", path)
    write_temperatures(path, day, rng, offset_K)
    write_duty(path, plan, day)
    write_settings(path, model is not None)
    points = table(plan / "points.csv")
    t_s = np.array([float(row["t_s"]) for row in points]) + rng.uniform(-2.0, 2.0, len(points))
    at_mm = {a.name: np.array([float(row[f"at_{a.name}_mm"]) for row in points]) for a in MACHINE.axes}
    moving = np.array([row["kind"] == "sweep" for row in points])
    where = np.array([[float(row[f"{c}_mm"]) for c in "xyz"] for row in points])
    error = machine.geometry_um(at_mm) + machine.thermal_um(day, t_s, at_mm)
    if model is not None:
        error -= strength * predicted(model, path, t_s, at_mm).error_um
    where[moving] += 1e-3 * error[moving]
    seen = instrument_noise_mm(rng, _in_tracker(where, t_s / day.clock_s[-1], sinking_um), INSTRUMENT)
    order = np.argsort(t_s, kind="stable")
    lines = [f"{points[i]['point']}, " + ", ".join(f"{v:.5f}" for v in seen[i]) + f", {t_s[i]:.1f}" for i in order]
    (path / "tracker.txt").write_text("// point, x, y, z, seconds\n" + "\n".join(lines) + "\n", encoding="utf-8")
    return path


def predicted(model: ModelDocument, path: Path, t_s: Floats, at_mm: Positions) -> VolumePrediction:
    """What a compensator would predict from the temperatures of the run alone."""
    log, work = table(path / "temperatures.csv"), table(path / "duty.csv")
    heat = Temperatures(
        np.array([float(row["t_s"]) for row in log]),
        MACHINE.sensor_ids,
        np.array([[float(row[s]) for s in MACHINE.sensor_ids] for row in log]),
    )
    columns = [c for c in work[0] if c != "t_s"]
    duty = Duty(np.array([float(r["t_s"]) for r in work]), {c: np.array([float(r[c]) for r in work]) for c in columns})
    reference_s = float(re.search(r"reference_s = (\d+)", (path / "campaign.toml").read_text("utf-8"))[1])
    return predict_volume(model, heat, t_s, at_mm, reference=reference_s, duty=duty)


def write_temperatures(path: Path, day: Day, rng: np.random.Generator, offset_K: float) -> None:
    """The log below the header of the plan: rises of the drives and the spindle, all read `offset_K` too high."""
    header = (path / "temperatures.csv").read_text("utf-8").strip()
    assert header.split(",") == ["t_s", *MACHINE.sensor_ids]
    full_K = np.array([9.0, 8.0, 10.0, 14.0])
    degC = 20.0 + np.column_stack([day.sensor * full_K, np.zeros(len(day.clock_s))]) + day.hall_K[:, None]
    degC = degC[::2] + offset_K + rng.normal(0.0, NOISE_K, degC[::2].shape)
    rows = [f"{t:.0f}," + ",".join(f"{v:.3f}" for v in row) for t, row in zip(day.clock_s[::2], degC, strict=True)]
    (path / "temperatures.csv").write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")


def write_duty(path: Path, plan: Path, day: Day) -> None:
    """The planned duty, corrected to what was really done."""
    rows = table(campaign_of(plan) / "duty.csv")
    columns = [*(f"feed_{name}_mm_min" for name in "XYW"), "spindle_rpm"]
    full = {c: max(float(row[c]) for row in rows) for c in columns}
    done = [day.duty[min(round(float(row["t_s"]) / 60.0) + 1, len(day.clock_s) - 1)] for row in rows]
    for row, value in zip(rows, done, strict=True):
        row |= {c: f"{full[c] * v:.0f}" for c, v in zip(columns, value, strict=True)}
        row["feed_mm_min"] = f"{sum(float(row[c]) for c in columns[:3]):.0f}"
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    (path / "duty.csv").write_text(text.getvalue(), encoding="utf-8")


def write_settings(path: Path, on: bool) -> None:
    """campaign.toml as the plan wrote it, with the tracker's scatter as it was found, and its cells."""
    text = (path / "campaign.toml").read_text("utf-8")
    for key in ("distance_sd_um", "distance_sd_um_per_m", "horizontal_sd_urad", "vertical_sd_urad"):
        text, count = re.subn(rf"(?m)^{key} = \S+", f"{key} = {getattr(INSTRUMENT, key)}", text)
        assert count == 1, key
    text = text.replace('"target", "x", "y", "z"]', '"target", "x", "y", "z", "t_s"]')
    if on:
        text = text.replace('compensation = "off"', 'compensation = "on"')
        text = text.replace("active_tables = []", 'active_tables = ["temperature"]')
    (path / "campaign.toml").write_text(text, encoding="utf-8")


def _in_tracker(where_mm: Floats, share: Floats, sinking_um: float) -> Floats:
    """Points in the frame of the tracker, which sinks and tilts evenly; `share` (n,) of the day has passed."""
    out = np.empty_like(where_mm)
    for i, (point, part) in enumerate(zip(where_mm, share, strict=True)):
        tilt = rotation_matrix(np.array([TILT_URAD, 0.0, -0.5 * TILT_URAD]) * 1e-6 * part * (sinking_um != 0))
        shift = np.array([0.0, -sinking_um, 0.0]) * 1e-3 * part
        out[i] = (tilt @ STAND.rotation()).T @ (point - STAND.at_mm - shift)
    return out


def campaign_of(plan: Path) -> Path:
    """The campaign's folder that the plan made."""
    return plan / "machine_folder" / "campaigns" / "planned"


def table(path: Path) -> list[dict[str, str]]:
    """A CSV file row by row."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def machine_toml() -> str:
    """MACHINE as its file."""
    text = f'format = 1\n\n[machine]\nname = "{MACHINE.name}"\n'
    for axis in MACHINE.axes:
        text += (
            f'\n[[axes]]\nname = "{axis.name}"\ndirection = "{axis.direction}"\ntravel_mm = {list(axis.travel_mm)}\n'
        )
    for sensor in MACHINE.sensors:
        text += f'\n[[sensors]]\nid = "{sensor.id}"\nrole = "{sensor.role}"\nlocation = "{sensor.location}"\n'
        text += f'axis = "{sensor.axis}"\n' if sensor.axis else ""
    return text


def draw_share(rng: np.random.Generator, low: float = 0.4) -> dict[str, float]:
    """A duty of its own: `low` to 1 of each source."""
    return {name: float(rng.uniform(low, 1.0)) for name in SOURCES}

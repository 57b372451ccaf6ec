"""A machine in a hall, seen by a laser tracker that stands askew, sinks and turns: known truth for the tests.

The machine has X, Y (upwards), Z and, along the same direction as Z, the ram W. Every round measures the foundation
targets, one sweep of X, Y and W out and back, and the foundation targets again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thetacomp.campaign import Campaign, CampaignSettings, SweepPoints, TrackerSettings
from thetacomp.machine import Axis, Machine, Sensor
from thetacomp.model.temperatures import Temperatures
from thetacomp.tracker import Foundation, to_machine_frame
from thetacomp.tracker.rigid import rotation_matrix

Floats = NDArray[np.float64]

MACHINE = Machine(
    name="hall",
    axes=(
        Axis(name="X", direction="+X", travel_mm=(0.0, 4000.0)),
        Axis(name="Y", direction="+Y", travel_mm=(0.0, 2000.0)),
        Axis(name="Z", direction="-Z", travel_mm=(0.0, 800.0)),
        Axis(name="W", direction="+Z", travel_mm=(0.0, 1000.0)),
    ),
    sensors=(Sensor(id="t1", role="drive", axis="Y"),),
)
SWEPT = ("X", "Y", "W")
# Sharp along the beam, poor across it: what makes the weights matter.
INSTRUMENT = TrackerSettings(distance_sd_um=2.0, distance_sd_um_per_m=0.3, horizontal_sd_urad=1.2, vertical_sd_urad=1.5)
# On the floor round the machine, in machine coordinates (mm); Y points up.
TARGETS_MM = {
    "F1": (-900.0, -700.0, 1500.0),
    "F2": (1200.0, -720.0, 2400.0),
    "F3": (4900.0, -690.0, 1700.0),
    "F4": (5200.0, -250.0, -600.0),
    "F5": (-1100.0, -400.0, -900.0),
}
TRACKER_MM = np.array([-2600.0, 500.0, 3900.0])
SLOPE_UM_PER_M = {
    "X": (30.0, -12.0, 8.0),
    "Y": (-60.0, 25.0, 40.0),
    "W": (10.0, -20.0, 35.0),
}
DRIFT_UM = np.array([60.0, 110.0, -80.0])
TIME_CONSTANT_S = 2.5 * 3600.0
DAY_S = 8 * 3600.0


@dataclass(frozen=True)
class Hall:
    """What was measured, and the truth: errors of the machine (n, 3) at the machine points."""

    points: SweepPoints
    xyz_mm: Floats
    foundation: Foundation
    truth_um: Floats
    reference_s: float
    settings: TrackerSettings = INSTRUMENT

    def errors(self):
        """The product's own way from tracker points to errors."""
        return to_machine_frame(MACHINE, self.points, self.xyz_mm, self.foundation, self.settings, self.reference_s)

    def campaign(self) -> Campaign:
        """The measured campaign, as reading makes it."""
        points, tie, _ = self.errors()
        clock = np.arange(0.0, self.points.t_s[-1] + 300.0, 300.0)
        heat = 20.0 + 10.0 * warmth(clock, self.reference_s)[:, None]
        settings = CampaignSettings(tracker=self.settings, reference_s=self.reference_s)
        return Campaign("day", settings, Temperatures(clock, ("t1",), heat), points, tracker=tie)


def warmth(t_s: Floats, reference_s: float) -> Floats:
    return 1.0 - np.exp(-np.maximum(t_s - reference_s, 0.0) / TIME_CONSTANT_S)


def thermal_um(t_s: Floats, at_mm: dict[str, Floats], reference_s: float) -> Floats:
    """True thermal error (n, 3): drift, and a slope for every axis about the middle of its travel."""
    error = np.tile(DRIFT_UM, (len(t_s), 1))
    for name, slope in SLOPE_UM_PER_M.items():
        error = error + np.outer((at_mm[name] - np.mean(MACHINE.axis(name).travel_mm)) / 1000.0, slope)
    return error * warmth(t_s, reference_s)[:, None]


def instrument_noise_mm(rng: np.random.Generator, xyz_mm: Floats, settings: TrackerSettings) -> Floats:
    """Points as the tracker reads them: distance and both angles disturbed, then turned into x, y, z again."""
    x, y, z = xyz_mm.T
    distance, azimuth, height = np.linalg.norm(xyz_mm, axis=1), np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))
    distance = distance + 1e-3 * rng.normal(size=len(x)) * (
        settings.distance_sd_um + settings.distance_sd_um_per_m * distance / 1000.0
    )
    azimuth = azimuth + 1e-6 * settings.horizontal_sd_urad * rng.normal(size=len(x))
    height = height + 1e-6 * settings.vertical_sd_urad * rng.normal(size=len(x))
    return np.column_stack(
        [
            distance * np.cos(height) * np.cos(azimuth),
            distance * np.cos(height) * np.sin(azimuth),
            distance * np.sin(height),
        ]
    )


@dataclass(frozen=True)
class Stand:
    """Where a tracker stands: its axes turned by `turn_rad` against the machine, then standing upright along Y."""

    at_mm: Floats
    turn_rad: tuple[float, float, float]

    def rotation(self) -> Floats:
        upright = rotation_matrix(np.array([-np.pi / 2, 0.0, 0.0]))  # the tracker's z points along machine Y
        return rotation_matrix(np.array(self.turn_rad)) @ upright


STAND = Stand(TRACKER_MM, (0.01, 0.6, -0.015))
OTHER_STAND = Stand(np.array([6300.0, 700.0, 3300.0]), (-0.02, -1.1, 0.01))


def measured_hall(
    rng: np.random.Generator,
    *,
    rounds: int = 9,
    targets: int = 11,
    sinking_um: float = 40.0,
    tilt_urad: float = 6.0,
    noise: bool = True,
    stations: dict[int, str] | None = None,
    moved_target: tuple[str, float, float] | None = None,
    bump_um: float = 0.0,
    scale_um_per_m: float = 0.0,
    foundation_names: tuple[str, ...] = tuple(TARGETS_MM),
    swept: tuple[str, ...] = SWEPT,
    geometry_um: float = 0.0,
    settings: TrackerSettings = INSTRUMENT,
) -> Hall:
    """One day. The tracker sinks by `sinking_um` over eight hours, evenly, and tilts by `tilt_urad`.

    `stations` maps the number of a round to the name of the station from then on ("B" stands at OTHER_STAND).
    `moved_target` is (name, µm upwards, from this time on). `bump_um` shifts the tracker along X in the middle of the
    sweeps of round 4. `geometry_um` bends the cold machine.
    """
    rows: list[tuple[float, str, str, str, int, int, Floats]] = []  # t, station, axis or target, kind, run, direction
    now, bumped_s, reference_s, label = 0.0, np.inf, 0.0, "A"
    middle = {axis.name: float(np.mean(axis.travel_mm)) for axis in MACHINE.axes}
    for k in range(rounds):
        label = (stations or {}).get(k, label)
        now = max(now, k * DAY_S / max(rounds - 1, 1))
        for part in ("before", "sweeps", "after"):
            if part != "sweeps":
                for name in foundation_names:
                    x, y, z = TARGETS_MM[name]
                    rows.append((now, label, name, "target", k, 0, np.array([x, y, -z, 0.0])))
                    now += 20.0
                continue
            for axis in swept:
                stops = np.linspace(*MACHINE.axis(axis).travel_mm, targets)
                for direction, way in ((1, stops), (-1, stops[::-1])):
                    for p in way:
                        at = {**middle, axis: float(p)}
                        rows.append((now, label, axis, "machine", 10 * k + SWEPT.index(axis), direction, _vector(at)))
                        now += 15.0
                if k == 4 and axis == "X":
                    bumped_s = now - 7.0 if bump_um else np.inf
            if k == 0:
                reference_s = rows[-1][0]
    t_s = np.array([row[0] for row in rows])
    machine = np.array([row[3] == "machine" for row in rows])
    at_mm = {axis.name: np.array([row[6][i] for row in rows]) for i, axis in enumerate(MACHINE.axes)}
    where = np.column_stack([at_mm["X"], at_mm["Y"], at_mm["W"] - at_mm["Z"]])
    truth = thermal_um(t_s, at_mm, reference_s)
    truth[:, 0] += geometry_um * np.sin(np.pi * at_mm["Y"] / 2000.0) ** 2
    where[machine] = where[machine] * (1.0 + 1e-6 * scale_um_per_m) + 1e-3 * truth[machine]
    if moved_target is not None:
        name, shift, since = moved_target
        where[np.array([row[2] == name for row in rows]) & (t_s >= since), 1] += 1e-3 * shift
    xyz = _seen(rng, where, t_s, [row[1] for row in rows], sinking_um, tilt_urad, bump_um, bumped_s, noise, settings)
    chosen = [row for row, is_machine in zip(rows, machine, strict=True) if is_machine]
    run = np.array([row[4] for row in chosen])
    names = tuple(row[2] for row in chosen)
    points = SweepPoints(
        t_s=t_s[machine],
        axis=names,
        sweep=np.searchsorted(np.unique(run), run).astype(np.int64),
        position_mm=np.array([at_mm[name][machine][i] for i, name in enumerate(names)]),
        direction=np.array([row[5] for row in chosen], dtype=np.int64),
        error_um=np.full((len(chosen), 3), np.nan),
        station=tuple(row[1] for row in chosen),
        at_mm={
            axis.name: np.where(np.array(names) == axis.name, np.nan, at_mm[axis.name][machine])
            for axis in MACHINE.axes
        },
    )
    rest = [row for row in rows if row[3] == "target"]
    foundation = Foundation(t_s[~machine], tuple(row[1] for row in rest), tuple(row[2] for row in rest), xyz[~machine])
    return Hall(points, xyz[machine], foundation, truth[machine], reference_s, settings)


def _vector(at: dict[str, float]) -> Floats:
    return np.array([at[axis.name] for axis in MACHINE.axes])


def _seen(rng, where, t_s, stations, sinking_um, tilt_urad, bump_um, bumped_s, noise, settings) -> Floats:
    """Points in the frame of the tracker that saw them, at the place where it was at that moment."""
    out = np.empty_like(where)
    for i, (point, t, name) in enumerate(zip(where, t_s, stations, strict=True)):
        stand = OTHER_STAND if name == "B" else STAND
        shift = np.array([bump_um * (t > bumped_s), -sinking_um * t / DAY_S, 0.0]) * 1e-3
        tilt = rotation_matrix(np.array([tilt_urad, 0.0, -0.5 * tilt_urad]) * 1e-6 * t / DAY_S)
        out[i] = (tilt @ stand.rotation()).T @ (point - stand.at_mm - shift)
    return instrument_noise_mm(rng, out, settings) if noise else out


def machine_toml() -> str:
    """MACHINE as its file."""
    text = 'format = 1\n\n[machine]\nname = "hall"\n'
    for axis in MACHINE.axes:
        text += (
            f'\n[[axes]]\nname = "{axis.name}"\ndirection = "{axis.direction}"\ntravel_mm = {list(axis.travel_mm)}\n'
        )
    return text + '\n[[sensors]]\nid = "t1"\nrole = "drive"\naxis = "Y"\n'


def campaign_toml(hall: Hall, more: str = "") -> str:
    """Settings of the campaign with the section [tracker]."""
    s = hall.settings
    return (
        f"reference_s = {hall.reference_s}\n\n[tracker]\ndistance_sd_um = {s.distance_sd_um}\n"
        f"distance_sd_um_per_m = {s.distance_sd_um_per_m}\nhorizontal_sd_urad = {s.horizontal_sd_urad}\n"
        f"vertical_sd_urad = {s.vertical_sd_urad}\n{more}"
    )


def tracker_rows(hall: Hall) -> list[list[object]]:
    """Rows of tracker.csv in order of time, header first."""
    names = [axis.name for axis in MACHINE.axes]
    p, f = hall.points, hall.foundation
    assert p.station is not None
    rows: list[list[object]] = []
    for i, axis in enumerate(p.axis):
        at = [None if name == axis else float(p.at_mm[name][i]) for name in names]
        sign = "+" if p.direction[i] > 0 else "-"
        xyz = [f"{value:.5f}" for value in hall.xyz_mm[i]]
        target = f"{axis}{i:04d}"
        rows.append([float(p.t_s[i]), p.station[i], target, *xyz, axis, float(p.position_mm[i]), *at, sign, p.sweep[i]])
    for i, target in enumerate(f.target):
        xyz = [f"{value:.5f}" for value in f.xyz_mm[i]]
        rows.append([float(f.t_s[i]), f.station[i], target, *xyz, None, None, *[None] * len(names), None, None])
    header: list[object] = ["t_s", "station", "target", "x_mm", "y_mm", "z_mm", "axis", "position_mm"]
    header += [f"at_{name}_mm" for name in names] + ["direction", "run"]
    return [header, *sorted(rows, key=lambda row: float(str(row[0])))]


def temperature_text(hall: Hall, warmer_K: float = 10.0) -> str:
    """temperatures.csv that follows the true warmth."""
    clock = np.arange(0.0, hall.points.t_s[-1] + 600.0, 300.0)
    lines = [f"{t:.0f},{20.0 + warmer_K * w:.3f}" for t, w in zip(clock, warmth(clock, hall.reference_s), strict=True)]
    return "t_s,t1\n" + "\n".join(lines) + "\n"

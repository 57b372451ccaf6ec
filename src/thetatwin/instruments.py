"""What the instruments make of the truth: Pt100 thermometers and a laser tracker."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from thetacomp.arrays import Floats, Ints
from thetatwin.conditions import Pt100, Tracker
from thetatwin.kinematics import carry_pose
from thetatwin.operation import STEP_S, History

FAULTS = ("jump", "stuck", "detached", "noisy", "dead")


@dataclass(frozen=True)
class SensorTruth:
    """One thermometer as it was mounted: it stays so over all campaigns."""

    id: str
    offset_K: float
    air_share: float
    lag_s: float


@dataclass(frozen=True)
class Fault:
    """A fault of one thermometer: from `t_s` on it reads wrong. `size_K` belongs to a jump."""

    sensor: str
    kind: str
    t_s: float
    size_K: float


def mount_sensors(rng: np.random.Generator, ids: Sequence[str], settings: Pt100) -> tuple[SensorTruth, ...]:
    """Draw offset, air share and lag of every thermometer."""
    return tuple(
        SensorTruth(
            name,
            float(rng.normal() * settings.offset_sd_K),
            float(rng.uniform(*settings.air_share)),
            float(np.exp(rng.uniform(*np.log(settings.lag_s)))),
        )
        for name in ids
    )


def draw_faults(rng: np.random.Generator, ids: Sequence[str], settings: Pt100, length_s: float) -> tuple[Fault, ...]:
    """Draw which thermometers fail during a campaign, how and when."""
    out = []
    for name in ids:
        if rng.random() < settings.fault_probability:
            kind = FAULTS[int(rng.integers(len(FAULTS)))]
            size = float(rng.choice([-1.0, 1.0]) * rng.uniform(2.0, 31.0))
            out.append(Fault(name, kind, float(rng.uniform(0.1, 0.9) * length_s), size))
    return tuple(out)


def read_sensors(
    rng: np.random.Generator,
    history: History,
    sensors: Sequence[SensorTruth],
    faults: Sequence[Fault],
    settings: Pt100,
    begin_s: float,
) -> tuple[Floats, Floats]:
    """Times from `begin_s` on (n,), counted from there, and readings (n, sensors) in °C, NaN where lost."""
    readings = np.empty_like(history.sensors_degC)
    for j, sensor in enumerate(sensors):
        share = np.full(len(history.t_s), sensor.air_share)
        for fault in faults:
            if fault.sensor == sensor.id and fault.kind == "detached":
                share[history.t_s >= begin_s + fault.t_s] = 0.7
        felt = (1 - share) * history.sensors_degC[:, j] + share * history.air_degC[:, j]
        keep = np.exp(-STEP_S / sensor.lag_s)
        readings[:, j], _ = lfilter([1 - keep], [1.0, -keep], felt, zi=np.array([keep * felt[0]]))
        readings[:, j] += sensor.offset_K
    t_s = np.arange(begin_s, history.t_s[-1] + 1e-6, settings.sample_s)
    out = np.stack([np.interp(t_s, history.t_s, readings[:, j]) for j in range(len(sensors))], axis=1)
    out += rng.normal(size=out.shape) * settings.noise_K
    t_s = t_s - begin_s
    for fault in faults:
        _break(rng, out[:, [s.id for s in sensors].index(fault.sensor)], t_s >= fault.t_s, fault)
    if settings.resolution_K > 0:
        out = np.round(out / settings.resolution_K) * settings.resolution_K
    lost = rng.random(out.shape) < settings.missing
    return t_s, np.where(lost, np.nan, out)


def _break(rng: np.random.Generator, reading: Floats, broken: NDArray[np.bool_], fault: Fault) -> None:
    if not broken.any():
        return
    if fault.kind == "jump":
        reading[broken] += fault.size_K
    elif fault.kind == "stuck":
        reading[broken] = reading[broken][0]
    elif fault.kind == "noisy":
        reading[broken] += rng.normal(size=int(broken.sum())) * abs(fault.size_K) * 0.1
    elif fault.kind == "dead":
        reading[broken] = np.nan


@dataclass(frozen=True)
class TrackerDay:
    """What stays the same for one set-up of the tracker: offset (3,) µm and gradient (3, 3) µm/m of its error."""

    offset_um: Floats
    gradient_um_per_m: Floats


def set_up_tracker(rng: np.random.Generator, tracker: Tracker, middle_m: Floats) -> TrackerDay:
    """Draw the part of the uncertainty that a set-up keeps all day; 2 m is the usual half of a working volume."""
    distance = float(np.linalg.norm(middle_m - np.array(tracker.at_mm) * 1e-3))
    sd = _standard_um(tracker, distance) * np.sqrt(1 - tracker.white_share - tracker.sweep_share)
    return TrackerDay(rng.normal(size=3) * sd * 0.6, rng.normal(size=(3, 3)) * sd * 0.8 / 2.0 / np.sqrt(3))


def _standard_um(tracker: Tracker, distance_m: Floats | float) -> Floats:
    return np.asarray((tracker.u_um + tracker.u_um_per_m * np.asarray(distance_m)) / 2.0)


def track(
    rng: np.random.Generator, tracker: Tracker, day: TrackerDay, tool_m: Floats, error_um: Floats, sweep: Ints
) -> Floats:
    """Measured error (n, 3) of points at `tool_m` (n, 3) with true error `error_um`; NaN where the beam was lost.

    `sweep` (n,) says which points were measured in one sequence and share an angle error and what the tie leaves of
    drift.
    """
    station = np.array(tracker.at_mm) * 1e-3
    middle = tool_m.mean(axis=0)
    sd = _standard_um(tracker, np.linalg.norm(tool_m - station, axis=1))
    out = error_um + day.offset_um + (tool_m - middle) @ day.gradient_um_per_m.T
    out = out + rng.normal(size=out.shape) * (sd * np.sqrt(tracker.white_share))[:, None]
    for number in np.unique(sweep):
        own = sweep == number
        reach = float(np.mean(np.linalg.norm(tool_m[own] - station, axis=1)))
        angle_urad = rng.normal(size=3) * float(np.mean(sd[own])) * np.sqrt(tracker.sweep_share) / reach
        out[own] += np.cross(angle_urad, tool_m[own] - station)
        tie_urad = rng.normal(size=3) * tracker.tie_urad
        out[own] += rng.normal(size=3) * tracker.tie_um + np.cross(tie_urad, tool_m[own] - middle)
    gross = rng.random(len(out)) < tracker.outliers
    out[gross] += rng.normal(size=(int(gross.sum()), 3)) * tracker.outlier_um
    out[rng.random(len(out)) < tracker.missing] = np.nan
    return np.asarray(out)


def fit_frame(tool_m: Floats, error_um: Floats) -> Floats:
    """The rigid transform (6,) from tracker to machine, µm and µrad, fitted without scale on cold points.

    Robust against gross errors: twice fitted, points beyond 4 standard deviations left out of the second fit.
    """
    design = frame_design(tool_m)
    good = np.isfinite(error_um).all(axis=1)
    fit: Floats = np.zeros(6)
    for _ in range(3):
        rows = np.repeat(good, 3)
        fit = np.asarray(np.linalg.lstsq(design[rows], error_um.ravel()[rows], rcond=None)[0])
        rest = np.linalg.norm(error_um - (design @ fit).reshape(-1, 3), axis=1)
        good = np.isfinite(rest) & (rest < 4 * 1.4826 * np.nanmedian(rest))
    return fit


def frame_design(tool_m: Floats) -> Floats:
    """Rows (3 n, 6) of a rigid motion about the origin of the machine frame."""
    return np.asarray(carry_pose(tool_m)[:, :3, :].reshape(-1, 6))

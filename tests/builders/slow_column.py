"""A column whose heat is slow, with known truth: the error follows sensor a by an hour."""

from __future__ import annotations

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.campaign import Campaign, CampaignSettings, MachineFolder, SweepPoints
from thetacomp.machine import Axis, Machine, Sensor
from thetacomp.model.filters import run_filters
from thetacomp.model.temperatures import Duty, Temperatures

MACHINE = Machine(
    name="slow column",
    axes=(Axis(name="Y", direction="+Y", travel_mm=(0.0, 2000.0)),),
    sensors=(Sensor(id="a", role="bearing", axis="Y"), Sensor(id="b", role="structure", axis="Y")),
)
LAG_S = 3600.0
POSITIONS_MM = np.linspace(0.0, 2000.0, 9)
NOISE_UM = 2.0


def thermal_um(lag_K: Floats, position_mm: Floats) -> Floats:
    """The truth: E = (6 + 10 (p - 1000)/1000) µm for each K of the column, which follows sensor a by an hour."""
    return (6.0 + 10.0 * (position_mm - 1000.0) / 1000.0) * lag_K


def campaign(seed: int, heat_K: float = 8.0) -> Campaign:
    """Twelve hours: an hour cold, work that changes each hour, sweeps every half hour."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(0.0, 12 * 3600.0, 60.0)
    speed_rpm = np.where(t_s < 3600.0, 0.0, rng.uniform(0, 1, 12)[(t_s // 3600.0).astype(int)] * 2000.0)
    source_K = heat_K * speed_rpm / 2000.0
    a_K = run_filters(t_s, source_K[:, None], (1500.0,))[0][:, 0, 0]
    lag_K = run_filters(t_s, a_K[:, None], (LAG_S,))[0][:, 0, 0]
    noise = rng.normal(0, 0.02, (len(t_s), 2))
    value = np.column_stack([20.0 + a_K, 20.0 + 0.5 * a_K]) + noise
    begin_s = np.arange(600.0, 11.5 * 3600.0, 1800.0)
    point_s = (begin_s[:, None] + 40.0 * np.arange(len(POSITIONS_MM))).ravel()
    position = np.tile(POSITIONS_MM, len(begin_s))
    error = np.full((len(point_s), 3), np.nan)
    error[:, 1] = thermal_um(np.interp(point_s, t_s, lag_K), position) + 5.0 * np.sin(position / 300.0)
    error[:, 1] += rng.normal(0, NOISE_UM, len(point_s))
    return Campaign(
        f"c{seed}",
        CampaignSettings(instrument="laser", reference_s=1800.0),
        Temperatures(t_s, ("a", "b"), value),
        SweepPoints(
            point_s,
            ("Y",) * len(point_s),
            np.repeat(np.arange(len(begin_s)), len(POSITIONS_MM)),
            position,
            np.ones(len(point_s), dtype=np.int64),
            error,
        ),
        duty=Duty(t_s, {"spindle_rpm": speed_rpm}),
    )


def folder(*seeds: int) -> MachineFolder:
    return MachineFolder(MACHINE, tuple(campaign(seed) for seed in seeds))

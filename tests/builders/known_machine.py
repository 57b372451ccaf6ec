"""Machines with known geometry, slope and intercept, measured by a tracker with stated noise: truth for the tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thetacomp.campaign import Campaign, CampaignSettings, SweepPoints
from thetacomp.machine import Axis, Machine, Sensor
from thetacomp.model.temperatures import Temperatures

Floats = NDArray[np.float64]

TRAVEL_MM = 3000.0
POINT_U_UM = 15.0  # expanded (k = 2), as an AT901-B states it
ANGLE_U_UM_PER_M = 6.0
OUTLIER_SHARE = 0.005


@dataclass(frozen=True)
class Truth:
    """Warm-up curves of the three directions: amplitudes (3,) and the time constant of the machine."""

    intercept_um: Floats
    slope_um_per_m: Floats
    time_constant_s: float
    reference_s: float

    def warmth(self, t_s: Floats) -> Floats:
        return 1.0 - np.exp(-np.maximum(t_s - self.reference_s, 0.0) / self.time_constant_s)

    def intercept(self, t_s: Floats, direction: int) -> Floats:
        return self.intercept_um[direction] * self.warmth(t_s)

    def slope(self, t_s: Floats, direction: int) -> Floats:
        return self.slope_um_per_m[direction] * self.warmth(t_s)


MACHINE = Machine(
    name="known",
    axes=(Axis(name="Y", direction="+Y", travel_mm=(0.0, TRAVEL_MM)),),
    sensors=(Sensor(id="t1", role="drive", axis="Y"),),
)


def measured_campaign(
    rng: np.random.Generator,
    *,
    both_directions: bool = True,
    sweeps: int = 9,
    targets: int = 21,
    sweep_s: float = 1200.0,
    angle_u_um_per_m: float = ANGLE_U_UM_PER_M,
    outlier_share: float = OUTLIER_SHARE,
    point_u_um: float = POINT_U_UM,
    bend_um: float = 0.0,
) -> tuple[Campaign, Truth]:
    """One axis, one sweep an hour, every point at its own time; the first sweep is cold.

    `bend_um` adds a thermal bend (half sine) that grows with heat: it breaks the assumption of a line.
    """
    truth = Truth(rng.normal(0, 100, 3), rng.normal(0, 40, 3), rng.uniform(1.5, 4.0) * 3600.0, sweep_s)
    forward = np.linspace(0.0, TRAVEL_MM, targets)
    position = np.concatenate([forward, forward[::-1]]) if both_directions else forward
    direction = np.where(np.arange(len(position)) < targets, 1, -1)
    lever = (position - TRAVEL_MM / 2) / 1000.0
    shape = rng.normal(0, 10, (3, 4))
    columns: dict[str, list[Floats]] = {"t": [], "p": [], "d": [], "k": [], "e": []}
    for k in range(sweeps):
        t_s = 3600.0 * k + np.linspace(0.0, sweep_s, len(position))
        error = np.empty((len(position), 3))
        for j in range(3):
            a, b, c, reversal = shape[j]
            geometry = a * lever + b * lever**2 + c * np.sin(2 * np.pi * position / 400.0) + reversal * (direction < 0)
            line = truth.intercept(t_s, j) + truth.slope(t_s, j) * lever
            bend = bend_um * truth.warmth(t_s) * np.sin(np.pi * position / TRAVEL_MM)
            angle = rng.normal(0, angle_u_um_per_m / 2) * lever
            error[:, j] = geometry + line + bend + angle + rng.normal(0, point_u_um / 2, len(position))
            gross = rng.random(len(position)) < outlier_share
            error[gross, j] += rng.choice([-1.0, 1.0], gross.sum()) * rng.uniform(100, 1000, gross.sum())
        for key, value in zip("tpdke", (t_s, position, direction, np.full(len(position), k), error), strict=True):
            columns[key].append(value)
    t_s, position, direction, sweep, error = (np.concatenate(columns[key]) for key in "tpdke")
    clock = np.arange(0.0, 3600.0 * sweeps + sweep_s, 300.0)
    campaign = Campaign(
        name="warm-up",
        settings=CampaignSettings(
            instrument="tracker", instrument_u_um=point_u_um, instrument_u_um_per_m=angle_u_um_per_m
        ),
        temperatures=Temperatures(clock, ("t1",), 20.0 + 10.0 * truth.warmth(clock)[:, None]),
        sweeps=SweepPoints(
            t_s=t_s,
            axis=("Y",) * len(t_s),
            sweep=sweep.astype(np.int64),
            position_mm=position,
            direction=direction.astype(np.int64),
            error_um=error,
        ),
    )
    return campaign, truth

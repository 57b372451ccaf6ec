"""A synthetic machine in a hall: nodes that store heat, sensors that are placed badly, a displacement no sensor sees.

Eleven nodes obey `C dT/dt = -Σ conductances × differences + sources`, solved exactly from sample to sample. Eight of
them carry a sensor, which also feels its neighbour and the air. The displacement is a weighted sum over all nodes, so
the three hidden ones put it outside the span of the sensors; the side of the column gets a draught that no sensor
feels. In `WINTER` the hall is even and cool. In `SUMMER` it is warmer, swings more over the day, and the sun comes to
the hidden side of the column.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from thetacomp.arrays import Floats, Ints
from thetacomp.model.filters import InputLayout, history_inputs

NODES = 11
SENSED = 8
SENSORS = tuple(f"theta_{j + 1}" for j in range(SENSED))
HIDDEN_COLUMN, HIDDEN_SHAFT, HIDDEN_FLOOR = 8, 9, 10
DAY_S = 86400.0


@dataclass(frozen=True)
class Season:
    """The air of the hall: mean and its scatter between days in °C, half of the daily swing in K, sun in K per h."""

    mean_degC: float
    scatter_K: float
    swing_K: tuple[float, float]
    sun_K_per_h: float


WINTER = Season(mean_degC=16.0, scatter_K=1.5, swing_K=(0.5, 2.0), sun_K_per_h=0.0)
SUMMER = Season(mean_degC=28.0, scatter_K=1.5, swing_K=(3.0, 6.0), sun_K_per_h=6.0)


@dataclass(frozen=True)
class Recording:
    """Campaigns one after another: n samples. `t_s` counts from the start of each campaign, whose number is `campaign`.

    `temperature_degC` (n, 8) as the sensors read it, `displacement_um` (n,) since the campaign's start as measured.
    """

    t_s: Floats
    campaign: Ints
    temperature_degC: Floats
    displacement_um: Floats

    def take(self, rows: np.ndarray) -> Recording:
        """Some of the samples."""
        return Recording(self.t_s[rows], self.campaign[rows], self.temperature_degC[rows], self.displacement_um[rows])


@dataclass(frozen=True)
class SyntheticMachine:
    """Conductances per hour between nodes and to the air, sources, what the sensors mix and what moves the tool."""

    exchange_per_h: Floats
    air_per_h: Floats
    source_K_per_h: Floats
    placement: Floats
    um_per_K: Floats

    def record(
        self,
        rng: np.random.Generator,
        campaigns: int,
        season: Season,
        *,
        hours: float = 8.0,
        step_s: float = 300.0,
        ramp_to: Season | None = None,
    ) -> Recording:
        """Campaigns of random duty; with `ramp_to` the season moves to another one, a step with each campaign."""
        n = int(hours * 3600 / step_s)
        t_s = np.arange(n) * step_s
        share = (np.zeros(campaigns) if ramp_to is None else np.linspace(0.0, 1.0, campaigns))[:, None]
        last = season if ramp_to is None else ramp_to
        mean_degC = season.mean_degC + share * (last.mean_degC - season.mean_degC)
        swing_K = (
            rng.uniform(*season.swing_K, (campaigns, 1)) * (1 - share)
            + rng.uniform(*last.swing_K, (campaigns, 1)) * share
        )
        sun_K_per_h = season.sun_K_per_h + share * (last.sun_K_per_h - season.sun_K_per_h)
        begin_s = rng.uniform(0, DAY_S / 3, (campaigns, 1))
        day = 2 * np.pi * (begin_s + t_s) / DAY_S
        air = mean_degC + rng.normal(0, season.scatter_K, (campaigns, 1)) - swing_K * np.cos(day)
        duty = _duty(rng, campaigns, n, self.source_K_per_h.shape[1], step_s)
        # a draught from the hall door cools or warms the hidden side of the column, another one every day
        draught_K = rng.normal(0, 2.0, (campaigns, 1)) * np.sin(np.pi * t_s / (6 * 3600))
        sun = sun_K_per_h * np.maximum(-np.cos(day), 0.0)
        nodes = self._nodes(air, duty, sun + self.air_per_h[HIDDEN_COLUMN] * draught_K, step_s)
        seen = (
            nodes @ self.placement.T
            + air[:, :, None] * (1 - self.placement.sum(axis=1))
            + rng.normal(0, 0.04, (campaigns, n, SENSED))
        )
        moved = (nodes - nodes[:, :1]) @ self.um_per_K + rng.normal(0, 0.5, (campaigns, n))
        return Recording(
            t_s=np.tile(t_s, campaigns),
            campaign=np.repeat(np.arange(campaigns), n),
            temperature_degC=seen.reshape(-1, SENSED),
            displacement_um=moved.ravel(),
        )

    def _nodes(self, air: Floats, duty: Floats, side: Floats, step_s: float) -> Floats:
        """Temperatures (campaigns, n, nodes), all at rest with the air at the first sample."""
        rate = self.exchange_per_h - np.diag(self.exchange_per_h.sum(axis=1) + self.air_per_h)
        keep = expm(rate * step_s / 3600)
        gain = np.linalg.solve(rate, keep - np.eye(NODES))
        out = np.empty((*air.shape, NODES))
        out[:, 0] = air[:, :1]
        for k in range(air.shape[1] - 1):
            heat = air[:, k, None] * self.air_per_h + duty[:, k] @ self.source_K_per_h.T
            heat[:, HIDDEN_COLUMN] += side[:, k]
            out[:, k + 1] = out[:, k] @ keep.T + heat @ gain.T
        return out


def _duty(rng: np.random.Generator, campaigns: int, n: int, sources: int, step_s: float) -> Floats:
    """Loads 0..1 of every source, held for half an hour to two hours; nothing runs in the last quarter of 8 hours."""
    held = np.cumsum(rng.random((campaigns, n)) < step_s / 4500, axis=1)
    level = rng.uniform(0, 1, (campaigns, n + 1, sources)) * (rng.random((campaigns, n + 1, 1)) < 0.75)
    duty = np.take_along_axis(level, held[:, :, None], axis=1)
    resting = (np.arange(n) * step_s) % (8 * 3600) > 6 * 3600
    return np.where(resting[None, :, None], 0.0, duty)


def synthetic_machine(rng: np.random.Generator) -> SyntheticMachine:
    """One machine of the family: three heat sources, eight sensed nodes and three hidden ones."""
    exchange = np.zeros((NODES, NODES))
    for i in range(NODES - 1):
        exchange[i, i + 1] = exchange[i + 1, i] = rng.uniform(0.3, 1.2)
    air = rng.uniform(0.2, 0.8, NODES)
    air[HIDDEN_FLOOR] = 0.05
    exchange[HIDDEN_FLOOR] *= 0.1
    source = np.zeros((NODES, 3))
    source[1, 0], source[4, 1], source[6, 2] = rng.uniform(8, 16, 3)
    source[HIDDEN_SHAFT] = rng.uniform(1, 3), 0.0, rng.uniform(2, 4)
    placement = np.zeros((SENSED, NODES))
    for j in range(SENSED):
        off = rng.uniform(0.05, 0.25)  # of the reading belongs to the neighbour, `leak` to the air
        leak = rng.uniform(0.02, 0.15)
        placement[j, j], placement[j, j + 1] = (1 - off) * (1 - leak), off * (1 - leak)
    weight = rng.normal(0, 1.5, NODES)
    weight[[1, 4]] += 3.0
    weight[HIDDEN_COLUMN] = rng.uniform(2.0, 4.0)
    weight[HIDDEN_SHAFT] = rng.uniform(1.0, 2.0)
    return SyntheticMachine(exchange, air, source, placement, weight)


LAYOUT = InputLayout(sensors=SENSORS, time_constants_s=(1800.0, 7200.0), speed_powers=(), base_degC=20.0)


def inputs_of(recording: Recording, layout: InputLayout = LAYOUT) -> Floats:
    """Inputs of the model (n, inputs): every campaign counts from its own first sample."""
    columns = [SENSORS.index(name) for name in layout.sensors]
    parts = []
    for label in np.unique(recording.campaign):
        rows = recording.campaign == label
        part = history_inputs(layout, recording.t_s[rows], recording.temperature_degC[rows][:, columns])
        parts.append(layout.since(part, part[0]))
    return np.vstack(parts)

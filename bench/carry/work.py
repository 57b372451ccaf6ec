"""What lumped machines do: minutes of spindle and feed, the shift before, and the air around."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from carry.network import Floats

STEP_S = 60.0
Kind = Literal["parts", "steps", "warm-up", "heating"]


@dataclass(frozen=True)
class Work:
    """Minutes of work, n each: spindle speed as a share of the largest, feed shares (n, axes), coolant 0 or 1."""

    spindle: Floats
    feed: Floats
    coolant: Floats

    def __len__(self) -> int:
        return len(self.spindle)


def joined(*parts: Work) -> Work:
    """One after another."""
    return Work(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("spindle", "feed", "coolant")))


def rest(minutes: int, axes: int) -> Work:
    """The machine stands."""
    return Work(np.zeros(minutes), np.zeros((minutes, axes)), np.zeros(minutes))


def work(kind: Kind, minutes: int, axes: int, rng: np.random.Generator) -> Work:
    """Some minutes of one kind of work."""
    out = rest(minutes, axes)
    at = 0
    while at < minutes:
        if kind == "parts":  # a batch of one part, some pauses, coolant for most parts
            length = int(rng.uniform(15, 100))
            runs = rng.random() < 0.8
            speed, feed, wet = rng.uniform(0.15, 1.0), rng.uniform(0.0, 1.0, axes), float(rng.random() < 0.7)
        elif kind == "steps":
            length = int(rng.uniform(40, 80))
            runs = rng.random() < 0.85
            speed, feed, wet = rng.choice([0.25, 0.5, 0.75, 1.0]), rng.choice([0.0, 0.5, 1.0], axes), 0.0
        else:  # one level throughout
            length, runs, speed, feed, wet = minutes, True, rng.uniform(0.9, 1.0), np.full(axes, 0.5), 0.0
        rows = slice(at, at + length)
        if runs:
            count = len(out.spindle[rows])
            cutting = rng.random(count) < 0.85 if kind == "parts" else np.ones(count)
            out.spindle[rows], out.coolant[rows] = speed * cutting, wet
            out.feed[rows] = feed * cutting[:, None]
        at += length
    return out


@dataclass(frozen=True)
class Air:
    """Air of a hall: its levels from campaign to campaign, the swing of a day, weather, and regulation."""

    level_degC: tuple[float, float]
    daily_K: float
    weather_K: float
    regulation_K: float = 0.0
    regulation_min: float = 20.0


def air_degC(air: Air, minutes: int, rng: np.random.Generator) -> Floats:
    """Temperature of the air at every minute, (minutes,)."""
    t_s = STEP_S * np.arange(minutes)
    level = rng.uniform(*air.level_degC)
    day = air.daily_K * np.sin(2 * np.pi * (t_s / 86400.0 + rng.random()))
    slow = np.cumsum(rng.normal(0.0, air.weather_K / np.sqrt(360.0), minutes))
    slow -= np.linspace(0.0, slow[-1], minutes) * 0.7  # weather comes back
    phase = 2 * np.pi * t_s / 60.0 / (air.regulation_min * rng.uniform(0.8, 1.25)) + rng.uniform(0.0, 6.0)
    return np.asarray(level + day + slow + air.regulation_K * np.sign(np.sin(phase)))

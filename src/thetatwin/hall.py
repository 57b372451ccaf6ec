"""Air and floor of the workshop over time, as inputs of the thermal system (K above the reference)."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from thetacomp.arrays import Floats
from thetatwin.conditions import Hall

DAY_S = 86400.0
YEAR_DAYS = 365.25


def random_process(rng: np.random.Generator, n: int, sd: float, time_s: float, step_s: float) -> Floats:
    """First-order (Ornstein-Uhlenbeck) process of n samples: standard deviation, correlation time, step."""
    keep = np.exp(-step_s / time_s)
    drive = rng.normal(size=n) * sd * np.sqrt(1 - keep**2)
    drive[:1] = rng.normal() * sd
    return np.asarray(lfilter([1.0], [1.0, -keep], drive))


def yearly_degC(hall: Hall, day: Floats) -> Floats:
    """Mean hall temperature of the season; `day` counts from New Year."""
    mean, swing = 0.5 * (hall.summer_degC + hall.winter_degC), 0.5 * (hall.summer_degC - hall.winter_degC)
    return np.asarray(mean - swing * np.cos(2 * np.pi * (day - hall.coldest_day) / YEAR_DAYS))


def hall_inputs(
    hall: Hall, rng: np.random.Generator, t_s: Floats, start_day: float, working: Floats, reference_degC: float
) -> tuple[Floats, Floats]:
    """Air inputs (n, 5) in the order of AIR_INPUTS, and the floor (n,), at times counted from midnight of a day.

    `working` (n,) is 1 while people work in the hall: doors open only then.
    """
    n, step = len(t_s), float(t_s[1] - t_s[0])
    day = start_day + t_s / DAY_S
    season = yearly_degC(hall, day)
    hour = 2 * np.pi * (t_s / DAY_S - 15.0 / 24.0)  # warmest at three in the afternoon
    weather = random_process(rng, n, hall.weather_sd_K, hall.weather_time_h * 3600, step)
    phase = (
        2
        * np.pi
        * np.cumsum(step / (hall.cycling_period_min * 60) * np.exp(random_process(rng, n, 0.15, 7200.0, step)))
    )
    # A thermostat's saw: quick rise, slow fall.
    cycling = hall.cycling_amplitude_K * (2 * (phase / (2 * np.pi) % 1.0) ** 0.6 - 1.25)
    level = season + hall.daily_amplitude_K * np.cos(hour) + weather + cycling
    heated = np.clip((18.0 - season) / 6.0, 0.0, 1.0)
    gradient = [random_process(rng, n, hall.gradient_sd_K_per_m, hall.gradient_time_h * 3600, step) for _ in range(3)]
    vertical = hall.stratification_K_per_m + heated * (hall.stratification_heated_K_per_m - hall.stratification_K_per_m)
    sun = hall.sun_K_per_m * np.clip(np.cos(hour), 0.0, None)
    air = [
        level - reference_degC,
        vertical + gradient[0],
        gradient[1] + sun,
        gradient[2],
        _draughts(hall, rng, step, working),
    ]
    # A slab is a low-pass: it follows the year, damped and late, and hardly the week.
    floor_year = yearly_degC(hall, day - hall.floor_delay_days)
    mean = 0.5 * (hall.summer_degC + hall.winter_degC)
    floor = mean + hall.floor_share * (floor_year - mean) - reference_degC
    return np.stack(air, axis=1), floor


def _draughts(hall: Hall, rng: np.random.Generator, step_s: float, working: Floats) -> Floats:
    """Depth of the door's draught, K: cold air comes in at once and goes with the time constant of an opening."""
    chance = hall.draughts_per_day * step_s / DAY_S * 2.0  # doors open in about half of the day
    opens = (rng.random(len(working)) < chance) & (working > 0)
    depth = np.where(opens, hall.draught_depth_K * rng.uniform(0.4, 1.4, len(working)), 0.0)
    keep = np.exp(-step_s / (hall.draught_minutes * 60))
    return np.asarray(lfilter([1.0], [1.0, -keep], depth))

"""How the virtual machine lives: hall, work, sensors, tracker, geometry, as the preset files say it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from thetacomp.machine import Strict
from thetatwin.files import load_toml

PRESETS = ("standard", "hard")
NotNegative = Annotated[float, Field(ge=0)]
Positive = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(ge=0, le=1)]
LONGEST_LEAD_H = 72.0  # the three days of work that are lived before a campaign


class Hall(Strict):
    """Air and floor of the workshop. The yearly mean swings between `winter_degC` and `summer_degC`.

    `weather` and the gradients are first-order random processes of a standard deviation and a correlation time.
    Draughts come as single events when the door opens during work.
    """

    winter_degC: float
    summer_degC: float
    coldest_day: Annotated[int, Field(ge=0, le=365)]
    daily_amplitude_K: NotNegative
    weather_sd_K: NotNegative
    weather_time_h: Positive
    cycling_amplitude_K: NotNegative
    cycling_period_min: Positive
    stratification_K_per_m: float
    stratification_heated_K_per_m: float
    gradient_sd_K_per_m: NotNegative
    gradient_time_h: Positive
    sun_K_per_m: NotNegative
    floor_share: Share
    floor_delay_days: NotNegative
    draughts_per_day: NotNegative
    draught_depth_K: NotNegative
    draught_minutes: Positive


class Work(Strict):
    """What the machine does. A campaign is a cold block of `cold_rounds` rounds of sweeps, `warm_h` of work and
    `cool_h` without; sweeps every `between_sweeps_min`. Each point of a sweep takes `dwell_s` and the travel at
    `sweep_feed_m_min`. The loggers of temperature and duty run `lead_h` before the campaign begins, at most 72 h: what
    the machine did earlier is not lived through."""

    rpm_max: Positive
    feed_m_min_max: Positive
    warm_h: Positive
    cool_h: NotNegative
    between_sweeps_min: Positive
    dwell_s: Positive
    sweep_feed_m_min: Positive
    points: Annotated[int, Field(ge=5)]
    tool_length_mm: NotNegative
    chiller: Share
    chiller_change: bool
    spacing_days: Positive
    first_day: Annotated[int, Field(ge=0, le=365)]
    cold_rounds: Annotated[int, Field(ge=1, le=24)] = 2
    lead_h: Annotated[float, Field(ge=0, le=LONGEST_LEAD_H)] = 0.0


class Pt100(Strict):
    """A resistance thermometer: reading = true + offset + noise, behind a first-order lag, rounded to a resolution.

    `air_share` is how much of the reading is air instead of metal; `lag_s` the range that lags are drawn from;
    `fault_probability` the chance that a sensor has one fault in a campaign; `missing` the share of lost samples.
    """

    noise_K: NotNegative
    resolution_K: NotNegative
    offset_sd_K: NotNegative
    air_share: tuple[Share, Share]
    lag_s: tuple[Positive, Positive]
    sample_s: Positive
    fault_probability: Share
    missing: Share


class Tracker(Strict):
    """A laser tracker of stated expanded uncertainty U = u_um + u_um_per_m * distance (k = 2), source: data sheet.

    The variance is split: `white_share` from point to point, `sweep_share` as an angle common to a sweep, the rest
    stays the same all day (frame, station) and so looks like geometry. `tie_um` and `tie_urad` are what the fixed
    foundation targets leave of the station's drift, new at every sweep. `outliers` is the share of gross errors.
    """

    name: str
    u_um: Positive
    u_um_per_m: NotNegative
    white_share: Share
    sweep_share: Share
    tie_um: NotNegative
    tie_urad: NotNegative
    outliers: Share
    outlier_um: NotNegative
    missing: Share
    at_mm: tuple[float, float, float]


class Geometry(Strict):
    """Geometric errors: straightness and positioning over the whole travel, angles, periodic error, reversal."""

    linear_um: NotNegative
    angular_urad: NotNegative
    squareness_urad: NotNegative
    periodic_um: NotNegative
    periodic_mm: dict[str, Positive]
    reversal_um: NotNegative


class Conditions(Strict):
    """One preset."""

    name: str
    machine: str
    hall: Hall
    work: Work
    pt100: Pt100
    tracker: Tracker
    geometry: Geometry


def load_conditions(name_or_path: str | Path) -> Conditions:
    """Read a preset ("standard", "hard") or a TOML file. Raises InputError with everything that is wrong in it."""
    return load_toml(Conditions, name_or_path, PRESETS)

"""What was measured, as arrays with their units in the names. Every array here has been checked on reading.

`E = actual - commanded`; a missing value is NaN; time counts in seconds from the start of the campaign.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from thetacomp.machine import Machine, Strict

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CARTESIAN = ("X", "Y", "Z")


class CampaignSettings(Strict):
    """`campaign.toml`. `sign = "unproven"` marks data whose sign convention the source does not state."""

    datum: Literal["campaign", "common"] = "campaign"
    instrument: str = ""
    instrument_u_um: float | None = None
    instrument_u_um_per_m: float | None = None
    compensation: Literal["off", "on"] = "off"
    active_tables: tuple[str, ...] = ()
    mode: str = ""
    tool_length_mm: float = 0.0
    reference_s: float | None = None
    sign: Literal["stated", "unproven"] = "stated"
    origin: str = ""


@dataclass(frozen=True)
class Temperatures:
    """Sensor temperatures: `t_s` (n,) ascending, `value_degC` (n, sensors)."""

    t_s: Floats
    sensor_ids: tuple[str, ...]
    value_degC: Floats

    def at(self, t_s: Floats) -> Floats:
        """Temperatures at other times, shape (len(t_s), sensors): linear between samples, held at the ends.

        Missing samples of a sensor are bridged by its neighbours in time; a sensor without any sample stays NaN.
        """
        out = np.full((len(t_s), len(self.sensor_ids)), np.nan)
        for j in range(len(self.sensor_ids)):
            good = np.isfinite(self.value_degC[:, j])
            if good.any():
                out[:, j] = np.interp(t_s, self.t_s[good], self.value_degC[good, j])
        return out


@dataclass(frozen=True)
class SweepPoints:
    """All points of all sweeps of a campaign, in order of time, n points.

    `sweep` counts the sweeps from 0 in order of time; `direction` is the approach, +1 or -1 (0: not known).
    `error_um` is (n, 3) along machine X, Y, Z; `rotation_urad` (n, 3) about X, Y, Z where it was measured.
    `at_mm` holds the positions of the other axes where they were written down.
    """

    t_s: Floats
    axis: tuple[str, ...]
    sweep: Ints
    position_mm: Floats
    direction: Ints
    error_um: Floats
    run: tuple[str, ...] | None = None
    station: tuple[str, ...] | None = None
    rotation_urad: Floats | None = None
    at_mm: Mapping[str, Floats] = field(default_factory=dict)


@dataclass(frozen=True)
class Drift:
    """Displacement at a fixed position (ISO 230-3): `error_um` (n, 3), `rotation_urad` (n, 3) where measured."""

    t_s: Floats
    error_um: Floats
    rotation_urad: Floats | None = None
    at_mm: Mapping[str, Floats] = field(default_factory=dict)


@dataclass(frozen=True)
class Parameters:
    """Already separated thermal lines `S (p - P0) + I`, one row a state and component, n rows."""

    t_s: Floats
    component: tuple[str, ...]
    intercept_um: Floats
    slope_um_per_m: Floats
    p0_mm: Floats
    p_min_mm: Floats
    p_max_mm: Floats


@dataclass(frozen=True)
class Duty:
    """What the machine did: named columns such as `spindle_rpm`, `feed_mm_min`, each (n,)."""

    t_s: Floats
    columns: Mapping[str, Floats]


@dataclass(frozen=True)
class LeadIn:
    """What an unbroken recording holds before a campaign starts, at negative times: heat is still in the machine."""

    temperatures: Temperatures
    duty: Duty | None = None


@dataclass(frozen=True)
class Campaign:
    """One warm-up and cool-down: the unit of every hold-out."""

    name: str
    settings: CampaignSettings
    temperatures: Temperatures
    sweeps: SweepPoints | None = None
    drift: Drift | None = None
    parameters: Parameters | None = None
    duty: Duty | None = None
    start: datetime | None = None
    before: LeadIn | None = None


@dataclass(frozen=True)
class CorrelationTable:
    """Published correlations: `value` (rows, columns) in -1..1, NaN where not published."""

    rows: tuple[str, ...]
    columns: tuple[str, ...]
    value: Floats


@dataclass(frozen=True)
class MachineFolder:
    """A machine and its campaigns, with the published correlation tables where the folder holds them."""

    machine: Machine
    campaigns: tuple[Campaign, ...]
    parameter_correlations: CorrelationTable | None = None
    sensor_correlations: CorrelationTable | None = None

    def campaign(self, name: str) -> Campaign:
        """The campaign of that name; KeyError where there is none."""
        for campaign in self.campaigns:
            if campaign.name == name:
                return campaign
        raise KeyError(name)

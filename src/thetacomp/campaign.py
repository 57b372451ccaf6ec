"""What was measured, as arrays with their units in the names. Every array here has been checked on reading.

`E = actual - commanded`; a missing value is NaN; time counts in seconds from the start of the campaign.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from thetacomp.arrays import Floats, Ints
from thetacomp.machine import Machine, Strict, Text
from thetacomp.model.temperatures import Duty, Temperatures

Positive = Annotated[float, Field(gt=0)]


class TrackerSettings(Strict):
    """`[tracker]` of `campaign.toml`: standard deviations of one point (not expanded), and the form of SA-like files.

    The distance has `distance_sd_um + distance_sd_um_per_m * distance`; the two angles turn into µm by the distance.
    """

    distance_sd_um: Positive
    distance_sd_um_per_m: Annotated[float, Field(ge=0)] = 0.0
    horizontal_sd_urad: Positive
    vertical_sd_urad: Positive
    columns: tuple[str, ...] = ("target", "x", "y", "z")
    unit: Literal["mm", "m", "inch"] = "mm"


class CampaignSettings(Strict):
    """`campaign.toml`. `sign = "unproven"` marks data whose sign convention the source does not state."""

    datum: Literal["campaign", "common"] = "campaign"
    instrument: Text = ""
    instrument_u_um: float | None = None
    instrument_u_um_per_m: float | None = None
    compensation: Literal["off", "on"] = "off"
    active_tables: tuple[Text, ...] = ()
    mode: Text = ""
    tool_length_mm: float = 0.0
    reference_s: float | None = None
    sign: Literal["stated", "unproven"] = "stated"
    origin: str = ""
    tracker: TrackerSettings | None = None


@dataclass(frozen=True)
class SweepPoints:
    """All points of all sweeps of a campaign, in order of time, n points.

    `sweep` counts the sweeps from 0 in order of time; `direction` is the approach, +1 or -1 (0: not known);
    `direction_given` is False where some of it was inferred from the motion.
    `error_um` is (n, 3) along machine X, Y, Z; `rotation_urad` (n, 3) about X, Y, Z where it was measured.
    `at_mm` holds the positions of the other axes where they were written down.

    From tracker points: `sd_um` (n, 3) is the standard deviation of each error (instrument, tie and frame), `noise_um`
    (n, 3) its part that is new at every point. `tie_covariance` (sweeps, 3, 2, 2) is what the points of a sweep share
    in each direction: covariance of an offset in µm at the mean position and a slope in µm/m.
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
    direction_given: bool = True
    sd_um: Floats | None = None
    noise_um: Floats | None = None
    tie_covariance: Floats | None = None


@dataclass(frozen=True)
class StationClosure:
    """How well the fixed foundation targets of one station fit together, over all its rounds.

    `moved_um` (3,) is the motion of the tracker along machine X, Y, Z from its first round to its last, with its
    standard error. `excess` is the factor by which the closure exceeds the stated uncertainty (1: it does not).
    """

    station: str
    rounds: int
    targets: int
    rms_um: float
    largest_um: float
    largest_target: str
    largest_t_s: float
    moved_um: Floats
    moved_se_um: Floats
    excess: float


@dataclass(frozen=True)
class TrackerTie:
    """How tracker points became errors of the machine.

    `rotation` (3, 3) and `translation_mm` (3,) carry foundation coordinates into the machine frame, fitted once on
    the cold block; `frame_rms_um` and `frame_largest_um` are what it leaves there. `scale_um_per_m` is reported, never
    applied. `motion_um` (rounds, 3) is the position of the tracker at each round, against its station's first one.
    `notes` says all this in words, `doubts` what a user should look into.
    """

    rotation: Floats
    translation_mm: Floats
    cold_points: int
    frame_rms_um: float
    frame_largest_um: float
    scale_um_per_m: float
    scale_se_um_per_m: float
    closures: tuple[StationClosure, ...]
    round_t_s: Floats
    round_station: tuple[str, ...]
    motion_um: Floats
    motion_se_um: Floats
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()


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
    tracker: TrackerTie | None = None

    def recording(self) -> tuple[Temperatures, Duty | None]:
        """Temperatures and duty with what came before the campaign as one recording, for filters to run through.

        Sensors come in the order of the campaign. Where nobody logged the duty before, the machine counts as standing
        still up to the start of the campaign.
        """
        own, before = self.temperatures, self.before
        if before is None or not len(before.temperatures.t_s):
            return own, self.duty
        earlier = before.temperatures.select(own.sensor_ids)
        if self.duty is None:
            return earlier.joined(own), None
        past = before.duty or Duty(earlier.t_s[:1], {})
        # The first entry of a campaign counts from its start, with or without a lead-in.
        own_s = np.concatenate([np.minimum(self.duty.t_s[:1], own.t_s[0]), self.duty.t_s[1:]])
        return earlier.joined(own), past.joined(replace(self.duty, t_s=own_s))

    def without_sensors(self, sensors: Collection[str]) -> Campaign:
        """The campaign as if these sensors had never been read."""
        before = self.before
        if before is not None:
            before = replace(before, temperatures=before.temperatures.without(sensors))
        return replace(self, temperatures=self.temperatures.without(sensors), before=before)


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

    def without_sensors(self, sensors: Collection[str]) -> MachineFolder:
        """The folder as if these sensors had never been read."""
        return replace(self, campaigns=tuple(campaign.without_sensors(sensors) for campaign in self.campaigns))

"""A machine folder of the thermal network with drift and duty: what screening and analysis are tested on."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from machine_folders import csv_text, write_files
from thermal_network import SENSORS, network, operate

from thetacomp.arrays import Floats
from thetacomp.campaign import Campaign, CampaignSettings, Drift, LeadIn, MachineFolder
from thetacomp.machine import Machine, Sensor
from thetacomp.model.temperatures import Duty, Temperatures

HOUR_S = 3600.0
MACHINE = Machine(name="network", sensors=tuple(Sensor(id=f"theta_{i + 1}", role="structure") for i in range(SENSORS)))


@lru_cache
def folder(campaigns: int = 4, seed: int = 1, hours: float = 10.0) -> MachineFolder:
    """Healthy campaigns, temperatures each minute and the displacement in X every five."""
    return MachineFolder(MACHINE, tuple(_campaign(k, seed, hours) for k in range(campaigns)))


def _campaign(k: int, seed: int, hours: float) -> Campaign:
    rng = np.random.default_rng(k)
    temperatures, moved_um = operate(network(seed), hours, rng, step_s=60.0, season_degC=rng.uniform(16.0, 26.0))
    error_um = np.full((len(moved_um[::5]), 3), np.nan)
    error_um[:, 0] = moved_um[::5]
    return Campaign(f"c{k}", CampaignSettings(), temperatures, drift=Drift(temperatures.t_s[::5], error_um))


def with_temperatures(whole: MachineFolder, name: str, table: Temperatures) -> MachineFolder:
    """The folder with other temperatures in one campaign."""
    changed = (replace(c, temperatures=table) if c.name == name else c for c in whole.campaigns)
    return replace(whole, campaigns=tuple(changed))


def column(table: Temperatures, sensor: str) -> Floats:
    """Values (n,) of one sensor."""
    return table.value_degC[:, table.sensor_ids.index(sensor)]


@lru_cache
def unbroken(campaigns: int = 4, seed: int = 1, hours: float = 10.0) -> Temperatures:
    """One recording over all campaigns, as long as all of them together."""
    return operate(network(seed), campaigns * hours, np.random.default_rng(0), step_s=60.0)[0]


def cut(recording: Temperatures, campaigns: int = 4) -> MachineFolder:
    """The campaigns of a recording; each knows what came before it."""
    made = []
    edges = np.linspace(0, len(recording.t_s), campaigns + 1).astype(int)
    for k, (begin, end) in enumerate(pairwise(edges.tolist())):
        zero_s = recording.t_s[begin]
        own, earlier = (
            Temperatures(recording.t_s[rows] - zero_s, recording.sensor_ids, recording.value_degC[rows])
            for rows in (slice(begin, end), slice(0, begin))
        )
        made.append(Campaign(f"c{k}", CampaignSettings(), own, before=LeadIn(earlier) if begin else None))
    return MachineFolder(MACHINE, tuple(made))


def standing(begin_s: float, end_s: float) -> Duty:
    """A spindle that runs but for one stretch of standstill."""
    return Duty(np.array([0.0, begin_s, end_s]), {"spindle_rpm": np.array([1000.0, 0.0, 1000.0])})


def write_folder(whole: MachineFolder, root: Path) -> Path:
    """The folder on disk, as a user would have it."""
    sensors = "".join(f'[[sensors]]\nid = "{s.id}"\nlocation = "{s.id}"\nrole = "{s.role}"\n' for s in MACHINE.sensors)
    files = {"machine.toml": f'format = 1\n[machine]\nname = "network"\n{sensors}'}
    for campaign in whole.campaigns:
        assert campaign.drift is not None
        table = campaign.temperatures
        place = f"campaigns/{campaign.name}"
        files[f"{place}/temperatures.csv"] = csv_text(
            [["t_s", *table.sensor_ids], *np.column_stack([table.t_s, table.value_degC.round(3)]).tolist()]
        )
        moved_um = campaign.drift.error_um[:, 0].round(3)
        files[f"{place}/drift.csv"] = csv_text(
            [["t_s", "dX_um"], *np.column_stack([campaign.drift.t_s, moved_um]).tolist()]
        )
    return write_files(root, files)

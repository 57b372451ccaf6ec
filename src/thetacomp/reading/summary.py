"""What was read, in a few lines: campaigns, tables, points, duration, sensors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thetacomp.campaign import Campaign, MachineFolder


@dataclass(frozen=True)
class CampaignSummary:
    """Size of one campaign. `points` is the number of rows of each table; `duration_s` that of the temperatures.

    `lead_s` is how long temperatures were logged before it, 0 where they were not; its rows are not counted.
    `direction_given` is False where the approach of some sweep was inferred from the motion. `tracker` says how tracker
    points were brought into the machine frame.
    """

    name: str
    duration_s: float
    sensors: int
    points: dict[str, int]
    sweeps: dict[str, int]
    direction_given: bool = True
    tracker: tuple[str, ...] = ()
    lead_s: float = 0.0


@dataclass(frozen=True)
class FolderSummary:
    """Size of a machine folder."""

    machine: str
    axes: tuple[str, ...]
    sensors: int
    campaigns: tuple[CampaignSummary, ...]


def summarize(folder: MachineFolder) -> FolderSummary:
    """Count what a machine folder holds."""
    return FolderSummary(
        machine=folder.machine.name,
        axes=tuple(axis.name for axis in folder.machine.axes),
        sensors=len(folder.machine.sensors),
        campaigns=tuple(_campaign(campaign) for campaign in folder.campaigns),
    )


def _campaign(campaign: Campaign) -> CampaignSummary:
    tables = {
        "temperatures": campaign.temperatures,
        "sweeps": campaign.sweeps,
        "drift": campaign.drift,
        "parameters": campaign.parameters,
        "duty": campaign.duty,
    }
    sweeps: dict[str, int] = {}
    if campaign.sweeps is not None:
        starts = np.unique(campaign.sweeps.sweep, return_index=True)[1]
        for axis in (campaign.sweeps.axis[i] for i in starts):
            sweeps[axis] = sweeps.get(axis, 0) + 1
    return CampaignSummary(
        name=campaign.name,
        duration_s=float(campaign.temperatures.t_s[-1] - campaign.temperatures.t_s[0]),
        sensors=len(campaign.temperatures.sensor_ids),
        points={name: len(table.t_s) for name, table in tables.items() if table is not None},
        sweeps=sweeps,
        direction_given=campaign.sweeps is None or campaign.sweeps.direction_given,
        tracker=campaign.tracker.notes if campaign.tracker is not None else (),
        lead_s=_lead_s(campaign),
    )


def _lead_s(campaign: Campaign) -> float:
    if campaign.before is None or not len(campaign.before.temperatures.t_s):
        return 0.0
    return float(campaign.temperatures.t_s[0] - campaign.before.temperatures.t_s[0])

"""Pandas frames instead of files: the same checks, the same messages."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from thetacomp.campaign import Campaign, CampaignSettings
from thetacomp.machine import Machine
from thetacomp.reading import campaigns
from thetacomp.reading.columns import schema
from thetacomp.reading.machine_file import settings_plausible
from thetacomp.reading.problems import ProblemList
from thetacomp.reading.sources import from_frame
from thetacomp.reading.tables import Table, load

if TYPE_CHECKING:
    import pandas as pd


def campaign_from_frames(
    machine: Machine,
    name: str,
    *,
    temperatures: pd.DataFrame,
    sweeps: pd.DataFrame | None = None,
    tracker: pd.DataFrame | None = None,
    drift: pd.DataFrame | None = None,
    parameters: pd.DataFrame | None = None,
    duty: pd.DataFrame | None = None,
    settings: CampaignSettings | None = None,
) -> Campaign:
    """A campaign from pandas frames with the columns of docs/machine_folder.md.

    Rows in messages count as in a spreadsheet: the first row of a frame is row 2. Raises InputError with all errors.
    """
    settings = settings or CampaignSettings()
    frames = {
        "temperatures": temperatures,
        "sweeps": sweeps,
        "tracker": tracker,
        "drift": drift,
        "parameters": parameters,
        "duty": duty,
    }
    problems = ProblemList()
    settings_plausible(settings, "settings", problems)
    tables: dict[str, Table] = {}
    for table, frame in frames.items():
        if frame is None:
            continue
        loaded = load(partial(from_frame, frame, table), table, table, schema(table, machine), problems)
        if loaded is not None:
            tables[table] = loaded
    campaign = campaigns.build(name, f"campaign '{name}'", settings, tables, machine, problems)
    problems.raise_errors()
    assert campaign is not None
    return campaign

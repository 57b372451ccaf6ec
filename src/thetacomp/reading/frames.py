"""Tables in memory instead of files, pandas or NumPy: the same checks, the same messages."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

from thetacomp.campaign import Campaign, CampaignSettings, MachineFolder
from thetacomp.machine import Machine
from thetacomp.reading import campaigns
from thetacomp.reading.columns import TABLES, schema
from thetacomp.reading.folder import read_machine
from thetacomp.reading.machine_file import settings_plausible
from thetacomp.reading.problems import ProblemList, nearest
from thetacomp.reading.sources import Columns, from_columns
from thetacomp.reading.tables import Table, load

_NAMES = tuple(name for name in TABLES if name != "tracker_points")  # planned points go with exported files alone


def read_frames(
    machine: Machine | Path | str,
    tables: Mapping[str, Mapping[str, Columns]],
    settings: Mapping[str, CampaignSettings] | None = None,
) -> MachineFolder:
    """A machine and its campaigns from tables in memory, with the columns of docs/machine_folder.md.

    `machine` is a Machine or the path of its machine.toml. `tables` holds for each campaign its tables by name
    (`temperatures`, `sweeps`, …), each a pandas DataFrame or a mapping from column names to arrays; `settings` what
    campaign.toml would say. Rows in messages count as in a spreadsheet: the first row of a table is row 2. Raises
    InputError with all errors of all campaigns.
    """
    known = machine if isinstance(machine, Machine) else read_machine(Path(machine))
    problems = ProblemList()
    stated = settings or {}
    for name in sorted(set(stated) - set(tables)):
        problems.error(
            "unknown-campaign",
            "settings",
            f"there are no tables of a campaign '{name}'.",
            f"name one of {', '.join(tables)}.",
        )
    found = [_campaign(known, name, own, stated.get(name), problems) for name, own in tables.items()]
    problems.raise_errors()
    return MachineFolder(known, tuple(campaign for campaign in found if campaign is not None))


def _campaign(
    machine: Machine,
    name: str,
    frames: Mapping[str, Columns],
    settings: CampaignSettings | None,
    problems: ProblemList,
) -> Campaign | None:
    place = f"campaign '{name}'"
    settings = settings or CampaignSettings()
    settings_plausible(settings, f"{place}, settings", problems)
    tables: dict[str, Table] = {}
    for table, frame in frames.items():
        if table not in _NAMES:
            problems.error(
                "unknown-table",
                f"{place}, {table}",
                f"there is no such table{nearest(table, _NAMES)}.",
                f"tables are named {', '.join(_NAMES)}.",
            )
            continue
        file = f"{place}, {table}"
        loaded = load(partial(from_columns, frame, file), file, table, schema(table, machine), problems)
        if loaded is not None:
            tables[table] = loaded
    if "temperatures" not in frames:
        problems.error("missing-table", place, "there is no table of temperatures.", "add `temperatures`.")
    return campaigns.build(name, place, settings, tables, machine, problems, set(frames) - set(tables))

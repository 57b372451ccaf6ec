"""`recording.toml`: one long recording in one table, cut into campaigns by rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from datetime import timedelta
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field, ValidationError

from thetacomp.arrays import Ints
from thetacomp.campaign import Campaign, CampaignSettings, LeadIn
from thetacomp.machine import Machine, Strict
from thetacomp.model.temperatures import Duty, Temperatures
from thetacomp.reading import campaigns
from thetacomp.reading.columns import Matched, Meaning, Schema, schema
from thetacomp.reading.machine_file import Sections, check_format, read_toml, settings_plausible, translate
from thetacomp.reading.problems import ProblemList, UnreadableError, nearest, quoted
from thetacomp.reading.sources import Column, Source, read_source
from thetacomp.reading.tables import Clock, Table, convert

FILE = "recording.toml"
TIME_MEANINGS = {
    "s": Meaning("t_s", "time"),
    "min": Meaning("t_s", "time", 60.0),
    "h": Meaning("t_s", "time", 3600.0),
    "iso": Meaning("t_s", "clock"),
}
HEADER_ROWS = 2  # data row 0 is spreadsheet row 2


class RecordedCampaign(Strict):
    """One campaign of a recording: data rows counted from 0, both ends included."""

    name: str = Field(min_length=1)
    first_row: int = Field(ge=0)
    last_row: int = Field(ge=0)


class RecordingDescription(Strict):
    """What the columns of a recording mean. The values of the mappings are column headers."""

    file: str = Field(min_length=1)
    sheet: str | None = None
    time: str
    time_unit: Literal["s", "min", "h", "iso"]
    settings: CampaignSettings = CampaignSettings()
    temperatures: dict[str, str] = Field(min_length=1)
    drift: dict[str, str] = Field(default_factory=dict)
    duty: dict[str, str] = Field(default_factory=dict)
    campaigns: tuple[RecordedCampaign, ...]


class RecordingToml(Strict):
    """The complete `recording.toml`."""

    format: Literal[1]
    recording: RecordingDescription


def read_recording(path: Path, machine: Machine, problems: ProblemList) -> tuple[Campaign, ...]:
    """All campaigns of the recording that `path` (recording.toml) describes; problems are noted."""
    recording = _description(path, problems)
    if recording is None:
        return ()
    known = _names_known(recording, machine, problems) & _campaigns_apart(recording, problems)
    try:
        source = read_source(path.parent / recording.file, recording.file, recording.sheet)
    except UnreadableError as refusal:
        if refusal.code == "missing-file":
            refusal.fix = f"put the recording next to {FILE} (see the README.md there), or correct `file` in {FILE}."
        problems.refuse(recording.file, refusal)
        return ()
    matched = _match(source, recording, machine, problems)
    if matched is None or not known:
        return ()
    whole = convert("recording", matched, Schema({}, ()), problems)
    if whole is None:
        return ()
    found = (_campaign(whole, entry, recording, machine, problems) for entry in recording.campaigns)
    return tuple(campaign for campaign in found if campaign is not None)


def _description(path: Path, problems: ProblemList) -> RecordingDescription | None:
    try:
        raw = read_toml(path)
    except UnreadableError as refusal:
        problems.refuse(FILE, refusal)
        return None
    if not check_format(raw, FILE, problems):
        return None
    try:
        recording = RecordingToml.model_validate(raw).recording
    except ValidationError as exc:
        sections: Sections = {
            "": RecordingToml,
            "recording": RecordingDescription,
            "recording.settings": CampaignSettings,
            "recording.campaigns": RecordedCampaign,
        }
        translate(exc, raw, sections, FILE, problems)
        return None
    return recording if settings_plausible(recording.settings, FILE, problems) else None


def _names_known(recording: RecordingDescription, machine: Machine, problems: ProblemList) -> bool:
    drift = {name for name, meaning in schema("drift", machine).known.items() if meaning.name != "t_s"}
    good = True
    for section, names, known in (
        ("temperatures", recording.temperatures, machine.sensor_ids),
        ("drift", recording.drift, tuple(sorted(drift))),
    ):
        for name in names:
            if name not in known:
                what = "a sensor of machine.toml" if section == "temperatures" else f"one of {quoted(known, 12)}"
                problems.error(
                    "unknown-sensor" if section == "temperatures" else "unknown-column",
                    FILE,
                    f"[recording.{section}] names '{name}'{nearest(name, known)}, expected {what}.",
                    "correct the name (left of the equals sign).",
                )
                good = False
    return good


def _campaigns_apart(recording: RecordingDescription, problems: ProblemList) -> bool:
    """Campaigns have rows, names of their own, and share no row: a shared row would spoil every hold-out."""
    good = bool(recording.campaigns)
    if not good:
        problems.error("no-campaigns", FILE, "there are no campaigns.", "add [[recording.campaigns]] with rows.")
    ordered = sorted(recording.campaigns, key=lambda entry: entry.first_row)
    for entry in ordered:
        if entry.last_row <= entry.first_row:
            problems.error(
                "campaign-rows",
                FILE,
                f"campaign '{entry.name}': last_row {entry.last_row} is not above first_row {entry.first_row}.",
                "correct the rows.",
            )
            good = False
    for before, after in pairwise(ordered):
        if after.first_row <= before.last_row:
            problems.error(
                "campaign-rows",
                FILE,
                f"the campaigns '{before.name}' and '{after.name}' share rows.",
                "give every campaign rows of its own.",
            )
            good = False
    if len({entry.name for entry in ordered}) < len(ordered):
        problems.error("campaign-rows", FILE, "two campaigns have the same name.", "name each one differently.")
        good = False
    return good


def _match(source: Source, recording: RecordingDescription, machine: Machine, problems: ProblemList) -> Matched | None:
    """The columns that the recording names, each under `section/name`."""
    by_header = {column.header: column for column in source.columns}
    wanted: list[tuple[str, str, Meaning]] = [("t_s", recording.time, TIME_MEANINGS[recording.time_unit])]
    drift = schema("drift", machine).known
    for section, names in _sections(recording).items():
        for name, header in names.items():
            meaning = drift.get(name, Meaning(name)) if section == "drift" else Meaning(name)
            wanted.append((f"{section}/{meaning.name}", header, meaning))
    columns: dict[str, tuple[Column, Meaning]] = {}
    used: set[str] = set()
    good = True
    for key, header, meaning in wanted:
        header = " ".join(header.split())
        if header not in by_header:
            problems.error(
                "missing-column",
                source.file,
                f"there is no column '{header}'{nearest(header, by_header)}, which {FILE} names;"
                f" found {quoted(by_header, 30)}.",
                f"correct the header in {FILE}.",
                (1,),
                header,
            )
            good = False
        elif header in used or key in columns:
            problems.error(
                "duplicate-column",
                FILE,
                f"the column '{header}' is named twice, or two columns state the same quantity.",
                "give every quantity one column of its own.",
            )
            good = False
        else:
            used.add(header)
            columns[key] = (by_header[header], meaning)
    return Matched(source, columns) if good else None


def _campaign(
    whole: Table, entry: RecordedCampaign, recording: RecordingDescription, machine: Machine, problems: ProblemList
) -> Campaign | None:
    mine = np.flatnonzero((whole.rows >= entry.first_row + HEADER_ROWS) & (whole.rows <= entry.last_row + HEADER_ROWS))
    if entry.last_row + HEADER_ROWS > whole.rows[-1] or not len(mine):
        problems.error(
            "campaign-rows",
            FILE,
            f"campaign '{entry.name}' ends at row {entry.last_row}, but the last data row of {recording.file} is"
            f" {int(whole.rows[-1]) - HEADER_ROWS} (counted from 0).",
            "correct last_row.",
        )
        return None
    tables = {section: _section(whole, section, mine) for section, names in _sections(recording).items() if names}
    place = f"{recording.file}, campaign '{entry.name}'"
    campaign = campaigns.build(entry.name, place, recording.settings, tables, machine, problems)
    return None if campaign is None else replace(campaign, before=_lead_in(whole, campaign, int(mine[0])))


def _lead_in(whole: Table, campaign: Campaign, first: int) -> LeadIn | None:
    """The rows of the recording before the campaign, which is the heat that it starts with."""
    if not first:
        return None
    t_s = whole.elapsed_s if whole.clock is None else whole.clock.micros / 1e6
    if t_s is None:
        return None
    earlier_s = t_s[:first] - t_s[first]
    sensors = campaign.temperatures.sensor_ids
    value_degC = np.column_stack([whole.numbers[f"temperatures/{name}"][:first] for name in sensors])
    duty = None
    if campaign.duty is not None:
        columns = {name: whole.numbers[f"duty/{name}"][:first] for name in campaign.duty.columns}
        duty = Duty(earlier_s, columns)
    return LeadIn(Temperatures(earlier_s, sensors, value_degC), duty)


def _sections(recording: RecordingDescription) -> dict[str, dict[str, str]]:
    return {"temperatures": recording.temperatures, "drift": recording.drift, "duty": recording.duty}


def _section(whole: Table, section: str, index: Ints) -> Table:
    """One table of one campaign; elapsed time counts from its first row."""
    prefix = f"{section}/"
    columns: Mapping[str, tuple[Column, Meaning]] = {
        key.removeprefix(prefix): value
        for key, value in whole.matched.columns.items()
        if key == "t_s" or key.startswith(prefix)
    }
    numbers = {
        key.removeprefix(prefix): values[index] for key, values in whole.numbers.items() if key.startswith(prefix)
    }
    source = replace(whole.matched.source, rows=whole.rows[index])
    elapsed = None if whole.elapsed_s is None else whole.elapsed_s[index] - whole.elapsed_s[index[0]]
    clock = None
    if whole.clock is not None:
        micros = whole.clock.micros[index]
        later = timedelta(microseconds=int(micros.min()) - whole.clock.first_micros)
        clock = Clock(micros, whole.clock.first + later)
    return Table(section, Matched(source, columns), elapsed, clock, numbers, {})

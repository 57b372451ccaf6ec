"""TOML files of a machine folder: `machine.toml` and `campaign.toml`, with messages an engineer understands."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from thetacomp.campaign import CampaignSettings, TrackerSettings
from thetacomp.machine import Axis, HeatSource, Machine, Sensor, WantedLength
from thetacomp.reading.columns import TIME
from thetacomp.reading.problems import ProblemList, UnreadableError, nearest, quoted, shortened
from thetacomp.reading.text import decode, read_bytes

FORMAT = 1

Sections = Mapping[str, type[BaseModel]]

# What a key says and how it is written; used in messages alone.
_MEANING = {
    "direction": ("the Cartesian machine direction (ISO 841) of positive travel of this axis", 'direction = "+Z"'),
    "travel_mm": ("the lowest and the highest position of the axis, in mm", "travel_mm = [0.0, 1000.0]"),
    "name": ("the name that the tables use", 'name = "X"'),
    "id": ("the header of the sensor's column in temperatures", 'id = "theta_1"'),
    "role": ("what the sensor is mounted on", 'role = "bearing"'),
    "feedback": ("what measures the position of the axis", 'feedback = "scale"'),
    "expansion_per_K": ("the expansion of the scale or screw per kelvin", "expansion_per_K = 11.5e-6"),
    "sensors": ("the temperature sensors", '[[sensors]] with id = "theta_1" and role = "bearing"'),
    "datum": ("from where errors count", 'datum = "campaign"'),
    "compensation": ("whether the control compensated", 'compensation = "off"'),
    "sign": ("whether the source states its sign convention", 'sign = "stated"'),
    "file": ("the recording, relative to recording.toml", 'file = "data.xlsx"'),
    "time": ("the header of the time column", 'time = "time (s)"'),
    "time_unit": ("the unit of the time column", 'time_unit = "s"'),
    "temperatures": ("the sensors and their column headers", '[recording.temperatures] with t1 = "t1 (°C)"'),
    "campaigns": ("the campaigns by rows", "[[recording.campaigns]] with name, first_row and last_row"),
    "first_row": ("the first data row of the campaign, counted from 0", "first_row = 0"),
    "last_row": ("the last data row of the campaign, counted from 0", "last_row = 1950"),
    "tracker": ("the uncertainty of the tracker", "[tracker] with distance_sd_um = 5.0"),
    "distance_sd_um": ("the standard deviation of a distance, in µm", "distance_sd_um = 5.0"),
    "horizontal_sd_urad": ("the standard deviation of a horizontal angle, in µrad", "horizontal_sd_urad = 2.0"),
    "vertical_sd_urad": ("the standard deviation of a vertical angle, in µrad", "vertical_sd_urad = 2.0"),
    "columns": ("what the cells of a row of tracker*.txt hold", 'columns = ["group", "target", "x", "y", "z"]'),
    "unit": ("the unit of x, y, z in tracker*.txt", 'unit = "mm"'),
    "recording": ("what the recording holds", "[recording] with file, time and time_unit"),
}

# What a value must be, by the start of the name that pydantic gives to the error.
_WANTED = {
    "string": 'a text in double quotes, like "text"',
    "int": "a whole number, without quotes",
    "float": "a number, without quotes",
    "finite": "a finite number",
    "bool": "true or false, without quotes",
    "tuple": "a list in square brackets, like [0.0, 1000.0]",
    "list": "a list in square brackets, like [0.0, 1000.0]",
    "too_": "a list in square brackets, like [0.0, 1000.0]",
    "missing_positional": "a list in square brackets, like [0.0, 1000.0]",
    "model": "a section with keys",
    "dict": "a section with keys",
    "greater": "a larger number",
    "less": "a smaller number",
}


def read_toml(path: Path) -> dict[str, Any]:
    """The content of a TOML file in any encoding that `decode` knows. Raises UnreadableError."""
    try:
        return tomllib.loads(decode(read_bytes(path)))
    except ValueError as exc:  # TOMLDecodeError, or an integer of thousands of digits
        raise UnreadableError(
            "toml-syntax",
            f"the text is not valid TOML: {shortened(exc, 100)}.",
            "correct the line; texts stand in double quotes, decimals use a point, back slashes are doubled.",
        ) from None
    except RecursionError:
        raise UnreadableError("toml-syntax", "the text is nested too deeply.", "correct the brackets.") from None


def check_format(raw: Mapping[str, Any], file: str, problems: ProblemList) -> bool:
    """Whether `format` is the one this version reads."""
    if type(raw.get("format")) is int and raw["format"] == FORMAT:
        return True
    found = f"found format = {raw['format']!r}" if "format" in raw else "there is no `format`"
    problems.error(
        "format-number",
        file,
        f"{found}, expected format = {FORMAT}.",
        f"write `format = {FORMAT}` as the first line, or use the thetacomp version that knows this format.",
    )
    return False


def machine_from_toml(path: Path, file: str, problems: ProblemList) -> Machine | None:
    """The machine of `machine.toml`. None, with the problems noted, where there are errors in it."""
    try:
        raw = read_toml(path)
    except UnreadableError as refusal:
        problems.refuse(file, refusal)
        return None
    if not check_format(raw, file, problems):
        return None
    head = raw.get("machine")
    if not isinstance(head, dict):
        problems.error(
            "missing-key", file, "there is no [machine] section.", 'add [machine] with name = "…" to the file.'
        )
        return None
    parts = ("axes", "sensors", "heat_sources", "length")
    good = _known_keys(raw, ("format", "machine", *parts), "the file", file, problems)
    good &= _known_keys(head, ("name", "origin"), "[machine]", file, problems)
    body = {key: value for key, value in raw.items() if key in parts}
    head = {key: value for key, value in head.items() if key in ("name", "origin")}
    try:
        machine = Machine.model_validate({**head, **body})
    except ValidationError as exc:
        sections: Sections = {
            "axes": Axis,
            "sensors": Sensor,
            "heat_sources": HeatSource,
            "length": WantedLength,
            "": Machine,
        }
        translate(exc, {**head, **body}, sections, file, problems)
        return None
    return machine if _machine_is_plausible(machine, file, problems) and good else None


def _known_keys(raw: Mapping[str, Any], known: Sequence[str], where: str, file: str, problems: ProblemList) -> bool:
    unknown = [key for key in raw if key not in known]
    for key in unknown:
        problems.error(
            "unknown-key",
            file,
            f"{where} holds the unknown key '{key}'{nearest(key, known)}; expected {quoted(known)}.",
            "correct or delete it.",
        )
    return not unknown


def _machine_is_plausible(machine: Machine, file: str, problems: ProblemList) -> bool:
    good = True
    if not machine.sensors:
        problems.error("missing-key", file, "there are no [[sensors]].", "describe every sensor with id and role.")
        good = False
    for sensor in machine.sensors:
        if sensor.id in TIME or sensor.id != " ".join(sensor.id.split()):
            problems.error(
                "sensor-id",
                file,
                f"'{sensor.id}' cannot be the id of a sensor: it is a time column or has extra spaces.",
                "choose another id, the same as the header in temperatures.",
            )
            good = False
    for axis in machine.axes:
        if axis.expansion_per_K is not None and not 1e-7 <= axis.expansion_per_K <= 1e-4:
            problems.error(
                "expansion",
                file,
                f"axis '{axis.name}': expansion_per_K = {axis.expansion_per_K:g}, expected 1e-7 to 1e-4"
                " (steel: 11.5e-6).",
                "write µm/m per kelvin times 1e-6, like 11.5e-6.",
            )
            good = False
        length = axis.travel_mm[1] - axis.travel_mm[0]
        if not 10 <= length <= 100_000:
            problems.warning(
                "travel-unit",
                file,
                f"axis '{axis.name}': travel_mm spans {length:g} mm. Is it in {'metres' if length < 10 else 'µm'}?",
                "give the travel in mm.",
            )
    return good


def settings_from_toml(path: Path, file: str, problems: ProblemList) -> CampaignSettings | None:
    """The settings of `campaign.toml`. None, with the problems noted, where there are errors in it."""
    try:
        raw = read_toml(path)
    except UnreadableError as refusal:
        problems.refuse(file, refusal)
        return None
    try:
        settings = CampaignSettings.model_validate(raw)
    except ValidationError as exc:
        translate(exc, raw, {"": CampaignSettings, "tracker": TrackerSettings}, file, problems)
        return None
    return settings if settings_plausible(settings, file, problems) else None


def settings_plausible(settings: CampaignSettings, file: str, problems: ProblemList) -> bool:
    """Uncertainties cannot be negative."""
    negative = [
        name
        for name in ("instrument_u_um", "instrument_u_um_per_m", "tool_length_mm")
        if (getattr(settings, name) or 0.0) < 0
    ]
    if negative:
        problems.error("negative", file, f"{quoted(negative)} is negative.", "give a value of zero or more.")
    return not negative


def translate(
    exc: ValidationError, raw: Mapping[str, Any], sections: Sections, file: str, problems: ProblemList
) -> None:
    """Note each error of a pydantic check in plain words: which entry, what was found, what is expected."""
    for error in exc.errors():
        where, key = _place(raw, error["loc"])
        meaning, example = _MEANING.get(key, ("", ""))
        says = f" It states {meaning}." if meaning else ""
        kind, context = error["type"], error.get("ctx", {})
        found = shortened(repr(error["input"]), 60)
        fix = f"write it like {example}." if example else "correct the entry; see docs/machine_folder.md."
        if kind == "missing":
            problems.error(
                "missing-key", file, f"{where}`{key}` is missing.{says}", f"add it, like {example or key + ' = …'}."
            )
        elif kind == "extra_forbidden":
            known = _fields(sections, error["loc"])
            problems.error(
                "unknown-key",
                file,
                f"{where}unknown key '{key}'{nearest(key, known)}; expected {quoted(known, 20)}.",
                "correct or delete it.",
            )
        elif kind == "literal_error":
            problems.error("bad-value", file, f"{where}{key} = {found}, expected {context['expected']}.{says}", fix)
        elif kind == "value_error":
            message = error["msg"].removeprefix("Value error, ")
            problems.error("bad-value", file, f"{where}{f'{key}: ' if key else ''}{message}.", fix)
        else:
            wanted = next((words for start, words in _WANTED.items() if kind.startswith(start)), "another value")
            problems.error("bad-value", file, f"{where}{key} = {found}, expected {wanted}.{says}", fix)


def _place(raw: Mapping[str, Any], loc: Sequence[str | int]) -> tuple[str, str]:
    """Words for the entry (`[[axes]] number 3 ('W'): `) and the key inside it."""
    entry: Any = raw
    where = ""
    parts = list(loc)
    for depth, part in enumerate(parts):
        entry = _entry(entry, part)
        if isinstance(part, int) and isinstance(entry, dict):
            label = entry.get("name", entry.get("id"))
            where = f"[[{'.'.join(str(p) for p in parts[:depth])}]] number {part + 1}"
            where += f" ('{label}'): " if label is not None else ": "
    names = [str(part) for part in parts if isinstance(part, str)]
    return where, names[-1] if names else ""


def _entry(parent: Any, part: str | int) -> Any:
    if isinstance(parent, dict):
        return parent.get(part)
    if isinstance(parent, list) and isinstance(part, int) and part < len(parent):
        return parent[part]
    return None


def _fields(sections: Sections, loc: Sequence[str | int]) -> tuple[str, ...]:
    owner = ".".join(part for part in loc[:-1] if isinstance(part, str))
    return tuple(sections[owner].model_fields) if owner in sections else ()

"""Which columns each table may have: name, meaning, unit. Headers are matched exactly, after stripping white space."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from thetacomp.machine import Machine
from thetacomp.reading.problems import ProblemList, nearest, quoted
from thetacomp.reading.sources import Column, Source

TABLES = ("temperatures", "sweeps", "drift", "parameters", "duty")

Kind = Literal["time", "clock", "number", "text"]


@dataclass(frozen=True)
class Meaning:
    """What a header means: the name inside thetacomp, the kind of cells, and the factor to the unit in the name."""

    name: str
    kind: Kind = "number"
    factor: float = 1.0


@dataclass(frozen=True)
class Schema:
    """Headers of one table. Of every group in `required` one header must be there.

    `free` takes any further column as a number under its own name. `missing_is_error` names columns whose cells
    must all be filled.
    """

    known: Mapping[str, Meaning]
    required: tuple[tuple[str, ...], ...]
    filled: frozenset[str] = frozenset()
    free: bool = False
    known_hint: str = ""
    unknown_code: str = "unknown-column"


@dataclass(frozen=True)
class Matched:
    """A source whose columns are understood: meaning by meaning, the column it stands in."""

    source: Source
    columns: Mapping[str, tuple[Column, Meaning]] = field(default_factory=dict)

    def header(self, name: str) -> str | None:
        """The header under which a meaning stands in the file."""
        return self.columns[name][0].header if name in self.columns else None


TIME = {
    "t_s": Meaning("t_s", "time"),
    "t_min": Meaning("t_s", "time", 60.0),
    "t_h": Meaning("t_s", "time", 3600.0),
    "time": Meaning("t_s", "clock"),
}
_TIME_REQUIRED = tuple(TIME)
DUTY = Schema(TIME, (_TIME_REQUIRED,), free=True)
ERRORS = ("dX_um", "dY_um", "dZ_um")
ROTATIONS = ("rA_urad", "rB_urad", "rC_urad")


def _length(stem: str) -> dict[str, Meaning]:
    return {f"{stem}_um": Meaning(f"{stem}_um"), f"{stem}_mm": Meaning(f"{stem}_um", "number", 1000.0)}


def _displacement() -> dict[str, Meaning]:
    known: dict[str, Meaning] = {}
    for letter in "XYZ":
        known |= _length(f"d{letter}")
    return known | {name: Meaning(name) for name in ROTATIONS}


def _positions_of_axes(machine: Machine) -> dict[str, Meaning]:
    return {f"at_{axis.name}_mm": Meaning(f"at_{axis.name}_mm") for axis in machine.axes}


def schema(table: str, machine: Machine) -> Schema:
    """The schema of a campaign's table (see TABLES) for this machine."""
    measured = (*ERRORS, *(name.replace("_um", "_mm") for name in ERRORS), *ROTATIONS)
    if table == "temperatures":
        return temperature_schema(machine)
    if table == "sweeps":
        known = TIME | {"axis": Meaning("axis", "text"), "position_mm": Meaning("position_mm")} | _displacement()
        known |= {name: Meaning(name, "text") for name in ("direction", "run", "station")}
        required = (_TIME_REQUIRED, ("axis",), ("position_mm",), measured)
        return Schema(known | _positions_of_axes(machine), required, frozenset({"position_mm"}))
    if table == "drift":
        known = TIME | _displacement() | _positions_of_axes(machine)
        return Schema(known, (_TIME_REQUIRED, measured))
    if table == "parameters":
        known = TIME | {"component": Meaning("component", "text")} | _length("intercept")
        known |= {name: Meaning(name) for name in ("slope_um_per_m", "p0_mm", "p_min_mm", "p_max_mm")}
        single = (("component",), ("slope_um_per_m",), ("p0_mm",), ("p_min_mm",), ("p_max_mm",))
        return Schema(known, (_TIME_REQUIRED, ("intercept_um", "intercept_mm"), *single))
    return DUTY


def temperature_schema(machine: Machine) -> Schema:
    """Time and one column a sensor of the machine."""
    known = TIME | {sensor.id: Meaning(sensor.id) for sensor in machine.sensors}
    return Schema(
        known,
        (_TIME_REQUIRED, machine.sensor_ids),
        known_hint=f"one of t_s, t_min, t_h, time; sensors of machine.toml: {quoted(machine.sensor_ids, 20)}",
        unknown_code="unknown-sensor",
    )


POSITIONS = Schema(
    TIME
    | {"axis": Meaning("axis", "text"), "position_mm": Meaning("position_mm")}
    | {"tool_length_mm": Meaning("tool_length_mm")},
    (_TIME_REQUIRED,),
    known_hint="t_s (or t_min, t_h, time), axis, position_mm, tool_length_mm",
)
ANY_SENSORS = Schema(TIME, (_TIME_REQUIRED,), free=True)


def match(source: Source, wanted: Schema, problems: ProblemList) -> Matched | None:
    """Give every column its meaning. None, with the problems noted, where that fails."""
    found: dict[str, tuple[Column, Meaning]] = {}
    unknown: list[str] = []
    good = True
    for column in source.columns:
        meaning = wanted.known.get(column.header)
        if meaning is None and wanted.free:
            meaning = Meaning(column.header)
        if meaning is None:
            unknown.append(column.header)
        elif meaning.name in found:
            other = found[meaning.name][0].header
            problems.error(
                "duplicate-column",
                source.file,
                f"the columns '{other}' and '{column.header}' state the same quantity.",
                f"keep one of the two.{_time_hint(meaning)}",
                (1,),
                column.header,
            )
            good = False
        else:
            found[meaning.name] = (column, meaning)
    if unknown:
        _report_unknown(source.file, unknown, wanted, problems)
        good = False
    headers = {column.header for column in source.columns}
    return Matched(source, found) if _has_required(source.file, headers, unknown, wanted, problems) and good else None


def _time_hint(meaning: Meaning) -> str:
    return " Time is exactly one of t_s, t_min, t_h, time." if meaning.name == "t_s" else ""


def _report_unknown(file: str, unknown: Sequence[str], wanted: Schema, problems: ProblemList) -> None:
    hints = [f"'{name}'{nearest(name, wanted.known)}" for name in unknown[:8]]
    more = f" and {len(unknown) - 8} more" if len(unknown) > 8 else ""
    what = "sensor columns that machine.toml does not know" if "sensor" in wanted.unknown_code else "unknown columns"
    expected = wanted.known_hint or ", ".join(wanted.known)
    problems.error(
        wanted.unknown_code,
        file,
        f"found {what}: {', '.join(hints)}{more}; expected {expected}.",
        "rename or delete these columns"
        + (", or add the sensors to machine.toml as [[sensors]]." if "sensor" in wanted.unknown_code else "."),
        (1,),
        unknown[0],
    )


def _has_required(
    file: str, headers: Iterable[str], unknown: Sequence[str], wanted: Schema, problems: ProblemList
) -> bool:
    have = set(headers)
    good = True
    for group in wanted.required:
        if have.isdisjoint(group):
            lacking = "is none of the columns" if len(group) > 1 else "is no column"
            candidates = [f"'{name}'" for name in unknown if nearest(name, group)]
            hint = f" Perhaps {', '.join(candidates)} is meant." if candidates else ""
            code = "no-time-column" if group == _TIME_REQUIRED else "missing-column"
            problems.error(
                code,
                file,
                f"there {lacking} {quoted(group, 12)}; found {quoted(sorted(have), 12)}.{hint}",
                "add the column, with exactly this header."
                + (" See docs/machine_folder.md." if len(group) > 1 else ""),
                (1,),
            )
            good = False
    return good

"""Tables on their own, for predictions: temperatures without a machine file, and positions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.model.temperatures import Duty, Temperatures
from thetacomp.reading import campaigns
from thetacomp.reading.columns import ANY_SENSORS, DUTY, POSITIONS, Meaning, Schema, match
from thetacomp.reading.problems import ProblemList, UnreadableError
from thetacomp.reading.sources import Columns, Source, from_columns, read_source
from thetacomp.reading.tables import Table, convert
from thetacomp.reading.workbook import Workbook

SingleTable: TypeAlias = "Path | str | Columns"
"""A table of its own: the path of a file, or a table in memory."""


@dataclass(frozen=True)
class Positions:
    """Where an error is wanted, n rows: one moving axis (`axis`, `position_mm`), or all axes (`at_mm` by axis).

    `axis` is "" and `position_mm` NaN where no moving axis is named.
    """

    t_s: Floats
    axis: tuple[str, ...]
    position_mm: Floats
    tool_length_mm: Floats | None = None
    at_mm: Mapping[str, Floats] = field(default_factory=dict)


def read_temperatures(table: SingleTable) -> Temperatures:
    """Read a temperature table of any format; every column but time is a sensor. Raises InputError.

    Absolute times (`time`) count in seconds from 1970-01-01, so that they agree with those of `read_positions`.
    """
    problems = ProblemList()
    found = _table(table, "temperatures", lambda source: ANY_SENSORS, problems)
    data = campaigns.temperatures(found, 0, None, problems) if found is not None else None
    problems.raise_errors()
    assert data is not None
    return data


def read_duty(table: SingleTable) -> Duty:
    """Read a duty table (`spindle_rpm`, `feed_mm_min`, …). Raises InputError.

    Absolute times (`time`) count in seconds from 1970-01-01, so that they agree with those of `read_temperatures`.
    """
    problems = ProblemList()
    found = _table(table, "duty", lambda source: DUTY, problems)
    data = campaigns.duty(found, 0, problems) if found is not None else None
    problems.raise_errors()
    assert data is not None
    return data


def read_positions(table: SingleTable) -> Positions:
    """Read positions: time, then `axis` and `position_mm`, or `<axis>_mm` columns, optional `tool_length_mm`.

    Absolute times (`time`) count in seconds from 1970-01-01. Raises InputError.
    """
    problems = ProblemList()
    found = _table(table, "positions", _positions_schema, problems)
    data = _positions(found, problems) if found is not None else None
    problems.raise_errors()
    assert data is not None
    return data


def _table(table: SingleTable, name: str, wanted: Callable[[Source], Schema], problems: ProblemList) -> Table | None:
    """A table in memory or of a file of its own; of a workbook the sheet of that name, else the first."""
    try:
        if isinstance(table, Path | str):
            path, sheet = Path(table), None
            if path.suffix.lower() == ".xlsx":
                sheet = next((s for s in Workbook(path).sheets if s.strip().lower() == name), None)
            source = read_source(path, path.name, sheet)
        else:
            source = from_columns(table, name)
    except UnreadableError as refusal:
        problems.refuse(Path(table).name if isinstance(table, Path | str) else name, refusal)
        return None
    schema = wanted(source)
    matched = match(source, schema, problems)
    return None if matched is None else convert(name, matched, schema, problems)


def _positions_schema(source: Source) -> Schema:
    headers = [column.header for column in source.columns]
    axes = {
        header: Meaning(header)
        for header in headers
        if header.endswith("_mm") and header != "_mm" and header not in POSITIONS.known
    }
    pair = ("axis", "position_mm")
    required = (
        POSITIONS.required if axes and not set(pair) & set(headers) else (*POSITIONS.required, *((p,) for p in pair))
    )
    return Schema(dict(POSITIONS.known) | axes, required, known_hint=POSITIONS.known_hint)


def _positions(table: Table, problems: ProblemList) -> Positions:
    n = len(table.rows)
    axis = table.texts.get("axis", ("",) * n)
    position = table.numbers.get("position_mm", np.full(n, np.nan))
    lost = [i for i in range(n) if axis[i] and np.isnan(position[i])]
    if lost:
        problems.error(
            "missing-value",
            table.file,
            f"the axis is {axis[lost[0]]}, but the position is empty.",
            "fill in the position in mm.",
            table.rows[lost].tolist(),
            table.header("position_mm"),
        )
    beside = [name for name in table.numbers if name.endswith("_mm") and name not in ("position_mm", "tool_length_mm")]
    if any(axis) and beside:
        problems.error(
            "two-forms",
            table.file,
            f"an axis with position_mm stands beside {', '.join(beside)}.",
            "give either t_s, axis, position_mm, or t_s and one column for each axis.",
            [int(table.rows[0])],
        )
    at_mm = {
        name.removesuffix("_mm"): values
        for name, values in table.numbers.items()
        if name not in ("position_mm", "tool_length_mm")
    }
    return Positions(table.t_s(0), axis, position, table.numbers.get("tool_length_mm"), at_mm)

"""Cells to numbers: one matched table becomes float arrays in the units of their names, or problems."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta
from numbers import Real
from typing import Any

import numpy as np

from thetacomp.arrays import Floats, Ints
from thetacomp.reading import text
from thetacomp.reading.columns import Matched, Schema, match
from thetacomp.reading.problems import ProblemList, UnreadableError, shortened
from thetacomp.reading.sources import EXCEL_ERROR, Column, Source
from thetacomp.safe_names import name_fault

_ISO = re.compile(r"\d{4}-\d\d-\d\d([T ]\d\d:\d\d(:\d\d([.,]\d{1,9})?)?(Z|[+-]\d\d(:?\d\d)?)?)?", re.ASCII)
_DAY_MONTH = re.compile(r"(\d{1,2})([./-])(\d{1,2})\2(\d{4}|\d\d)\b.*", re.ASCII)
_NUMBER = re.compile(r"[+-]?\d+([.,]\d+)?", re.ASCII)
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_MONTHS = (
    *("January", "February", "March", "April", "May", "June"),
    *("July", "August", "September", "October", "November", "December"),
)
_MICROSECOND = timedelta(microseconds=1)


@dataclass(frozen=True)
class Clock:
    """A column of absolute times: `micros` since 1970 (UTC, or local time where no zone is given)."""

    micros: Ints
    first: datetime

    @property
    def has_zone(self) -> bool:
        """Whether the times carry a time zone."""
        return self.first.tzinfo is not None

    @property
    def first_micros(self) -> int:
        """The earliest time, in µs since 1970."""
        return int(self.micros.min())


@dataclass(frozen=True)
class Table:
    """One table as numbers. `elapsed_s` is None where the table has absolute times (`clock`), and the other way."""

    name: str
    matched: Matched
    elapsed_s: Floats | None
    clock: Clock | None
    numbers: Mapping[str, Floats]
    texts: Mapping[str, tuple[str, ...]]

    @property
    def file(self) -> str:
        """The file as it is named in messages."""
        return self.matched.source.file

    @property
    def rows(self) -> Ints:
        """Spreadsheet rows (header = 1)."""
        return self.matched.source.rows

    def header(self, name: str) -> str | None:
        """The header of a meaning in the user's file."""
        return self.matched.header(name)

    def t_s(self, start_micros: int) -> Floats:
        """Seconds since the start of the campaign; `start_micros` counts for absolute times only."""
        if self.clock is not None:
            return (self.clock.micros - start_micros) / 1e6
        assert self.elapsed_s is not None
        return self.elapsed_s

    def stacked(self, names: Sequence[str]) -> Floats:
        """Columns side by side, NaN for those that the table does not have."""
        missing = np.full(len(self.rows), np.nan)
        return np.column_stack([self.numbers.get(name, missing) for name in names])


def load(get_source: Callable[[], Source], file: str, name: str, wanted: Schema, problems: ProblemList) -> Table | None:
    """Read, match and convert one table. None, with the problems noted, where there are errors in it."""
    try:
        source = get_source()
    except UnreadableError as refusal:
        problems.refuse(file, refusal)
        return None
    matched = match(source, wanted, problems)
    return None if matched is None else convert(name, matched, wanted, problems)


def convert(name: str, matched: Matched, wanted: Schema, problems: ProblemList) -> Table | None:
    """Numbers, texts and times of a matched table. None, with the problems noted, where a cell cannot be read."""
    source = matched.source
    try:
        sign = _decimal_sign(matched)
    except UnreadableError as refusal:
        problems.refuse(source.file, refusal)
        return None
    numbers: dict[str, Floats] = {}
    texts: dict[str, tuple[str, ...]] = {}
    elapsed, clock, good = None, None, True
    for canonical, (column, meaning) in matched.columns.items():
        if meaning.kind == "text":
            texts[canonical] = tuple(_as_text(cell) for cell in _plain(column))
            good &= canonical == "direction" or _are_names(source, column, texts[canonical], problems)
            continue
        if meaning.kind == "clock":
            clock = _clock(source, column, problems)
            good &= clock is not None
            continue
        values = _numbers(source, column, sign, problems)
        if values is None:
            good = False
            continue
        values = values * meaning.factor
        if meaning.kind == "time":
            elapsed = values
        else:
            numbers[canonical] = values
        if meaning.kind == "time" or canonical in wanted.filled:
            good &= _is_filled(source, column, values, problems)
    return Table(name, matched, elapsed, clock, numbers, texts) if good else None


def _are_names(source: Source, column: Column, texts: Sequence[str], problems: ProblemList) -> bool:
    """No text that can reach an output table may be a formula; a run or target called -1 is a number."""
    wrong = [i for i, cell in enumerate(texts) if name_fault(cell) and not _NUMBER.fullmatch(cell)]
    if wrong:
        problems.error(
            "name",
            source.file,
            f"found {texts[wrong[0]]!r}: {name_fault(texts[wrong[0]])}.",
            "give it another name.",
            source.rows[wrong].tolist(),
            column.header,
        )
    return not wrong


def _decimal_sign(matched: Matched) -> str:
    if matched.source.delimiter is None:
        return "."
    columns: dict[str, Sequence[str]] = {
        column.header: column.cells  # type: ignore[misc]
        for column, meaning in matched.columns.values()
        if meaning.kind in ("number", "time")
    }
    return text.decimal_sign(columns, matched.source.rows, matched.source.delimiter)


def _plain(column: Column) -> Iterator[Any]:
    """Cells as Python objects; a missing one is ''."""
    cells = column.cells.tolist() if isinstance(column.cells, np.ndarray) else column.cells
    for cell in cells:
        missing = cell is None or (isinstance(cell, float | datetime) and cell != cell)  # NaN and NaT
        yield "" if missing else cell


def _as_text(cell: Any) -> str:
    """A name such as a run number reads the same from a text file and from a numeric spreadsheet cell."""
    if isinstance(cell, float) and cell.is_integer():
        return str(int(cell))
    return str(cell).strip()


def _numbers(source: Source, column: Column, sign: str, problems: ProblemList) -> Floats | None:
    if isinstance(column.cells, np.ndarray):
        values, bad = column.cells, np.flatnonzero(np.isinf(column.cells)).tolist()
    elif source.delimiter is not None:
        values, bad = text.to_floats(column.cells, sign)
    else:
        values, bad = _typed_floats(list(_plain(column)))
    if not bad:
        return values
    cells = list(_plain(column))
    kinds: dict[str, tuple[str, str, list[int]]] = {}
    for i in bad:
        code, message, fix = _explained(cells[i], source.delimiter is not None)
        kinds.setdefault(code, (message, fix, []))[2].append(int(source.rows[i]))
    for code, (message, fix, rows) in kinds.items():
        problems.error(code, source.file, message, fix, rows, column.header)
    return None


def _typed_floats(cells: list[Any]) -> tuple[Floats, list[int]]:
    values = np.full(len(cells), np.nan)
    bad = []
    for i, cell in enumerate(cells):
        if isinstance(cell, Real) and not isinstance(cell, bool):
            try:
                values[i] = float(cell)
            except OverflowError:
                values[i] = np.inf
            if np.isinf(values[i]):
                bad.append(i)
        elif not (isinstance(cell, str) and cell.lower() in ("", "nan")):
            bad.append(i)
    return values, bad


def _explained(cell: Any, is_text_file: bool) -> tuple[str, str, str]:
    """Code, message and fix for a cell that should have been a number."""
    shown = shortened(cell)
    leave_empty = "write the number, or leave the cell empty where the value is missing."
    if isinstance(cell, date | time | timedelta):
        return (
            "date-cell",
            f"found '{shown}' ({type(cell).__name__}), expected a number: spreadsheets turn some numbers into dates.",
            "format the column as a number and enter the values again; absolute times belong into a column `time`.",
        )
    if not isinstance(cell, str):
        return "not-a-number", f"found '{shown}', expected a finite number.", leave_empty
    if EXCEL_ERROR.fullmatch(cell):
        return (
            "formula-error",
            f"found the formula error '{shown}', expected a number.",
            f"correct the formula, or {leave_empty}",
        )
    if _ISO.fullmatch(cell) or _DAY_MONTH.fullmatch(cell):
        return (
            "date-cell",
            f"found the date '{shown}', expected a number.",
            "absolute times belong into a column `time` (ISO 8601, like 2026-03-04T10:00:00).",
        )
    if not is_text_file and re.fullmatch(r"[+-]?[\d.,\s]+([eE][+-]?\d+)?", cell):
        return (
            "number-as-text",
            f"found the number '{shown}' stored as text, expected a number cell.",
            "convert the cells to numbers (in Excel: select them, click the warning sign, 'Convert to Number').",
        )
    if re.fullmatch(r"[+-]?\d{1,3}([ '’\u00a0\u202f]\d{3})+([.,]\d+)?", cell):
        return "thousands", f"found '{shown}' with thousands separators.", "write it without them, like 1234.5."
    if re.match(r"[+-]?\d[\d.,]*\s*[^\d\s.,]+$", cell):
        return "not-a-number", f"found '{shown}', expected a number alone.", "take the unit out of the cell."
    return "not-a-number", f"found '{shown}', expected a number.", leave_empty


def _is_filled(source: Source, column: Column, values: Floats, problems: ProblemList) -> bool:
    empty = np.isnan(values)
    if empty.any():
        problems.error(
            "missing-value",
            source.file,
            "the cell is empty, expected a number in every row.",
            "fill it in, or delete the row.",
            source.rows[empty].tolist(),
            column.header,
        )
    return not empty.any()


def _clock(source: Source, column: Column, problems: ProblemList) -> Clock | None:
    times: list[datetime] = []
    bad: dict[str, tuple[str, str, list[int]]] = {}
    for cell, row in zip(_plain(column), source.rows.tolist(), strict=True):
        moment = _moment(cell)
        if moment is None:
            code, message, fix = _explained_time(cell)
            bad.setdefault(code, (message, fix, []))[2].append(row)
        else:
            times.append(moment)
    for code, (message, fix, rows) in bad.items():
        problems.error(code, source.file, message, fix, rows, column.header)
    if bad:
        return None
    zones = {moment.tzinfo is not None for moment in times}
    if len(zones) > 1:
        problems.error(
            "time-zone",
            source.file,
            "some times carry a time zone and some do not.",
            "write all times in one way, with or without zone.",
            (),
            column.header,
        )
        return None
    utc = [moment if moment.tzinfo else moment.replace(tzinfo=UTC) for moment in times]
    micros = np.array([(moment - _EPOCH) // _MICROSECOND for moment in utc], dtype=np.int64)
    return Clock(micros, times[int(np.argmin(micros))])


def _moment(cell: Any) -> datetime | None:
    if isinstance(cell, datetime):
        return cell
    if isinstance(cell, date):
        return datetime(cell.year, cell.month, cell.day)
    if isinstance(cell, str) and _ISO.fullmatch(cell):
        try:
            return datetime.fromisoformat(cell)
        except ValueError:
            return None
    return None


def _explained_time(cell: Any) -> tuple[str, str, str]:
    shown = shortened(cell)
    iso = "write it as ISO 8601, like 2026-03-04T10:00:00"
    if cell == "":
        return "missing-value", "the time is empty.", "fill it in, or delete the row."
    parts = _DAY_MONTH.fullmatch(cell) if isinstance(cell, str) else None
    if parts:
        first, second, year = int(parts[1]), int(parts[3]), parts[4]
        readings = [
            f"{day} {_MONTHS[month - 1]} {year}"
            for day, month in ((first, second), (second, first))
            if 1 <= month <= 12 and 1 <= day <= 31
        ]
        return (
            "day-month-order",
            f"found '{shown}', which may mean {' or '.join(dict.fromkeys(readings)) or 'no date at all'}:"
            " the order of day and month is not the same in all countries.",
            f"{iso} (in Excel: format the cells as yyyy-mm-dd hh:mm:ss before exporting).",
        )
    if isinstance(cell, int | float):
        return (
            "not-a-time",
            f"found the number {shown}, expected a date and time.",
            f"{iso}; for elapsed time name the column t_s, t_min or t_h.",
        )
    return "not-a-time", f"found '{shown}', expected a date and time in ISO 8601.", f"{iso}."

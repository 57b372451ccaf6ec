"""Collects everything wrong or doubtful in the user's files, so that all of it is reported at once."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Literal

from thetacomp.errors import InputError, Problem

Severity = Literal["error", "warning"]

SHOWN_ROWS = 3
SHOWN_OF_A_KIND = 3


class UnreadableError(Exception):
    """A file or table that cannot be read any further. It becomes one Problem where the file name is known."""

    def __init__(
        self, code: str, message: str, fix: str, rows: Sequence[int] = (), column: str | None = None, file: str = ""
    ) -> None:
        super().__init__(message)
        self.code, self.message, self.fix, self.rows, self.column, self.file = code, message, fix, rows, column, file


class ProblemList:
    """Grows while a folder is read. `rows` are spreadsheet rows: the header is row 1."""

    def __init__(self) -> None:
        self._found: list[Problem] = []

    def add(
        self,
        severity: Severity,
        code: str,
        file: str,
        message: str,
        fix: str,
        rows: Sequence[int] = (),
        column: str | None = None,
    ) -> None:
        """Note one problem. Several rows with the same problem are reported once, with their count."""
        if len(rows) > 1:
            shown = ", ".join(str(int(row)) for row in rows[:SHOWN_ROWS])
            more = ", …" if len(rows) > SHOWN_ROWS else ""
            message += f" The same in {len(rows)} rows in all: {shown}{more}."
        row = int(rows[0]) if len(rows) else None
        self._found.append(Problem(severity, code, file, message, fix, row, column))

    def error(
        self, code: str, file: str, message: str, fix: str, rows: Sequence[int] = (), column: str | None = None
    ) -> None:
        """Note something that makes the data unusable."""
        self.add("error", code, file, message, fix, rows, column)

    def warning(
        self, code: str, file: str, message: str, fix: str, rows: Sequence[int] = (), column: str | None = None
    ) -> None:
        """Note something doubtful that does not stop the reading."""
        self.add("warning", code, file, message, fix, rows, column)

    def refuse(self, file: str, refusal: UnreadableError) -> None:
        """Note why a file could not be read any further."""
        self.error(refusal.code, refusal.file or file, refusal.message, refusal.fix, refusal.rows, refusal.column)

    def extend(self, other: ProblemList) -> None:
        """Take over everything another list found."""
        self._found.extend(other._found)

    def drop(self, code: str) -> None:
        """Drop all problems of a kind: a better one says the same."""
        self._found = [problem for problem in self._found if problem.code != code]

    @property
    def has_errors(self) -> bool:
        """Whether anything found so far is an error."""
        return any(problem.severity == "error" for problem in self._found)

    def has(self, code: str) -> bool:
        """Whether a problem of this kind was found."""
        return any(problem.code == code for problem in self._found)

    def collected(self) -> tuple[Problem, ...]:
        """All problems, errors first; more than three of a kind in one file become three and a count."""
        kinds: dict[tuple[str, str, str], list[Problem]] = {}
        for problem in dict.fromkeys(self._found):
            kinds.setdefault((problem.severity, problem.code, problem.file), []).append(problem)
        told: list[Problem] = []
        for same in kinds.values():
            told.extend(same[:SHOWN_OF_A_KIND])
            hidden = same[SHOWN_OF_A_KIND:]
            if hidden:
                columns = [f"'{problem.column}'" for problem in hidden if problem.column is not None]
                where = f" (columns {', '.join(columns)})" if columns else ""
                last = told[-1]
                told[-1] = replace(last, message=f"{last.message} {len(hidden)} more of this kind{where}.")
        return tuple(sorted(told, key=lambda problem: problem.severity != "error"))

    def raise_errors(self) -> None:
        """Raise InputError with every error found so far, if there is one."""
        errors = [problem for problem in self.collected() if problem.severity == "error"]
        if errors:
            raise InputError(errors)


_BRACKETED = re.compile(r"\s*[(\[{（【]\s*([^)\]}）】]*?)\s*[)\]}）】]\s*$")
_UNITS = {"µ": "u", "μ": "u", "/": "_per_", "sec": "s", "hours": "h", "hour": "h", "std": "h", "秒": "s", "分": "min"}
_ELAPSED_WORDS = ("zeit", "time", "t", "elapsed", "时间", "時間")
_CLOCK_WORDS = ("datum", "date", "uhrzeit", "zeitstempel", "timestamp", "日期", "日時", "datetime")


def nearest(name: str, known: Iterable[str]) -> str:
    """`, did you mean 'x'?` for the nearest known name, or nothing where none is near.

    A unit in brackets does not count (`T3 (°C)`), or says which column is meant (`dX [µm]`, `Zeit [s]`).
    """
    names = list(known)
    meant = _with_unit(name, names) or _time_column(name, names)
    if meant:
        return f" (did you mean {' or '.join(repr(other) for other in meant)}?)"
    by_lower = {other.lower(): other for other in names if not _differ_in_number(name, other)}
    close = difflib.get_close_matches(name.lower(), by_lower, n=1, cutoff=0.6)
    return f" (did you mean '{by_lower[close[0]]}'?)" if close else ""


def _parted(name: str) -> tuple[str, str]:
    """A header without its bracketed unit, and the unit as our names write it; both in small letters."""
    match = _BRACKETED.search(name)
    unit = match[1].lower() if match else ""
    for found, ours in _UNITS.items():
        unit = unit.replace(found, ours)
    return (name[: match.start()] if match else name).strip().lower(), unit


def _with_unit(name: str, known: Sequence[str]) -> list[str]:
    stem, unit = _parted(name)
    if stem == name.lower() or not stem:
        return []
    by_lower = {other.lower(): other for other in known}
    candidates = (f"{stem}_{unit}", stem)
    if stem in _ELAPSED_WORDS:
        candidates = (f"t_{unit}", stem)
    return [by_lower[c] for c in candidates if c in by_lower][:1]


def _time_column(name: str, known: Sequence[str]) -> list[str]:
    """Time columns that a word for time may mean, where the table can have them."""
    stem = _parted(name)[0]
    wanted = ("t_s", "time") if stem in _ELAPSED_WORDS else ("time",) if stem in _CLOCK_WORDS else ()
    return [column for column in wanted if column in known]


def _differ_in_number(name: str, other: str) -> bool:
    """Whether two names are members of one numbered series, such as theta_1 and theta_2: no slip of the pen."""
    digits = r"\d+"
    return name != other and re.sub(digits, "", name) == re.sub(digits, "", other)


def quoted(names: Iterable[str], limit: int = 8) -> str:
    """`'a', 'b'`, cut off after `limit` names with the number of the others."""
    all_names = list(names)
    text = ", ".join(f"'{shortened(name)}'" for name in all_names[:limit])
    hidden = len(all_names) - limit
    return f"{text} and {hidden} more" if hidden > 0 else text


def shortened(value: object, length: int = 40) -> str:
    """A cell as it is shown in a message: one line, not longer than `length`."""
    text = " ".join(str(value).split())
    return text if len(text) <= length else text[: length - 1] + "…"

"""Compares the tables of two versions and tells what differs."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import SequenceMatcher
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from ruler.tables import Table

RELATIVE = 1e-9
# Typical size of a number by the end of its name: smaller numbers are compared as if they had this size.
TYPICAL = {
    "_um": 100.0, "_um_per_m": 10.0, "_um_per_m2": 10.0, "_um_per_K": 10.0, "_urad": 10.0, "_mm": 1.0, "_s": 100.0,
    "_degC": 10.0, "_K": 1.0, "_percent": 100.0,
}  # fmt: skip
SMALLEST = 1e-3  # typical size of all other numbers
SHOWN = 8  # differing rows that are printed for one quantity


@dataclass(frozen=True)
class Difference:
    """One value that differs; `where` says in which row."""

    where: str
    stored: object
    found: object
    relative: float = math.nan


@dataclass
class Quantity:
    """One column: how many values were compared, the largest relative difference, and what differs."""

    name: str
    compared: int = 0
    largest: float = 0.0
    differences: list[Difference] = field(default_factory=list)
    reason: str = ""  # why the differences are intended, where they are


@dataclass
class Report:
    """All quantities, and the names of what only the new version has."""

    quantities: list[Quantity] = field(default_factory=list)
    added: list[str] = field(default_factory=list)

    def failing(self) -> list[Quantity]:
        """Quantities that differ without a reason."""
        return [q for q in self.quantities if q.differences and not q.reason]

    def intended(self) -> list[Quantity]:
        """Quantities that differ for a reason."""
        return [q for q in self.quantities if q.differences and q.reason]


def read_intended(path: Path) -> list[tuple[str, str]]:
    """Patterns of quantities that may differ, each with the reason."""
    with path.open("rb") as file:
        entries = tomllib.load(file).get("difference", [])
    return [(entry["quantity"], entry["reason"]) for entry in entries]


def compare(
    stored: Mapping[str, Table],
    found: Mapping[str, Table],
    intended: Sequence[tuple[str, str]],
    relative: float = RELATIVE,
) -> Report:
    """Compare all tables of the same name."""
    report = Report()
    for name, table in found.items():
        if name not in stored:
            report.added.append(name)
        else:
            report.quantities += _compare_table(name, stored[name], table, relative, report.added)
    for name in stored.keys() - found.keys():
        gone = Quantity(name, stored[name].rows)
        gone.differences.append(Difference("whole table", f"{stored[name].rows} rows", "absent"))
        report.quantities.append(gone)
    report.quantities.sort(key=lambda quantity: quantity.name)
    for quantity in report.quantities:
        quantity.reason = next((why for pattern, why in intended if fnmatchcase(quantity.name, pattern)), "")
    return report


def _compare_table(name: str, stored: Table, found: Table, relative: float, added: list[str]) -> Iterable[Quantity]:
    if stored.kind == "text":
        yield _compare_lines(f"{name}:line", stored.columns["line"], found.columns.get("line", []))
        return
    pairs, lone = _matched(stored, found)
    if lone or not stored.columns:
        yield Quantity(f"{name}:rows", stored.rows, differences=lone)
    added += [f"{name}:{column}" for column in found.columns if column not in stored.columns and stored.columns]
    for column, values in stored.columns.items():
        quantity = Quantity(f"{name}:{column}", len(pairs))
        if column not in found.columns:
            quantity.differences.append(Difference("whole column", f"{len(values)} values", "absent"))
        else:
            other = found.columns[column]
            judge = _Full(column, relative) if stored.kind == "full" else _Printed(values)
            for where, i, j in pairs:
                deviation, same = judge.judge(values[i], other[j])
                quantity.largest = max(quantity.largest, deviation)
                if not same:
                    quantity.differences.append(Difference(where, values[i], other[j], deviation))
        yield quantity


def _matched(stored: Table, found: Table) -> tuple[list[tuple[str, int, int]], list[Difference]]:
    """Pairs of rows (their name, stored row, found row), and the rows without a partner."""
    ours, theirs = _row_names(stored, stored.keys), _row_names(found, stored.keys)
    pairs = [(name, i, theirs[name]) for name, i in ours.items() if name in theirs]
    lone = [Difference(name, "a row", "absent") for name in ours if name not in theirs]
    lone += [Difference(name, "absent", "a row") for name in theirs if name not in ours]
    return pairs, lone


def _row_names(table: Table, keys: Sequence[str]) -> dict[str, int]:
    """Row numbers by name: its keys, and which of the rows of these keys it is."""
    names: dict[str, int] = {}
    count: dict[str, int] = {}
    columns = [table.columns[key] for key in keys if key in table.columns]
    for row in range(table.rows):
        key = " ".join(str(column[row]) for column in columns if column[row] not in ("", None))
        count[key] = count.get(key, 0) + 1
        names[f"{key} #{count[key]}".strip()] = row
    return names


def _compare_lines(name: str, stored: list[Any], found: list[Any]) -> Quantity:
    quantity = Quantity(name, len(stored))
    for kind, i, i_end, j, j_end in SequenceMatcher(None, stored, found, autojunk=False).get_opcodes():
        if kind == "equal":
            continue
        for k in range(max(i_end - i, j_end - j)):
            ours = stored[i + k] if i + k < i_end else "absent"
            theirs = found[j + k] if j + k < j_end else "absent"
            quantity.differences.append(Difference(f"line {i + k + 1}", ours, theirs))
    return quantity


class _Full:
    """Numbers with all digits: relative to the larger one, or to the typical size of such a number."""

    def __init__(self, column: str, relative: float) -> None:
        ends = [end for end in TYPICAL if column.endswith(end) or f"{end}." in column or f"{end}[" in column]
        self.typical = TYPICAL[max(ends, key=len)] if ends else SMALLEST
        self.relative = relative

    def judge(self, stored: Any, found: Any) -> tuple[float, bool]:
        """The relative difference, and whether the two count as equal."""
        if not (_is_number(stored) and _is_number(found)):
            return 0.0, type(stored) is type(found) and stored == found
        deviation = abs(found - stored) / max(abs(stored), abs(found), self.typical)
        return deviation, deviation <= self.relative


class _Printed:
    """Numbers as printed: half a unit of the last digit that the column shows."""

    def __init__(self, column: Sequence[str]) -> None:
        numbers = [text for text in column if _number(text) is not None]
        self.decimals = max((_decimals(text) for text in numbers), default=0)
        self.digits = max((_digits(text) for text in numbers), default=1)

    def judge(self, stored: str, found: str) -> tuple[float, bool]:
        """The relative difference, and whether the two count as equal."""
        a, b = _number(stored), _number(found)
        if a is None or b is None:
            return 0.0, stored == found
        size = max(abs(a), abs(b))
        if a == b or size == 0.0:
            return 0.0, True
        # Fixed decimals: the first is larger. A fixed number of significant digits: the second is.
        unit = max(10.0**-self.decimals, 10.0 ** (math.floor(math.log10(size)) + 1 - self.digits))
        return abs(b - a) / size, abs(b - a) <= 0.5 * unit


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _decimals(text: str) -> int:
    mantissa, _, exponent = text.lower().partition("e")
    return max(0, len(mantissa.partition(".")[2]) - int(exponent or 0))


def _digits(text: str) -> int:
    mantissa = text.lower().partition("e")[0]
    return max(1, len(mantissa.replace(".", "").lstrip("+-0")))


# --- printing ---


def told(report: Report, every: bool = False) -> str:
    """The report as text: a line for each table (`every`: each column), then what differs, the intended apart."""
    lines = [f"{'quantity':<66}{'compared':>9}{'differ':>8}{'largest relative difference':>29}"]
    groups: dict[str, list[Quantity]] = {}
    for quantity in report.quantities:
        groups.setdefault(quantity.name if every else quantity.name.rpartition(":")[0] or quantity.name, []).append(
            quantity
        )
    for name, parts in groups.items():
        compared, differ = (sum(p.compared for p in parts), sum(len(p.differences) for p in parts))
        lines.append(f"{name:<66}{compared:>9}{differ:>8}{max(p.largest for p in parts):>29.2g}")
    if report.added:
        lines += ["", "Only in the new version, not compared:", *(f"  {name}" for name in sorted(report.added))]
    for title, quantities in (("Intended differences", report.intended()), ("DIFFERENCES", report.failing())):
        if quantities:
            lines += ["", f"{title}:"]
        for quantity in quantities:
            lines += _differences(quantity)
    total = sum(q.compared for q in report.quantities)
    count = sum(len(q.differences) for q in report.failing())
    aside = sum(len(q.differences) for q in report.intended())
    verdict = "EQUAL" if not count else "DIFFERENT"
    lines += ["", f"{verdict}: {total} values compared, {count} differ, {aside} differ as intended."]
    return "\n".join(lines)


def _differences(quantity: Quantity) -> list[str]:
    reason = f"   ({quantity.reason})" if quantity.reason else ""
    lines = [f"  {quantity.name}: {len(quantity.differences)} of {quantity.compared}{reason}"]
    worst = sorted(quantity.differences, key=lambda d: -d.relative if math.isfinite(d.relative) else 0.0)
    for one in worst[:SHOWN]:
        by = f"   relative {one.relative:.2g}" if one.relative > 0.0 else ""
        lines.append(f"    {one.where}: stored {one.stored!r}, found {one.found!r}{by}")
    if len(worst) > SHOWN:
        lines.append(f"    … and {len(worst) - SHOWN} more")
    return lines

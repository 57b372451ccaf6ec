"""What the program says, as tables: CSV files, JSON objects, and text (controller files, pages)."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, Literal

# full: JSON values with all digits; printed: cells as they stand in a file; text: one column of lines, compared in turn
Kind = Literal["full", "printed", "text"]
MOST_ROWS = 3000  # of a longer table every second, third … row is kept
LINE_FILES = (".ini", ".spf", ".mpf", ".ngc", ".toml")
# Columns that say what a row is about. Rows of one key are matched in their order.
KEYS = (
    *("of", "source", "campaign", "component", "axis", "model", "split", "sensor", "name", "partner", "strategy"),
    *("fault", "method", "parameter", "standard", "test", "symbol", "place", "title", "equation", "coefficient"),
    *("part", "register", "cause", "round", "lost", "kind"),
)
# In JSON: names of files and folders, and the version. They are no result.
DROPPED = {"files", "replay_files", "out", "command", "folder", "truth", "page", "thetacomp"}
# Text that changes from run to run: moments and versions.
PASSING = (
    (re.compile(r"\b\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d(\.\d+)?)?( UTC|Z|[+-]\d\d:\d\d)?"), "<moment>"),
    (re.compile(r"\bthetacomp \d+\.\d+\S*"), "thetacomp <version>"),
)


@dataclass(frozen=True)
class Table:
    """Columns of equal length. `keys` are the columns that identify a row."""

    kind: Kind
    columns: dict[str, list[Any]]
    keys: tuple[str, ...] = ()

    @property
    def rows(self) -> int:
        """Number of rows."""
        return max(map(len, self.columns.values()), default=0)


def steady(text: str) -> str:
    """Text without moments and versions."""
    for pattern, instead in PASSING:
        text = pattern.sub(instead, text)
    return text


def thinned(table: Table) -> Table:
    """Every k-th row of a long table."""
    step = -(-table.rows // MOST_ROWS)
    if step < 2 or table.kind == "text":
        return table
    return Table(table.kind, {name: values[::step] for name, values in table.columns.items()}, table.keys)


def from_csv(path: Path) -> Table:
    """A CSV file with a header."""
    with path.open(encoding="utf-8", newline="") as file:
        head, *rows = list(csv.reader(file)) or [[]]
    columns = {name: [steady(row[k]) for row in rows] for k, name in enumerate(head)}
    return thinned(Table("printed", columns, tuple(key for key in KEYS if key in columns)))


def from_lines(text: str) -> Table:
    """The lines of a text that are not empty."""
    lines = (steady(line.rstrip()) for line in text.splitlines())
    return Table("text", {"line": [line for line in lines if line]})


class _Words(HTMLParser):
    """Collects the visible text of a page, one entry for each element."""

    HIDDEN = ("script", "style", "svg")

    def __init__(self) -> None:
        super().__init__()
        self.hidden = 0
        self.lines: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.hidden += tag in self.HIDDEN

    def handle_endtag(self, tag: str) -> None:
        self.hidden -= tag in self.HIDDEN

    def handle_data(self, data: str) -> None:
        if not self.hidden and data.strip():
            self.lines.append(" ".join(data.split()))


def from_page(text: str) -> Table:
    """The visible words of an HTML page, pictures left out."""
    words = _Words()
    words.feed(text)
    return from_lines("\n".join(words.lines))


def from_folder(name: str, folder: Path) -> dict[str, Table]:
    """All tables, controller files and pages of a folder, by their path below it."""
    found = {}
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        title = f"{name}/{path.relative_to(folder).as_posix()}"
        if path.suffix == ".csv":
            found[title] = from_csv(path)
        elif path.suffix in LINE_FILES:
            found[title] = from_lines(path.read_text(encoding="utf-8"))
        elif path.suffix == ".html":
            found[title] = from_page(path.read_text(encoding="utf-8"))
    return found


def from_json(name: str, document: Mapping[str, Any]) -> dict[str, Table]:
    """A JSON object as tables: one row of single values, and one table for every list in it, however deep."""
    tables: dict[str, Table] = {}
    _add(tables, name, [dict(document)])
    return {title: thinned(table) for title, table in tables.items()}


def _add(tables: dict[str, Table], name: str, items: Sequence[Mapping[str, Any]]) -> None:
    """Add the table of `items`, then those of the lists in them; `of` says which row a list belongs to."""
    rows: list[dict[str, Any]] = []
    lists: dict[str, list[dict[str, Any]]] = {}
    for k, item in enumerate(items):
        row: dict[str, Any] = {}
        inner = dict(_leaves("", item, row))
        rows.append(row)
        label = " ".join(str(row[key]) for key in KEYS if isinstance(row.get(key), str)) or str(k)
        for path, entries in inner.items():
            wrapped = (entry if isinstance(entry, dict) else {"value": entry} for entry in entries)
            lists.setdefault(path, []).extend({**entry, "of": label} for entry in wrapped)
    names = dict.fromkeys(column for row in rows for column in row)
    columns = {column: [row.get(column) for row in rows] for column in names}
    keys = tuple(key for key in KEYS if key in columns and not any(isinstance(v, float) for v in columns[key]))
    tables[name] = Table("full", columns, keys if len(rows) > 1 or "of" in keys else ())
    for path, entries in lists.items():
        _add(tables, f"{name}/{path}", entries)


def _leaves(prefix: str, item: Mapping[str, Any], row: dict[str, Any]) -> Iterable[tuple[str, list[Any]]]:
    """Put single values into `row`, objects flattened with dots; yield the lists with their paths."""
    for key, value in item.items():
        if key in DROPPED:
            continue
        path = f"{prefix}.{key}" if prefix else str(key)
        if isinstance(value, dict):
            yield from _leaves(path, value, row)
        elif isinstance(value, list):
            yield path, value
        else:
            row[path] = steady(value) if isinstance(value, str) else value

"""Published correlation tables: names of rows in the first column, names of columns in the header."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.campaign import CorrelationTable
from thetacomp.reading.columns import Matched, Meaning, Schema
from thetacomp.reading.problems import ProblemList, UnreadableError
from thetacomp.reading.sources import read_source
from thetacomp.reading.tables import Table, convert
from thetacomp.safe_names import name_fault

_ROW = "row"


def read_correlations(path: Path) -> CorrelationTable:
    """Read a correlation table of any format. An empty cell is NaN; a lower triangle is mirrored.

    Raises InputError, among others for values outside -1 to 1.
    """
    problems = ProblemList()
    table = correlation_table(Path(path), Path(path).name, problems)
    problems.raise_errors()
    assert table is not None
    return table


def correlation_table(path: Path, file: str, problems: ProblemList) -> CorrelationTable | None:
    """The same with the problems noted; None where there are errors."""
    try:
        source = read_source(path, file, row_names=True)
    except UnreadableError as refusal:
        problems.refuse(file, refusal)
        return None
    first, *others = source.columns
    if not others:
        problems.error("missing-column", file, "there is one column only.", "add the columns of the table.", (1,))
        return None
    columns = {_ROW: (first, Meaning(_ROW, "text"))} | {c.header: (c, Meaning(c.header)) for c in others}
    table = convert("correlations", Matched(source, columns), Schema({}, ()), problems)
    if table is None:
        return None
    names = tuple(column.header for column in others)
    rows = table.texts[_ROW]
    value = table.stacked(names)
    good = _rows_named(table, rows, problems) & _in_range(table, names, value, problems)
    if good and set(rows) == set(names):
        good = _mirror(table, rows, names, value, problems)
    return CorrelationTable(rows, names, value) if good else None


def _rows_named(table: Table, rows: tuple[str, ...], problems: ProblemList) -> bool:
    faults = [f"{name!r}: {name_fault(name)}" for name in table.numbers if name_fault(name)]
    if faults:
        problems.error("name", table.file, f"found the column {faults[0]}.", "give it another name.", (1,))
    wrong = [i for i, name in enumerate(rows) if not name or name in rows[:i]]
    if wrong:
        problems.error(
            "row-name",
            table.file,
            f"the row name '{rows[wrong[0]]}' is empty or stands twice.",
            "give every row a name of its own in the first column.",
            table.rows[wrong].tolist(),
            table.header(_ROW),
        )
    return not wrong and not faults


def _in_range(table: Table, names: tuple[str, ...], value: Floats, problems: ProblemList) -> bool:
    for j in np.flatnonzero((np.abs(value) > 1).any(axis=0)):
        where = np.flatnonzero(np.abs(value[:, j]) > 1)
        problems.error(
            "correlation-range",
            table.file,
            f"found {value[where[0], j]:g}, expected a correlation from -1 to 1.",
            "correct the value (a percentage? a lost decimal point?).",
            table.rows[where].tolist(),
            names[j],
        )
    return not (np.abs(value) > 1).any()


def _mirror(table: Table, rows: tuple[str, ...], names: tuple[str, ...], value: Floats, problems: ProblemList) -> bool:
    """Fill each empty cell of a square table from its mirror image; both given must agree."""
    good = True
    for i, row in enumerate(rows):
        for j, name in enumerate(names):
            mirror = value[rows.index(name), names.index(row)]
            if np.isnan(value[i, j]):
                value[i, j] = mirror
            elif abs(value[i, j] - mirror) > 0.01:
                problems.error(
                    "correlation-symmetry",
                    table.file,
                    f"{row} with {name} is {value[i, j]:g}, but {name} with {row} is {mirror:g}.",
                    "correct one of the two, or leave the upper triangle empty.",
                    [int(table.rows[i])],
                    name,
                )
                good = False
    return good

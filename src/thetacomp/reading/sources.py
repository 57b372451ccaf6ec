"""One table as it stands in a file or frame, before its columns are understood: CSV, .xlsx sheet, Parquet, pandas."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from thetacomp.arrays import Floats, Ints
from thetacomp.extras import require
from thetacomp.reading import text
from thetacomp.reading.problems import UnreadableError, quoted, shortened
from thetacomp.reading.workbook import Workbook

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

Columns: TypeAlias = "pd.DataFrame | Mapping[str, ArrayLike]"
"""A table in memory: a pandas DataFrame, or its columns by name."""

ROW_NAMES = "row names"
EXCEL_ERROR = re.compile(r"#[A-ZÄÖÜ0-9/]+[!?]?")  # #DIV/0!, #N/A, #WERT!, …

# Numbers, dates and times; a name such as T1 or E5 starts with a letter and is none.
_NUMERIC = re.compile(r"(?=[^\d]*\d)[\d.,+-][\d.,:eETZ\s+-]*")


@dataclass(frozen=True)
class Column:
    """One column: `cells` are stripped strings (text files), a float array, or a list of what the file holds."""

    header: str
    cells: Floats | Sequence[Any]


@dataclass(frozen=True)
class Source:
    """A table. `rows` are spreadsheet rows (header = 1); `delimiter` is None where cells have types of their own."""

    file: str
    columns: tuple[Column, ...]
    rows: Ints
    delimiter: str | None = None


def read_source(path: Path, file: str, sheet: str | None = None, row_names: bool = False) -> Source:
    """The table of a .csv, .parquet or .xlsx file (`sheet`: default the first). Raises UnreadableError.

    With `row_names` the first column needs no header.
    """
    kind = path.suffix.lower()
    if kind == ".parquet":
        return _from_parquet(path, file)
    if kind == ".xlsx":
        workbook = Workbook(path)
        return from_sheet(workbook, sheet or workbook.sheets[0], file, row_names)
    if kind == ".csv":
        delimiter, rows = text.split(text.decode(text.read_bytes(path)))
        return _from_grid(rows, file, delimiter, row_names)
    raise UnreadableError(
        "unknown-format", f"found the ending '{path.suffix}', expected .csv, .xlsx or .parquet.", "export it as CSV."
    )


def from_sheet(workbook: Workbook, sheet: str, file: str, row_names: bool = False) -> Source:
    """One sheet of a workbook. Raises UnreadableError, among others for formulas without a result."""
    source = _from_grid(workbook.cells(sheet), file, None, row_names)
    workbook.refuse_broken_formulas(sheet)
    return source


def from_columns(table: Columns, file: str) -> Source:
    """A table in memory; an index that is named like a time column counts as a column. Raises UnreadableError."""
    if isinstance(table, Mapping):
        names, cells = list(table), [_array_cells(column) for column in table.values()]
    else:
        frame = table.reset_index() if table.index.name is not None else table
        names, cells = list(frame.columns), [_series_cells(frame.iloc[:, i]) for i in range(frame.shape[1])]
    names = [str(name).strip() for name in names]
    _refuse_duplicates(names)
    lengths = {len(column) for column in cells}
    if len(lengths) > 1:
        raise UnreadableError(
            "ragged-rows",
            f"found columns of {' and '.join(map(str, sorted(lengths)))} values.",
            "give every column as many values; a missing one is NaN.",
        )
    return _typed_source([Column(*pair) for pair in zip(names, cells, strict=True)], max(lengths, default=0), file)


def _array_cells(column: ArrayLike) -> Floats | list[Any]:
    """Numbers as floats; times, strings and everything else as Python objects."""
    array = np.atleast_1d(np.asarray(column))
    if array.dtype.kind in "iuf" and array.ndim == 1:
        return array.astype(np.float64)
    cells = (array.astype("datetime64[us]") if array.dtype.kind == "M" else array).tolist()
    return [cell.strip() if isinstance(cell, str) else cell for cell in cells]


def _series_cells(series: pd.Series[Any]) -> Floats | list[Any]:
    """The same of a pandas series, NaN or None for a missing value."""
    import pandas as pd

    objects = zip(series.astype(object).tolist(), series.isna().tolist(), strict=True)
    cells: list[Any] = [None if missing else cell for cell, missing in objects]
    if all(cell is None or (isinstance(cell, int | float | Decimal) and not isinstance(cell, bool)) for cell in cells):
        with suppress(OverflowError):  # an integer beyond a float stays what it is, and is told with its row
            return np.array([np.nan if cell is None else float(cell) for cell in cells])
    # A pandas Timestamp counts nanoseconds, a datetime microseconds.
    cells = [cell.to_pydatetime(warn=False) if isinstance(cell, pd.Timestamp) else cell for cell in cells]
    return [cell.strip() if isinstance(cell, str) else cell for cell in cells]


def _from_parquet(path: Path, file: str) -> Source:
    require("parquet")
    import pyarrow as pa
    import pyarrow.parquet as pq

    data = text.read_bytes(path)
    try:
        table = pq.read_table(pa.BufferReader(data))
    except (pa.ArrowException, OSError, ValueError) as exc:
        raise UnreadableError(
            "binary-file",
            f"the file is no Parquet file or it is damaged ({shortened(exc, 80)}).",
            "write it again, for example with pandas `to_parquet`.",
        ) from None
    _refuse_duplicates([name.strip() for name in table.column_names])
    columns = [
        Column(name.strip(), _arrow_cells(array, name))
        for name, array in zip(table.column_names, table.columns, strict=True)
    ]
    return _typed_source(columns, table.num_rows, file)


def _typed_source(columns: list[Column], rows: int, file: str) -> Source:
    if not columns or not rows:
        raise _empty()
    return Source(file, tuple(columns), np.arange(2, rows + 2, dtype=np.int64))


def _arrow_cells(array: pa.Array | pa.ChunkedArray, name: str) -> Floats | list[Any]:
    """Numbers as floats with NaN for null; times, strings and everything else as Python objects."""
    import pyarrow as pa

    kind = array.type
    try:
        if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind):
            return np.asarray(array.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False), dtype=np.float64)
        if pa.types.is_timestamp(kind):
            array = array.cast(pa.timestamp("us", tz=kind.tz), safe=False)
        return [cell.strip() if isinstance(cell, str) else cell for cell in array.to_pylist()]
    except (pa.ArrowException, ValueError, OverflowError, TypeError) as exc:
        raise UnreadableError(
            "cell-type",
            f"the cells of type {kind} cannot be read ({shortened(exc, 60)}).",
            "write numbers as float, times as timestamps and names as strings.",
            column=name,
        ) from None


def _from_grid(grid: Sequence[Sequence[Any]], file: str, delimiter: str | None, row_names: bool = False) -> Source:
    """Header and columns of rows of cells; an empty cell is ''."""
    filled = [(number, row) for number, row in enumerate(grid, start=1) if any(cell != "" for cell in row)]
    if not filled:
        raise UnreadableError("empty-file", "the table is empty.", "export the table again, or delete it.")
    number, header_cells = filled[0]
    body = filled[1:]
    header = [_header(cell) for cell in header_cells]
    while header and not header[-1] and all(_blank(row, len(header) - 1) for _, row in body):
        header.pop()
    if row_names and header and not header[0]:
        header[0] = ROW_NAMES
    _refuse_comments(filled)
    _refuse_no_header(header, header_cells, number, body)
    _refuse_duplicates(header)
    _refuse_ragged(body, len(header), delimiter)
    if not body:
        raise _empty()
    columns = list(zip(*(row[: len(header)] for _, row in body), strict=True))
    kept = []
    for name, cells in zip(header, columns, strict=True):
        if name:
            kept.append(Column(name, list(cells)))
        elif any(cell != "" for cell in cells):
            raise UnreadableError(
                "unnamed-column",
                f"a column without a header holds data, such as '{next(cell for cell in cells if cell != '')}'.",
                "give every column a header, or delete it; check that the header has as many cells as the rows.",
                rows=(number,),
            )
    return Source(file, tuple(kept), np.array([number for number, _ in body], dtype=np.int64), delimiter)


def _blank(row: Sequence[Any], place: int) -> bool:
    return place >= len(row) or row[place] == ""


def _header(cell: Any) -> str:
    return " ".join(str(cell).split())


def _empty() -> UnreadableError:
    return UnreadableError(
        "empty-table", "the table has a header but no rows.", "export it with its data, or delete it."
    )


def _refuse_comments(filled: Sequence[tuple[int, Sequence[Any]]]) -> None:
    rows = [
        number
        for number, row in filled
        if isinstance(row[0], str) and row[0].startswith("#") and not EXCEL_ERROR.fullmatch(row[0])
    ]
    if rows:
        raise UnreadableError(
            "comment-line",
            "found a line that starts with '#': comment lines are not read.",
            "delete the line (notes can go into campaign.toml as `origin` or into a README.md).",
            rows=rows,
        )


def _refuse_no_header(
    header: Sequence[str], header_cells: Sequence[Any], number: int, body: Sequence[tuple[int, Sequence[Any]]]
) -> None:
    first_line = "make the header with the column names the first line, directly followed by the data."
    if number > 1:
        raise UnreadableError("header", "the first line is empty, expected the header.", first_line, rows=(1,))
    if all(not isinstance(cell, str) or cell == "" or _NUMERIC.fullmatch(cell) for cell in header_cells):
        raise UnreadableError(
            "header", f"found the numbers {quoted(header, 4)} in the first line, expected the header.", first_line, (1,)
        )
    if sum(bool(name) for name in header) != 1:
        return
    widest = max((sum(cell != "" for cell in row) for _, row in body), default=0)
    if widest > 1:
        raise UnreadableError(
            "header",
            f"found only '{shortened(header_cells[0] or header[-1])}' in the first line, but up to {widest} cells"
            " below: a title above the header?",
            first_line,
            (1,),
        )


def _refuse_duplicates(header: Sequence[str]) -> None:
    twice = sorted({name for name in header if name and header.count(name) > 1})
    if twice:
        raise UnreadableError(
            "duplicate-column",
            f"the column {quoted(twice)} stands twice in the header.",
            "keep one of the two.",
            (1,),
            twice[0],
        )


def _refuse_ragged(body: Sequence[tuple[int, Sequence[Any]]], width: int, delimiter: str | None) -> None:
    wrong = [(number, len(row)) for number, row in body if len(row) < width or any(cell != "" for cell in row[width:])]
    if wrong:
        cells = wrong[0][1]
        hint = " A decimal comma in a file separated by commas does this." if delimiter == "," and cells > width else ""
        raise UnreadableError(
            "ragged-rows",
            f"found {cells} cells, expected {width} as in the header.{hint}",
            "give every row as many cells as the header; leave a missing value empty between its delimiters.",
            rows=[number for number, _ in wrong],
        )

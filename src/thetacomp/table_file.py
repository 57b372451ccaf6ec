"""Tables as files: CSV for programs, .xlsx for people, from the same rows."""

from __future__ import annotations

import csv
import io
import math
import re
import zipfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from xml.sax.saxutils import escape

from thetacomp.errors import OutputError
from thetacomp.files import write_file
from thetacomp.safe_names import is_formula, name_fault

Cell = str | float | int | None
# Directions ("-X+Y") and places ("-500 mm, approach +") are our own texts and no formulas.
_OUR_SIGNS = re.compile(r"([+-][XYZ]?)+|-[\d.]+(e[+-]\d+)? (mm|to) ?[\w ,.+-]*")

UNITS = {
    "um_per_m2": "µm/m²", "urad_per_m2": "µrad/m²", "um_per_m": "µm/m", "urad_per_m": "µrad/m", "mm_min": "mm/min",
    "per_K": "1/K", "um": "µm", "urad": "µrad", "mm": "mm", "degC": "°C", "K": "K", "percent": "%", "rpm": "rpm",
    "min": "min", "h": "h", "s": "s",
}  # fmt: skip


class Number(str):
    """The decimal text of a number: a table shows these digits, and an .xlsx gets them as a number."""


def fixed(value: float, decimals: int) -> Number | str:
    """A number with so many decimals; empty where there is no finite value."""
    return Number(f"{value:.{decimals}f}") if math.isfinite(value) else ""


def digits(value: float, count: int = 6) -> Number | str:
    """A number with so many significant digits; empty where there is no finite value."""
    return Number(f"{value:.{count}g}") if math.isfinite(value) else ""


def free_text(text: str) -> str:
    """A text that is no name, as a cell: an apostrophe before what a spreadsheet would take for a formula."""
    return f"'{text}" if is_formula(text) else text


def plain(value: object) -> Cell:
    """A value of a result as a cell: six significant digits, 0 or 1 for a truth value, empty for None and NaN."""
    if isinstance(value, float):
        return digits(value)
    if hasattr(value, "__index__"):
        return int(value)
    return "" if value is None else value if isinstance(value, str) else str(value)


def csv_text(columns: Sequence[str], rows: Iterable[Sequence[Cell]], line_end: str = "\n") -> str:
    """CSV with a decimal point; None is an empty cell. Raises OutputError where a text would be a formula."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator=line_end)
    writer.writerow([_no_formula(name, "the header") for name in columns])
    for number, row in enumerate(rows, start=1):
        writer.writerow([_no_formula(cell, f"row {number}") for cell in row])
    return out.getvalue()


def xlsx_bytes(columns: Sequence[str], rows: Iterable[Sequence[Cell]]) -> bytes:
    """A workbook of one sheet: names, then units in a row of their own, then numbers as numbers and texts as texts."""
    body: list[Sequence[Cell]] = [columns, [unit_of(name) for name in columns], *rows]
    lines = "".join(
        f'<row r="{r}">{"".join(_xlsx_cell(f"{_letters(c)}{r}", cell, r <= 2) for c, cell in enumerate(row))}</row>'
        for r, row in enumerate(body, start=1)
    )
    sheet = f'{_XML}<worksheet xmlns="{_MAIN}">{_FROZEN}<sheetData>{lines}</sheetData></worksheet>'
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as book:
        for name, text in {**_PARTS, "xl/worksheets/sheet1.xml": sheet}.items():
            # A fixed date: the same table gives the same bytes.
            book.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), text, zipfile.ZIP_DEFLATED)
    return out.getvalue()


def table_content(name: str, columns: Sequence[str], rows: Iterable[Sequence[Cell]]) -> str | bytes:
    """The content of a table file, its kind by the ending of its name."""
    return xlsx_bytes(columns, rows) if name.lower().endswith(".xlsx") else csv_text(columns, rows)


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Sequence[Cell]]) -> Path:
    """Write one table, CSV or .xlsx by its ending. Raises OutputError."""
    return write_file(path, table_content(path.name, columns, rows))


def unit_of(column: str) -> str:
    """The unit that the end of a column's name states, as people write it; empty where there is none."""
    return next((unit for end, unit in UNITS.items() if column.endswith(f"_{end}")), "")


def _no_formula(cell: Cell, place: str) -> Cell:
    """Names are refused where they enter; this protects against any other text."""
    if isinstance(cell, str) and not isinstance(cell, Number) and not _OUR_SIGNS.fullmatch(cell):
        fault = name_fault(cell)
        if fault:
            raise OutputError(Path("table"), f"{place}: {cell!r} cannot be a cell, {fault}.", "give it another name.")
    return cell


def _letters(column: int) -> str:
    name = ""
    column += 1
    while column:
        column, rest = divmod(column - 1, 26)
        name = chr(ord("A") + rest) + name
    return name


def _xlsx_cell(at: str, cell: Cell, head: bool) -> str:
    if cell is None or cell == "":
        return ""
    style = ' s="1"' if head else ""
    if isinstance(cell, str) and not isinstance(cell, Number):
        text = escape(str(_no_formula(cell, f"cell {at}")))
        return f'<c r="{at}" t="inlineStr"{style}><is><t xml:space="preserve">{text}</t></is></c>'
    return f'<c r="{at}"{style}><v>{cell}</v></c>'


_XML = '<?xml version="1.0" encoding="UTF-8" standalone="yes"?>\n'
_MAIN = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
_OFFICE = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
_PACKAGE = "http://schemas.openxmlformats.org/package/2006"
_KIND = "application/vnd.openxmlformats-officedocument.spreadsheetml"
_FROZEN = (
    '<sheetViews><sheetView workbookViewId="0"><pane ySplit="2" topLeftCell="A3" activePane="bottomLeft"'
    ' state="frozen"/></sheetView></sheetViews>'
)
_FONT = '<font>{}<sz val="11"/><name val="Calibri"/></font>'
_PARTS = {
    "[Content_Types].xml": f'{_XML}<Types xmlns="{_PACKAGE}/content-types">'
    '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    '<Default Extension="xml" ContentType="application/xml"/>'
    f'<Override PartName="/xl/workbook.xml" ContentType="{_KIND}.sheet.main+xml"/>'
    f'<Override PartName="/xl/worksheets/sheet1.xml" ContentType="{_KIND}.worksheet+xml"/>'
    f'<Override PartName="/xl/styles.xml" ContentType="{_KIND}.styles+xml"/></Types>',
    "_rels/.rels": f'{_XML}<Relationships xmlns="{_PACKAGE}/relationships">'
    f'<Relationship Id="rId1" Type="{_OFFICE}/officeDocument" Target="xl/workbook.xml"/></Relationships>',
    "xl/workbook.xml": f'{_XML}<workbook xmlns="{_MAIN}" xmlns:r="{_OFFICE}"><sheets>'
    '<sheet name="table" sheetId="1" r:id="rId1"/></sheets></workbook>',
    "xl/_rels/workbook.xml.rels": f'{_XML}<Relationships xmlns="{_PACKAGE}/relationships">'
    f'<Relationship Id="rId1" Type="{_OFFICE}/worksheet" Target="worksheets/sheet1.xml"/>'
    f'<Relationship Id="rId2" Type="{_OFFICE}/styles" Target="styles.xml"/></Relationships>',
    "xl/styles.xml": f'{_XML}<styleSheet xmlns="{_MAIN}"><fonts count="2">{_FONT.format("")}{_FONT.format("<b/>")}'
    '</fonts><fills count="2"><fill><patternFill patternType="none"/></fill><fill><patternFill patternType="gray125"/>'
    '</fill></fills><borders count="1"><border><left/><right/><top/><bottom/><diagonal/></border></borders>'
    '<cellStyleXfs count="1"><xf numFmtId="0" fontId="0" fillId="0" borderId="0"/></cellStyleXfs><cellXfs count="2">'
    '<xf numFmtId="0" fontId="0" fillId="0" borderId="0" xfId="0"/>'
    '<xf numFmtId="0" fontId="1" fillId="0" borderId="0" xfId="0" applyFont="1"/></cellXfs>'
    '<cellStyles count="1"><cellStyle name="Normal" xfId="0" builtinId="0"/></cellStyles></styleSheet>',
}

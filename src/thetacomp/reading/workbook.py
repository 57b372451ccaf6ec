"""Excel workbooks: sheets as rows of cells, and what a spreadsheet shows but its values do not hold."""

from __future__ import annotations

import io
import re
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from thetacomp.reading.problems import UnreadableError, quoted, shortened
from thetacomp.reading.text import read_bytes

_RELATION = "{http://schemas.openxmlformats.org/officeDocument/2006/relationships}id"
_ERROR_CELL = re.compile(rb'<c\b([^>]*\bt="e"[^>]*)>')
_NO_RESULT = re.compile(rb"<c\b([^>]*)>\s*<f\b(?:[^>]*/>|[^>]*>[^<]*</f>)\s*(?:<v\s*/>|<v>\s*</v>)?\s*</c>")
_PLACE = re.compile(rb'\br="([A-Z]+)(\d+)"')


class Workbook:
    """An opened .xlsx file. Raises UnreadableError where it cannot be opened."""

    def __init__(self, path: Path) -> None:
        import python_calamine

        self._data = read_bytes(path)
        try:
            self._book = python_calamine.CalamineWorkbook.from_filelike(io.BytesIO(self._data))
            self.sheets: list[str] = list(self._book.sheet_names)
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException as exc:  # a panic inside the Rust reader is no Exception
            raise self._damaged(exc) from None
        if not self.sheets:
            raise UnreadableError("empty-file", "the workbook has no sheet.", "save it again from Excel.")

    def cells(self, sheet: str) -> list[list[Any]]:
        """All rows of a sheet from its first row; an empty cell is ''. Raises UnreadableError."""
        if sheet not in self.sheets:
            raise UnreadableError(
                "missing-sheet", f"there is no sheet '{sheet}'; found {quoted(self.sheets)}.", "name one of the sheets."
            )
        try:
            found = self._book.get_sheet_by_name(sheet)
            rows = found.to_python(skip_empty_area=False)
            merged = found.merged_cell_ranges or []
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException as exc:
            raise self._damaged(exc) from None
        if merged:
            raise UnreadableError(
                "merged-cells",
                f"found {len(merged)} merged cells; only the first cell of each would be read.",
                "in Excel, select all and choose 'Unmerge cells'; the header must be one plain first row.",
                rows=sorted(first[0] + 1 for first, _ in merged),
            )
        return [[cell.strip() if isinstance(cell, str) else cell for cell in row] for row in rows]

    def is_empty(self, sheet: str) -> bool:
        """Whether a sheet has no cell with content; one that cannot be read counts as filled."""
        try:
            return not any(cell != "" for row in self.cells(sheet) for cell in row)
        except UnreadableError:
            return False

    def refuse_broken_formulas(self, sheet: str) -> None:
        """Raise UnreadableError for cells such as #DIV/0! and formulas that were never computed.

        The cell reader hands out both as empty cells, which would count as missing values.
        """
        xml = self._xml(sheet)
        broken = _ERROR_CELL.findall(xml) if b't="e"' in xml else []
        if broken:
            raise _at_cells(
                "formula-error", "the formula gives an error such as #DIV/0!.", "correct the formula", broken
            )
        uncomputed = [a for a in _NO_RESULT.findall(xml) if b't="str"' not in a] if b"<f" in xml else []
        if uncomputed:
            raise _at_cells(
                "formula-error",
                "the formula has no stored result.",
                "open the file in Excel and save it so that formulas are computed",
                uncomputed,
            )

    def _xml(self, sheet: str) -> bytes:
        try:
            with zipfile.ZipFile(io.BytesIO(self._data)) as archive:
                book = ElementTree.fromstring(archive.read("xl/workbook.xml"))
                links = ElementTree.fromstring(archive.read("xl/_rels/workbook.xml.rels"))
                targets = {link.get("Id"): link.get("Target", "") for link in links}
                entry = next(e for e in book.iter() if e.tag.endswith("}sheet") and e.get("name") == sheet)
                target = targets[entry.get(_RELATION)]
                return archive.read(target.lstrip("/") if target.startswith("/") else f"xl/{target}")
        except Exception as exc:  # a damaged archive fails in many ways
            raise self._damaged(exc) from None

    def _damaged(self, exc: BaseException) -> UnreadableError:
        return UnreadableError(
            "binary-file",
            f"the file is no .xlsx workbook or it is damaged ({shortened(exc, 60)}).",
            "open it in Excel and save it as .xlsx again; a password must be removed.",
        )


def _at_cells(code: str, message: str, fix: str, attributes: list[bytes]) -> UnreadableError:
    places = [match for match in map(_PLACE.search, attributes) if match]
    names = [(match[1] + match[2]).decode() for match in places]
    return UnreadableError(
        code,
        f"cell {names[0] if names else '?'}: {message}",
        f"{fix}, or leave the cell empty where the value is missing.",
        rows=[int(match[2]) for match in places],
    )

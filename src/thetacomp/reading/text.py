"""Text files from any office: what encoding, which delimiter, which decimal sign. Doubt is an error, never a guess."""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from thetacomp.arrays import Floats, Ints
from thetacomp.reading.problems import UnreadableError, shortened

DELIMITERS = (",", ";", "\t")
SAVE_AS_UTF8 = "save the file as UTF-8 (in Excel: Save as, 'CSV UTF-8')."

_SIGNATURES = (
    (b"PK\x03\x04", "a zip or .xlsx file", "give it the ending .xlsx, or save the table as CSV."),
    (b"\xd0\xcf\x11\xe0", "an old Excel file (.xls)", "open it in Excel and save it as .xlsx or CSV."),
    (b"PAR1", "a Parquet file", "give it the ending .parquet."),
    (b"%PDF", "a PDF file", "export the table as CSV."),
    (b"\x1f\x8b", "a gzip file", "unpack it."),
)
# What single bytes above 127 mean in a German, French or Scandinavian export; anything else is no such export.
_WESTERN = set("äöüÄÖÜßµ°²³±·×–éèêëàáâåæçñóôøúûíîÅÆÉÈØ\xa0")
_CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]")
_NUMBER = {
    ".": re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII),
    ",": re.compile(r"[+-]?(\d+(,\d*)?|,\d+)([eE][+-]?\d+)?", re.ASCII),
}
# A number that could as well be thousands: 1.234 or 12,345,678.
_GROUPED = {
    ".": re.compile(r"[+-]?[1-9]\d{0,2}(\.\d{3})+", re.ASCII),
    ",": re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+", re.ASCII),
}
_BOTH_SIGNS = re.compile(r"[+-]?(?=[.,]*\d)[\d.,]+([eE][+-]?\d+)?", re.ASCII)
_BIG_INTEGER = re.compile(r"[+-]?\d{4,}", re.ASCII)


def read_bytes(path: Path) -> bytes:
    """The content of a file. Raises UnreadableError where it is missing, a directory, or locked."""
    if path.is_dir():
        raise UnreadableError("is-directory", "found a directory, expected a file.", "put the file itself here.")
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise UnreadableError("missing-file", "there is no such file.", "check the name and the path.") from None
    except OSError as exc:
        raise UnreadableError(
            "unreadable-file",
            f"the file cannot be opened ({exc.strerror or exc}).",
            "close it in other programs and check the access rights.",
        ) from None


def decode(data: bytes) -> str:
    """Text of a file in UTF-8, UTF-16 with a byte order mark, GB18030 or Western (cp1252). Raises UnreadableError."""
    if not data.strip(b"\x00\x1a \t\r\n"):
        raise UnreadableError("empty-file", "the file is empty.", "export the table again, or delete the file.")
    for signature, what, fix in _SIGNATURES:
        if data.startswith(signature):
            raise UnreadableError("binary-file", f"found {what}, expected text.", fix)
    text = _decoded(data).rstrip("\x1a")
    _refuse_control(text)
    return text


def _refuse_control(text: str) -> None:
    control = _CONTROL.search(text)
    if control:
        raise UnreadableError(
            "binary-file",
            f"found the control character 0x{ord(control.group()):02X}, expected plain text.",
            "export the table as CSV again; the file may be damaged or not be a text file.",
            rows=(text.count("\n", 0, control.start()) + 1,),
        )


def _decoded(data: bytes) -> str:
    for mark, encoding in ((codecs.BOM_UTF32_LE, "utf-32"), (codecs.BOM_UTF8, "utf-8-sig")):
        if data.startswith(mark):
            return _strictly(data, encoding)
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return _strictly(data, "utf-16")
    if b"\x00" in data:
        raise UnreadableError(
            "binary-file",
            "found NUL bytes, expected text: a binary or damaged file, or UTF-16 without its mark.",
            SAVE_AS_UTF8,
        )
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as exc:
        return _legacy(data, data.count(b"\n", 0, exc.start) + 1)


def _strictly(data: bytes, encoding: str) -> str:
    try:
        return data.decode(encoding)
    except UnicodeDecodeError:
        raise UnreadableError(
            "encoding", f"the file starts as {encoding.removesuffix('-sig')} text but is damaged.", SAVE_AS_UTF8
        ) from None


def _legacy(data: bytes, row: int) -> str:
    """Chinese (GB18030) or Western text, distinguished by what the bytes would mean in each; both or neither: ask."""
    _refuse_control(data.decode("latin-1").rstrip("\x1a"))
    chinese, rare_pairs = _as_chinese(data)
    western = _as_western(data)
    if western is not None and (chinese is None or rare_pairs > 0):
        return western
    if chinese is not None and western is None and rare_pairs <= 0.5:
        return chinese
    if chinese is not None and western is not None:
        known = "It could be Chinese (GB18030) or Western (Windows-1252) text"
    else:
        known = "It is neither UTF-8 nor plain Chinese (GB18030) nor Western (Windows-1252) text"
    line = data.split(b"\n")[row - 1]
    raise UnreadableError(
        "encoding",
        f"the encoding of the text is not clear. {known}: {shortened(line.decode('ascii', 'backslashreplace'))}",
        SAVE_AS_UTF8,
        rows=(row,),
    )


def _as_chinese(data: bytes) -> tuple[str | None, float]:
    """The text read as GB18030 if it then holds Chinese, and the share of double bytes outside everyday Chinese.

    Everyday are symbols (rows 1 to 9 of GB 2312) and its first level of letters. Western and Cyrillic bytes also form
    valid pairs, but nearly always rare letters.
    """
    try:
        text = data.decode("gb18030")
    except UnicodeDecodeError:
        return None, 0.0
    foreign = [char for char in text if ord(char) > 127]
    chinese = any("\u3000" <= char <= "\u9fff" or "\uff00" <= char <= "\uffef" or char == "℃" for char in foreign)
    if not chinese or any("\ue000" <= char <= "\uf8ff" for char in foreign):
        return None, 0.0
    pairs = [code for code in (char.encode("gb18030") for char in foreign) if len(code) == 2]
    rare = [code for code in pairs if code[1] < 0xA1 or not (0xA1 <= code[0] <= 0xA9 or 0xB0 <= code[0] <= 0xD7)]
    return text, len(rare) / max(len(pairs), 1)


def _as_western(data: bytes) -> str | None:
    try:
        text = data.decode("cp1252")
    except UnicodeDecodeError:
        return None
    return text if all(ord(char) < 128 or char in _WESTERN for char in text) else None


def split(text: str) -> tuple[str, list[list[str]]]:
    """The delimiter, and all rows as lists of stripped cells. Raises UnreadableError where the delimiter is unclear."""
    first_line = next((line for line in io.StringIO(text, newline=None) if line.strip()), "")
    candidates = [mark for mark in DELIMITERS if mark in _unquoted(first_line)]
    if not candidates:
        return ",", _rows(text, ",")
    if len(candidates) > 1:
        sample = "".join(io.StringIO(text, newline=None).readlines()[:200])
        candidates = [mark for mark in candidates if _is_regular(sample, mark)]
    if len(candidates) != 1:
        raise UnreadableError(
            "delimiter",
            f"the first line holds several of comma, semicolon and tab: {shortened(first_line)}. It is not clear"
            " which one separates the columns.",
            "use one delimiter, and no other of the three inside the headers.",
            rows=(1,),
        )
    return candidates[0], _rows(text, candidates[0])


def _unquoted(line: str) -> str:
    return re.sub(r'"[^"]*"', "", line)


def _is_regular(sample: str, delimiter: str) -> bool:
    try:
        widths = {len(row) for row in csv.reader(io.StringIO(sample), delimiter=delimiter) if any(row)}
    except csv.Error:
        return False
    return len(widths) == 1 and widths != {1}


def _rows(text: str, delimiter: str) -> list[list[str]]:
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
    rows: list[list[str]] = []
    try:
        for row in reader:
            rows.append([cell.strip() for cell in row])
    except csv.Error as exc:
        raise UnreadableError(
            "quotes",
            f"the quotation marks do not match from here on ({exc}).",
            'close every opened ", or take the quotation marks out.',
            rows=(len(rows) + 1,),
        ) from None
    return rows


def decimal_sign(columns: Mapping[str, Sequence[str]], rows: Ints, delimiter: str) -> str:
    """`.` or `,` for all number columns of a file (by header). Raises UnreadableError where the file leaves a doubt.

    The comma counts as decimal sign only in a file separated by semicolons or tabs, without any decimal point, and
    where at least one cell cannot be meant as thousands (`21,5` can not, `1,234` can).
    """
    if delimiter == "," and not any("," in "".join(cells) for cells in columns.values()):
        return "."
    points = _Found(".", columns, rows)
    commas = _Found(",", columns, rows)
    plain = "write every number with a decimal point and without thousands separators, like 1234.5"
    if points.any and commas.any:
        mark = points.first if "," in points.first.cell else commas.first
        raise UnreadableError(
            "decimal-mixed",
            f"found '{shortened(commas.first.cell)}' and '{shortened(points.first.cell)}' in one file: comma and point"
            " could each be the decimal sign or part thousands.",
            f"{plain} (or with a decimal comma throughout).",
            rows=(mark.row,),
            column=mark.header,
        )
    if commas.any and delimiter == ",":
        raise UnreadableError(
            "decimal-comma",
            f"found the comma number '{shortened(commas.first.cell)}' in a file separated by commas: decimal comma or"
            " thousands?",
            f"{plain}, or part the columns by semicolons.",
            rows=(commas.first.row,),
            column=commas.first.header,
        )
    if delimiter == ",":
        return "."
    for found in (commas, points):
        if found.any:
            found.require_proof()
            return found.sign
    return "."


class _Found:
    """Where a decimal sign occurs in number cells; the first place is looked for once, the rest only when needed."""

    def __init__(self, sign: str, columns: Mapping[str, Sequence[str]], rows: Ints) -> None:
        self.sign = sign
        self._columns = columns
        self._rows = rows
        self._first = next(self._places(), None)

    @property
    def any(self) -> bool:
        return self._first is not None

    @property
    def first(self) -> _Cell:
        assert self._first is not None
        return self._first

    def _places(self) -> Iterator[_Cell]:
        for header, cells in self._columns.items():
            if self.sign in "".join(cells):
                for cell, row in zip(cells, self._rows, strict=True):
                    if self.sign in cell and _BOTH_SIGNS.fullmatch(cell):
                        yield _Cell(cell, header, int(row))

    def require_proof(self) -> None:
        """`1.234` alone may be 1234: some cell of the file must exclude that."""
        grouped, number = _GROUPED[self.sign], _NUMBER[self.sign]
        if any(number.fullmatch(place.cell) and not grouped.fullmatch(place.cell) for place in self._places()):
            return
        if any(_BIG_INTEGER.fullmatch(cell) for cells in self._columns.values() for cell in cells):
            return  # thousands separators, if used, would have been used here too
        cell = shortened(self.first.cell)
        raise UnreadableError(
            "thousands",
            f"found '{cell}', which may mean {cell.replace(self.sign, '')} or {cell.replace(self.sign, '.', 1)};"
            " no other cell of the file settles it.",
            "write thousands without separators, and decimals so that they cannot be thousands (like 1.2340).",
            rows=(self.first.row,),
            column=self.first.header,
        )


class _Cell(NamedTuple):
    cell: str
    header: str
    row: int


def to_floats(cells: Sequence[str], sign: str) -> tuple[Floats, list[int]]:
    """Numbers of one column, NaN where empty or `nan`; and the places of the cells that are no finite numbers."""
    joined = "".join(cells)
    other = "," if sign == "." else "."
    if joined.isascii() and "_" not in joined and other not in joined:
        try:
            texts = cells if sign == "." else [cell.replace(",", ".") for cell in cells]
            values = np.array([float(cell) if cell else np.nan for cell in texts], dtype=np.float64)
        except ValueError:
            pass
        else:
            if not any(cells[i] for i in np.flatnonzero(~np.isfinite(values)).tolist()):
                return values, []
    return _to_floats_one_by_one(cells, sign)


def _to_floats_one_by_one(cells: Sequence[str], sign: str) -> tuple[Floats, list[int]]:
    values = np.full(len(cells), np.nan)
    bad: list[int] = []
    for i, cell in enumerate(cells):
        if not cell or cell.lower() == "nan":
            continue
        if _NUMBER[sign].fullmatch(cell):
            values[i] = float(cell.replace(",", "."))
        if not np.isfinite(values[i]):
            values[i] = np.nan
            bad.append(i)
    return values, bad

"""One place writes files, one makes tables, one makes pages: nobody else has a hand of their own."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[2] / "src"
WRITERS = {"thetacomp/files.py", "thetacomp/folder_exchange.py"}

HANDS = {
    r"\.write_(text|bytes)\(": set(),
    r"open\([^)]*[\"'][rb]*[wax+][bt+]*[\"']": WRITERS,
    r"\bto_(csv|excel|parquet|feather|pickle|hdf)\(": set(),
    r"\bwrite_table\([^)]*pq|\bpq\.write|ParquetWriter": set(),
    r"\bcsv\.(writer|DictWriter)\b": {"thetacomp/table_file.py"},
    r"\bsavefig\(|\bnp\.save|\.tofile\(": set(),
    r"\bshutil\.(copy|copy2|copyfile|copytree|move)\(": WRITERS,
    r"\bos\.(replace|rename|link)\(|\.symlink_to\(|\.touch\(": WRITERS,
    r"NamedTemporaryFile|mkstemp": set(),
    r"\bEnvironment\(|\bTemplate\(": {"thetacomp/report/page_writer.py"},
    r"<(html|style|body|table)\b[^{]": set(),
}


@pytest.mark.parametrize("hand", HANDS)
def test_nobody_else_writes(hand: str) -> None:
    found = {
        path.relative_to(SOURCE).as_posix()
        for path in SOURCE.rglob("*.py")
        if re.search(hand, path.read_text(encoding="utf-8"))
    }
    assert found <= HANDS[hand], f"{sorted(found - HANDS[hand])} write by hand; use thetacomp.files or table_file"


def test_there_is_one_style_sheet_and_one_base_page() -> None:
    assert [path.name for path in SOURCE.rglob("*.css")] == ["style.css"]
    for path in SOURCE.rglob("*.html.j2"):
        text = path.read_text(encoding="utf-8")
        if path.name in ("base.html.j2", "parts.html.j2"):
            continue
        assert text.startswith('{% extends "thetacomp.report/base.html.j2" %}'), path
        assert "<style" not in text, path

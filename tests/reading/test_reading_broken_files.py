"""Broken files that are no text, files that cannot be opened, tables that stand twice, and broken recordings."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import openpyxl
import pandas as pd
import pytest
from machine_folders import (
    MACHINE_TOML,
    drift_rows,
    temperature_rows,
    valid_files,
    write_files,
    write_xlsx,
)

from thetacomp.errors import Problem
from thetacomp.reading import check_folder

C = "campaigns/c"
HEAT, SWEEPS, DRIFT = (f"{C}/{table}.csv" for table in ("temperatures", "sweeps", "drift"))
SETTINGS = f"{C}/campaign.toml"
Files = dict[str, str | bytes]


def valid() -> Files:
    return dict(valid_files(("c",)))


def folder_with(root: Path, **kept: str) -> Path:
    files = {k: v for k, v in valid().items() if k in ("machine.toml", SWEEPS)}
    return write_files(root, files | {f"{C}/{name}": text for name, text in kept.items()})


def one_error(root: Path, code: str) -> Problem:
    problems = [problem for problem in check_folder(root)[1] if problem.severity == "error"]
    assert [problem.code for problem in problems] == [code], problems
    return problems[0]


def sheet_with(root: Path, cells: Mapping[str, Any], merge: str | None = None) -> Path:
    root = folder_with(root)
    path = write_xlsx(root / C / "log.xlsx", {"temperatures": temperature_rows()})
    book = openpyxl.load_workbook(path)
    sheet = book["temperatures"]
    for place, value in cells.items():
        sheet[place] = value
        if isinstance(value, str) and value.startswith("#"):
            sheet[place].data_type = "e"
    if merge:
        sheet.merge_cells(merge)
    book.save(path)
    return root


def test_a_damaged_workbook(tmp_path: Path) -> None:
    for data in (b"", b"PK\x03\x04 garbage", b"not a workbook" * 100):
        root = write_files(folder_with(tmp_path), {f"{C}/log.xlsx": data})
        problem = one_error(root, "binary-file")
        assert problem.file == f"{C}/log.xlsx"
        assert "no .xlsx workbook or it is damaged" in problem.message


def test_a_truncated_workbook(tmp_path: Path) -> None:
    root = sheet_with(tmp_path, {})
    path = root / C / "log.xlsx"
    path.write_bytes(path.read_bytes()[:-200])
    assert one_error(root, "binary-file").file == f"{C}/log.xlsx"


def test_formula_errors_in_a_workbook(tmp_path: Path) -> None:
    """The cell reader hands out #DIV/0! as an empty cell: it must not count as a missing value."""
    problem = one_error(sheet_with(tmp_path, {"B5": "#DIV/0!", "C7": "#N/A"}), "formula-error")
    assert problem.file == f"{C}/log.xlsx, sheet 'temperatures'"
    assert (problem.row, "cell B5" in problem.message) == (5, True)
    assert "The same in 2 rows in all: 5, 7." in problem.message


def test_formulas_that_were_never_computed(tmp_path: Path) -> None:
    problem = one_error(sheet_with(tmp_path, {"B5": "=1+1"}), "formula-error")
    assert (problem.row, "no stored result" in problem.message) == (5, True)


def test_numbers_stored_as_text_in_a_workbook(tmp_path: Path) -> None:
    problem = one_error(sheet_with(tmp_path, {"C4": "21,5"}), "number-as-text")
    assert (problem.row, problem.column) == (4, "theta_2")
    assert "Convert to Number" in problem.fix


def test_a_number_that_excel_turned_into_a_date(tmp_path: Path) -> None:
    problem = one_error(sheet_with(tmp_path, {"C4": pd.Timestamp("2026-05-03")}), "date-cell")
    assert (problem.row, problem.column) == (4, "theta_2")


def test_merged_cells(tmp_path: Path) -> None:
    problem = one_error(sheet_with(tmp_path, {}, merge="B3:B6"), "merged-cells")
    assert (problem.row, "Unmerge" in problem.fix) == (3, True)


def test_title_lines_in_a_workbook(tmp_path: Path) -> None:
    root = folder_with(tmp_path)
    write_xlsx(root / C / "log.xlsx", {"temperatures": [["Hall 3"], [], *temperature_rows()]})
    assert "a title above the header?" in one_error(root, "header").message


def test_the_same_table_twice(tmp_path: Path) -> None:
    root = write_files(tmp_path, valid())
    pd.DataFrame(drift_rows()[1:], columns=drift_rows()[0]).to_parquet(root / C / "drift.parquet")
    problem = one_error(root, "two-sources")
    assert (problem.file, f"also stands in {DRIFT}" in problem.message) == (f"{C}/drift.parquet", True)


def test_the_same_table_in_a_sheet_and_a_file(tmp_path: Path) -> None:
    root = write_files(tmp_path, valid())
    write_xlsx(root / C / "more.xlsx", {"drift": drift_rows()})
    assert one_error(root, "two-sources").file == f"{C}/more.xlsx, sheet 'drift'"


def test_sheets_with_other_names(tmp_path: Path) -> None:
    root = write_files(tmp_path, valid())
    write_xlsx(root / C / "more.xlsx", {"Tabelle1": drift_rows(), "empty": []})
    problems = check_folder(root)[1]
    assert [(p.severity, p.code) for p in problems] == [("warning", "unknown-sheet")]
    assert "'Tabelle1'" in problems[0].message
    assert "'empty'" not in problems[0].message


def test_damaged_parquet(tmp_path: Path) -> None:
    root = write_files(folder_with(tmp_path), {f"{C}/temperatures.parquet": b"PAR1 garbage PAR1"})
    assert "no Parquet file or it is damaged" in one_error(root, "binary-file").message


def test_numbers_as_strings_in_parquet(tmp_path: Path) -> None:
    root = folder_with(tmp_path)
    rows = temperature_rows()
    table = pd.DataFrame(rows[1:], columns=rows[0]).astype({"theta_2": str})
    table.to_parquet(root / C / "temperatures.parquet")
    problem = one_error(root, "number-as-text")
    assert (problem.row, problem.column) == (2, "theta_2")


def test_a_directory_instead_of_a_file(tmp_path: Path) -> None:
    root = folder_with(tmp_path)
    for name in ("temperatures.csv", "campaign.toml"):
        (root / C / name).mkdir()
    assert {(p.code, p.file) for p in check_folder(root)[1]} == {("is-directory", HEAT), ("is-directory", SETTINGS)}


def test_a_file_that_cannot_be_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = write_files(tmp_path, valid())

    def locked(path: Path) -> bytes:
        if path.name == "drift.csv":
            raise PermissionError(13, "Permission denied")
        with path.open("rb") as file:
            return file.read()

    monkeypatch.setattr(Path, "read_bytes", locked)
    problem = one_error(root, "unreadable-file")
    assert (problem.file, "close it in other programs" in problem.fix) == (DRIFT, True)


def test_a_broken_link(tmp_path: Path) -> None:
    root = write_files(tmp_path, valid())
    (root / DRIFT).unlink()
    (root / DRIFT).symlink_to(tmp_path / "gone.csv")
    assert one_error(root, "missing-file").file == DRIFT


def test_a_file_instead_of_a_folder(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t_s\n", encoding="utf-8")
    assert [p.code for p in check_folder(path)[1]] == ["not-a-folder"]
    assert [p.code for p in check_folder(tmp_path / "absent")[1]] == ["missing-file"]


def test_office_and_system_files_are_passed_over(tmp_path: Path) -> None:
    extra: Files = {f"{C}/~$log.xlsx": b"x", f"{C}/.DS_Store": b"x", "Thumbs.db": b"x", "README.md": "note"}
    assert check_folder(write_files(tmp_path, valid() | extra))[1] == ()


def test_an_encrypted_or_foreign_zip(tmp_path: Path) -> None:
    root = folder_with(tmp_path)
    with zipfile.ZipFile(root / C / "log.xlsx", "w") as archive:
        archive.writestr("hello.txt", "no workbook")
    assert one_error(root, "binary-file").file == f"{C}/log.xlsx"


# recording.toml

RECORDING = """\
format = 1
[recording]
file = "log.csv"
time = "t"
time_unit = "s"
[recording.temperatures]
theta_1 = "a"
[recording.drift]
dX_um = "x"
[[recording.campaigns]]
name = "one"
first_row = 0
last_row = 9
"""
LOG = "t,a,x\n" + "".join(f"{600 * i},{20 + i / 2},{i * 1.5}\n" for i in range(20))


@pytest.mark.parametrize(
    ("old", "new", "code", "phrase"),
    [
        ('time_unit = "s"', 'time_unit = "sec"', "bad-value", "time_unit = 'sec', expected 's', 'min', 'h' or 'iso'"),
        ('time_unit = "s"', "", "missing-key", "`time_unit` is missing. It states the unit of the time column"),
        ('"log.csv"', '"lost.csv"', "missing-file", "there is no such file"),
        ('"a"', '"A"', "missing-column", "there is no column 'A' (did you mean 'a'?), which recording.toml names"),
        ("theta_1", "theta_9", "unknown-sensor", "names 'theta_9', expected a sensor of machine.toml"),
        ("dX_um", "dQ_um", "unknown-column", "names 'dQ_um'"),
        ('"x"', '"a"', "duplicate-column", "the column 'a' is named twice"),
        ("last_row = 9", "last_row = 99", "campaign-rows", "ends at row 99, but the last data row of log.csv is 19"),
        ("last_row = 9", "last_row = 0", "campaign-rows", "last_row 0 is not above first_row 0"),
        ("first_row = 0", "first_row = -1", "bad-value", "number 1 ('one'): first_row = -1"),
        ("[[recording.campaigns]]", "[[recording.parts]]", "unknown-key", "unknown key 'parts'"),
        ("last_row = 9", 'last_row = 9\n[[recording.campaigns]]\nname = "two"\nfirst_row = 9\nlast_row = 12',
         "campaign-rows", "'one' and 'two' share rows"),
        ("format = 1", "format = 7", "format-number", "found format = 7"),
        ("[recording.drift]", "[recording.settings]\ndatums = 1\n[recording.drift]", "unknown-key",
         "unknown key 'datums' (did you mean 'datum'?)"),
    ],
)  # fmt: skip
def test_a_broken_recording(tmp_path: Path, old: str, new: str, code: str, phrase: str) -> None:
    assert old in RECORDING
    files = {"machine.toml": MACHINE_TOML, "recording.toml": RECORDING, "log.csv": LOG}
    good, problems = check_folder(write_files(tmp_path, files))
    assert good is not None, problems
    (tmp_path / "recording.toml").write_text(RECORDING.replace(old, new, 1), encoding="utf-8")
    told = [problem for problem in check_folder(tmp_path)[1] if problem.code == code]
    assert told, check_folder(tmp_path)[1]
    assert phrase in told[0].message

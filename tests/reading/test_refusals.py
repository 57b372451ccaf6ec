"""Refusals that no usual file meets: each is reached once, and names file, place and remedy."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import openpyxl
import pandas as pd
import pytest
from machine_folders import MACHINE_TOML, csv_text, small_machine, temperature_rows, valid_files, write_files

from thetacomp.campaign import CampaignSettings
from thetacomp.errors import InputError, Problem
from thetacomp.reading import check_folder, read_correlations
from thetacomp.reading.columns import ANY_SENSORS
from thetacomp.reading.frames import read_frames
from thetacomp.reading.problems import ProblemList
from thetacomp.reading.single_tables import read_positions, read_temperatures
from thetacomp.reading.sources import from_columns, read_source
from thetacomp.reading.tables import load

C = "campaigns/c"
WITHOUT_SENSORS = MACHINE_TOML[: MACHINE_TOML.index("[[sensors]]")]


def problem_of(folder: Path, code: str) -> Problem:
    found = [p for p in check_folder(folder)[1] if p.code == code]
    assert len(found) == 1, check_folder(folder)[1]
    assert found[0].fix
    return found[0]


def refused(path: Path, code: str) -> Problem:
    with pytest.raises(InputError) as refusal:
        read_temperatures(path)
    (problem,) = refusal.value.problems
    assert problem.code == code
    assert problem.fix
    return problem


def changed(root: Path, **files: str) -> Path:
    """The valid folder with some of its files written anew; dots stand for `__`."""
    named = {name.replace("__", "."): text for name, text in files.items()}
    return write_files(root, {**valid_files(("c",)), **named})


@pytest.mark.parametrize(
    ("text", "code", "words"),
    [
        ("[" * 5000 + "]" * 5000, "toml-syntax", ""),
        (WITHOUT_SENSORS, "missing-key", "sensors"),
        (WITHOUT_SENSORS.replace("format = 1\n", "format = 1\nsensors = []\n").replace('sensor = "theta_1"\n', ""),
         "missing-key", "there are no [[sensors]]"),
        (MACHINE_TOML.replace('"theta_3"', '"t_s"'), "sensor-id", "'t_s' cannot be the id of a sensor"),
        (MACHINE_TOML.replace('"theta_3"', '"theta  3"'), "sensor-id", "extra spaces"),
        (MACHINE_TOML.replace("format = 1", "format = 1\nmore = 2"), "unknown-key", "unknown key 'more'"),
    ],
)  # fmt: skip
def test_machine_files_that_describe_no_machine(tmp_path: Path, text: str, code: str, words: str) -> None:
    found = [p for p in check_folder(changed(tmp_path, machine__toml=text))[1] if p.code == code]
    assert found
    assert found[0].file == "machine.toml"
    assert words in found[0].message


@pytest.mark.parametrize("expansion", [0.9e-7, 1.1e-4])
def test_an_expansion_that_no_scale_has(tmp_path: Path, expansion: float) -> None:
    def text(value: float) -> str:
        return MACHINE_TOML.replace(
            'sensor = "theta_1"\n\n[[axes]]', f'sensor = "theta_1"\nexpansion_per_K = {value}\n\n[[axes]]'
        )

    assert any(p.severity == "error" for p in check_folder(changed(tmp_path / "a", machine__toml=text(expansion)))[1])
    for value in (1e-7, 1e-4):
        folder, _ = check_folder(changed(tmp_path / str(value), machine__toml=text(value)))
        assert folder is not None


def test_recordings_that_cannot_be_read(tmp_path: Path) -> None:
    def found(text: str, code: str) -> Problem:
        return problem_of(write_files(tmp_path, {"machine.toml": MACHINE_TOML, "recording.toml": text}), code)

    assert found("format = \n", "toml-syntax").file == "recording.toml"
    recording = 'format = 1\n[recording]\nfile = "log.csv"\ntime = "t"\ntime_unit = "s"\ncampaigns = []\n'
    recording += '[recording.temperatures]\ntheta_1 = "a"\n'
    (tmp_path / "log.csv").write_text("t,a\n0,20\n60,21\n", encoding="utf-8")
    assert "there are no campaigns" in found(recording, "no-campaigns").message


def test_a_folder_that_may_not_be_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = changed(tmp_path)
    plain = Path.iterdir

    def locked(path: Path):  # type: ignore[no-untyped-def]
        if path.name == "c":
            raise PermissionError(13, "Permission denied")
        return plain(path)

    monkeypatch.setattr(Path, "iterdir", locked)
    assert "cannot be opened (Permission denied)" in problem_of(root, "unreadable-file").message


def test_temperatures_without_any_value(tmp_path: Path) -> None:
    rows = temperature_rows()
    for row in rows[1:]:
        row[1:] = [None, None, None]
    found = {p.code: p for p in check_folder(changed(tmp_path, **{f"{C}/temperatures__csv": csv_text(rows)}))[1]}
    assert "no sensor has a value" in found["empty-table"].message


def test_correlations_that_cannot_be_read(tmp_path: Path) -> None:
    for text, code in ((None, "missing-file"), ("", "empty-file"), ("a\n1\n", "missing-column")):
        if text is not None:
            (tmp_path / "r.csv").write_text(text, encoding="utf-8")
        with pytest.raises(InputError) as refusal:
            read_correlations(tmp_path / "r.csv")
        assert [p.code for p in refusal.value.problems] == [code]


def test_positions_in_two_forms_at_once(tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text("t_s,axis,position_mm,W_mm\n0,X,10,5\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"row 2: an axis with position_mm stands beside W_mm"):
        read_positions(tmp_path / "p.csv")


def test_files_of_no_known_kind_or_without_content(tmp_path: Path) -> None:
    (tmp_path / "t.ods").write_bytes(b"x")
    assert "found the ending '.ods'" in refused(tmp_path / "t.ods", "unknown-format").message
    (tmp_path / "t.csv").write_text("\n\n", encoding="utf-8")
    refused(tmp_path / "t.csv", "empty-file")
    pd.DataFrame({"t_s": np.zeros(0), "a": np.zeros(0)}).to_parquet(tmp_path / "t.parquet")
    refused(tmp_path / "t.parquet", "empty-table")
    book = openpyxl.Workbook()
    book.save(tmp_path / "t.xlsx")
    refused(tmp_path / "t.xlsx", "empty-file")


def test_the_delimiter_is_that_which_makes_a_table(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text('t_s;"a;x,y"\n0;20\n60;21\n', encoding="utf-8")
    assert read_temperatures(tmp_path / "t.csv").sensor_ids == ("a;x,y",)
    (tmp_path / "t.csv").write_text("t_s;a,b\n0;20,5\n60;21,0\n", encoding="utf-8")
    assert refused(tmp_path / "t.csv", "delimiter").row == 1


def test_a_sheet_that_a_workbook_does_not_have(tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    book.active.title = "log"
    book.active.append(["t_s", "a"])
    book.active.append([0, 20.0])
    book.save(tmp_path / "t.xlsx")
    assert len(read_source(tmp_path / "t.xlsx", "t.xlsx", "log").rows) == 1
    with pytest.raises(Exception, match=r"there is no sheet 'x'; found 'log'"):
        read_source(tmp_path / "t.xlsx", "t.xlsx", "x")


def test_parquet_with_moments_and_with_cells_that_are_none(tmp_path: Path) -> None:
    moments = pd.to_datetime(["2026-03-02T08:00:00.0", "2026-03-02T08:00:01.5"]).tz_localize("UTC")
    pd.DataFrame({"time": moments, "a": [20.0, 21.0]}).to_parquet(tmp_path / "t.parquet")
    found = read_temperatures(tmp_path / "t.parquet")
    assert found.t_s.tolist() == [datetime(2026, 3, 2, 8, tzinfo=UTC).timestamp() + s for s in (0.0, 1.5)]
    pd.DataFrame({"t_s": [0.0, 60.0], "a": [True, False]}).to_parquet(tmp_path / "b.parquet")
    problem = refused(tmp_path / "b.parquet", "not-a-number")
    assert (problem.row, problem.column) == (2, "a")


# --- tables in memory -------------------------------------------------------------------------------------------------


def test_tables_in_memory_have_columns_of_one_length_and_one_name_each() -> None:
    with pytest.raises(Exception, match="found columns of 2 and 3 values"):
        from_columns({"t_s": [0.0, 60.0, 120.0], "a": [20.0, 21.0]}, "t")
    with pytest.raises(Exception, match="'a' stands twice"):
        from_columns({"t_s": [0.0, 60.0], "a": [20.0, 21.0], " a ": [1.0, 2.0]}, "t")
    with pytest.raises(Exception, match="stands twice"):
        from_columns(pd.DataFrame([[0.0, 1.0, 2.0]], columns=["t_s", "a", "a"]), "t")
    source = from_columns({"t_s": [0.0, 60.0], "a": [20, 21], "axis": [" X ", "W"]}, "t")
    assert [column.header for column in source.columns] == ["t_s", "a", "axis"]
    assert source.rows.tolist() == [2, 3]
    assert list(source.columns[2].cells) == ["X", "W"]


def test_settings_of_tables_in_memory_are_checked_too() -> None:
    heat = {"t_s": np.arange(0.0, 6000.0, 600.0), "theta_1": np.arange(10.0)}
    drift = {"t_s": np.array([0.0, 600.0, 1200.0]), "dX_um": np.array([1.0, 2.0, 3.0])}
    tables = {"c": {"temperatures": heat, "drift": drift}}
    assert len(read_frames(small_machine(), tables).campaigns) == 1
    wrong = CampaignSettings(instrument_u_um=-1.0)
    with pytest.raises(InputError, match=r"campaign 'c', settings: 'instrument_u_um' is negative"):
        read_frames(small_machine(), tables, settings={"c": wrong})


def test_a_number_too_large_for_a_float_is_told() -> None:
    problems = ProblemList()
    columns = pd.DataFrame({"t_s": [0.0, 60.0], "a": pd.Series([10**400, 1], dtype=object)})
    assert load(lambda: from_columns(columns, "t"), "t", "temperatures", ANY_SENSORS, problems) is None
    (problem,) = problems.collected()
    assert (problem.code, problem.row, problem.column) == ("not-a-number", 2, "a")

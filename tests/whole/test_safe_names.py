"""Names that would be formulas in a table, or that hold control characters, are refused where they enter."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from machine_folders import valid_files, write_files

from thetacomp.errors import InputError
from thetacomp.planning.options import PlanOptions
from thetacomp.planning.setup import make_setup
from thetacomp.planning.tables import sensors_csv
from thetacomp.reading import read_folder, read_positioning, read_temperatures
from thetacomp.reading.correlations import read_correlations
from thetacomp.safe_names import name_fault, text_fault
from thetacomp.table_file import csv_text, free_text

FORMULAS = ("=1+1", "+SUM(1)", "-2+3", "@A1", "＝1", "＋1", "－1", "＠1")
CONTROLS = ("a\x00b", "a\x1bb", "a\x7fb", "a\x85b", "a\u2028b", "a\ud800b")
# marks of direction, a space of no width, a soft hyphen, a byte order mark, a mark of shorthand, a tag
INVISIBLE = ("a\u200fb", "\u202eb", "a\u2066b", "a\u200bb", "a\u00adb", "\ufeffa", "a\U0001bca0b", "a\U000e0041b")


@pytest.mark.parametrize("text", [*FORMULAS, *CONTROLS, *INVISIBLE, "\tx", "x\r"])
def test_faults_are_named(text: str) -> None:
    assert name_fault(text)


def test_what_cannot_be_seen_is_a_fault_of_any_text_a_formula_only_of_a_name() -> None:
    assert [text_fault(text) for text in FORMULAS] == [""] * len(FORMULAS)
    assert all(text_fault(text).startswith("it holds the control character U+") for text in CONTROLS)
    assert all(text_fault(text).startswith("it holds the invisible character U+") for text in INVISIBLE)
    assert text_fault("=\u200f") == name_fault("=\u200f") == "it holds the invisible character U+200F"


def test_a_free_text_becomes_a_cell_that_is_no_formula() -> None:
    for text in FORMULAS:
        cell = free_text(text)
        assert cell == f"'{text}"
        assert name_fault(cell) == ""
    for text in ("+Y side of the column", " =1"):
        assert csv_text(["a"], [[free_text(text)]]) == f"a\n'{text}\n"
    assert free_text("column, +Y side") == "column, +Y side"
    assert free_text("") == ""


@pytest.mark.parametrize("text", ["theta_1", "立柱", "X-Y", "a=b", "2026-03-02", "Z+", "µ", "–5 dash", ""])
def test_good_names_have_none(text: str) -> None:
    assert name_fault(text) == ""


def refusal(tmp_path: Path, files: dict[str, str | bytes]) -> str:
    with pytest.raises(InputError) as caught:
        read_folder(write_files(tmp_path / "m", files))
    return str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ('name = "small mill"', 'name = "=mill"', "name"),
        ('name = "W"', 'name = "-W"', "[[axes]] number 2"),
        ('id = "theta_2"', 'id = "+theta_2"', "[[sensors]] number 2"),
        ('location = "hall"', 'location = "hall\\u200f"', "location"),
        ('name = "X motor"', 'name = "X\\u0007motor"', "[[heat_sources]] number 1"),
    ],
)
def test_the_machine_file_may_not_bring_them_in(tmp_path: Path, old: str, new: str, place: str) -> None:
    files = dict(valid_files())
    assert old in str(files["machine.toml"])
    files["machine.toml"] = str(files["machine.toml"]).replace(old, new)
    message = refusal(tmp_path, files)
    assert "error: machine.toml: " in message
    assert place in message
    assert "cannot be used here: it " in message


def test_where_a_sensor_sits_is_said_freely_and_written_as_a_text(tmp_path: Path) -> None:
    files = dict(valid_files())
    files["machine.toml"] = str(files["machine.toml"]).replace('location = "hall"', 'location = "+Y side, -Z"')
    machine = read_folder(write_files(tmp_path / "m", files)).machine
    (sensor,) = (one for one in machine.sensors if one.location == "+Y side, -Z")
    rows = csv.DictReader(sensors_csv(make_setup(machine, PlanOptions())).splitlines())
    assert {row["sensor"]: row["location"] for row in rows}[sensor.id] == "'+Y side, -Z"


def test_campaigns_settings_and_cells_may_not_either(tmp_path: Path) -> None:
    files = dict(valid_files())
    first = next(name for name in files if name.endswith("campaign.toml"))
    folder = first.rpartition("/")[0]
    bad = files | {first: str(files[first]).replace('instrument = "', 'instrument = "=')}
    assert f"error: {first}: instrument: '=Leica AT901-B' cannot be used here" in refusal(tmp_path / "a", bad)
    moved = {name.replace(folder, "campaigns/=x"): text for name, text in files.items()}
    assert "error: campaigns/=x: '=x' cannot be the name of a campaign: it begins with '='" in refusal(
        tmp_path / "b", moved
    )
    sweeps = f"{folder}/sweeps.csv"
    lines = str(files[sweeps]).splitlines()
    lines[3] = lines[3].replace(",X,", ",=X,")
    message = refusal(tmp_path / "c", files | {sweeps: "\n".join(lines)})
    assert f"error: {sweeps}, row 4, column 'axis': found '=X': it begins with '='" in message


def test_lone_tables_may_not_either(tmp_path: Path) -> None:
    (tmp_path / "T.csv").write_text("t_s,=t\n0,20\n60,21\n")
    with pytest.raises(InputError, match=r"T\.csv, row 1, column '=t': '=t' cannot be the id of a sensor"):
        read_temperatures(tmp_path / "T.csv")
    (tmp_path / "C.csv").write_text(",=a,b\nEXX,0.1,0.2\n")
    with pytest.raises(InputError, match=r"C\.csv, row 1: found the column '=a'"):
        read_correlations(tmp_path / "C.csv")
    (tmp_path / "P.csv").write_text("axis,target_mm,run,direction,error_um\n@X,0,1,+,1\n@X,10,-1,-,1\n")
    with pytest.raises(InputError, match=r"P\.csv, row[s]? 2.*, column 'axis': found '@X'"):
        read_positioning(tmp_path / "P.csv")

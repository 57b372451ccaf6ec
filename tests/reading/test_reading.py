"""Machine folders read right: every table and form, formats equal, German and Chinese exports, a real recording."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from machine_folders import (
    CAMPAIGN_TOML,
    MACHINE_TOML,
    campaign_of_frames,
    csv_text,
    drift_rows,
    duty_rows,
    parameter_rows,
    small_folder,
    small_machine,
    sweep_rows,
    temperature_rows,
    valid_files,
    write_files,
    write_xlsx,
)
from typer.testing import CliRunner

from thetacomp.campaign import Campaign, CampaignSettings
from thetacomp.cli.main import app
from thetacomp.errors import InputError
from thetacomp.reading import (
    check_folder,
    read_correlations,
    read_folder,
    read_frames,
    read_machine,
    read_positions,
    read_temperatures,
)

ROOT = Path(__file__).parents[2]
A = "campaigns/a"


# A folder without any measured error is refused: tests of temperatures alone set this campaign beside theirs.
MEASURED = {
    "campaigns/z/temperatures.csv": csv_text(temperature_rows()),
    "campaigns/z/drift.csv": csv_text(drift_rows()),
}


def one_campaign(root: Path, files: Mapping[str, str | bytes]) -> Campaign:
    alone = not any("sweeps" in name or "drift" in name or "parameters" in name for name in files)
    beside = MEASURED if alone else {}
    folder, problems = check_folder(write_files(root, {"machine.toml": MACHINE_TOML, **files, **beside}))
    assert folder is not None, problems
    return folder.campaigns[0]


def tables() -> dict[str, list[list[object]]]:
    return {
        "temperatures": temperature_rows(),
        "sweeps": sweep_rows(),
        "drift": drift_rows(),
        "duty": duty_rows(),
    }


def frame(rows: list[list[object]]) -> pd.DataFrame:
    return pd.DataFrame(rows[1:], columns=[str(name) for name in rows[0]])


def same(first: Campaign, second: Campaign) -> None:
    for part in ("temperatures", "sweeps", "drift", "parameters", "duty"):
        one, two = getattr(first, part), getattr(second, part)
        assert (one is None) == (two is None), part
        for name, value in vars(one).items() if one is not None else ():
            other = vars(two)[name]
            if isinstance(value, np.ndarray):
                np.testing.assert_array_equal(value, other, err_msg=f"{part}.{name}")
            elif isinstance(value, dict):
                assert value.keys() == other.keys()
                for key in value:
                    np.testing.assert_array_equal(value[key], other[key])
            else:
                assert value == other, (part, name)


def test_a_valid_folder_has_no_problem_and_every_number(tmp_path: Path) -> None:
    folder, problems = check_folder(small_folder(tmp_path))
    assert problems == ()
    assert folder is not None
    assert [c.name for c in folder.campaigns] == ["2026-03-02", "2026-03-09"]
    campaign = folder.campaign("2026-03-02")
    assert campaign.settings.instrument == "Leica AT901-B"
    assert campaign.temperatures.sensor_ids == ("theta_1", "theta_2", "theta_3")
    written = np.array([row[1:] for row in temperature_rows()[1:]], dtype=float)
    np.testing.assert_array_equal(campaign.temperatures.value_degC, written)
    sweeps = campaign.sweeps
    assert sweeps is not None
    rows = sweep_rows()[1:]
    np.testing.assert_array_equal(sweeps.error_um, np.array([row[3:] for row in rows], dtype=float))
    assert sweeps.axis == tuple(row[1] for row in rows)
    np.testing.assert_array_equal(sweeps.sweep, np.repeat(np.arange(8), 10))
    np.testing.assert_array_equal(sweeps.direction[:10], [1] * 5 + [-1] * 5)
    assert campaign.duty is not None
    np.testing.assert_array_equal(campaign.duty.columns["spindle_rpm"], [0, 650, 650, 0])


def test_csv_xlsx_parquet_and_pandas_give_equal_numbers(tmp_path: Path) -> None:
    rows = tables()
    read = one_campaign(tmp_path / "csv", {f"{A}/{name}.csv": csv_text(table) for name, table in rows.items()})
    xlsx = write_files(tmp_path / "xlsx", {"machine.toml": MACHINE_TOML})
    write_xlsx(xlsx / A / "all tables.xlsx", rows)
    parquet = write_files(tmp_path / "parquet", {"machine.toml": MACHINE_TOML, f"{A}/note.md": ""})
    for name, table in rows.items():
        frame(table).to_parquet(parquet / A / f"{name}.parquet")
    frames = {name: frame(table) for name, table in rows.items()}
    same(read, read_folder(xlsx).campaigns[0])
    same(read, read_folder(parquet).campaigns[0])
    same(read, campaign_of_frames(small_machine(), "a", **frames))


# Real bytes of exports: encoding, delimiter, decimal sign.
EXPORTS = {
    "German Excel": ("cp1252", ";", ",", b""),
    "German Excel, UTF-8": ("utf-8", ";", ",", b"\xef\xbb\xbf"),
    "Excel Unicode text": ("utf-16-le", "\t", ",", b"\xff\xfe"),
    "Excel Unicode text, big endian": ("utf-16-be", "\t", ".", b"\xfe\xff"),
    "Chinese Excel": ("gb18030", ",", ".", b""),
    "plain": ("utf-8", ",", ".", b""),
}


@pytest.mark.parametrize("export", EXPORTS)
def test_exports_of_german_and_chinese_excel(tmp_path: Path, export: str) -> None:
    encoding, delimiter, decimal, mark = EXPORTS[export]
    sensors = {"Chinese Excel": ("主轴前轴承", "丝杠螺母", "环境")}.get(export, ("Spindel_größer", "Öl_µ", "t3"))
    if encoding == "cp1252":
        sensors = ("Gehäuse", "Öl µ", "t3")
    machine = MACHINE_TOML
    for old, new in zip(("theta_1", "theta_2", "theta_3"), sensors, strict=True):
        machine = machine.replace(old, new)
    rows = temperature_rows()
    rows[0] = ["t_s", *sensors]
    data = mark + csv_text(rows, delimiter, decimal).replace("\n", "\r\n").encode(encoding)
    drift = {f"{A}/drift.csv": csv_text(drift_rows())}
    campaign = one_campaign(tmp_path, {"machine.toml": machine, f"{A}/temperatures.csv": data, **drift})
    assert campaign.temperatures.sensor_ids == sensors
    written = np.array([row[1:] for row in temperature_rows()[1:]], dtype=float)
    np.testing.assert_array_equal(campaign.temperatures.value_degC, written)


def test_toml_of_a_chinese_or_german_editor(tmp_path: Path) -> None:
    chinese = MACHINE_TOML.replace("X screw nut", "丝杠螺母温度")
    (tmp_path / "gbk.toml").write_bytes(chinese.encode("gbk"))
    assert read_machine(tmp_path / "gbk.toml").sensors[0].location == "丝杠螺母温度"
    (tmp_path / "bom.toml").write_bytes(MACHINE_TOML.encode("utf-8-sig"))
    assert read_machine(tmp_path / "bom.toml").name == "small mill"
    german = MACHINE_TOML.replace("X screw nut", "Gehäuse, 40 °C")
    (tmp_path / "ansi.toml").write_bytes(german.encode("cp1252"))
    assert read_machine(tmp_path / "ansi.toml").sensors[0].location == "Gehäuse, 40 °C"


@pytest.mark.parametrize(("header", "factor"), [("t_s", 1), ("t_min", 60), ("t_h", 3600)])
def test_elapsed_time_in_each_unit(tmp_path: Path, header: str, factor: int) -> None:
    rows = temperature_rows()
    table = [[header, *rows[0][1:]], *([row[0] / factor, *row[1:]] for row in rows[1:])]  # type: ignore[operator]
    campaign = one_campaign(tmp_path, {f"{A}/temperatures.csv": csv_text(table)})
    np.testing.assert_allclose(campaign.temperatures.t_s, np.arange(0, 28801, 600), rtol=1e-14)


@pytest.mark.parametrize("zone", ["", "Z", "+08:00"])
def test_absolute_time_counts_from_the_earliest_of_all_tables(tmp_path: Path, zone: str) -> None:
    """Drift starts 30 s before the temperatures: the campaign starts with it."""
    heat = "time,theta_1\n" + "".join(f"2026-03-04T{h:02}:00:00{zone},{20 + h / 2}\n" for h in range(8, 13))
    drift = "time,dX_um\n" + "".join(f"2026-03-04 {h:02}:59:30.5{zone},{h * 2.5}\n" for h in range(7, 12))
    campaign = one_campaign(tmp_path, {f"{A}/temperatures.csv": heat, f"{A}/drift.csv": drift})
    assert campaign.start is not None
    assert campaign.start.replace(tzinfo=None) == datetime(2026, 3, 4, 7, 59, 30, 500000)
    assert (campaign.start.tzinfo is not None) == bool(zone)
    np.testing.assert_array_equal(campaign.temperatures.t_s, 29.5 + 3600 * np.arange(5))
    assert campaign.drift is not None
    np.testing.assert_array_equal(campaign.drift.t_s, 3600 * np.arange(5))


def test_real_dates_of_excel_parquet_and_pandas(tmp_path: Path) -> None:
    times = [datetime(2026, 3, 4, hour) for hour in range(8, 12)]
    rows: list[list[object]] = [["time", "theta_1"], *([time, 20.5 + i] for i, time in enumerate(times))]
    write_files(tmp_path, {"machine.toml": MACHINE_TOML, **MEASURED})
    write_xlsx(tmp_path / A / "log.xlsx", {"temperatures": rows})
    xlsx = read_folder(tmp_path).campaigns[0]
    np.testing.assert_array_equal(xlsx.temperatures.t_s, 3600 * np.arange(4))
    assert xlsx.start == times[0]
    same(xlsx, campaign_of_frames(small_machine(), "a", temperatures=frame(rows)))
    indexed = frame(rows).set_index("time")
    same(xlsx, campaign_of_frames(small_machine(), "a", temperatures=indexed))
    zoned = frame(rows)
    zoned["time"] = zoned["time"].dt.tz_localize("Europe/Berlin")
    start = campaign_of_frames(small_machine(), "a", temperatures=zoned).start
    assert start is not None
    assert start.astimezone(UTC) == datetime(2026, 3, 4, 7, tzinfo=UTC)


def test_millimetres_missing_cells_rotations_and_other_axes(tmp_path: Path) -> None:
    sweeps = (
        "t_min,axis,position_mm,dX_mm,dZ_um,rB_urad,at_W_mm,station,run,direction\n"
        "0,X,0,0.0015,,10,300,east,1,+\n1,X,500,0.0125,2,,300,east,1,-\n2,X,1000,-0.5,3.5,30,,west,1,\n"
    )
    heat = csv_text(temperature_rows())
    data = one_campaign(tmp_path, {f"{A}/sweeps.csv": sweeps, f"{A}/temperatures.csv": heat}).sweeps
    assert data is not None
    np.testing.assert_allclose(data.error_um[:, 0], [1.5, 12.5, -500], rtol=1e-15)
    np.testing.assert_array_equal(data.error_um[:, 1], [np.nan] * 3)
    np.testing.assert_array_equal(data.error_um[:, 2], [np.nan, 2, 3.5])
    assert data.rotation_urad is not None
    np.testing.assert_array_equal(data.rotation_urad[:, 1], [10, np.nan, 30])
    np.testing.assert_array_equal(data.at_mm["W"], [300, 300, np.nan])
    assert (data.station, data.run) == (("east", "east", "west"), ("1", "1", "1"))
    np.testing.assert_array_equal(data.direction, [1, -1, 1])  # the empty one follows the motion


def test_parameters_with_an_empty_slope_and_drift_components(tmp_path: Path) -> None:
    table = csv_text(parameter_rows()).replace("3,EXX,47.25,4.5,", "3,EXX,47.25,,") + "1,DX,12.5,,,,\n"
    files = {f"{A}/parameters.csv": table, f"{A}/temperatures.csv": csv_text(temperature_rows())}
    lines = one_campaign(tmp_path, files).parameters
    assert lines is not None
    assert np.flatnonzero(np.isnan(lines.slope_um_per_m)).tolist() == [3, 16]
    assert (lines.component[-1], lines.intercept_um[-1]) == ("DX", 12.5)


def test_quoted_cells_trailing_delimiters_and_blank_lines(tmp_path: Path) -> None:
    table = '"t_s" , "theta_1","theta_2",,\r\n"0","20.5", 21 ,,\r\n\r\n600,20.75,"",\r\n1200,21,22.5\r\n,,\r\n'
    heat = one_campaign(tmp_path, {f"{A}/temperatures.csv": table.replace('" , "', '","')}).temperatures
    np.testing.assert_array_equal(heat.t_s, [0, 600, 1200])
    np.testing.assert_array_equal(heat.value_degC, [[20.5, 21], [20.75, np.nan], [21, 22.5]])


def test_symbolic_links_are_followed(tmp_path: Path) -> None:
    real = small_folder(tmp_path / "real")
    link = tmp_path / "link"
    link.mkdir()
    (link / "machine.toml").symlink_to(real / "machine.toml")
    (link / "campaigns").symlink_to(real / "campaigns")
    assert len(read_folder(link).campaigns) == 2


def test_lone_temperatures_and_positions(tmp_path: Path) -> None:
    heat = tmp_path / "log.csv"
    heat.write_text("t_h;a;b\n0;20,5;21\n1;22,5;\n", encoding="utf-8")
    read = read_temperatures(heat)
    assert read.sensor_ids == ("a", "b")
    np.testing.assert_array_equal(read.t_s, [0, 3600])
    np.testing.assert_array_equal(read.value_degC, [[20.5, 21], [22.5, np.nan]])
    path = tmp_path / "p.csv"
    path.write_text("t_s,axis,position_mm\n0,X,12.5\n5,,\n", encoding="utf-8")
    one = read_positions(path)
    assert one.axis == ("X", "")
    np.testing.assert_array_equal(one.position_mm, [12.5, np.nan])
    assert one.tool_length_mm is None
    path.write_text("t_s,X_mm,W_mm,tool_length_mm\n0,1,2,150\n", encoding="utf-8")
    many = read_positions(path)
    assert {name: values.tolist() for name, values in many.at_mm.items()} == {"X": [1], "W": [2]}
    assert many.axis == ("",)
    assert many.tool_length_mm is not None
    path.write_text("t_s,axis,position_mm\n0,X,\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"row 2, column 'position_mm'.*the axis is X"):
        read_positions(path)
    path.write_text("t_s,axis\n0,X\n", encoding="utf-8")
    with pytest.raises(InputError, match="no column 'position_mm'"):
        read_positions(path)


def test_lone_absolute_times_agree(tmp_path: Path) -> None:
    """Both tables count from one origin, although their first rows differ."""
    (tmp_path / "t.csv").write_text("time,a\n2026-03-04T10:00:00,20\n2026-03-04T11:00:00,21\n", encoding="utf-8")
    (tmp_path / "p.csv").write_text("time,axis,position_mm\n2026-03-04T10:30:00,X,5\n", encoding="utf-8")
    heat, positions = read_temperatures(tmp_path / "t.csv"), read_positions(tmp_path / "p.csv")
    assert positions.t_s[0] - heat.t_s[0] == 1800


def test_correlation_tables(tmp_path: Path) -> None:
    path = tmp_path / "c.csv"
    path.write_text(",a,b,c\na,1,,\nb,0.5,1,\nc,-0.25,,1\n", encoding="utf-8")
    table = read_correlations(path)
    assert (table.rows, table.columns) == (("a", "b", "c"), ("a", "b", "c"))
    np.testing.assert_array_equal(table.value, [[1, 0.5, -0.25], [0.5, 1, np.nan], [-0.25, np.nan, 1]])
    path.write_text("parameter,a\nEXX slope,-1.2\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"row 2, column 'a': found -1.2, expected a correlation from -1 to 1"):
        read_correlations(path)
    path.write_text("s,a,b\na,1,0.5\nb,0.4,1\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"a with b is 0.5, but b with a is 0.4"):
        read_correlations(path)
    path.write_text("s,a,b\na,1,0.5\na,0.4,1\n", encoding="utf-8")
    with pytest.raises(InputError, match="the row name 'a' is empty or stands twice"):
        read_correlations(path)


def test_pandas_frames_are_checked_like_files() -> None:
    heat = frame(temperature_rows())
    heat.loc[3, "theta_1"] = 999.0
    sweeps = frame(sweep_rows()).assign(axis="Q")
    settings = CampaignSettings(reference_s=1e9)
    with pytest.raises(InputError) as caught:
        campaign_of_frames(small_machine(), "a", temperatures=heat, sweeps=sweeps, settings=settings)
    codes = {problem.code: problem for problem in caught.value.problems}
    assert set(codes) == {"temperature-range", "unknown-axis", "reference"}
    assert codes["temperature-range"].row == 5
    mixed = frame(temperature_rows()).astype({"theta_1": object})
    mixed.loc[2, "theta_1"] = "21,5"
    with pytest.raises(InputError, match="row 4, column 'theta_1': found the number '21,5' stored as text"):
        campaign_of_frames(small_machine(), "a", temperatures=mixed)
    odd = frame(temperature_rows())
    odd["theta_1"] = [[1]] * len(odd)
    with pytest.raises(InputError, match="expected a finite number"):
        campaign_of_frames(small_machine(), "a", temperatures=odd)


def test_arrays_are_read_like_pandas_frames() -> None:
    table = frame(temperature_rows())
    arrays = {name: table[name].to_numpy() for name in table.columns}
    same(
        campaign_of_frames(small_machine(), "a", temperatures=table),
        campaign_of_frames(small_machine(), "a", temperatures=arrays),
    )
    clock = np.datetime64("2026-03-04T08:00") + (arrays.pop("t_s") * 1e6).astype("timedelta64[us]")
    dated = campaign_of_frames(small_machine(), "a", temperatures={"time": clock, **arrays})
    assert dated.start == datetime(2026, 3, 4, 8)
    np.testing.assert_array_equal(dated.temperatures.t_s, table["t_s"])
    with pytest.raises(InputError, match="temperatures: found columns of 2 and 49 values"):
        campaign_of_frames(small_machine(), "a", temperatures={**arrays, "t_s": np.arange(2.0)})


def test_all_campaigns_of_frames_are_checked_at_once() -> None:
    heat, sweeps = frame(temperature_rows()), frame(sweep_rows())
    folder = read_frames(small_machine(), {"a": {"temperatures": heat, "sweeps": sweeps}, "b": {"temperatures": heat}})
    assert [campaign.name for campaign in folder.campaigns] == ["a", "b"]
    tables = {"a": {"temperatures": heat, "sweep": sweeps}, "b": {"sweeps": sweeps.assign(axis="Q")}}
    with pytest.raises(InputError) as caught:
        read_frames(small_machine(), tables, {"c": CampaignSettings()})
    found = {(problem.code, problem.file) for problem in caught.value.problems}
    assert found == {
        ("unknown-campaign", "settings"),
        ("unknown-table", "campaign 'a', sweep"),
        ("unknown-axis", "campaign 'b', sweeps"),
        ("missing-table", "campaign 'b'"),
    }


def documented() -> dict[str, str]:
    """The first example below each heading of docs/machine_folder.md."""
    text = (ROOT / "docs/machine_folder.md").read_text(encoding="utf-8")
    sections = re.findall(r"^## (\S+).*?\n(.*?)(?=^## |\Z)", text, flags=re.DOTALL | re.MULTILINE)
    blocks = {name: re.search(r"```\w+\n(.*?)```", body, flags=re.DOTALL) for name, body in sections}
    return {name: block[1] for name, block in blocks.items() if block}


@pytest.mark.parametrize("instead", ["sweeps", "parameters"])
def test_the_examples_of_the_documentation_read(tmp_path: Path, instead: str) -> None:
    examples = documented()
    files = {f"{A}/{name}.csv": examples[name] for name in ("temperatures", "drift", "duty", instead)}
    campaign = one_campaign(tmp_path, files | {f"{A}/campaign.toml": examples["campaign.toml"]})
    assert getattr(campaign, instead) is not None
    assert campaign.settings.active_tables == ("pitch",)
    (tmp_path / "documented.toml").write_text(examples["machine.toml"], encoding="utf-8")
    assert read_machine(tmp_path / "documented.toml").axis("W").direction == "+Z"


def test_tk6920_example_reads() -> None:
    folder = read_folder(ROOT / "src/thetacomp/examples/tk6920")
    assert [campaign.name for campaign in folder.campaigns] == ["W", "X", "Y"]
    parameters, sensors = folder.parameter_correlations, folder.sensor_correlations
    assert parameters is not None
    assert sensors is not None
    np.testing.assert_array_equal(sensors.value, sensors.value.T)  # printed as lower triangle, mirrored


@pytest.mark.shared_data("caiviac_fl_thermal/data.xlsx")
def test_the_spindle_recording(tmp_path: Path, shared_data: Path) -> None:
    """Rows as the source's README counts them: 11,115 in six campaigns; t16 steps by 2.9 K at 21.8 h."""
    example = ROOT / "examples/spindle"
    text = (example / "recording.toml").read_text(encoding="utf-8")
    files = {
        "machine.toml": (example / "machine.toml").read_text(encoding="utf-8"),
        "recording.toml": text.replace('"data.xlsx"', f'"{shared_data.as_posix()}"'),
    }
    folder, problems = check_folder(write_files(tmp_path, files))
    assert folder is not None
    sizes = [len(campaign.temperatures.t_s) for campaign in folder.campaigns]
    assert sizes == [1951, 1920, 1920, 1920, 1920, 1484]
    assert sum(sizes) == 11_115
    assert all(campaign.temperatures.t_s[0] == 0 for campaign in folder.campaigns)
    assert {problem.code for problem in problems} == {"temperature-jump"}
    (jump,) = (problem for problem in problems if "+2.9 K" in problem.message)
    assert (jump.column, jump.severity) == ("t16(°C)", "warning")
    assert jump.row is not None
    assert abs((jump.row - 2) * 15 / 3600 - 21.8) < 0.05
    drift = folder.campaigns[0].drift
    assert drift is not None
    assert drift.error_um[0].tolist() == [0.377452788, 0.106198061, 0.14420852]  # ch1, ch3, ch5 of the first row
    duty = folder.campaigns[3].duty
    assert duty is not None
    assert duty.columns["spindle_rpm"].max() == pytest.approx(5000, rel=0.01)


def test_the_spindle_example_without_its_recording_says_where_it_belongs() -> None:
    folder, problems = check_folder(ROOT / "examples/spindle")
    if (ROOT / "examples/spindle/data.xlsx").exists():
        pytest.skip("the recording has been put beside the example")
    assert folder is None
    assert [problem.code for problem in problems] == ["missing-file"]
    assert "README.md" in problems[0].fix


def recording_files(extra: str = "") -> dict[str, str]:
    rows = temperature_rows()
    body = [[i * 2, 10 + i, *row[1:3]] for i, row in enumerate(rows[1:])]
    table = csv_text([["Zeit (min) ", "Weg", "T1", "T2"], *body])
    toml = f"""\
format = 1
[recording]
file = "log.csv"
time = " Zeit (min)"
time_unit = "min"
[recording.temperatures]
theta_1 = "T1"
theta_2 = "T2"
[recording.drift]
dX_mm = "Weg"
[[recording.campaigns]]
name = "first"
first_row = 0
last_row = 19
[[recording.campaigns]]
name = "second"
first_row = 20
last_row = 39
{extra}"""
    return {"machine.toml": MACHINE_TOML, "recording.toml": toml, "log.csv": table}


def test_a_recording_in_csv_with_units(tmp_path: Path) -> None:
    files = recording_files()
    files["log.csv"] = files["log.csv"].replace("\n38,29,", "\n38,0.5,")
    folder, problems = check_folder(write_files(tmp_path, files))
    assert folder is None  # 10 to 58 mm of drift
    assert {problem.code for problem in problems if problem.severity == "error"} == {"error-unit"}
    files = recording_files()
    files["recording.toml"] = files["recording.toml"].replace("dX_mm", "dX_um")
    folder, problems = check_folder(write_files(tmp_path, files))
    assert folder is not None, problems
    first, second = folder.campaigns
    np.testing.assert_array_equal(second.temperatures.t_s, 120 * np.arange(20))
    assert second.drift is not None
    assert second.drift.error_um[0, 0] == 30
    assert first.temperatures.sensor_ids == ("theta_1", "theta_2")


def test_check_prints_a_summary_and_json(tmp_path: Path) -> None:
    root = small_folder(tmp_path)
    runner = CliRunner()
    result = runner.invoke(app, ["check", str(root)])
    assert result.exit_code == 0
    assert "small mill: axes X, W; 3 sensors; 2 campaigns" in result.output
    assert (
        "2026-03-02: 8.00 h; temperatures 49 rows of 3 sensors; sweeps 80 rows in 4 × X, 4 × W sweeps" in result.output
    )
    assert "No problems found." in result.output
    (root / "campaigns/2026-03-02/sweeps.csv").write_text("t_s,axis\n", encoding="utf-8")
    result = runner.invoke(app, ["check", str(root), "--json"])
    assert result.exit_code == 1
    data = json.loads(result.output)
    assert data["summary"] is None
    assert data["problems"][0]["file"] == "campaigns/2026-03-02/sweeps.csv"
    result = runner.invoke(app, ["check", str(tmp_path / "absent")])
    assert result.exit_code == 1
    assert "there is no such folder" in result.output


def test_importing_thetacomp_does_not_import_pandas() -> None:
    code = "import sys, thetacomp; assert 'pandas' not in sys.modules; thetacomp.read_folder"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_campaign_toml_and_absent_tables(tmp_path: Path) -> None:
    files = valid_files(("a",))
    del files[f"{A}/sweeps.csv"], files[f"{A}/duty.csv"]
    files[f"{A}/campaign.toml"] = CAMPAIGN_TOML + 'compensation = "on"\nactive_tables = ["pitch"]\nreference_s = 600\n'
    campaign = one_campaign(tmp_path, dict(files))
    assert campaign.sweeps is None
    assert campaign.settings.active_tables == ("pitch",)
    assert campaign.settings.reference_s == 600

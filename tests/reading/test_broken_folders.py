"""Every kind of broken machine folder gets one clear message: what, where, what was expected, how to mend it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest
from machine_folders import (
    MACHINE_TOML,
    csv_text,
    parameter_rows,
    sweep_rows,
    temperature_rows,
    valid_files,
    write_files,
    write_xlsx,
)

from thetacomp.errors import InputError, Problem
from thetacomp.reading import check_folder, read_positions, read_temperatures

C = "campaigns/c"
HEAT, SWEEPS, DRIFT, DUTY, LINES = (f"{C}/{t}.csv" for t in ("temperatures", "sweeps", "drift", "duty", "parameters"))
SETTINGS = f"{C}/campaign.toml"
Files = dict[str, str | bytes]


@dataclass(frozen=True)
class Broken:
    """One way to spoil the valid folder, and the problem that must be told."""

    name: str
    spoil: Callable[[Files], Mapping[str, str | bytes | None]]
    code: str
    file: str
    phrase: str
    row: int | None = None
    column: str | None = None
    severity: str = "error"
    only: bool = True  # no other error beside it


def valid() -> Files:
    return dict(valid_files(("c",)))


def replaced(file: str, *pairs: tuple[str, str]) -> Callable[[Files], Files]:
    def spoil(files: Files) -> Files:
        text = files[file]
        assert isinstance(text, str)
        for old, new in pairs:
            assert old in text, old
            text = text.replace(old, new, 1)
        return {file: text}

    return spoil


def content(
    file: str, new: str | bytes | None, **others: str | bytes | None
) -> Callable[[Files], Mapping[str, str | bytes | None]]:
    return lambda files: {file: new, **others}


def heat(*rows: str, header: str = "t_s,theta_1,theta_2,theta_3") -> str:
    return "\n".join((header, *rows)) + "\n"


def semicolons(decimal: str) -> str:
    return csv_text(temperature_rows(), ";", decimal)


def lines(*changes: tuple[str, str]) -> Callable[[Files], Mapping[str, str | bytes | None]]:
    text = csv_text(parameter_rows())
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    return content(LINES, text, **{SWEEPS: None})


WITHOUT_AXES = """\
format = 1
[machine]
name = "m"
[[sensors]]
id = "theta_1"
role = "drive"
"""
FIRST = "0,20.13,20.13,20.13"
BROKEN = [
    # machine.toml
    Broken("no machine file", content("machine.toml", None), "missing-file", "machine.toml",
           "there is no machine.toml in the folder"),
    Broken("wrong format number", replaced("machine.toml", ("format = 1", "format = 2")), "format-number",
           "machine.toml", "found format = 2, expected format = 1"),
    Broken("no format number", replaced("machine.toml", ("format = 1", "")), "format-number", "machine.toml",
           "there is no `format`"),
    Broken("axis without direction", replaced("machine.toml", ('direction = "+Z"', "")), "missing-key", "machine.toml",
           "[[axes]] number 2 ('W'): `direction` is missing. It states the Cartesian machine direction"),
    Broken("direction without sign", replaced("machine.toml", ('"+Z"', '"Z"')), "bad-value", "machine.toml",
           "('W'): direction = 'Z', expected '+X', '-X'"),
    Broken("axis without travel", replaced("machine.toml", ("travel_mm = [0.0, 1000.0]", "")), "missing-key",
           "machine.toml", "('X'): `travel_mm` is missing"),
    Broken("travel reversed", replaced("machine.toml", ("[0.0, 1000.0]", "[1000.0, 0.0]")), "bad-value", "machine.toml",
           "the end of the travel (0.0 mm) must be above its start"),
    Broken("misspelt key", replaced("machine.toml", ("travel_mm", "travel")), "unknown-key", "machine.toml",
           "unknown key 'travel' (did you mean 'travel_mm'?)", only=False),
    Broken("unknown role", replaced("machine.toml", ('"ambient"', '"room"')), "bad-value", "machine.toml",
           "number 3 ('theta_3'): role = 'room', expected 'drive'"),
    Broken("sensor id twice", replaced("machine.toml", ('"theta_3"', '"theta_2"')), "bad-value", "machine.toml",
           "sensor named twice: theta_2"),
    Broken("axis names an absent sensor", replaced("machine.toml", ('sensor = "theta_1"', 'sensor = "t1"')),
           "bad-value", "machine.toml", "axis X names the sensor 't1'"),
    Broken("expansion without the power of ten",
           replaced("machine.toml", ('sensor = "theta_1"', 'sensor = "theta_1"\nexpansion_per_K = 11.5')), "expansion",
           "machine.toml", "expansion_per_K = 11.5, expected 1e-7 to 1e-4"),
    Broken("travel in metres", replaced("machine.toml", ("[0.0, 1000.0]", "[0.0, 1.0]")), "travel-unit", "machine.toml",
           "spans 1 mm. Is it in metres?", severity="warning", only=False),
    Broken("TOML without quotes", replaced("machine.toml", ('"small mill"', "small mill")), "toml-syntax",
           "machine.toml", "not valid TOML"),
    Broken("machine file in UTF-16 without mark", content("machine.toml", MACHINE_TOML.encode("utf-16-le")),
           "binary-file", "machine.toml", "NUL bytes"),
    # campaign.toml
    Broken("misspelt setting", replaced(SETTINGS, ("instrument_u_um", "instrument_um")), "unknown-key", SETTINGS,
           "unknown key 'instrument_um' (did you mean 'instrument_u_um'?)"),
    Broken("unknown datum", replaced(SETTINGS, ('datum = "campaign"', 'datum = "machine"')), "bad-value", SETTINGS,
           "datum = 'machine', expected 'campaign' or 'common'"),
    Broken("negative uncertainty", replaced(SETTINGS, ("15.0", "-15.0")), "negative", SETTINGS, "is negative"),
    Broken("reference outside", replaced(SETTINGS, ("datum", "reference_s = 90000\ndatum")), "reference", C,
           "reference_s = 90000 s in campaign.toml is outside the temperatures"),
    # the folder
    Broken("no campaigns", lambda files: {**dict.fromkeys(files), "machine.toml": MACHINE_TOML}, "no-campaigns",
           "campaigns", "there is no folder campaigns/"),
    Broken("tables in the root", lambda files: {**dict.fromkeys(files), "machine.toml": MACHINE_TOML,
           "temperatures.csv": files[HEAT]}, "no-campaigns", "campaigns", "move 'temperatures.csv' into"),
    Broken("campaigns without a folder", lambda files: {**dict.fromkeys(files), "machine.toml": MACHINE_TOML,
           "campaigns/temperatures.csv": files[HEAT]}, "no-campaigns", "campaigns", "the folder holds no campaign"),
    Broken("no temperatures", content(HEAT, None), "missing-table", C, "there is no table of temperatures"),
    Broken("misspelt table", lambda files: {f"{C}/drifts.csv": files[DRIFT]}, "unknown-file", f"{C}/drifts.csv",
           "did you mean 'drift'?", severity="warning"),
    Broken("table as text file", lambda files: {f"{C}/temperatures.txt": files[HEAT]}, "unknown-file",
           f"{C}/temperatures.txt", "tables are .csv, .xlsx or .parquet", severity="warning"),
    Broken("unknown file in the root", content("machine.tml", "x"), "unknown-file", "machine.tml",
           "did you mean 'machine.toml'?", severity="warning"),
    Broken("campaigns and a recording", content("recording.toml", "format = 1\n"), "two-sources", "recording.toml",
           "there are campaigns/ and a recording.toml"),
    Broken("sweeps and parameters", content(LINES, csv_text(parameter_rows())), "two-sources", C,
           "there are sweeps and already separated parameters"),
    Broken("nothing measured", content(SWEEPS, None, **{DRIFT: None}), "nothing-measured", "campaigns",
           "add sweeps.csv (errors over position), parameters.csv (separated lines) or drift.csv"),
    Broken("text without quotes", replaced(SETTINGS, ('mode = "no cooling"', "mode = 3")), "bad-value", SETTINGS,
           "mode = 3, expected a text in double quotes"),
    Broken("number in quotes", replaced(SETTINGS, ("instrument_u_um = 15.0", 'instrument_u_um = "wide"')), "bad-value",
           SETTINGS, "instrument_u_um = 'wide', expected a number, without quotes"),
    Broken("travel is one number", replaced("machine.toml", ("travel_mm = [0.0, 1000.0]", "travel_mm = 1000.0")),
           "bad-value", "machine.toml", "travel_mm = 1000.0, expected a list in square brackets"),
    Broken("travel of three numbers", replaced("machine.toml", ("[0.0, 1000.0]", "[0.0, 500.0, 1000.0]")),
           "bad-value", "machine.toml", "expected a list in square brackets"),
    # headers as people write them
    Broken("unit in brackets", replaced(HEAT, ("theta_1", "theta_1 (°C)")), "unknown-sensor", HEAT,
           "'theta_1 (°C)' (did you mean 'theta_1'?)", 1, "theta_1 (°C)"),
    Broken("unit in square brackets", replaced(SWEEPS, ("dX_um", "dX [µm]")), "unknown-column", SWEEPS,
           "'dX [µm]' (did you mean 'dX_um'?)", 1, "dX [µm]"),
    Broken("position with its unit apart", replaced(SWEEPS, ("position_mm", "Position (mm)")), "unknown-column",
           SWEEPS, "'Position (mm)' (did you mean 'position_mm'?)", 1, "Position (mm)", only=False),
    Broken("German time", replaced(HEAT, ("t_s", "Zeit [s]")), "unknown-sensor", HEAT,
           "'Zeit [s]' (did you mean 't_s'?)", 1, "Zeit [s]", only=False),
    Broken("German date", replaced(HEAT, ("t_s", "Datum")), "unknown-sensor", HEAT,
           "'Datum' (did you mean 'time'?)", 1, "Datum", only=False),
    Broken("Chinese time", replaced(HEAT, ("t_s", "时间")), "unknown-sensor", HEAT,
           "'时间' (did you mean 't_s' or 'time'?)", 1, "时间", only=False),
    Broken("Japanese time", replaced(DRIFT, ("t_s", "時間")), "unknown-column", DRIFT,
           "'時間' (did you mean 't_s' or 'time'?)", 1, "時間", only=False),
    # text files
    Broken("empty file", content(HEAT, b""), "empty-file", HEAT, "the file is empty"),
    Broken("header only", content(HEAT, heat()), "empty-table", HEAT, "a header but no rows"),
    Broken("binary garbage", content(HEAT, bytes(range(1, 256))), "binary-file", HEAT,
           "found the control character 0x01", 1),
    Broken("high bytes", content(HEAT, bytes(range(160, 256))), "encoding", HEAT,
           "encoding of the text is not clear", 1),
    Broken("NUL bytes", content(HEAT, b"t_s,theta_1\n0,\x00\x00\n"), "binary-file", HEAT, "NUL bytes"),
    Broken("control characters", content(HEAT, heat(FIRST, "600,2\x011,22,23")), "binary-file", HEAT,
           "control character 0x01", 3),
    Broken("workbook named csv", content(HEAT, b"PK\x03\x04\x14\x00"), "binary-file", HEAT, "a zip or .xlsx file"),
    Broken("Chinese or Western", content(HEAT, heat(FIRST, header="t_s,a°±,b,c").encode("cp1252")), "encoding", HEAT,
           "It could be Chinese (GB18030) or Western (Windows-1252) text", 1),
    Broken("damaged UTF-16", content(HEAT, b"\xff\xfe" + heat(FIRST).encode("utf-16-le")[:-1]), "encoding", HEAT,
           "starts as utf-16 text but is damaged"),
    Broken("title above the header", content(HEAT, "Temperature log 7\n" + heat(FIRST)), "header", HEAT,
           "found only 'Temperature log 7' in the first line, but up to 4 cells below", 1),
    Broken("padded title above the header", content(HEAT, "Temperature log 7,,,\n" + heat(FIRST)), "header", HEAT,
           "make the header with the column names the first line", 1),
    Broken("no header", content(HEAT, f"{FIRST}\n600,21,22,23\n"), "header", HEAT, "expected the header", 1),
    Broken("empty first line", content(HEAT, "\n" + heat(FIRST)), "header", HEAT, "the first line is empty", 1),
    Broken("comment line", content(HEAT, heat(FIRST, "# opened the door", "600,21,22,23")), "comment-line", HEAT,
           "comment lines are not read", 3),
    Broken("ragged rows", content(HEAT, heat(FIRST, "600,21,22", "1200,21,22,23")), "ragged-rows", HEAT,
           "found 3 cells, expected 4", 3),
    Broken("decimal comma separated by commas", content(HEAT, heat("0,20,5,21,5,22,5", "60,20,6,21,6,22,6")),
           "ragged-rows", HEAT, "A decimal comma in a file separated by commas", 2),
    Broken("open quotation mark", content(HEAT, heat(FIRST, '600,"21,22,23')), "quotes", HEAT,
           "quotation marks do not match", 3),
    Broken("two delimiters", content(HEAT, heat("0;20,21;22", header="t_s;theta_1,theta_2;theta_3")), "delimiter", HEAT,
           "several of comma, semicolon and tab", 1),
    Broken("column without header", content(HEAT, heat("0,20,21,22", header="t_s,theta_1,,theta_3")), "unnamed-column",
           HEAT, "a column without a header holds data, such as '21'", 1),
    Broken("column twice", content(HEAT, heat(FIRST, header="t_s,theta_1,theta_1,theta_3")), "duplicate-column", HEAT,
           "'theta_1' stands twice", 1, "theta_1"),
    # numbers
    Broken("quoted decimal comma", content(HEAT, heat('0,"20,5",21,22')), "decimal-comma", HEAT,
           "'20,5' in a file separated by commas", 2, "theta_1"),
    Broken("lone point among commas", content(DRIFT, "t_s;dX_um\n0;1,5\n1200;1.234\n"), "decimal-mixed", DRIFT,
           "'1,5' and '1.234' in one file", 2, "dX_um"),
    Broken("thousands and decimals", content(DRIFT, "t_s;dX_um\n0;1,5\n1200;1.234,5\n"), "decimal-mixed", DRIFT,
           "could each be the decimal sign or part thousands", 3, "dX_um"),
    Broken("point alone may be thousands", content(DRIFT, "t_s;dX_um\n0;100\n600;1.234\n"), "thousands", DRIFT,
           "found '1.234', which may mean 1234 or 1.234", 3, "dX_um"),
    Broken("comma alone may be thousands", content(DRIFT, "t_s;dX_um\n0;100\n600;1,234\n"), "thousands", DRIFT,
           "found '1,234', which may mean 1234 or 1.234", 3, "dX_um"),
    Broken("thousands with spaces", content(DRIFT, "t_s;dX_um\n0;1 234\n1200;2\n"), "thousands", DRIFT,
           "'1 234' with thousands separators", 2, "dX_um"),
    Broken("unit in the cell", content(HEAT, heat("0,20 °C,21,22", "600,21 °C,22,23")), "not-a-number", HEAT,
           "found '20 °C', expected a number alone", 2, "theta_1"),
    Broken("text in a number column", replaced(HEAT, ("600,", "600,broken")), "not-a-number", HEAT, "found 'broken", 3,
           "theta_1"),
    Broken("infinite number", replaced(DUTY, ("650", "inf")), "not-a-number", DUTY, "found 'inf'", 3, "spindle_rpm"),
    Broken("spreadsheet error in text", replaced(DUTY, ("650", "#WERT!")), "formula-error", DUTY,
           "the formula error '#WERT!'", 3, "spindle_rpm"),
    # columns
    Broken("Chinese header", content(DRIFT, "时间,dX_um\n0,1\n".encode("gb18030")), "no-time-column", DRIFT,
           "there is none of the columns 't_s', 't_min', 't_h', 'time'", 1, only=False),
    Broken("German header", content(DRIFT, "t_s,Weg_um\n0,1\n"), "unknown-column", DRIFT,
           "found unknown columns: 'Weg_um'; expected t_s, t_min", 1, "Weg_um", only=False),
    Broken("nearly right header", content(DRIFT, "t_s,dx_um\n0,1\n"), "unknown-column", DRIFT,
           "'dx_um' (did you mean 'dX_um'?)", 1, "dx_um", only=False),
    Broken("required column absent", replaced(SWEEPS, ("position_mm", "pos_mm")), "missing-column", SWEEPS,
           "there is no column 'position_mm'; found 'axis'", 1, only=False),
    Broken("two times", content(HEAT, heat("0,0,20", "600,10,21", header="t_s,t_min,theta_1")), "duplicate-column",
           HEAT, "'t_s' and 't_min' state the same quantity", 1, "t_min"),
    Broken("same error in two units", content(DRIFT, "t_s,dX_um,dX_mm\n0,1,0.001\n"), "duplicate-column", DRIFT,
           "'dX_um' and 'dX_mm' state the same quantity", 1, "dX_mm"),
    Broken("unknown sensor", content(HEAT, heat(FIRST, header="t_s,theta_1,theta2,theta_3")), "unknown-sensor", HEAT,
           "sensor columns that machine.toml does not know: 'theta2' (did you mean 'theta_2'?)", 1, "theta2"),
    Broken("sensor without column", replaced(HEAT, (",theta_3", ",")), "unnamed-column", HEAT, "without a header", 1),
    Broken("sensors missing", content(HEAT, heat("0,20", "28800,30", header="t_s,theta_1")), "sensor-without-column",
           HEAT, "2 of the 3 sensors of machine.toml have no column here: 'theta_2', 'theta_3'", severity="warning"),
    Broken("empty sensor column", content(HEAT, heat("0,20,,21", "28800,30,,22")), "empty-column", HEAT,
           "no value at all in the column of 'theta_2'", None, "theta_2", severity="warning"),
    # time
    Broken("time backward", content(HEAT, heat(FIRST, "1200,21,22,23", "600,21,22,23", "28800,21,22,23")),
           "time-backward", HEAT, "time goes back from 1200 s to 600 s", 4, "t_s"),
    Broken("time twice", replaced(HEAT, ("\n1200,", "\n600,")), "time-duplicate", HEAT,
           "the time 600 s stands twice", 4, "t_s"),
    Broken("time missing", replaced(HEAT, ("\n1200,", "\n,")), "missing-value", HEAT, "the cell is empty", 4, "t_s"),
    Broken("time not a number", replaced(HEAT, ("\n1200,", "\nnan,")), "missing-value", HEAT, "the cell is empty", 4,
           "t_s"),
    Broken("day and month", content(DRIFT, "time;dX_um\n04.03.2026 10:00;1\n05.03.2026 10:00;2\n"), "day-month-order",
           DRIFT, "'04.03.2026 10:00', which may mean 4 March 2026 or 3 April 2026", 2, "time"),
    Broken("month and day", content(DRIFT, "time,dX_um\n3/14/2026,1\n"), "day-month-order", DRIFT,
           "'3/14/2026', which may mean 14 March 2026", 2, "time"),
    Broken("impossible date", content(DRIFT, "time,dX_um\n2026-02-30T10:00,1\n"), "not-a-time", DRIFT,
           "found '2026-02-30T10:00', expected a date and time in ISO 8601", 2, "time"),
    Broken("date in a column of seconds", content(DRIFT, "t_s,dX_um\n2026-02-03T10:00,1\n"), "date-cell", DRIFT,
           "found the date '2026-02-03T10:00', expected a number", 2, "t_s"),
    Broken("elapsed and absolute times", content(DRIFT, "time,dX_um\n2026-02-03T10:00,1\n"), "time-mixed", C,
           "absolute times (`time`) in 'drift', elapsed times in"),
    Broken("some zones", content(DRIFT, "time,dX_um\n2026-02-03T10:00,1\n2026-02-03T11:00Z,1\n"), "time-zone", DRIFT,
           "some times carry a time zone and some do not", None, "time"),
    Broken("milliseconds", content(HEAT, heat(FIRST, "14400000,25,25,20", "28800000,30,25,20")), "time-unit", HEAT,
           "the table covers 333 days; a campaign takes hours. Is the time in milliseconds", None, "t_s",
           severity="warning"),
    Broken("minutes as seconds", content(HEAT, heat(FIRST, "240,25,25,20", "480,30,25,20")), "time-unit", HEAT,
           "only 480 s; a campaign takes hours. Is the time in minutes", None, "t_s", severity="warning", only=False),
    Broken("sweeps after the log ended", content(HEAT, heat(FIRST, "600,21,22,23", "1200,22,23,24", "7200,25,25,25")),
           "not-covered", SWEEPS, "but the temperature table covers only 0 to 7200 s", 33, "t_s", only=False),
    Broken("log with a gap", replaced(HEAT, *((f"\n{t},", f"\n{t + 20000},") for t in range(28800, 10000, -600))),
           "time-gap", HEAT, "min without a temperature", 19, "t_s", severity="warning"),
    # temperatures
    Broken("sensor fault code", replaced(HEAT, ("\n600,", "\n600,-999")), "temperature-range", HEAT,
           "expected -60 to 250 °C", 3, "theta_1"),
    Broken("kelvin", content(HEAT, heat("0,293.1,293.2,293.3", "28800,300,301,293")), "temperature-range", HEAT,
           "is the column in kelvin?", 2, "theta_1", only=False),
    Broken("Fahrenheit", content(HEAT, heat("0,68.1,68.2,68.3", "28800,90.5,80.5,69")), "temperature-unit", HEAT,
           "degrees Fahrenheit?", severity="warning"),
    Broken("sensor at rest", content(HEAT, heat(*(f"{t},{20 + t / 3600},20.5,20" for t in range(0, 28801, 1800)))),
           "temperature-constant", HEAT, "these sensors never change: theta_2, theta_3", None, "theta_2",
           severity="warning"),
    Broken("no heat at all", content(HEAT, heat(*(f"{t},20,20,20" for t in range(0, 28801, 1800)))),
           "temperature-constant", HEAT, "no temperature changes at all", severity="warning"),
    Broken("jump", content(HEAT, heat(*(f"{t},{20 + t / 7200 + 31 * (t > 9000)},20.{t},20.5"
           for t in range(0, 28801, 600)))), "temperature-jump", HEAT, "the temperature jumps by +31.1 K within 600 s",
           18, "theta_1", severity="warning"),
    # sweeps and drift
    Broken("unknown axis", replaced(SWEEPS, (",X,", ",Q,")), "unknown-axis", SWEEPS,
           "found the axis 'Q', expected one of 'X', 'W'", 2, "axis"),
    Broken("axis cell empty", replaced(SWEEPS, (",X,", ",,")), "unknown-axis", SWEEPS, "the cell is empty", 2, "axis"),
    Broken("no axes in the machine file", content("machine.toml", WITHOUT_AXES), "unknown-axis", SWEEPS,
           "machine.toml has no [[axes]]", 2, "axis", only=False),
    Broken("outside the travel", replaced(SWEEPS, (",X,1000,", ",X,1500,")), "outside-travel", SWEEPS,
           "found 1500 mm on axis X, expected 0 to 1000 mm", 6, "position_mm"),
    Broken("positions in metres", lambda files: {SWEEPS: csv_text([r if i == 0 else [*r[:2], r[2] / 1000, *r[3:]]
           for i, r in enumerate(sweep_rows())])}, "position-unit", SWEEPS, "are they in metres?", None,
           "position_mm", only=False),
    Broken("positions in µm", lambda files: {SWEEPS: csv_text([r if i == 0 else [*r[:2], r[2] * 1000, *r[3:]]
           for i, r in enumerate(sweep_rows())])}, "outside-travel", SWEEPS, "Are the positions in µm?", 3,
           "position_mm", only=False),
    Broken("position missing", replaced(SWEEPS, (",X,250,", ",X,,")), "missing-value", SWEEPS, "the cell is empty", 3,
           "position_mm"),
    Broken("two points are no sweep", content(SWEEPS, "t_s,axis,position_mm,dX_um\n0,X,0,1\n30,X,1000,2\n"),
           "sweep-too-short", SWEEPS, "fewer than 3 different positions", 2, "position_mm"),
    Broken("errors in mm under µm", content(DRIFT, "t_s,dX_um\n0,0.0021\n1200,0.1234\n"), "error-unit", DRIFT,
           "the largest error is 0.123 µm: are the errors in mm?", severity="warning"),
    Broken("errors beyond 20 mm", content(DRIFT, "t_s,dX_mm\n0,0.5\n1200,123.4\n"), "error-unit", DRIFT,
           "found 123400 µm, expected errors below 20000 µm", 3, "dX_mm"),
    Broken("direction in words", lambda files: {SWEEPS: csv_text([[*r, "direction" if i == 0 else "up"]
           for i, r in enumerate(sweep_rows())])}, "direction", SWEEPS, "found 'up', expected + or -", 2, "direction"),
    Broken("position of the moving axis twice", lambda files: {SWEEPS: csv_text([[*r, "at_X_mm" if i == 0 else 300]
           for i, r in enumerate(sweep_rows())])}, "at-moving-axis", SWEEPS, "axis X moves in these rows", 2,
           "at_X_mm"),
    Broken("position of an unknown axis", content(DRIFT, "t_s,dX_um,at_Q_mm\n0,1,2\n"), "unknown-column", DRIFT,
           "'at_Q_mm'", 1, "at_Q_mm"),
    Broken("same point twice", replaced(SWEEPS, ("\n30,X,250,", "\n0,X,0,")), "time-duplicate", SWEEPS,
           "the same time, axis and position stand twice", 3, "t_s"),
    Broken("pause in a sweep", lambda files: {SWEEPS: csv_text([r if i < 6 or i > 10 else [r[0] + 5000, *r[1:]]
           for i, r in enumerate(sweep_rows()) if r[1] != "W"])}, "sweep-pause", SWEEPS, "are these two sweeps?", 7,
           "t_s", severity="warning"),
    # parameters
    Broken("line without P0", lines(("0,EXX,0.0,0.0,0,", "0,EXX,0.0,0.0,,")), "missing-value", LINES,
           "expected the position at which the intercept holds", 2, "p0_mm"),
    Broken("line without numbers", lines(("0,EXX,0.0,0.0,", "0,EXX,,,")), "missing-value", LINES,
           "intercept and slope are both empty", 2, "intercept_um"),
    Broken("moving axis first", lines(("EXX", "XEX")), "component", LINES, "found the component 'XEX', expected E +", 2,
           "component"),
    Broken("component of an unknown axis", lines(("EYX", "EYQ")), "component", LINES, "'EYQ'", 10, "component"),
    Broken("state twice", lines(("\n1,EXX", "\n0,EXX")), "time-duplicate", LINES, "same component and time stand twice",
           3, "t_h"),
    Broken("states out of order", lines(("\n2,EXX", "\n0.5,EXX")), "time-backward", LINES,
           "the time of this component goes back", 4, "t_h"),
    Broken("line beyond the travel", lines(("0,0,1000\n", "0,0,9000\n")), "outside-travel", LINES,
           "the lines of axis X cover 0 to 9000 mm", 2, "p_max_mm"),
    Broken("range reversed", lines(("0,0,1000\n", "0,1000,0\n")), "outside-travel", LINES,
           "p_max_mm is not above p_min_mm", 2, "p_max_mm"),
    # correlations
    Broken("correlation above 1", content("sensor_correlations.csv", "s,a\nb,99\n"), "correlation-range",
           "sensor_correlations.csv", "found 99, expected a correlation from -1 to 1", 2, "a"),
]  # fmt: skip


def spoilt(root: Path, case: Broken) -> tuple[Problem, ...]:
    files = valid()
    changes = case.spoil(files)
    write_files(root, {name: data for name, data in (files | dict(changes)).items() if data is not None})
    folder, problems = check_folder(root)
    assert (folder is None) == any(problem.severity == "error" for problem in problems)
    return problems


@pytest.mark.parametrize("case", BROKEN, ids=lambda case: case.name)
def test_a_broken_folder_is_told_what_where_and_how(tmp_path: Path, case: Broken) -> None:
    problems = spoilt(tmp_path, case)
    told = [p for p in problems if p.code == case.code and p.file == case.file and p.severity == case.severity]
    assert told, problems
    problem = told[0]
    assert case.phrase in f"{problem.message} {problem.fix}", problem
    assert (problem.row, problem.column) == (case.row, case.column), problem
    assert problem.fix.endswith((".", ")")), problem
    if case.only:
        errors = [p for p in problems if p.severity == "error" and p is not problem]
        assert not errors, errors


def test_an_unreadable_sweep_table_is_not_called_absent(tmp_path: Path) -> None:
    files = valid() | {SWEEPS: str(valid()[SWEEPS]).replace(",X,250,", ",X,abc,", 1)}
    del files[DRIFT]
    problems = check_folder(write_files(tmp_path, files))[1]
    assert {p.code for p in problems} == {"not-a-number"}


def test_the_name_of_an_unread_sheet_is_proposed(tmp_path: Path) -> None:
    files = valid()
    del files[SWEEPS], files[DRIFT]
    write_xlsx(write_files(tmp_path, files) / C / "tracker.xlsx", {"Sheet1": sweep_rows()})
    problems = check_folder(tmp_path)[1]
    assert [p.code for p in problems] == ["nothing-measured", "unknown-sheet"]
    assert "rename the sheet to 'sweeps'" in problems[1].fix


def test_names_of_sensors_are_not_numbers(tmp_path: Path) -> None:
    """`T1` and `E5` are made of letters that also occur in dates and numbers."""
    path = tmp_path / "T3.csv"
    path.write_text("T1,E5\n20.5,21\n20.6,22\n", encoding="utf-8")
    with pytest.raises(InputError, match="none of the columns 't_s'"):
        read_temperatures(path)
    path.write_text("0,20.5\n60,20.6\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"found the numbers '0', '20\.5'"):
        read_temperatures(path)


def test_positions_of_several_axes_are_described_and_not_offered_for_a_misspelt_column(tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    path.write_text("t_s,axis,position\n0,X,1\n", encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_positions(path)
    assert "<axis>_mm" not in str(caught.value)
    page = (Path(__file__).parents[2] / "docs" / "machine_folder.md").read_text(encoding="utf-8")
    assert "<axis>_mm" in page[page.index("## Tables for `thetacomp predict`") :]


def test_all_problems_come_in_one_go(tmp_path: Path) -> None:
    """Six files, six faults: six errors, each with its file."""
    files = valid()
    files |= {
        HEAT: heat("0,20,21,22", "600,x,21,22", "28800,20,21,22"),
        SWEEPS: str(files[SWEEPS]).replace(",X,", ",Q,", 1),
        DRIFT: "t_s,dX_um\n0,1\n0,2\n",
        DUTY: "",
        SETTINGS: "datum = 1\n",
        "machine.toml": MACHINE_TOML,
        "parameter_correlations.csv": "a\n1\n",
    }
    problems = check_folder(write_files(tmp_path, files))[1]
    assert {problem.file for problem in problems} == {HEAT, SWEEPS, DRIFT, DUTY, SETTINGS, "parameter_correlations.csv"}
    assert all(problem.severity == "error" for problem in problems)


def test_a_broken_machine_file_does_not_hide_broken_tables(tmp_path: Path) -> None:
    files = valid() | {"machine.toml": "format = 1\n", HEAT: b"", SETTINGS: "datum = 1\n"}
    problems = check_folder(write_files(tmp_path, files))[1]
    assert {problem.file for problem in problems} == {"machine.toml", HEAT, SETTINGS}


def test_five_thousand_bad_cells_are_one_line(tmp_path: Path) -> None:
    rows = [f"{t},bad,worse,20" for t in range(0, 50_000, 10)]
    problems = check_folder(write_files(tmp_path, valid() | {HEAT: heat(*rows)}))[1]
    assert [(p.column, p.row) for p in problems] == [("theta_1", 2), ("theta_2", 2)]
    assert "The same in 5000 rows in all: 2, 3, 4, …" in problems[0].message


def test_many_columns_with_one_fault_are_three_lines_and_a_count(tmp_path: Path) -> None:
    ids = [f"s{i}" for i in range(20)]
    machine = "format = 1\n[machine]\nname = 'm'\n" + "".join(
        f"[[sensors]]\nid = '{s}'\nrole = 'ambient'\n" for s in ids
    )
    table = ",".join(["t_s", *ids]) + "\n" + "".join(f"{t}" + ",300" * 20 + "\n" for t in (0, 3600))
    problems = check_folder(write_files(tmp_path, {"machine.toml": machine, HEAT: table}))[1]
    errors = [problem for problem in problems if problem.severity == "error"]
    assert [problem.column for problem in errors] == ["s0", "s1", "s2"]
    assert "17 more of this kind (columns 's3'" in errors[-1].message

"""Every limit that tells a plausible number from a slip: a value just inside is taken, one just outside is told."""

from __future__ import annotations

from datetime import UTC, date, datetime, timedelta
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from machine_folders import csv_text, valid_files, write_files

from thetacomp.campaign import Campaign
from thetacomp.errors import InputError, Problem
from thetacomp.reading import check_folder
from thetacomp.reading.problems import ProblemList, nearest, quoted, shortened
from thetacomp.reading.single_tables import read_duty, read_positions, read_temperatures
from thetacomp.reading.summary import summarize

NAME = "2026-03-02"
C = f"campaigns/{NAME}"
Rows = list[list[object]]


def heat_rows(count: int = 49, step_s: float = 600.0, start_s: float = 0.0) -> Rows:
    """Three sensors that rise by hundredths of a kelvin a row."""
    rows: Rows = [["t_s", "theta_1", "theta_2", "theta_3"]]
    rows += [[start_s + step_s * i, *(round(20.0 + k + 0.01 * i, 2) for k in range(3))] for i in range(count)]
    return rows


def read(root: Path, **tables: Rows | str | None) -> tuple[Campaign | None, list[Problem]]:
    """One campaign of the small mill with heat and some tables; what is found, errors first."""
    files = {name: text for name, text in valid_files((NAME,)).items() if not name.startswith(C)}
    given: dict[str, Rows | str | None] = {"temperatures": heat_rows(), "drift": drift_rows(), **tables}
    for name, rows in given.items():
        if rows is not None:
            ending = "toml" if isinstance(rows, str) else "csv"
            files[f"{C}/{name}.{ending}"] = rows if isinstance(rows, str) else csv_text(rows)
    folder, problems = check_folder(write_files(root, files))
    return (folder.campaigns[0] if folder is not None else None), list(problems)


def drift_rows(times_s: tuple[float, ...] = (0.0, 1200.0, 2400.0), x_um: float = 5.0) -> Rows:
    return [["t_s", "dX_um"], *([t, x_um + 0.001 * t] for t in times_s)]


def told(root: Path, code: str, **tables: Rows | str | None) -> list[Problem]:
    return [problem for problem in read(root, **tables)[1] if problem.code == code]


def with_cell(rows: Rows, row: int, column: int, value: object) -> Rows:
    rows[row][column] = value
    return rows


# --- temperatures -----------------------------------------------------------------------------------------------------


def test_plain_tables_have_no_problem(tmp_path: Path) -> None:
    campaign, problems = read(tmp_path)
    assert campaign is not None
    assert problems == []


@pytest.mark.parametrize(
    ("degC", "kelvin", "wrong"),
    [(-60.0, False, False), (-60.1, False, True), (250.0, False, False), (250.1, False, True)],
)
def test_temperatures_of_machines(tmp_path: Path, degC: float, kelvin: bool, wrong: bool) -> None:
    found = told(tmp_path, "temperature-range", temperatures=with_cell(heat_rows(), 5, 2, degC))
    assert bool(found) == wrong
    assert not wrong or (found[0].row, found[0].column) == (6, "theta_2")
    assert not wrong or ("kelvin" in found[0].message) == kelvin


def test_a_whole_column_above_the_range_may_be_in_kelvin(tmp_path: Path) -> None:
    rows = heat_rows()
    for row in rows[1:]:
        row[1] = round(float(row[1]) + 273.15, 2)  # type: ignore[arg-type]
    (found,) = told(tmp_path, "temperature-range", temperatures=rows)
    assert "is the column in kelvin?" in found.message


@pytest.mark.parametrize(("coldest", "doubt"), [(50.0, False), (50.5, True)])
def test_temperatures_that_never_fall_below_fifty_may_be_fahrenheit(
    tmp_path: Path, coldest: float, doubt: bool
) -> None:
    rows = heat_rows()
    shift = coldest - 20.0
    for row in rows[1:]:
        row[1:] = [round(float(v) + shift, 2) for v in row[1:]]  # type: ignore[arg-type]
    assert bool(told(tmp_path, "temperature-unit", temperatures=rows)) == doubt


@pytest.mark.parametrize(("rows", "resting", "doubt"), [(10, 1, True), (9, 1, False), (10, 3, True), (10, 0, False)])
def test_sensors_that_never_change(tmp_path: Path, rows: int, resting: int, doubt: bool) -> None:
    table = heat_rows(rows)
    for row in table[1:]:
        for k in range(resting):
            row[1 + k] = 21.0
    found = told(tmp_path, "temperature-constant", temperatures=table)
    assert bool(found) == doubt
    if doubt:
        assert ("theta_1." in found[0].message, found[0].column) == (
            (True, "theta_1") if resting == 1 else (False, None)
        )


@pytest.mark.parametrize(
    ("step_K", "step_s", "doubt"),
    [
        (2.0, 60.0, False),
        (2.1, 60.0, True),
        (-2.1, 60.0, True),
        (2.1, 120.0, True),
        (2.1, 127.0, False),
        (9.0, 600.0, False),
    ],
)
def test_a_jump_is_more_than_two_kelvin_and_faster_than_one_a_minute(
    tmp_path: Path, step_K: float, step_s: float, doubt: bool
) -> None:
    rows = heat_rows(20, step_s)
    for row in rows[11:]:
        row[2] = round(21.0 + step_K, 2)
    for row in rows[1:11]:
        row[2] = 21.0
    (*found,) = told(tmp_path, "temperature-jump", temperatures=rows, drift=drift_rows((0.0, 60.0, 120.0)))
    assert bool(found) == doubt
    if doubt:
        assert (found[0].row, found[0].column) == (12, "theta_2")
        assert f"jumps by {step_K:+.1f} K within {step_s:g} s (at {10 * step_s / 3600:.2f} h)" in found[0].message


@pytest.mark.parametrize(
    ("step_s", "gap_s", "doubt"),
    [(60.0, 600.0, False), (60.0, 601.0, True), (30.0, 599.0, False), (600.0, 1800.0, False), (600.0, 1801.0, True)],
)
def test_a_gap_is_three_steps_and_ten_minutes(tmp_path: Path, step_s: float, gap_s: float, doubt: bool) -> None:
    rows = heat_rows(20, step_s)
    for row in rows[11:]:
        row[0] = float(row[0]) + gap_s - step_s  # type: ignore[arg-type]
    found = told(tmp_path, "time-gap", temperatures=rows, drift=drift_rows((0.0, 60.0, 120.0)))
    assert bool(found) == doubt
    assert not doubt or (found[0].row == 12 and f"{gap_s / 60:.0f} min without" in found[0].message)


@pytest.mark.parametrize(
    ("span_s", "words"), [(600.0, ""), (599.0, "only 599 s"), (14 * 86400.0, ""), (15 * 86400.0, "15 days")]
)
def test_a_campaign_takes_ten_minutes_to_two_weeks(tmp_path: Path, span_s: float, words: str) -> None:
    found = told(tmp_path, "time-unit", temperatures=heat_rows(11, span_s / 10.0), drift=drift_rows((0.0, 1.0, 2.0)))
    assert bool(found) == bool(words)
    assert not words or words in found[0].message


def test_time_goes_forward_and_stands_nowhere_twice(tmp_path: Path) -> None:
    (back,) = told(tmp_path / "a", "time-backward", temperatures=with_cell(heat_rows(), 7, 0, 2999.0))
    assert (back.row, back.column) == (8, "t_s")
    assert "goes back from 3000 s to 2999 s" in back.message
    (same,) = told(tmp_path / "b", "time-duplicate", temperatures=with_cell(heat_rows(), 7, 0, 3000.0))
    assert same.row == 8
    assert "the time 3000 s stands twice" in same.message


# --- errors -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("header", "value", "wrong"),
    [
        ("dX_um", 20000.0, False), ("dX_um", -20000.1, True), ("dX_mm", 20.0, False), ("dX_mm", 20.1, True),
        ("rA_urad", 20000.0, False), ("rA_urad", -20001.0, True),
    ],
)  # fmt: skip
def test_errors_of_machines(tmp_path: Path, header: str, value: float, wrong: bool) -> None:
    rows: Rows = [["t_s", "dY_um", header], [0, 5.0, 0.0], [1200, 6.0, value], [2400, 7.0, 0.0]]
    found = [p for p in told(tmp_path, "error-unit", drift=rows) if p.severity == "error"]
    assert bool(found) == wrong
    assert not wrong or (found[0].row, found[0].column) == (3, header)


@pytest.mark.parametrize(("largest_um", "doubt"), [(0.99, True), (1.0, False), (0.0, False)])
def test_errors_below_a_micrometre_may_be_millimetres(tmp_path: Path, largest_um: float, doubt: bool) -> None:
    rows: Rows = [["t_s", "dX_um", "rA_urad"], [0, 0.0, 50.0], [1200, -largest_um, 50.0], [2400, 0.0, 50.0]]
    found = [p for p in told(tmp_path, "error-unit", drift=rows) if p.severity == "warning"]
    assert bool(found) == doubt


def test_an_empty_direction_is_told_once_and_read_as_missing(tmp_path: Path) -> None:
    rows: Rows = [["t_s", "dX_um", "dY_um"], [0, 5.0, None], [1200, 6.0, None], [2400, 7.0, None]]
    campaign, problems = read(tmp_path, drift=rows)
    (found,) = problems
    assert (found.code, found.severity, found.column) == ("empty-column", "warning", "dY_um")
    assert campaign is not None
    assert campaign.drift is not None
    assert np.isnan(campaign.drift.error_um[:, 1:]).all()
    assert campaign.drift.rotation_urad is None


@pytest.mark.parametrize(("last_s", "wrong"), [(29400.0, False), (29401.0, True), (-600.0, False), (-601.0, True)])
def test_temperatures_cover_the_errors_within_one_step(tmp_path: Path, last_s: float, wrong: bool) -> None:
    """Temperatures from 0 to 28800 s, a row each 600 s."""
    times = (0.0, 1200.0, last_s) if last_s > 0 else (last_s, 0.0, 1200.0)
    found = told(tmp_path, "not-covered", drift=drift_rows(times))
    assert bool(found) == wrong
    assert not wrong or found[0].row == (4 if last_s > 0 else 2)


# --- sweeps -----------------------------------------------------------------------------------------------------------


def sweep(positions_mm: list[float], axis: str = "X", start_s: float = 0.0, step_s: float = 30.0) -> Rows:
    rows: Rows = [["t_s", "axis", "position_mm", "dX_um"]]
    return rows + [[start_s + step_s * i, axis, p, 5.0 + i] for i, p in enumerate(positions_mm)]


@pytest.mark.parametrize(
    ("position_mm", "wrong"), [(1001.0, False), (1001.2, True), (-1.0, False), (-1.2, True), (20000.0, True)]
)
def test_positions_lie_in_the_travel(tmp_path: Path, position_mm: float, wrong: bool) -> None:
    """Of 0 to 1000 mm a thousandth and 0.1 mm more are rounding."""
    rows = sweep([0.0, 500.0, position_mm] if position_mm > 0 else [position_mm, 500.0, 1000.0])
    found = told(tmp_path, "outside-travel", sweeps=rows, drift=None)
    assert bool(found) == wrong
    if wrong:
        assert found[0].row == (4 if position_mm > 0 else 2)
        assert ("in µm?" in found[0].message) == (position_mm > 10_000.0)


@pytest.mark.parametrize(("span_mm", "wrong"), [(9.9, True), (10.0, False)])
def test_positions_over_less_than_a_hundredth_of_the_travel_may_be_metres(
    tmp_path: Path, span_mm: float, wrong: bool
) -> None:
    found = told(tmp_path, "position-unit", sweeps=sweep([0.0, span_mm / 2, span_mm]), drift=None)
    assert bool(found) == wrong


def test_a_sweep_has_three_positions(tmp_path: Path) -> None:
    (found,) = told(tmp_path / "a", "sweep-too-short", sweeps=sweep([0.0, 1000.0]), drift=None)
    assert found.row == 2
    assert told(tmp_path / "b", "sweep-too-short", sweeps=sweep([0.0, 500.0, 1000.0]), drift=None) == []


@pytest.mark.parametrize(
    ("pause_s", "step_s", "doubt"),
    [(600.0, 30.0, False), (601.0, 30.0, True), (601.0, 70.0, False), (901.0, 70.0, True)],
)
def test_a_pause_in_a_sweep_is_ten_minutes_and_ten_steps(
    tmp_path: Path, pause_s: float, step_s: float, doubt: bool
) -> None:
    rows = sweep([0.0, 200.0, 400.0, 600.0, 800.0, 1000.0], step_s=step_s)
    for row in rows[4:]:
        row[0] = float(row[0]) + pause_s - step_s  # type: ignore[arg-type]
    found = told(tmp_path, "sweep-pause", sweeps=rows, drift=None)
    assert bool(found) == doubt
    assert not doubt or found[0].row == 5


def test_one_time_for_several_points_is_doubtful_and_for_one_place_wrong(tmp_path: Path) -> None:
    rows = sweep([0.0, 500.0, 1000.0])
    (doubt,) = told(tmp_path / "a", "time-duplicate", sweeps=with_cell(rows, 3, 0, 30.0), drift=None)
    assert (doubt.severity, doubt.row) == ("warning", 4)
    rows = with_cell(sweep([0.0, 500.0, 500.0, 1000.0]), 3, 0, 30.0)
    (wrong,) = told(tmp_path / "b", "time-duplicate", sweeps=rows, drift=None)
    assert (wrong.severity, wrong.row) == ("error", 4)


@pytest.mark.parametrize("given", [True, False])
def test_a_clock_of_whole_minutes_may_stamp_both_ways_at_the_turn_alike(tmp_path: Path, given: bool) -> None:
    """Out and back with readings each 30 s: the turning point is read twice within one minute, once from each side."""
    places = [0.0, 250.0, 500.0, 750.0, 1000.0]
    rows = sweep([*places, *places[::-1]])
    for i, row in enumerate(rows[1:]):
        row[0] = 60.0 * (i // 2) + (60.0 if i % 2 and i != 5 else 0.0)
    if given:
        rows[0].append("direction")
        for i, row in enumerate(rows[1:]):
            row.append("+" if i < 5 else "-")
    rows[6][0] = rows[5][0]
    rows[1:] = sorted(rows[1:], key=lambda row: float(str(row[0])))
    found = told(tmp_path, "time-duplicate", sweeps=rows, drift=None)
    assert [problem.severity for problem in found] == ["warning"]


def test_a_probe_that_hung_and_one_that_never_moves_are_told(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    rows: Rows = [["t_s", "dX_um", "dY_um"]]
    rows += [[60.0 * i, round(0.1 * i + rng.normal(0.0, 0.4), 2), 3.0] for i in range(300)]
    for row in rows[101:141]:
        row[1] = rows[101][1]
    (hung,) = told(tmp_path / "a", "error-frozen", drift=rows)
    assert (hung.severity, hung.row, hung.column) == ("warning", 103, "dX_um")
    assert "39 readings are repeated" in hung.message
    (still,) = told(tmp_path / "b", "error-constant", drift=rows)
    assert (still.severity, still.column) == ("warning", "dY_um")


# --- campaigns --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("reference_s", "wrong"), [(0.0, False), (28800.0, False), (28801.0, True), (-1.0, True)])
def test_a_reference_lies_inside_the_temperatures(tmp_path: Path, reference_s: float, wrong: bool) -> None:
    assert bool(told(tmp_path, "reference", campaign=f"reference_s = {reference_s}\n")) == wrong


def lines(rows: Rows) -> Rows:
    return [["t_s", "component", "intercept_um", "slope_um_per_m", "p0_mm", "p_min_mm", "p_max_mm"], *rows]


def test_separated_lines_have_all_that_gives_them_a_meaning(tmp_path: Path) -> None:
    good: Rows = [
        [0, "EXX", 5, None, 0, 0, 1000],
        [600, "EXX", None, 7, 0, 0, 1000],
        [0, "DX", 5, None, None, None, None],
    ]
    campaign, problems = read(tmp_path / "0", parameters=lines(good), drift=None)
    assert problems == []
    assert campaign is not None
    for k, (changed, code, row) in enumerate(
        (
            ([0, "EXX", 5, 1, None, 0, 1000], "missing-value", 2),
            ([0, "EXX", None, None, 0, 0, 1000], "missing-value", 2),
            ([0, "EXX", 5, 1, 0, 1000, 1000], "outside-travel", 2),
            ([0, "EXX", 5, 1, 0, 0, 1001.2], "outside-travel", 2),
            ([0, "EXX", 5, 1, 0, -1.2, 1000], "outside-travel", 2),
            ([0, "EXQ", 5, 1, 0, 0, 1000], "component", 2),
            ([0, "EQX", 5, 1, 0, 0, 1000], "component", 2),
            ([600, "EXX", 5, 1, 0, 0, 1000], "time-duplicate", 3),
            ([700, "EXX", 5, 1, 0, 0, 1000], "time-backward", 3),
        ),
        start=1,
    ):
        found = told(tmp_path / str(k), code, parameters=lines([changed, *good[1:]]), drift=None)  # type: ignore[list-item]
        assert [p.row for p in found] == [row], changed
    for k, (span_mm, wrong) in enumerate(((9.9, True), (10.0, False)), start=20):
        few = lines([[0, "EXX", 5, 1, 0, 0, span_mm], [600, "EXX", 5, 1, 0, 0, span_mm]])
        assert bool(told(tmp_path / str(k), "position-unit", parameters=few, drift=None)) == wrong


def test_clocks_of_all_tables_are_of_one_kind(tmp_path: Path) -> None:
    """Temperatures by a clock with zone, drift without: told once; elapsed times beside a clock are another fault."""
    start = datetime(2026, 3, 2, 8, tzinfo=UTC)

    def timed(rows: Rows, zone: bool) -> Rows:
        moments = [start + timedelta(seconds=float(row[0])) for row in rows[1:]]  # type: ignore[arg-type]
        texts = [(m if zone else m.replace(tzinfo=None)).isoformat() for m in moments]
        return [["time", *rows[0][1:]], *([text, *row[1:]] for text, row in zip(texts, rows[1:], strict=True))]

    one, problems = read(tmp_path / "a", temperatures=timed(heat_rows(), True), drift=timed(drift_rows(), True))
    assert problems == []
    assert one is not None
    assert one.start == start
    (zone,) = told(tmp_path / "b", "time-zone", temperatures=timed(heat_rows(), True), drift=timed(drift_rows(), False))
    assert zone.file == C
    assert "the times of some tables carry a time zone" in zone.message
    (mixed,) = told(tmp_path / "c", "time-mixed", temperatures=timed(heat_rows(), True))
    assert "absolute times (`time`) in 'temperatures', elapsed times in 'drift'" in mixed.message
    # The drift may begin first: all tables count from the earliest moment, and what was logged before is history.
    early = timed([["t_s", "dX_um"], [-600.0, 5.0], [0.0, 6.0], [600.0, 7.0]], True)
    found, _ = read(tmp_path / "d", temperatures=timed(heat_rows(), True), drift=early)
    assert found is not None
    assert found.drift is not None
    assert found.drift.t_s.tolist() == [0.0, 600.0, 1200.0]
    assert found.temperatures.t_s[0] == 600.0


def test_two_kinds_of_errors_over_position_and_none_at_all(tmp_path: Path) -> None:
    both = {"sweeps": sweep([0.0, 500.0, 1000.0]), "parameters": lines([[0, "EXX", 5, 1, 0, 0, 1000]])}
    (two,) = told(tmp_path / "a", "two-sources", **both)
    assert "there are sweeps and already separated parameters" in two.message
    (nothing,) = told(tmp_path / "b", "nothing-measured", drift=None)
    assert (nothing.severity, nothing.file) == ("error", "campaigns")
    assert "no campaign has measured errors" in nothing.message


def test_what_was_read_is_counted(tmp_path: Path) -> None:
    positions = [0.0, 500.0, 1000.0]
    rows = sweep(positions) + sweep(positions, "W", 300.0)[1:] + sweep(positions, "X", 600.0)[1:]
    files = valid_files((NAME,))
    files = {name: text for name, text in files.items() if not name.startswith(C)} | {
        f"{C}/temperatures.csv": csv_text(heat_rows(53, 600.0, -2400.0)), f"{C}/sweeps.csv": csv_text(rows),
        f"{C}/duty.csv": csv_text([["t_s", "spindle_rpm"], [0, 0], [600, 5]]),
    }  # fmt: skip
    folder, _ = check_folder(write_files(tmp_path, files))
    assert folder is not None
    (one,) = summarize(folder).campaigns
    assert one.points == {"temperatures": 49, "sweeps": 9, "duty": 2}
    assert one.sweeps == {"X": 2, "W": 1}
    assert (one.duration_s, one.lead_s, one.sensors, one.direction_given) == (28800.0, 2400.0, 3, False)
    assert (summarize(folder).axes, summarize(folder).sensors) == (("X", "W"), 3)


# --- cells ------------------------------------------------------------------------------------------------------------


def test_dates_and_times_of_a_workbook_are_moments(tmp_path: Path) -> None:
    moments = [datetime(2026, 3, 2), datetime(2026, 3, 2, 0, 10), datetime(2026, 3, 2, 0, 20)]
    frame = pd.DataFrame({"time": moments, "a": [20.0, 20.5, 21.0]})
    frame.to_excel(tmp_path / "t.xlsx", index=False)
    read_back = read_temperatures(tmp_path / "t.xlsx")
    assert np.diff(read_back.t_s).tolist() == [600.0, 600.0]
    assert read_back.t_s[0] == datetime(2026, 3, 2, tzinfo=UTC).timestamp()
    days = pd.DataFrame({"time": [date(2026, 3, 2), date(2026, 3, 3), date(2026, 3, 5)], "a": [20.0, 20.5, 21.0]})
    days.to_parquet(tmp_path / "t.parquet")
    assert (np.diff(read_temperatures(tmp_path / "t.parquet").t_s) / 86400.0).tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("cell", "code", "words"),
    [
        ("2026-03-04", "date-cell", "found the date '2026-03-04'"),
        ("4.3.2026", "date-cell", "found the date '4.3.2026'"),
        ("1 234.5", "thousands", "thousands separators"),
        ("12.5 °C", "not-a-number", "expected a number alone"),
        ("#DIV/0!", "formula-error", "formula error '#DIV/0!'"),
        ("abc", "not-a-number", "found 'abc', expected a number."),
        ("inf", "not-a-number", "inf"),
    ],
)
def test_a_cell_that_is_no_number_is_told_by_what_it_seems_to_be(
    tmp_path: Path, cell: str, code: str, words: str
) -> None:
    rows = with_cell(with_cell(heat_rows(), 5, 2, cell), 9, 2, cell)
    found = [p for p in read(tmp_path, temperatures=rows)[1] if p.severity == "error"]
    assert [(p.code, p.row, p.column) for p in found] == [(code, 6, "theta_2")]
    assert words in found[0].message
    assert "The same in 2 rows in all: 6, 10." in found[0].message


@pytest.mark.parametrize(
    ("cell", "code", "words"),
    [
        ("04.03.2026 10:00", "day-month-order", "4 March 2026 or 3 April 2026"),
        ("25.03.2026 10:00", "day-month-order", "may mean 25 March 2026:"),
        ("45.33.2026 10:00", "day-month-order", "no date at all"),
        ("4711", "not-a-time", "4711"),
        ("", "missing-value", "the time is empty"),
        ("noon", "not-a-time", "found 'noon', expected a date and time"),
        ("2026-13-04T10:00:00", "not-a-time", "found '2026-13-04T10:00:00'"),
    ],
)
def test_a_cell_that_is_no_moment_is_told_by_what_it_seems_to_be(
    tmp_path: Path, cell: str, code: str, words: str
) -> None:
    rows: Rows = [["time", "a"], ["2026-03-04T09:00:00", 20.0], [cell, 20.5], ["2026-03-04T11:00:00", 21.0]]
    path = write_files(tmp_path, {"t.csv": csv_text(rows)}) / "t.csv"
    with pytest.raises(InputError) as refusal:
        read_temperatures(path)
    (problem,) = refusal.value.problems
    assert (problem.code, problem.row, problem.column) == (code, 3, "time")
    assert words in problem.message


def test_zones_within_one_column_are_all_there_or_none(tmp_path: Path) -> None:
    rows: Rows = [["time", "a"], ["2026-03-04T09:00:00+01:00", 20.0], ["2026-03-04T09:10:00+01:00", 20.5]]
    path = write_files(tmp_path, {"t.csv": csv_text(rows)}) / "t.csv"
    assert read_temperatures(path).t_s[0] == datetime(2026, 3, 4, 8, tzinfo=UTC).timestamp()
    path.write_text(csv_text(with_cell(rows, 2, 0, "2026-03-04T09:10:00")), encoding="utf-8")
    with pytest.raises(InputError, match="some times carry a time zone and some do not"):
        read_temperatures(path)


def test_tables_on_their_own(tmp_path: Path) -> None:
    files = {
        "p.csv": "t_s,axis,position_mm,tool_length_mm\n0,X,10,100\n1,,,100\n",
        "v.csv": "t_s,X_mm,W_mm\n0,1,2\n1,3,4\n",
        "d.csv": "t_s,spindle_rpm\n0,500\n60,0\n",
        "bad.csv": "t_s,axis,position_mm\n0,X,10\n1,X,\n2,X,\n",
    }
    root = write_files(tmp_path, files)
    one, volume = read_positions(root / "p.csv"), read_positions(root / "v.csv")
    assert (one.axis, one.position_mm[0], np.isnan(one.position_mm[1])) == (("X", ""), 10.0, True)
    assert one.tool_length_mm is not None
    assert (one.tool_length_mm.tolist(), dict(one.at_mm)) == ([100.0, 100.0], {})
    assert {name: values.tolist() for name, values in volume.at_mm.items()} == {"X": [1.0, 3.0], "W": [2.0, 4.0]}
    assert (volume.axis, volume.tool_length_mm, np.isnan(volume.position_mm).all()) == (("", ""), None, True)
    assert read_duty(root / "d.csv").columns["spindle_rpm"].tolist() == [500.0, 0.0]
    with pytest.raises(InputError, match=r"row 3, column 'position_mm': the axis is X, but the position is empty"):
        read_positions(root / "bad.csv")


# --- words ------------------------------------------------------------------------------------------------------------


def test_long_things_are_shortened_to_one_line() -> None:
    assert shortened("a" * 40) == "a" * 40
    assert shortened("a" * 41) == "a" * 39 + "…"
    assert shortened("a \n b\tc", 5) == "a b c"
    assert len(shortened("x" * 99, 60)) == 60
    assert quoted("abc") == "'a', 'b', 'c'"
    assert quoted("abcd", 3) == "'a', 'b', 'c' and 1 more"
    assert quoted("abc", 3) == "'a', 'b', 'c'"


def test_problems_are_told_in_order_of_weight_and_no_more_than_three_of_a_kind() -> None:
    problems = ProblemList()
    problems.warning("w", "f", "doubt", "look", [7])
    for k in range(5):
        problems.error("e", "f", f"wrong {k}", "mend", [k + 2, 30, 40, 50][: k + 1], f"c{k}")
    problems.error("e", "g", "other file", "mend")
    found = problems.collected()
    assert [p.severity for p in found] == ["error"] * 4 + ["warning"]
    assert found[0].message == "wrong 0"
    assert found[1].message == "wrong 1 The same in 2 rows in all: 3, 30."
    assert found[2].message == "wrong 2 The same in 3 rows in all: 4, 30, 40. 2 more of this kind (columns 'c3', 'c4')."
    assert (found[3].message, found[3].row, found[4].row) == ("other file", None, 7)
    assert problems.has("w")
    assert problems.has_errors
    problems.drop("e")
    assert not problems.has_errors
    more = ProblemList()
    more.error("e", "f", "four", "mend", [1, 2, 3, 4])
    assert more.collected()[0].message.endswith("The same in 4 rows in all: 1, 2, 3, ….")


@pytest.mark.parametrize(
    ("name", "known", "meant"),
    [
        ("theta_1 (°C)", ["theta_1", "theta_2"], "'theta_1'"),
        ("dX [µm]", ["dX_um", "dX_mm"], "'dX_um'"),
        ("Zeit [min]", ["t_s", "t_min", "time"], "'t_min'"),
        ("Zeit", ["t_s", "t_min", "time"], "'t_s' or 'time'"),
        ("Datum", ["t_s", "time"], "'time'"),
        ("postion_mm", ["position_mm", "axis"], "'position_mm'"),
        ("theta_3", ["theta_1", "theta_2"], ""),
        ("qqq", ["position_mm", "axis"], ""),
    ],
)
def test_the_nearest_name_is_offered(name: str, known: list[str], meant: str) -> None:
    assert nearest(name, known) == (f" (did you mean {meant}?)" if meant else "")

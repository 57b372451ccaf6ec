"""The plan of a campaign as a user meets it: timetable, tables that `check` reads, page, messages."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from browser import open_in_browser
from hypothesis import given, settings
from hypothesis import strategies as st
from plan_machines import SHORT, boring_machine, mill, rows, three
from typer.testing import CliRunner

from thetacomp.cli.main import app
from thetacomp.errors import InputError
from thetacomp.machine import Axis
from thetacomp.planning import tables
from thetacomp.planning.figures import floor_figure
from thetacomp.planning.foundation import propose_targets
from thetacomp.planning.options import PlanOptions
from thetacomp.planning.steps import Move, Read
from thetacomp.planning.timetable import make_timetable, moved_mm
from thetacomp.planning.writer import make_plan, write_plan
from thetacomp.reading import check_folder

TK6920 = Path(__file__).parents[2] / "src" / "thetacomp" / "examples" / "tk6920"
PUBLISHED = PlanOptions(mode="no cooling")


def plan(*arguments: object):
    return CliRunner().invoke(app, ["plan", *map(str, arguments)])


# --- the day ----------------------------------------------------------------------------------------------------------


def test_the_default_is_the_published_run_with_a_round_about_each_hour() -> None:
    timetable = make_timetable(boring_machine(), PUBLISHED)
    warm = [block for block in timetable.blocks if block.part == "warm-up"]
    # Section 1.3 of the paper: 650 rpm, 1000 mm/min, about 7.5 h, a sweep of every axis about each hour.
    assert warm[-1].end_s - warm[0].begin_s == pytest.approx(7.5 * 3600, abs=10)
    begins = [block.begin_s for block in timetable.rounds if block.part == "warm-up"]
    assert len(begins) == 8
    assert np.diff(begins) / 60 == pytest.approx(7.5 * 60 / 8, abs=0.2)
    duty = rows(tables.duty_csv(timetable))
    assert {float(row["spindle_rpm"]) for row in duty} == {0.0, 650.0}
    working = [float(row["feed_mm_min"]) for row in duty if float(row["spindle_rpm"])]
    assert all(990 < feed <= 1000 for feed in working)


def test_all_axes_get_about_the_same_share_of_the_warm_up() -> None:
    timetable = make_timetable(boring_machine(), PUBLISHED)
    duty = [block for block in timetable.blocks if block.kind == "duty"]
    moved = [sum(moved_mm(timetable.setup, block, axis.name) for block in duty) for axis in timetable.setup.axes]
    assert max(moved) / min(moved) < 1.1


def test_the_spindle_turns_in_the_warm_up_alone() -> None:
    timetable = make_timetable(mill(), SHORT)
    duty = rows(tables.duty_csv(timetable))
    by_time = {round(block.begin_s): block.kind for block in timetable.blocks}
    assert all((float(row["spindle_rpm"]) > 0) == (by_time.get(int(row["t_s"])) == "duty") for row in duty)


def test_the_length_of_a_sweep_is_way_over_feed_and_the_stops() -> None:
    options = replace(SHORT, points=11, dwell_s=5.0, settle_s=1.0, sweep_feed_mm_min=2000.0)
    timetable = make_timetable(mill(), options)
    found = {row["axis"]: row for row in rows(tables.timetable_csv(timetable)) if row["what"] == "sweep"}
    # X 0 to 800 rests at 400, turns at 4 and 796, and leaves the lowest position 8 for its rest; 22 stops of 6 s.
    way_mm = (400 - 4) + (796 - 4) + (796 - 8) + (400 - 8)
    length_s = float(found["X"]["t_end_s"]) - float(found["X"]["t_begin_s"])
    assert length_s == pytest.approx(way_mm / 2000 * 60 + 22 * 6, abs=1)


def test_a_start_gives_times_of_day_and_the_name_of_the_campaign() -> None:
    timetable = make_timetable(mill(), replace(SHORT, start=datetime(2026, 3, 2, 6, 0)))
    assert tables.campaign_name(timetable) == "2026-03-02"
    first = next(row for row in rows(tables.timetable_csv(timetable)) if row["what"] == "round")
    assert first["time"] == "2026-03-02T06:30"


def test_an_axis_too_long_for_a_block_moves_over_a_part_of_its_travel_and_the_plan_says_so() -> None:
    long = (Axis(name="X", direction="+X", travel_mm=(0.0, 40_000.0)), *three()[1:])
    timetable = make_timetable(mill(*long), replace(SHORT, sweep_feed_mm_min=20_000.0))
    assert any("Axis X needs 80 min" in note for note in timetable.notes)
    warm = [block for block in timetable.blocks if block.part == "warm-up"]
    assert warm[-1].end_s - warm[0].begin_s == pytest.approx(2 * 3600, abs=10)


def test_rounds_that_take_much_of_the_time_are_pointed_out() -> None:
    timetable = make_timetable(boring_machine(), replace(PUBLISHED, points=31))
    assert any("% of the warm-up on measuring" in note for note in timetable.notes)
    assert not make_timetable(boring_machine(), PUBLISHED).notes


@settings(max_examples=40, deadline=None)
@given(
    low=st.floats(-5000, 5000),
    length=st.floats(10, 20_000),
    share=st.floats(0, 1),
    points=st.integers(5, 40),
    speed=st.sampled_from([0.0, 650.0]),
)
def test_nothing_leaves_the_travel(low: float, length: float, share: float, points: int, speed: float) -> None:
    low, high = round(low, 3), round(low + length, 3)
    axis = Axis(name="X", direction="-X", travel_mm=(low, high))
    options = PlanOptions(
        points=points,
        duration_h=1.0,
        cool_h=0.0,
        sweep_feed_mm_min=10_000.0,
        feed_mm_min=500.0,
        speed_rpm=speed,
        park_mm={"X": min(round(low + share * length, 3), high)},
    )
    timetable = make_timetable(mill(axis), options)
    turn = timetable.setup.axes[0].turn_mm
    for block in timetable.blocks:
        for entry in block.steps:
            if isinstance(entry.step, Move):
                assert low <= entry.step.to_mm <= high
            if isinstance(entry.step, Read):
                assert entry.position_mm["X"] == entry.step.position_mm
                assert turn[0] < entry.step.position_mm < turn[1]


# --- the tables -------------------------------------------------------------------------------------------------------


@pytest.fixture
def written(tmp_path: Path) -> Path:
    result = plan(TK6920, "--out", tmp_path / "plan", "--mode", "no cooling")
    assert result.exit_code == 0, result.output
    return tmp_path / "plan"


def test_check_says_only_that_the_tables_wait_to_be_filled(written: Path) -> None:
    folder, problems = check_folder(written / "machine_folder")
    assert folder is None
    assert [(problem.severity, problem.code, problem.file.split("/")[-1]) for problem in problems] == [
        ("error", "empty-table", "temperatures.csv"),
        ("warning", "empty-column", "sweeps.csv"),
    ]


def test_filled_tables_are_read_without_any_complaint(written: Path) -> None:
    place = written / "machine_folder" / "campaigns" / "planned"
    header = (place / "temperatures.csv").read_text("utf-8").strip()
    assert header.split(",") == ["t_s", *(f"theta_{k}" for k in range(1, 16))]
    log = [f"{60 * k}," + ",".join(f"{20 + (j + 1) * k / 7000:.2f}" for j in range(15)) for k in range(720)]
    (place / "temperatures.csv").write_text("\n".join([header, *log]), "utf-8")
    lines = (place / "sweeps.csv").read_text("utf-8").splitlines()
    filled = [line.replace(",,,,", f",{k / 100 + 2},3.5,-1.25,", 1) for k, line in enumerate(lines[1:])]
    (place / "sweeps.csv").write_text("\n".join([lines[0], *filled]), "utf-8")
    folder, problems = check_folder(written / "machine_folder")
    assert [str(problem) for problem in problems] == []
    assert folder is not None
    campaign = folder.campaigns[0]
    assert campaign.sweeps is not None
    assert campaign.sweeps.sweep.max() + 1 == 13 * 4
    planned = [row for row in rows((written / "points.csv").read_text("utf-8")) if row["kind"] == "sweep"]
    assert campaign.sweeps.position_mm.tolist() == [float(row[f"at_{row['axis']}_mm"]) for row in planned]
    assert [{1: "+", -1: "-"}[d] for d in campaign.sweeps.direction] == [row["direction"] for row in planned]
    for axis in "XYZW":
        at = campaign.sweeps.at_mm[axis]
        moving = np.array(campaign.sweeps.axis) == axis
        assert np.isnan(at[moving]).all()
        assert len(set(at[~moving])) == 1
    assert campaign.settings.mode == "no cooling"
    cold = [row for row in planned if row["part"] == "cold block"]
    hot = [row for row in planned if row["part"] != "cold block"]
    assert float(cold[-1]["t_s"]) < campaign.settings.reference_s < float(hot[0]["t_s"])


def test_point_names_are_stable_and_tell_round_axis_position_and_approach(written: Path) -> None:
    points = rows((written / "points.csv").read_text("utf-8"))
    names = [point["point"] for point in points]
    assert len(set(names)) == len(names)
    for point in points:
        if point["kind"] == "sweep":
            way = {"+": "P", "-": "M"}[point["direction"]]
            assert point["point"] == f"{point['round']}_{point['axis']}_{point['target']}_{way}"
        else:
            assert re.fullmatch(rf"{point['round']}_F[1-4]_[BE]", point["point"])
    place = {(p["axis"], p["target"]): p[f"at_{p['axis']}_mm"] for p in points if p["axis"]}
    assert len(place) == 4 * 11
    assert all(place[p["axis"], p["target"]] == p[f"at_{p['axis']}_mm"] for p in points if p["axis"])
    times = [float(point["t_s"]) for point in points]
    assert times == sorted(times)


def test_nominal_points_are_the_tool_point_in_the_frame_of_the_machine() -> None:
    timetable = make_timetable(mill(), SHORT)  # its Y runs along -Y
    targets = propose_targets(timetable.setup)
    for row in rows(tables.points_csv(timetable, targets)):
        if row["kind"] == "sweep":
            wanted = [float(row["at_X_mm"]), -float(row["at_Y_mm"]), float(row["at_Z_mm"])]
        else:
            wanted = next(target.at_mm for target in targets if target.name == row["target"])
        assert [float(row[name]) for name in ("x_mm", "y_mm", "z_mm")] == pytest.approx(wanted, abs=1e-3)


def test_every_sensor_waits_for_its_commissioning(written: Path) -> None:
    sheet = rows((written / "sensor_commissioning.csv").read_text("utf-8"))
    assert [row["sensor"] for row in sheet] == list(boring_machine().sensor_ids)
    assert sheet[14]["location"] == "X feed motor bearing end cover"
    assert all(row["rise_by_hand_K"] == "" for row in sheet)


def test_odd_texts_come_back_from_campaign_toml(tmp_path: Path) -> None:
    import tomllib

    odd = 'chiller "on"\\ 20 °C – 冷却 # as in production'
    text = tables.campaign_toml(make_timetable(mill(), replace(SHORT, mode=odd, instrument=odd)))
    assert tomllib.loads(text)["mode"] == odd


# --- the page ---------------------------------------------------------------------------------------------------------


@pytest.mark.needs("chromium")
def test_the_page_opens_without_a_network_and_nothing_is_cut_off(written: Path, tmp_path: Path) -> None:
    view = open_in_browser(written / "plan.html", tmp_path, height=6000)
    assert view.requests == ()
    assert view.console == ()
    shown = np.any(np.abs(view.pixels - view.pixels[0, 0]) > 0.1, axis=2)
    assert 0.02 < shown.mean() < 0.9
    assert not shown[:, -4:].any()


def test_the_page_tells_safety_names_and_figures(tmp_path: Path) -> None:
    machine = mill().model_copy(update={"name": "<b>mill</b> & co"})
    made = make_plan(machine, replace(SHORT, must_see_um=1.0))
    files = write_plan(made, b"", tmp_path / "plan")
    page = (tmp_path / "plan" / "plan.html").read_text("utf-8")
    assert "<b>mill" not in page
    for words in ("responsible", "0.1 K", "R03_F1_B", "R03_X_002_P", "Not good enough", "no cooling", "12 h"):
        assert words in page, words
    for row in made.visible_changes:
        assert f"<strong>{row.visible_um:.1f}</strong>" in page
    programs = [file for file in files if file.startswith("nc/")]
    assert len(programs) == 2 * 6
    assert all(file in page for file in programs)


# --- messages ---------------------------------------------------------------------------------------------------------


def refused(machine, options: PlanOptions = SHORT) -> str:
    with pytest.raises(InputError) as caught:
        make_timetable(machine, options)
    return str(caught.value)


def test_what_cannot_be_planned_is_refused_with_the_mend() -> None:
    x = Axis(name="X", direction="+X", travel_mm=(0.0, 800.0))
    assert "no [[axes]]" in refused(mill().model_copy(update={"axes": ()}))
    ram = Axis(name="Ram", direction="+Z", travel_mm=(0.0, 500.0))
    assert "--nc-axis Ram=Z" in refused(mill(x, ram))
    assert "both be called X" in refused(mill(x, ram), replace(SHORT, nc_axis={"Ram": "X"}))
    assert "names the axis 'Q'" in refused(mill(x), replace(SHORT, park_mm={"Q": 1.0}))
    assert "outside its travel of 0 to 800 mm" in refused(mill(x), replace(SHORT, park_mm={"X": 801.0}))
    dash = Axis(name="X-1", direction="+X", travel_mm=(0.0, 800.0))
    assert "name of a tracker point" in refused(mill(dash), replace(SHORT, nc_axis={"X-1": "X"}))
    crowded = refused(boring_machine(), replace(SHORT, points=200))
    assert "hardly any time" in crowded
    assert "--interval-min" in crowded
    assert crowded.count("error:") == 2  # warm-up and cool-down, both told at once


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"points": 4}, "--points"),
        ({"dwell_s": 0.0}, "--dwell-s"),
        ({"settle_s": -1.0}, "--settle-s"),
        ({"sweep_feed_mm_min": float("nan")}, "--sweep-feed-mm-min"),
        ({"duration_h": 0.0}, "--duration-h"),
        ({"interval_min": 1e9}, "--interval-min"),
        ({"tracker_u_um": 0.0}, "--tracker-u-um"),
        ({"vertical": "W"}, "--vertical"),
        ({"must_see_um": 0.0}, "--must-see-um"),
    ],
)
def test_an_option_without_sense_is_named(change: dict[str, object], word: str) -> None:
    assert word in refused(mill(), replace(SHORT, **change))


def test_one_axis_alone_is_planned_and_the_open_roll_is_named() -> None:
    made = make_plan(mill(three()[0]), SHORT)
    assert any("roll of the tracker's frame" in note for note in made.notes)
    assert len(made.visible_changes) == 3
    header = tables.sweeps_csv(made.timetable).splitlines()[0]
    assert "at_" not in header
    assert not any("roll" in note for note in make_plan(mill(), SHORT).notes)


def test_what_is_taken_for_granted_is_said() -> None:
    def notes(options: PlanOptions) -> str:
        return " ".join(make_plan(mill(), options).notes)

    guessed = notes(PlanOptions())
    assert all(word in guessed for word in ("--mode", "5 m away", "--park"))
    stated = replace(SHORT, tracker_at_mm=(0.0, 0.0, -3000.0), park_mm={"X": 1.0, "Y": -1.0, "Z": 300.0})
    assert notes(stated) == ""


def test_broken_machine_files_are_told_as_everywhere(tmp_path: Path) -> None:
    missing = plan(tmp_path, "--out", tmp_path / "o")
    assert missing.exit_code == 1
    assert "machine.toml" in missing.output
    text = (TK6920 / "machine.toml").read_text("utf-8")
    (tmp_path / "machine.toml").write_text(re.sub(r"travel_mm = .*", "", text, count=1), "utf-8")
    broken = plan(tmp_path, "--out", tmp_path / "o")
    assert broken.exit_code == 1
    assert "`travel_mm` is missing" in broken.output
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["--tracker-at", "1,2"], "expected 3 numbers"),
        (["--tracker-at", "1,2,nan"], "expected 3 numbers"),
        (["--park", "X"], "--park X=1500"),
        (["--park", "X=1", "--park", "X=2"], "each axis once"),
        (["--park", "X=a"], "expected 1 number"),
    ],
)
def test_options_that_cannot_be_read_are_named(arguments: list[str], word: str, tmp_path: Path) -> None:
    result = plan(TK6920, "--out", tmp_path / "o", *arguments)
    assert result.exit_code == 1
    assert word in result.output


def test_a_filled_folder_is_never_overwritten(written: Path) -> None:
    before = (written / "points.csv").read_bytes()
    again = plan(TK6920, "--out", written, "--points", 7)
    assert again.exit_code == 1
    assert "not empty" in again.output
    assert (written / "points.csv").read_bytes() == before


def test_the_check_against_a_size_decides_the_exit_code_and_json_holds_all(tmp_path: Path) -> None:
    good = plan(TK6920, "--out", tmp_path / "a", "--must-see-um", 200, "--json")
    bad = plan(TK6920, "--out", tmp_path / "b", "--must-see-um", 20, "--json")
    assert (good.exit_code, bad.exit_code) == (0, 3)
    data = json.loads(good.stdout)
    assert data["good_enough"] is True
    assert len(data["reach"]) == 12
    assert all((tmp_path / "a" / name).is_file() for name in data["files"])
    listed = rows((tmp_path / "a" / "uncertainty.csv").read_text("utf-8"))
    assert [float(row["visible_um"]) for row in listed] == pytest.approx(
        [row["visible_um"] for row in data["reach"]], abs=0.01
    )


@pytest.mark.parametrize("vertical", ["X", "Y", "Z"])
def test_the_picture_from_above_is_not_a_mirror_image(vertical: str) -> None:
    setup = make_timetable(mill(), replace(SHORT, vertical=vertical)).setup
    drawn = floor_figure(setup, propose_targets(setup)).figure.axes[0]
    right = np.eye(3)["XYZ".index(drawn.get_xlabel()[0])]
    up = np.eye(3)["XYZ".index(drawn.get_ylabel()[0])] * (-1 if drawn.yaxis_inverted() else 1)
    # Right-handed axes: what comes towards the reader is what points up in the hall.
    assert np.cross(right, up) == pytest.approx(np.eye(3)["XYZ".index(vertical)])

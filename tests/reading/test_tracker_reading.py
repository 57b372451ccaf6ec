"""Tracker points in files: our own table, exported ASCII joined with the planned points, all problems in one go."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from machine_folders import campaign_of_frames, csv_text, write_files
from simulated_hall import MACHINE, campaign_toml, machine_toml, measured_hall, temperature_text, tracker_rows
from typer.testing import CliRunner

from thetacomp.analysis import analyze_folder
from thetacomp.cli.main import app
from thetacomp.reading import check_folder, read_folder

DAY = "campaigns/2026-03-02"
PLANNED = ("t_s", "station", "target", "axis", "position_mm", "at_X_mm", "at_Y_mm", "at_Z_mm", "at_W_mm", "direction")


@pytest.fixture(scope="module")
def seen():
    return measured_hall(np.random.default_rng(3), rounds=4, targets=5)


def files(hall, **changes) -> dict[str, str]:
    found = {
        "machine.toml": machine_toml(),
        f"{DAY}/temperatures.csv": temperature_text(hall),
        f"{DAY}/campaign.toml": campaign_toml(hall),
        f"{DAY}/tracker.csv": csv_text(tracker_rows(hall)),
    }
    return found | changes


def changed(hall, row: int, column: str, value) -> str:
    """tracker.csv with one cell changed; rows as in a spreadsheet."""
    rows = [list(line) for line in tracker_rows(hall)]
    rows[row - 1][rows[0].index(column)] = value
    return csv_text(rows)


def exported(hall, *, comma: bool = True, columns=("target", "x_mm", "y_mm", "z_mm"), scale: float = 1.0):
    """What a tracker program writes, and the planned points: (text, tracker_points.csv)."""
    header, *rows = tracker_rows(hall)
    place = {str(name): i for i, name in enumerate(header)}
    lines = ["// exported points", "//"]
    for row in rows:
        cells = [row[place[name]] if name in place else name for name in columns]
        cells = [f"{float(str(c)) * scale:.6f}" if n[:2] in ("x_", "y_", "z_") else str(c) for n, c in zip(
            columns, cells, strict=True)]  # fmt: skip
        lines.append((", " if comma else "   ").join(cells))
    return "\n".join(lines) + "\n", csv_text([list(PLANNED), *([row[place[n]] for n in PLANNED] for row in rows)])


def problems_of(path: Path, texts: dict[str, str]):
    folder, problems = check_folder(write_files(path, texts))
    return folder, {problem.code: problem for problem in problems}


# --- the table tracker ------------------------------------------------------------------------------------------------


def test_tracker_points_become_sweeps(tmp_path, seen):
    folder, problems = problems_of(tmp_path, files(seen))
    assert problems == {}
    (campaign,) = folder.campaigns
    expected, tie, _ = seen.errors()
    assert campaign.sweeps.error_um == pytest.approx(expected.error_um, abs=0.05)  # five decimals of a mm in the file
    assert campaign.sweeps.sd_um == pytest.approx(expected.sd_um, rel=1e-3)
    assert campaign.sweeps.sweep.tolist() == expected.sweep.tolist()
    assert campaign.sweeps.station == ("A",) * len(expected.t_s)
    assert campaign.tracker.closures[0].rms_um == pytest.approx(tie.closures[0].rms_um, abs=0.05)


def test_frames_give_the_same_as_files(tmp_path, seen):
    header, *rows = tracker_rows(seen)
    frame = pd.DataFrame(rows, columns=[str(name) for name in header])
    for letter in "xyz":
        frame[f"{letter}_mm"] = frame[f"{letter}_mm"].astype(float)
    folder = read_folder(write_files(tmp_path, files(seen)))
    clock = folder.campaigns[0].temperatures
    campaign = campaign_of_frames(
        MACHINE,
        "day",
        temperatures=pd.DataFrame({"t_s": clock.t_s, "t1": clock.value_degC[:, 0]}),
        tracker=frame,
        settings=folder.campaigns[0].settings,
    )
    assert campaign.sweeps.error_um == pytest.approx(folder.campaigns[0].sweeps.error_um)


def test_metres_and_inches_are_told_by_the_header(tmp_path, seen):
    header, *rows = [list(line) for line in tracker_rows(seen)]
    header[3:6] = ["x_m", "y_m", "z_inch"]
    for row in rows:
        values = [float(str(cell)) for cell in row[3:6]]
        row[3:6] = [f"{values[0] / 1000:.9f}", f"{values[1] / 1000:.9f}", f"{values[2] / 25.4:.8f}"]
    folder, problems = problems_of(tmp_path, files(seen, **{f"{DAY}/tracker.csv": csv_text([header, *rows])}))
    assert problems == {}
    assert folder.campaigns[0].sweeps.error_um == pytest.approx(seen.errors()[0].error_um, abs=0.05)


def test_all_problems_of_the_table_are_told_at_once(tmp_path, seen):
    header, *rows = [list(line) for line in tracker_rows(seen)]
    place = {str(name): i for i, name in enumerate(header)}
    machine = [i for i, row in enumerate(rows) if row[place["axis"]]]
    fixed = [i for i, row in enumerate(rows) if not row[place["axis"]]]
    rows[machine[0]][place["y_mm"]] = None
    rows[machine[1]][place["at_W_mm"]] = None
    rows[machine[2]][place["position_mm"]] = None
    rows[machine[3]][place["axis"]] = "Q"
    rows[fixed[0]][place["target"]] = None
    rows[fixed[1]][place["position_mm"]] = 500.0
    rows[fixed[2]][place["x_mm"]], rows[fixed[2]][place["y_mm"]], rows[fixed[2]][place["z_mm"]] = 1.0, 2.0, 3.0
    texts = files(seen, **{f"{DAY}/tracker.csv": csv_text([header, *rows])})
    texts[f"{DAY}/campaign.toml"] = "reference_s = 1000.0\n"
    _, problems = check_folder(write_files(tmp_path, texts))
    told = {(p.code, p.row, p.column) for p in problems}
    assert {
        ("tracker-coordinates", machine[0] + 2, "y_mm"),
        ("missing-value", machine[2] + 2, "position_mm"),
        ("unknown-axis", machine[3] + 2, "axis"),
        ("missing-value", fixed[0] + 2, "target"),
        ("missing-value", fixed[1] + 2, "axis"),
        ("tracker-distance", fixed[2] + 2, "x_mm"),
        ("tracker-uncertainty", None, None),
    } <= told
    assert all(p.file.endswith(("tracker.csv", "campaign.toml")) for p in problems if p.severity == "error")


def test_a_commanded_point_needs_the_positions_of_all_axes(tmp_path, seen):
    first = next(i for i, row in enumerate(tracker_rows(seen)) if i and row[6])
    _, problems = problems_of(
        tmp_path, files(seen, **{f"{DAY}/tracker.csv": changed(seen, first + 1, "at_W_mm", None)})
    )
    assert problems["missing-value"].row == first + 1
    assert problems["missing-value"].column == "at_W_mm"
    assert "position of axis W is not stated while axis X moves" in problems["missing-value"].message


def test_a_tracker_that_was_never_moved_needs_no_station(tmp_path, seen):
    rows = [[cell for k, cell in enumerate(row) if k != 1] for row in tracker_rows(seen)]
    folder, problems = problems_of(tmp_path, files(seen, **{f"{DAY}/tracker.csv": csv_text(rows)}))
    assert problems == {}
    assert folder.campaigns[0].tracker.closures[0].rounds == 8
    assert folder.campaigns[0].sweeps.error_um == pytest.approx(seen.errors()[0].error_um, abs=0.05)


def test_an_axis_that_never_moves_may_do_without_positions_and_this_is_said(tmp_path, seen):
    header, *rows = [list(line) for line in tracker_rows(seen)]
    z = header.index("at_Z_mm")
    text = csv_text([[cell for k, cell in enumerate(row) if k != z] for row in (header, *rows)])
    folder, problems = problems_of(tmp_path, files(seen, **{f"{DAY}/tracker.csv": text}))
    assert list(problems) == ["at-missing"]
    assert "'Z'" in problems["at-missing"].message
    assert folder.campaigns[0].sweeps.error_um == pytest.approx(seen.errors()[0].error_um, abs=0.05)


def test_the_section_tracker_is_checked(tmp_path, seen):
    texts = files(seen)
    texts[f"{DAY}/campaign.toml"] = "[tracker]\ndistance_sd_um = 0\nhorizontal_sd_urad = 1.0\nvertical_urad = 2.0\n"
    _, found = check_folder(write_files(tmp_path, texts))
    told = "\n".join(str(problem) for problem in found)
    assert "distance_sd_um = 0" in told
    assert "`vertical_sd_urad` is missing" in told
    assert "unknown key 'vertical_urad' (did you mean 'vertical_sd_urad'?)" in told


def test_sweeps_and_tracker_points_do_not_stand_together(tmp_path, seen):
    sweeps = "t_s,axis,position_mm,dX_um\n0,X,0,1\n10,X,1000,2\n20,X,4000,3\n"
    _, problems = problems_of(tmp_path, files(seen, **{f"{DAY}/sweeps.csv": sweeps}))
    assert "there are sweeps and tracker points" in problems["two-sources"].message


@pytest.mark.parametrize(
    ("options", "code"),
    [({"foundation_names": ("F1", "F3")}, "foundation-line"), ({"swept": ("Y",)}, "frame-line")],
)
def test_what_cannot_be_determined_is_an_error_of_the_folder(tmp_path, options, code):
    hall = measured_hall(np.random.default_rng(0), rounds=3, targets=5, **options)
    folder, problems = problems_of(tmp_path, files(hall))
    assert folder is None
    assert problems[code].severity == "error"
    assert problems[code].file == f"{DAY}/tracker.csv"


# --- exported ASCII ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("comma", [True, False])
@pytest.mark.parametrize("ending", ["txt", "asc"])
def test_exported_points_are_joined_with_the_planned_ones(tmp_path, seen, comma, ending):
    text, planned = exported(seen, comma=comma)
    texts = files(seen, **{f"{DAY}/tracker_1.{ending}": text, f"{DAY}/tracker_points.csv": planned})
    del texts[f"{DAY}/tracker.csv"]
    folder, problems = problems_of(tmp_path, texts)
    assert list(problems) == ["planned-times"]
    assert folder.campaigns[0].sweeps.error_um == pytest.approx(seen.errors()[0].error_um, abs=0.05)


def test_columns_unit_times_and_several_files_are_settled_in_the_campaign_file(tmp_path, seen):
    columns = ("A::main", "day", "target", "x_mm", "y_mm", "z_mm", "0.05", "t_s", "station")
    text, planned = exported(seen, columns=columns, scale=1 / 25.4)
    head, *lines = [line for line in text.splitlines() if not line.startswith("//")]
    lines = [head, *lines]
    cut = len(lines) // 2
    more = 'columns = ["collection", "group", "target", "x", "y", "z", "-", "t_s", "station"]\nunit = "inch"\n'
    planned = "\n".join(",".join(line.split(",")[1:]) for line in planned.splitlines()) + "\n"  # without t_s
    texts = files(
        seen,
        **{
            f"{DAY}/tracker_b.txt": "\n".join(lines[:cut]) + "\n",
            f"{DAY}/tracker_a.txt": "// later half\n" + "\n".join(lines[cut:]) + "\n",
            f"{DAY}/tracker_points.csv": planned,
            f"{DAY}/campaign.toml": campaign_toml(seen, more),
        },
    )
    del texts[f"{DAY}/tracker.csv"]
    folder, problems = problems_of(tmp_path, texts)
    # F1 to F5 stand in every round: joined in the order of the files, and all their planned rows are alike.
    assert problems == {}
    assert folder.campaigns[0].sweeps.error_um == pytest.approx(seen.errors()[0].error_um, abs=0.05)


def test_problems_of_exported_points_name_file_row_and_cell(tmp_path, seen):
    text, planned = exported(seen)
    lines = text.splitlines()
    lines[2] = lines[2].replace("F1", "F9")
    lines[9] = lines[9].rsplit(",", 1)[0] + ", 12,5"
    broken = "\n".join(lines)
    texts = files(seen, **{f"{DAY}/tracker.txt": broken, f"{DAY}/tracker_points.csv": planned})
    del texts[f"{DAY}/tracker.csv"]
    _, problems = problems_of(tmp_path / "cells", texts)
    assert problems["ragged-rows"].row == 10
    assert "found 5 cells, expected 4 (target, x, y, z)" in problems["ragged-rows"].message
    lines[9] = text.splitlines()[9].rsplit(",", 1)[0] + ", about 12"
    _, problems = problems_of(tmp_path / "number", texts | {f"{DAY}/tracker.txt": "\n".join(lines)})
    assert (problems["not-a-number"].row, problems["not-a-number"].column) == (10, "z")
    lines[9] = text.splitlines()[9]
    _, problems = problems_of(tmp_path / "names", texts | {f"{DAY}/tracker.txt": "\n".join(lines)})
    assert problems["unplanned-target"].row == 3
    assert "'F9' is not in" in problems["unplanned-target"].message
    assert "'F1' was measured 7 times and planned 8 times" in problems["target-count"].message


def test_points_that_were_planned_and_not_measured_are_a_warning(tmp_path, seen):
    text, planned = exported(seen)
    lines = text.splitlines()
    del lines[9]  # a machine point, whose name stands once
    texts = files(seen, **{f"{DAY}/tracker.txt": "\n".join(lines), f"{DAY}/tracker_points.csv": planned})
    del texts[f"{DAY}/tracker.csv"]
    folder, problems = problems_of(tmp_path, texts)
    assert set(problems) == {"planned-times", "target-not-measured"}
    assert len(folder.campaigns[0].sweeps.t_s) == len(seen.points.t_s) - 1


def test_names_of_single_readings_tell_rounds_apart_where_a_target_is_missing(tmp_path, seen):
    # As a measuring plan names them: R3_F2 is the target F2 in the third round.
    text, planned = exported(seen)
    header, *rows = planned.splitlines()
    body = [line for line in text.splitlines() if not line.startswith("//")]
    begun = np.cumsum([",F1," in row for row in rows])
    names = [f"R{k}_{line.split(',')[0]}" for k, line in zip(begun, body, strict=True)]
    planned = "\n".join([f"point,{header}", *(f"{n},{row}" for n, row in zip(names, rows, strict=True))]) + "\n"
    body = [f"day   R {n}{line[line.index(',') :].replace(',', ' ')}" for n, line in zip(names, body, strict=True)]
    del body[next(i for i, line in enumerate(body) if "R3_F2" in line)]
    texts = files(seen, **{f"{DAY}/tracker.txt": "\n".join(body), f"{DAY}/tracker_points.csv": planned})
    del texts[f"{DAY}/tracker.csv"]
    texts[f"{DAY}/campaign.toml"] = campaign_toml(seen, 'columns = ["collection", "group", "target", "x", "y", "z"]\n')
    folder, problems = problems_of(tmp_path, texts)
    assert set(problems) == {"planned-times", "target-not-measured"}
    assert "'R3_F2'" in problems["target-not-measured"].message
    (campaign,) = folder.campaigns
    assert campaign.tracker.closures[0].targets == 5
    assert campaign.sweeps.error_um == pytest.approx(seen.errors()[0].error_um, abs=15.0)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ('columns = ["name", "x", "y", "z"]\n', "unknown 'name'"),
        ('columns = ["target", "x", "y"]\n', "without 'z'"),
        ('columns = ["target", "x", "x", "y", "z"]\n', "with 'x' twice"),
    ],
)
def test_wrong_columns_are_told_at_the_campaign_file(tmp_path, seen, more, words):
    text, planned = exported(seen)
    texts = files(seen, **{f"{DAY}/tracker.txt": text, f"{DAY}/tracker_points.csv": planned})
    del texts[f"{DAY}/tracker.csv"]
    texts[f"{DAY}/campaign.toml"] = campaign_toml(seen, more)
    _, problems = problems_of(tmp_path, texts)
    assert words in problems["tracker-columns"].message
    assert problems["tracker-columns"].file == f"{DAY}/campaign.toml"


def test_exported_points_without_planned_ones_are_refused(tmp_path, seen):
    texts = files(seen, **{f"{DAY}/tracker.txt": exported(seen)[0]})
    del texts[f"{DAY}/tracker.csv"]
    _, problems = problems_of(tmp_path, texts)
    assert "no table tracker_points says what they are" in problems["missing-table"].message


def test_two_sources_and_idle_plans_are_told(tmp_path, seen):
    text, planned = exported(seen)
    _, problems = problems_of(
        tmp_path / "two", files(seen, **{f"{DAY}/tracker.txt": text, f"{DAY}/tracker_points.csv": planned})
    )
    assert "the table tracker also stands in" in problems["two-sources"].message
    _, problems = problems_of(tmp_path / "idle", files(seen, **{f"{DAY}/tracker_points.csv": planned}))
    assert problems["unknown-file"].severity == "warning"


# --- commands ---------------------------------------------------------------------------------------------------------


def test_check_tells_frame_scale_and_closure(tmp_path, seen):
    path = write_files(tmp_path, files(seen))
    done = CliRunner().invoke(app, ["check", str(path)])
    assert done.exit_code == 0, done.output
    assert "tracker: the machine frame was fitted once, on 30 points of the cold block (axes X, Y, W)" in done.output
    assert "closure RMS" in done.output
    data = json.loads(CliRunner().invoke(app, ["check", str(path), "--json"]).output)
    assert len(data["summary"]["campaigns"][0]["tracker"]) == 3


def test_an_analysis_works_on_tracker_points_and_says_how_they_were_tied(tmp_path):
    texts = {"machine.toml": machine_toml()}
    for k, name in enumerate(("2026-03-02", "2026-03-09")):
        hall = measured_hall(np.random.default_rng(k), rounds=6, targets=5)
        texts |= {key.replace("2026-03-02", name): text for key, text in files(hall).items() if "/" in key}
        temperatures = temperature_text(hall)
        texts[f"campaigns/{name}/temperatures.csv"] = temperatures
    result = analyze_folder(read_folder(write_files(tmp_path, texts)))
    # The points say where the other axes stood: the joint form, with the drift as a component of its own.
    expected = {f"E{d}{a}" for d in "XYZ" for a in "XYW"} | {"DX", "DY", "DZ"}
    assert {s.component for s in result.separations} == expected
    notes = "\n".join(result.notes)
    assert "campaign 2026-03-09, tracker: station A: 12 rounds of 5 foundation targets, closure RMS" in notes
    assert "tracker: scale on the cold block" in notes
    assert "residual RMS" in notes
    assert "instrument_u_um_per_m is not stated" not in notes

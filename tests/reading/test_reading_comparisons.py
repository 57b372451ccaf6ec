"""What only shows when sensors or campaigns are compared: units, sizes and signs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from machine_folders import csv_text, drift_rows, parameter_rows, sweep_rows, temperature_rows, valid_files, write_files
from typer.testing import CliRunner

from thetacomp.cli.main import app
from thetacomp.errors import Problem
from thetacomp.reading import check_folder, summarize

A, B = "campaigns/2026-03-02", "campaigns/2026-03-09"
Rows = list[list[object]]

MANY_SENSORS = 'format = 1\n[machine]\nname = "m"\n' + "".join(
    f'[[sensors]]\nid = "s{k}"\nrole = "{"fluid" if k == 5 else "structure"}"\n' for k in range(1, 6)
)


def changed(rows: Rows, column: int, change: object) -> Rows:
    """The table with one column of numbers changed."""
    return [rows[0], *([*r[:column], round(change(r[column]), 4), *r[column + 1 :]] for r in rows[1:])]  # type: ignore[operator]


def problems_of(root: Path, files: dict[str, str]) -> tuple[Problem, ...]:
    return check_folder(write_files(root, files))[1]


def five_sensors(start_degC: float) -> dict[str, str]:
    """One campaign of five sensors at 20 to 25 °C; the last starts elsewhere."""
    rows: Rows = [["t_s", "s1", "s2", "s3", "s4", "s5"]]
    for t in range(0, 28801, 600):
        warm = 5 * t / 28800
        rows.append([t, 20 + warm, 20.2 + warm, 19.9 + warm, 20.4 + warm, round(start_degC + warm, 2)])
    return {"machine.toml": MANY_SENSORS, "campaigns/a/temperatures.csv": csv_text(rows),
            "campaigns/a/drift.csv": csv_text(drift_rows())}  # fmt: skip


def test_a_valid_folder_gives_no_doubt(tmp_path: Path) -> None:
    assert problems_of(tmp_path, valid_files()) == ()


@pytest.mark.parametrize(
    ("start_degC", "phrase"),
    [(68.4, "degrees Fahrenheit (20.3 °C)?"), (45.0, "the median of the other sensors is 20.2 °C, 25 K away")],
)
def test_a_sensor_far_from_the_others_is_doubtful(tmp_path: Path, start_degC: float, phrase: str) -> None:
    (problem,) = problems_of(tmp_path, five_sensors(start_degC))
    assert (problem.severity, problem.code, problem.column) == ("warning", "sensor-far-off", "s5")
    assert phrase in problem.message
    assert "a sensor of the role 'fluid' may truly be warm" in problem.fix


def test_a_sensor_that_is_a_little_warm_is_not(tmp_path: Path) -> None:
    assert problems_of(tmp_path, five_sensors(32.0)) == ()


def test_a_sensor_in_fahrenheit_in_one_campaign_only(tmp_path: Path) -> None:
    files = valid_files() | {f"{B}/temperatures.csv": csv_text(changed(temperature_rows(), 2, lambda v: v * 1.8 + 32))}
    found = [p for p in problems_of(tmp_path, files) if p.code == "sensor-far-off"]
    assert ("theta_2", B) in {(p.column, p.file) for p in found}
    assert all(p.severity == "warning" for p in found)
    assert "the same sensor in the other campaigns is 20.6 °C" in next(p for p in found if p.file == B).message


def test_millimetres_in_one_of_several_campaigns_are_an_error(tmp_path: Path) -> None:
    files = valid_files()
    sweeps, drift = sweep_rows(1.2), drift_rows()
    for k in (3, 4, 5):
        sweeps = changed(sweeps, k, lambda v: v / 1000)
    for k in (1, 2, 3):
        drift = changed(drift, k, lambda v: v / 1000)
    files |= {f"{B}/sweeps.csv": csv_text(sweeps), f"{B}/drift.csv": csv_text(drift)}
    errors = [p for p in problems_of(tmp_path, files) if p.severity == "error"]
    assert [(p.code, p.file) for p in errors] == [("error-unit", B)]
    assert "campaign 2026-03-09 is" in errors[0].message
    assert "campaign 2026-03-02" in errors[0].message
    assert "_mm instead of _um" in errors[0].fix


def lines(factor: float, seed: int = 0, noise_um: float = 0.0) -> str:
    """Lines of two components whose errors are a multiple of those of `parameter_rows`, with noise."""
    rng = np.random.default_rng(seed)
    rows = parameter_rows()
    return csv_text(
        [rows[0]]
        + [
            [r[0], r[1], round(factor * r[2] + rng.normal(0, noise_um), 2),
             round(factor * r[3] + rng.normal(0, noise_um), 2), *r[4:]]
            for r in rows[1:]
        ]
    )  # fmt: skip


def two_campaigns_of_lines(first: str, second: str) -> dict[str, str]:
    files = {name: text for name, text in valid_files().items() if "sweeps" not in name and "drift" not in name}
    return files | {f"{A}/parameters.csv": first, f"{B}/parameters.csv": second}


def test_opposite_signs_of_lines_get_one_warning(tmp_path: Path) -> None:
    (problem,) = problems_of(tmp_path, two_campaigns_of_lines(lines(1.0), lines(-1.1)))
    assert (problem.severity, problem.code, problem.file) == ("warning", "opposite-signs", B)
    assert "EXX, EYX" in problem.message
    assert "E = actual - commanded" in problem.fix


def test_campaigns_of_different_modes_may_differ_in_sign(tmp_path: Path) -> None:
    """Another source of heat may bend the machine the other way; the user has said that it was another one."""
    files = two_campaigns_of_lines(lines(1.0), lines(-1.1))
    files[f"{B}/campaign.toml"] = files[f"{B}/campaign.toml"].replace("no cooling", "spindle alone")
    assert problems_of(tmp_path, files) == ()


def test_opposite_signs_of_sweeps_are_seen_through_the_geometry(tmp_path: Path) -> None:
    files = valid_files()
    turned = sweep_rows(1.2)
    for k in (3, 4, 5):
        turned = changed(turned, k, lambda v: -v)
    files[f"{B}/sweeps.csv"] = csv_text(turned)
    told = [p for p in problems_of(tmp_path, files) if p.code == "opposite-signs"]
    assert len(told) == 1
    assert "EXX" in told[0].message


@pytest.mark.parametrize("seed", range(8))
def test_honest_noise_and_weak_errors_have_no_sign(tmp_path: Path, seed: int) -> None:
    """No growth at all under 20 µm of noise; and a growth that has turned but stays below 10 µm."""
    noise = two_campaigns_of_lines(lines(0.0, 2 * seed, 20.0), lines(0.0, 2 * seed + 1, 20.0))
    assert "opposite-signs" not in {p.code for p in problems_of(tmp_path / "a", noise)}
    weak = two_campaigns_of_lines(lines(0.08), lines(-0.08))
    assert "opposite-signs" not in {p.code for p in problems_of(tmp_path / "b", weak)}


def test_equal_signs_of_different_size_are_no_doubt(tmp_path: Path) -> None:
    files = two_campaigns_of_lines(lines(1.0, 1, 5.0), lines(0.6, 2, 5.0))
    assert "opposite-signs" not in {p.code for p in problems_of(tmp_path, files)}


def test_check_tells_the_inferred_direction_and_counts_in_good_english(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["check", str(write_files(tmp_path, valid_files(("c",))))])
    assert "direction not given: inferred from the motion" in result.output
    assert "3 sensors; 1 campaign\n" in result.output
    given = [[*r, "direction" if i == 0 else "+-"[(i - 1) % 10 // 5]] for i, r in enumerate(sweep_rows())]
    files = valid_files(("c",)) | {"campaigns/c/sweeps.csv": csv_text(given)}
    folder, problems = check_folder(write_files(tmp_path, files))
    assert folder is not None, problems
    assert summarize(folder).campaigns[0].direction_given
    given[3][-1] = ""
    files["campaigns/c/sweeps.csv"] = csv_text(given)
    folder, problems = check_folder(write_files(tmp_path, files))
    assert folder is not None, problems
    assert not summarize(folder).campaigns[0].direction_given


def test_check_says_that_further_checks_wait(tmp_path: Path) -> None:
    files = valid_files(("c",)) | {"campaigns/c/duty.csv": ""}
    result = CliRunner().invoke(app, ["check", str(write_files(tmp_path, files))])
    assert result.exit_code == 1
    assert "Further checks wait for these errors" in result.output
    data = json.loads(CliRunner().invoke(app, ["check", "--json", str(tmp_path)]).output)
    assert data["errors"] == 1

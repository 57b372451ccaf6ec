"""The bundled TK6920 example: its files against the published tables, and the published choice of key points."""

from __future__ import annotations

import csv
import json
import math
import tomllib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from thetacomp.campaign import CampaignSettings, CorrelationTable
from thetacomp.cli.main import app
from thetacomp.examples import TK6920
from thetacomp.machine import Machine
from thetacomp.sensors.selection import key_points_from_correlations

CARTESIAN = {"x": "X", "y": "Y", "w": "Z"}
TABLES = {"X": "table1_x_axis.csv", "Y": "table2_y_axis.csv", "W": "table3_w_axis.csv"}
# Temperatures found by inverting the printed equations (README of the published tables).
RECONSTRUCTED = {
    "X": ("theta_15", [19.3, 20.4, 22.0, 23.8, 24.5, 25.6, 26.8, 27.6]),
    "Y": ("theta_11", [18.8, 19.8, 20.8, 22.0, 22.9, 23.7, 24.6, 25.6]),
    "W": ("theta_13", [19.6, 22.8, 26.1, 26.6, 27.4, 29.1, 30.4, 29.5, 30.8, 31.5]),
}
# Cui, Gao, Yao 2012, section 3.1 (sets), 3.2 (key points); the correlations are read from table 5.
MAIN_FACTORS = {"X": {3, 6, 11, 13, 14, 15}, "Y": {3, 4, 7, 8, 11}, "W": {1, 5, 13}}
KEY_POINTS = {"X": "theta_15", "Y": "theta_11", "W": "theta_13"}
SMALLEST = {"X": 0.76, "Y": 0.86, "W": 0.92}


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def number(text: str) -> float:
    return float(text) if text else math.nan


def table(name: str) -> CorrelationTable:
    rows = rows_of(TK6920 / name)
    first, *sensors = rows[0]
    value = np.array([[number(row[s]) for s in sensors] for row in rows])
    return CorrelationTable(tuple(row[first] for row in rows), tuple(sensors), value)


@pytest.fixture
def machine() -> Machine:
    raw = tomllib.loads((TK6920 / "machine.toml").read_text(encoding="utf-8"))
    assert raw["format"] == 1
    return Machine(**raw["machine"], axes=raw["axes"], sensors=raw["sensors"], heat_sources=raw["heat_sources"])


@pytest.mark.shared_data("../paper/sensors.csv")
def test_sensors_are_those_of_the_publication(machine: Machine, shared_data: Path) -> None:
    published = rows_of(shared_data)
    assert machine.sensor_ids == tuple(row["sensor"] for row in published)
    for row in published:
        sensor = machine.sensor(row["sensor"])
        assert (sensor.role, sensor.axis or "") == (row["role"], row["axis"])


@pytest.mark.shared_data("../paper")
@pytest.mark.parametrize("axis", TABLES)
def test_parameters_are_the_printed_ones(axis: str, shared_data: Path) -> None:
    published = rows_of(shared_data / TABLES[axis])
    ours = {(float(r["t_h"]), r["component"]): r for r in rows_of(TK6920 / "campaigns" / axis / "parameters.csv")}
    assert len(ours) == 3 * len(published)
    for row in published:
        for letter, direction in CARTESIAN.items():
            line = ours[float(row["t_h"]), f"E{direction}{axis}"]
            pair = f"{axis.lower()}{letter}"
            # mm to µm and mm/mm to µm/m; an unreadable cell stays empty.
            expected = [number(row[f"I_{pair}_mm"]) * 1e3, number(row[f"S_{pair}"]) * 1e6]
            found = [number(line["intercept_um"]), number(line["slope_um_per_m"])]
            assert found == pytest.approx(expected, rel=1e-12, nan_ok=True), (row["t_h"], pair)
            assert float(line["p0_mm"]) == 0.0


@pytest.mark.parametrize("axis", TABLES)
def test_temperatures_are_the_reconstructed_ones(axis: str) -> None:
    sensor, expected = RECONSTRUCTED[axis]
    rows = rows_of(TK6920 / "campaigns" / axis / "temperatures.csv")
    assert list(rows[0]) == ["t_h", sensor]
    assert [float(row[sensor]) for row in rows] == expected


@pytest.mark.parametrize("axis", TABLES)
def test_campaigns_say_that_sign_and_temperature_are_not_measured(axis: str) -> None:
    text = (TK6920 / "campaigns" / axis / "campaign.toml").read_text(encoding="utf-8")
    settings = CampaignSettings(**tomllib.loads(text))
    assert settings.sign == "unproven"
    assert settings.compensation == "off"
    assert "reconstructed" in settings.origin
    assert RECONSTRUCTED[axis][0] in settings.origin


@pytest.mark.shared_data("../paper")
def test_correlation_tables_are_the_printed_ones(shared_data: Path) -> None:
    published = rows_of(shared_data / "table4_param_temp_correlation.csv")
    ours = {row["parameter"]: row for row in rows_of(TK6920 / "parameter_correlations.csv")}
    assert len(ours) == len(published) == 18
    for row in published:
        kind, pair = row.pop("parameter").split("_")
        name = f"E{CARTESIAN[pair[1]]}{pair[0].upper()} {'intercept' if kind == 'I' else 'slope'}"
        assert {k: v for k, v in ours[name].items() if k != "parameter"} == row
    between = shared_data / "table5_temp_temp_correlation.csv"
    assert rows_of(TK6920 / "sensor_correlations.csv") == rows_of(between)


# At most 0.10 (X, Y) and 0.40 (W): thresholds that were found for each axis on its own; None: one rule for all three.
@pytest.mark.parametrize("thresholds", [None, {"X": 0.10, "Y": 0.10, "W": 0.40}])
def test_published_choice(machine: Machine, thresholds: dict[str, float] | None) -> None:
    results = key_points_from_correlations(
        table("parameter_correlations.csv"), table("sensor_correlations.csv"), machine, thresholds
    )
    assert [result.axis for result in results] == ["X", "Y", "W"]
    for result in results:
        assert {int(s.removeprefix("theta_")) for s in result.main_factors} == MAIN_FACTORS[result.axis]
        assert result.key_points == (KEY_POINTS[result.axis],)
        assert result.smallest_correlation == SMALLEST[result.axis]
        assert [t.strategy for t in result.tables] == ["main factor (paper)", "mutual irrelevance"]
        assert len(result.tables[0].decisions) == 14


def test_one_threshold_for_all_axes_does_not_give_the_published_sets(machine: Machine) -> None:
    """What docs/key_points.md says of a fixed threshold: W has no sensor at 0.10."""
    tables = table("parameter_correlations.csv"), table("sensor_correlations.csv")
    *_, w = key_points_from_correlations(*tables, machine, {"X": 0.10, "Y": 0.10, "W": 0.10})
    assert w.key_points == ()
    assert w.main_factors == ()


def test_command_from_published_tables() -> None:
    done = CliRunner().invoke(
        app,
        [
            "keypoints",
            f"--parameter-correlations={TK6920 / 'parameter_correlations.csv'}",
            f"--sensor-correlations={TK6920 / 'sensor_correlations.csv'}",
            f"--machine={TK6920 / 'machine.toml'}",
            "--json",
        ],
    )
    assert done.exit_code == 0, done.output
    axes = json.loads(done.output)["axes"]
    assert {a["axis"]: a["key_points"] for a in axes} == {k: [v] for k, v in KEY_POINTS.items()}


def test_command_on_the_folder_shows_published_and_measured() -> None:
    done = CliRunner().invoke(app, ["keypoints", str(TK6920)])
    assert done.exit_code == 0, done.output
    for axis, sensor in KEY_POINTS.items():
        assert f"axis {axis}, from correlation tables (paper): {sensor}" in done.output
        # Only this one sensor has readings in the campaign of the axis.
        assert f"axis {axis}, from measurements (weighted): {sensor}" in done.output
    assert "Sign unproven in campaign" in done.output
    assert "no reading in the campaigns of this axis" in done.output
    assert max(map(len, done.output.splitlines())) <= 100


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["--parameter-correlations", "a.csv"],
        [str(TK6920), "--machine", str(TK6920 / "machine.toml")],
        [str(TK6920), "--method", "best"],
    ],
)
def test_command_refuses_bad_usage(arguments: list[str]) -> None:
    assert CliRunner().invoke(app, ["keypoints", *arguments]).exit_code == 2

"""Readings that no sensor measured are named with row, sensor and value; what a machine does is not."""

from __future__ import annotations

import numpy as np
import pytest

from thetacomp.arrays import Floats
from thetacomp.errors import Problem
from thetacomp.model.temperatures import Temperatures
from thetacomp.reading import campaigns
from thetacomp.reading.columns import ANY_SENSORS, match
from thetacomp.reading.problems import ProblemList
from thetacomp.reading.sources import from_columns
from thetacomp.reading.tables import convert

T_S = 60.0 * np.arange(240)
NAN = float("nan")


def warm(sensors: int = 4, seed: int = 0) -> Floats:
    """Temperatures (240, sensors) of four hours that warm up by some kelvin, scatter 0.02 K, two decimals."""
    rise = np.outer(1.0 - np.exp(-T_S / 5400.0), np.linspace(2.0, 9.0, sensors))
    return np.round(20.0 + rise + np.random.default_rng(seed).normal(0.0, 0.02, rise.shape), 2)


def read(value: Floats, t_s: Floats = T_S) -> tuple[Temperatures, list[Problem]]:
    """The table as reading takes it, and what is told of it."""
    problems = ProblemList()
    columns = {"t_s": t_s.tolist(), **{f"s{j}": column.tolist() for j, column in enumerate(value.T)}}
    matched = match(from_columns(columns, "temperatures"), ANY_SENSORS, problems)
    assert matched is not None
    table = convert("temperatures", matched, ANY_SENSORS, problems)
    assert table is not None
    return campaigns.temperatures(table, 0, None, problems), list(problems.collected())


def test_a_healthy_table_has_nothing_to_tell() -> None:
    for seed in range(20):
        data, problems = read(warm(seed=seed))
        assert problems == []
        np.testing.assert_array_equal(data.value_degC, warm(seed=seed))


@pytest.mark.parametrize("first_degC", [85.0, 0.0, -40.0])
def test_a_first_reading_that_was_not_converted_counts_as_missing(first_degC: float) -> None:
    """85 °C is what a DS18B20 says before its first conversion; -40 °C is no code, but far from all others."""
    value = warm()
    value[0, 2] = first_degC
    data, (problem,) = read(value)
    assert (problem.code, problem.severity, problem.row, problem.column) == ("stray-reading", "warning", 2, "s2")
    assert f"the first reading, {first_degC:g} °C, is no measurement" in problem.message
    assert np.argwhere(np.isnan(data.value_degC)).tolist() == [[0, 2]]


def test_a_sensor_alone_is_judged_by_the_code_and_a_real_step_after_the_start_stays() -> None:
    alone = warm(1)
    alone[0, 0] = 85.0
    data, (problem,) = read(alone)
    assert problem.code == "stray-reading"
    # A nozzle that is switched on behind the first reading: its start agrees with the others, the rest does not.
    nozzle = warm()
    nozzle[1:, 2] += 75.0
    data, problems = read(nozzle)
    assert np.isfinite(data.value_degC).all()
    assert {p.code for p in problems} == {"temperature-jump"}


@pytest.mark.parametrize(("end_degC", "rows"), [(0.0, [50, 51, 52]), (85.0, [100]), (150.0, [30, 31, 32, 90, 91])])
def test_an_open_input_is_told_once_with_its_value(end_degC: float, rows: list[int]) -> None:
    value = warm()
    value[rows, 1] = end_degC
    _, (problem,) = read(value)
    assert (problem.code, problem.row, problem.column) == ("sensor-open", rows[0] + 2, "s1")
    assert f"reads exactly {end_degC:g} °C {len(rows)} times" in problem.message


def test_a_sensor_that_was_not_read_for_a_while_is_told() -> None:
    value = warm()
    value[60:120, 3] = value[60, 3]
    _, (problem,) = read(value)
    assert (problem.code, problem.row, problem.column) == ("temperature-frozen", 63, "s3")
    assert "repeats 59 readings" in problem.message


def test_each_sensor_has_its_own_sampling() -> None:
    """One is read each quarter of an hour, one twelve minutes too long: only the second has a gap."""
    value = warm()
    value[np.arange(240) % 15 != 0, 0] = NAN
    value[100:112, 1] = NAN
    data, (problem,) = read(value)
    assert (problem.code, problem.row, problem.column) == ("time-gap", 114, "s1")
    assert "13 min without a temperature of 's1' (usual: 60 s)" in problem.message
    filled = data.bridged().value_degC
    assert np.isfinite(filled[:, 0]).all()
    assert np.abs(filled[:, 0] - warm()[:, 0]).max() < 0.2
    assert np.isnan(filled[100:112, 1]).all()


def test_readings_that_begin_late_or_break_off_are_told() -> None:
    value = warm()
    value[200:, 0] = NAN
    value[:30, 2] = NAN
    found = {p.column: p for p in read(value)[1]}
    assert set(found) == {"s0", "s2"}
    assert "40 min without a temperature of 's0'" in found["s0"].message
    assert "30 min without a temperature of 's2'" in found["s2"].message


def test_a_logger_that_reports_on_change_is_silent_where_nothing_changes() -> None:
    """Each sensor is reported when it has moved by 0.2 K: at rest not for hours. A pause that hides 3 K is a gap."""
    rest = np.concatenate([np.full(180, 20.0), 20.0 + 8.0 * (1.0 - np.exp(-T_S / 2400.0)), np.full(30, 27.98)])
    t_s = 60.0 * np.arange(len(rest))
    told = [0]
    for i, now in enumerate(rest):
        if abs(now - rest[told[-1]]) >= 0.2:
            told.append(i)
    steady = 20.0 + np.random.default_rng(0).normal(0.0, 0.02, len(rest))
    value = np.column_stack([np.full(len(rest), NAN), steady])
    value[told, 0] = rest[told]
    data, problems = read(value, t_s)
    assert [p.code for p in problems] == []
    assert np.abs(data.bridged().value_degC[:, 0] - rest).max() <= 0.21
    lost = value.copy()
    lost[200:230, 0] = NAN
    data, (problem,) = read(lost, t_s)
    assert (problem.code, problem.column) == ("time-gap", "s0")
    assert np.isnan(data.bridged().value_degC[200:225, 0]).all()

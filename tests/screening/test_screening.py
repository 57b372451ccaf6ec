"""Screening of temperatures: faults put into a synthetic machine and into the real spindle recording.

The expected sizes are those that were put in; tolerances are the noise of the sensors and of the prediction, as the
model states it. The synthetic machine is `thermal_network`: its parameters are drawn, nothing is taken from a source.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from thermal_network import network, operate

from thetacomp.arrays import Floats
from thetacomp.errors import AnalysisError
from thetacomp.model.temperatures import Temperatures
from thetacomp.screening import (
    Detector,
    ScreeningModel,
    fit_screening,
    from_json,
    screen,
    with_fault,
)
from thetacomp.screening.repair import sample_spikes

HOUR_S = 3600.0
START_S = 4.0 * HOUR_S
SENSOR = "theta_3"
DATA = "caiviac_fl_thermal/data.xlsx"


@lru_cache
def campaigns() -> tuple[Temperatures, ...]:
    rng = np.random.default_rng(7)
    machine = network(1)
    return tuple(operate(machine, 10.0, rng, season_degC=s)[0] for s in (18.0, 24.0, 21.0, 19.0, 23.0))


@lru_cache
def model() -> ScreeningModel:
    return fit_screening(campaigns()[:4])


def healthy() -> Temperatures:
    return campaigns()[4]


def column(table: Temperatures, sensor: str = SENSOR) -> Floats:
    return table.value_degC[:, table.sensor_ids.index(sensor)]


def test_a_healthy_campaign_is_believed_as_it_is() -> None:
    result = screen(model(), healthy())
    assert result.findings == ()
    assert result.believed.all()
    np.testing.assert_array_equal(result.repaired.value_degC, healthy().value_degC)


@pytest.mark.parametrize("size_K", [2.0, -5.0, 31.0])
def test_a_jump_is_found_at_once_and_shifted_back(size_K: float) -> None:
    result = screen(model(), with_fault(healthy(), SENSOR, "jump", START_S, size_K=size_K))
    (found,) = result.findings
    assert (found.sensor, found.kind, found.repair) == (SENSOR, "jump", "shifted back")
    assert found.size_K == pytest.approx(size_K, abs=0.1)
    assert found.start_s == pytest.approx(START_S, abs=120.0)
    assert found.detected_s - START_S < 300.0
    assert found.statistic > found.threshold
    assert np.max(np.abs(column(result.repaired) - column(healthy()))) < 0.1
    # No other sensor is touched.
    assert np.delete(result.believed, healthy().sensor_ids.index(SENSOR), axis=1).all()


@pytest.mark.parametrize(("start_s"), [START_S + 29.0, START_S + 31.0, START_S + 59.0])
def test_no_sample_of_a_jump_is_left_wherever_it_falls_in_a_block(start_s: float) -> None:
    result = screen(model(), with_fault(healthy(), SENSOR, "jump", start_s, size_K=31.0))
    assert np.max(np.abs(column(result.repaired) - column(healthy()))) < 0.1


def test_a_jump_back_ends_the_shift() -> None:
    result = screen(model(), with_fault(healthy(), SENSOR, "jump", START_S, size_K=5.0, duration_s=HOUR_S))
    (found,) = result.findings
    assert found.end_s == pytest.approx(START_S + HOUR_S, abs=120.0)
    assert np.max(np.abs(column(result.repaired) - column(healthy()))) < 0.1


def test_a_drift_is_rebuilt_from_before_its_begin() -> None:
    result = screen(model(), with_fault(healthy(), SENSOR, "drift", START_S, rate_K_per_h=0.5))
    (found,) = result.findings
    assert (found.sensor, found.kind, found.repair) == (SENSOR, "drift", "reconstructed")
    assert found.start_s == pytest.approx(START_S, abs=1200.0)
    assert found.detected_s - START_S < HOUR_S
    assert found.size_K == pytest.approx(3.0, abs=0.2)  # 0.5 K/h over the remaining 6 h
    assert SENSOR not in found.repaired_from
    error_K = column(result.repaired) - column(healthy())
    assert np.sqrt(np.mean(error_K**2)) < 0.1


def test_lost_contact_is_told_from_drift() -> None:
    faulty = with_fault(healthy(), SENSOR, "detached", START_S, size_K=2.0, air_degC=10.0)
    (found,) = screen(model(), faulty).findings
    assert (found.sensor, found.kind) == (SENSOR, "detached")
    assert found.detected_s - START_S < 600.0


def test_a_stuck_channel_and_one_at_its_limit() -> None:
    (found,) = screen(model(), with_fault(healthy(), SENSOR, "stuck", START_S)).findings
    assert (found.sensor, found.kind) == (SENSOR, "stuck")
    assert found.start_s == pytest.approx(START_S, abs=120.0)
    assert found.statistic > found.threshold  # both in seconds
    warm = column(healthy(), "theta_5")  # rises above 70 % of its range, and falls back below it later
    first = int(np.argmax(warm > warm.min() + 0.7 * np.ptp(warm)))
    cut = with_fault(healthy(), "theta_5", "saturated", float(healthy().t_s[first]))
    at_limit = [f for f in screen(model(), cut).findings if f.kind == "saturated"]
    assert at_limit
    assert at_limit[0].sensor == "theta_5"
    assert at_limit[0].size_K == pytest.approx(warm[first] - warm.max(), abs=1.0)


def test_swapped_channels_are_exchanged_back() -> None:
    faulty = with_fault(healthy(), SENSOR, "swapped", START_S, partner="theta_9")
    result = screen(model(), faulty)
    (found,) = result.findings
    assert found.kind == "swapped"
    assert {found.sensor, found.partner} == {SENSOR, "theta_9"}
    np.testing.assert_allclose(result.repaired.value_degC, healthy().value_degC, atol=0.2)
    late = healthy().t_s > START_S + 300.0
    np.testing.assert_array_equal(result.repaired.value_degC[late], healthy().value_degC[late])


@pytest.mark.parametrize("absent", [np.nan, -999.0, 850.0])
def test_a_drop_out_is_bridged_and_the_sensor_believed_again(absent: float) -> None:
    table = with_fault(healthy(), SENSOR, "missing", START_S, duration_s=HOUR_S)
    table = replace(table, value_degC=np.where(np.isnan(table.value_degC), absent, table.value_degC))
    result = screen(model(), table)
    (found,) = result.findings
    assert (found.kind, found.repair) == ("missing", "reconstructed")
    assert found.end_s == pytest.approx(START_S + HOUR_S, abs=120.0)
    assert np.max(np.abs(column(result.repaired) - column(healthy()))) < 0.3
    assert result.believed[healthy().t_s > START_S + HOUR_S + 60.0].all()


def test_one_missing_sample_is_no_fault_and_lies_between_its_neighbours() -> None:
    """A logger that drops single samples: nothing is found, and the line between the neighbours stands in."""
    table = replace(healthy(), t_s=healthy().t_s[::2], value_degC=healthy().value_degC[::2].copy())
    sampled = fit_screening([replace(c, t_s=c.t_s[::2], value_degC=c.value_degC[::2]) for c in campaigns()[:4]])
    at = len(table.t_s) // 2
    neighbours = column(table)[[at - 1, at + 1]]
    column(table)[at] = np.nan
    result = screen(sampled, table)
    assert [f.kind for f in result.findings] == []
    assert column(result.repaired)[at] == pytest.approx(neighbours.mean(), abs=1e-9)
    assert not result.believed[at, table.sensor_ids.index(SENSOR)]


def test_two_faulty_sensors_at_different_times() -> None:
    faulty = with_fault(healthy(), SENSOR, "jump", START_S, size_K=31.0)
    faulty = with_fault(faulty, "theta_6", "drift", START_S + HOUR_S, rate_K_per_h=1.0)
    result = screen(model(), faulty)
    assert {(f.sensor, f.kind) for f in result.findings} == {(SENSOR, "jump"), ("theta_6", "drift")}
    error_K = result.repaired.value_degC - healthy().value_degC
    assert np.max(np.sqrt(np.mean(error_K**2, axis=0))) < 0.15


def test_a_sensor_that_no_other_can_rebuild_is_lost() -> None:
    rng = np.random.default_rng(3)
    loose = tuple(
        replace(c, value_degC=np.hstack([c.value_degC, np.cumsum(rng.normal(0.0, 0.05, (len(c.t_s), 1)), axis=0)]))
        for c in (replace(c, sensor_ids=(*c.sensor_ids, "coolant")) for c in campaigns())
    )
    fitted = fit_screening(loose[:4])
    result = screen(fitted, with_fault(loose[4], "coolant", "missing", START_S))
    (found,) = [f for f in result.findings if f.sensor == "coolant"]
    assert found.repair == "lost"
    assert result.lost == (("coolant", found.start_s),)
    assert np.isnan(column(result.repaired, "coolant")[healthy().t_s > START_S]).all()


def test_another_operation_is_not_blamed_on_the_sensors() -> None:
    value = healthy().value_degC.copy()
    late = healthy().t_s > START_S
    value[np.ix_(late, np.arange(0, 15, 2))] += np.linspace(0.8, 3.0, 8)  # half of the sensors step at once
    found = screen(model(), replace(healthy(), value_degC=value)).findings
    assert {f.kind for f in found} == {"unexplained"}


def test_a_pause_of_the_logger_is_no_fault() -> None:
    t = healthy().t_s
    for pause_s in (120.0, 1800.0, 30000.0):
        on = (t < 2.0 * HOUR_S) | (t > 2.0 * HOUR_S + pause_s)
        assert screen(model(), Temperatures(t[on], healthy().sensor_ids, healthy().value_degC[on])).findings == ()


def test_a_fault_within_the_training_does_not_spoil_the_model() -> None:
    spoilt = with_fault(campaigns()[1], SENSOR, "jump", START_S, size_K=31.0)
    fitted = fit_screening([campaigns()[0], spoilt, *campaigns()[2:4]])
    np.testing.assert_allclose(fitted.floor_K, model().floor_K, rtol=0.15)


def test_live_verdicts_agree_with_the_record_and_never_use_a_wild_value() -> None:
    faulty = with_fault(healthy(), SENSOR, "jump", START_S, size_K=31.0)
    detector, j = Detector(model()), healthy().sensor_ids.index(SENSOR)
    seen = []
    for t_s, value in zip(faulty.t_s, faulty.value_degC, strict=True):
        verdict = detector.update(float(t_s), value)
        seen.append(verdict.state[j])
        assert abs(verdict.value_degC[j] - column(healthy())[len(seen) - 1]) < 0.5
    at = int(np.searchsorted(faulty.t_s, START_S))
    assert set(seen[:at]) == {"believed"}
    assert seen[at] == "suspect"
    assert seen[-1] == "repaired"
    live = [f for f in detector.monitor.events if f.j == j]
    assert [e.kind for e in live] == [f.kind for f in screen(model(), faulty).findings]


def test_the_detector_refuses_what_it_cannot_use() -> None:
    detector = Detector(model())
    detector.update(0.0, healthy().value_degC[0])
    with pytest.raises(AnalysisError, match="order of time"):
        detector.update(0.0, healthy().value_degC[0])
    with pytest.raises(AnalysisError, match="15 temperatures was expected, 3 came"):
        detector.update(1.0, np.zeros(3))
    with pytest.raises(AnalysisError, match="other sensors"):
        screen(model(), replace(healthy(), sensor_ids=tuple(f"s{i}" for i in range(15))))
    with pytest.raises(AnalysisError, match="at least one campaign"):
        fit_screening([])
    short = replace(healthy(), t_s=healthy().t_s[:20], value_degC=healthy().value_degC[:20])
    with pytest.raises(AnalysisError, match="at least 30 min"):
        fit_screening([short, short, short])


def test_the_model_goes_through_json_unchanged() -> None:
    again = from_json(json.loads(json.dumps(model().to_json())))
    faulty = with_fault(healthy(), SENSOR, "drift", START_S)
    assert screen(again, faulty).findings == screen(model(), faulty).findings
    with pytest.raises(AnalysisError, match="Fit it again"):
        from_json({"format": 1})


def test_stated_limits_hold() -> None:
    """A jump of the stated size is found in nearly all of ten tries, one of a fifth of it in none."""
    limit = {x.sensor: x for x in model().limits()}[SENSOR]
    for size_K, expected in ((limit.jump_transient_K, range(9, 11)), (limit.jump_transient_K / 5.0, range(0, 1))):
        count = 0
        for start_s in np.linspace(1.5 * HOUR_S, 9.0 * HOUR_S, 10):
            found = screen(model(), with_fault(healthy(), SENSOR, "jump", float(start_s), size_K=size_K)).findings
            count += any(f.sensor == SENSOR for f in found)
        assert count in expected


def test_no_false_alarm_in_ten_days() -> None:
    """Nights, another season than in training and sampling by the minute; `bench/bench_screening.py` runs months."""
    table, _ = operate(network(1), 240.0, np.random.default_rng(11), step_s=60.0, season_degC=27.0)
    assert screen(model(), table).findings == ()


def _recording(path: Path) -> list[Temperatures]:
    import pandas as pd

    data = pd.read_excel(path, engine="calamine").to_numpy(float)
    ids = tuple(f"t{i}" for i in range(1, 17))
    cuts = (0, 1951, 3871, 5791, 7711, 9631, 11115)
    return [Temperatures(data[a:b, 0] - data[a, 0], ids, data[a:b, 7:]) for a, b in pairwise(cuts)]


@pytest.mark.shared_data(DATA)
def test_real_recording(shared_data: Path) -> None:
    """Held out, the third campaign gives no fault but the short excursions of t16 (2.9 K at 21.8 h of the record)."""
    tables = _recording(shared_data)
    fitted = fit_screening([t for i, t in enumerate(tables) if i != 2])
    found = screen(fitted, tables[2]).findings
    assert {(f.sensor, f.kind) for f in found} == {("t16", "spike")}
    begin_h = 3871 * 15.0 / HOUR_S
    assert any(f.size_K > 2.3 and abs(begin_h + f.start_s / HOUR_S - 21.8) < 0.05 for f in found)
    for sensor in ("t1", "t7", "t13"):
        (jump,) = [
            f for f in screen(fitted, with_fault(tables[2], sensor, "jump", 9000.0, size_K=31.0)).findings if f.window_s
        ]
        assert (jump.sensor, jump.kind) == (sensor, "jump")
        assert jump.size_K == pytest.approx(31.0, abs=0.1)


def test_screening_runs_without_the_analysis_libraries() -> None:
    code = "import sys, thetacomp.screening\nassert not {'scipy', 'pandas', 'sklearn', 'matplotlib'} & set(sys.modules)"
    subprocess.run(
        [sys.executable, "-c", code], check=True, env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    )


def test_the_sharp_peak_of_a_fast_sensor_is_no_spike() -> None:
    """Where a heat source stops, a fast sensor turns within a sample; a sample that fits neither side is a spike."""
    value, at = healthy().value_degC.copy(), 600
    value[:, 2] = 30.0 - 0.5 * np.minimum(np.abs(np.arange(len(value)) - at), 10)
    assert sample_spikes(model(), replace(healthy(), value_degC=value)) == []
    value[at + 40, 2] += 2.0
    (event,) = sample_spikes(model(), replace(healthy(), value_degC=value))
    assert (event.j, event.onset) == (2, at + 40)

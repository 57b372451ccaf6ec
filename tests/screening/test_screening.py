"""Screening of temperatures: faults put into a synthetic machine and into the real spindle recording.

The expected sizes are those that were put in; tolerances are the noise of the sensors and of the prediction, as the
model states it. The synthetic machine is `thermal_network`: its parameters are drawn, nothing is taken from a source.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from thermal_network import network, operate

from thetacomp.arrays import Floats
from thetacomp.campaign import Campaign, CampaignSettings, MachineFolder
from thetacomp.errors import AnalysisError
from thetacomp.machine import Machine, Sensor, SensorRole
from thetacomp.model.temperatures import Temperatures
from thetacomp.screening import Detector, Finding, ScreeningModel, fit_screening, with_fault
from thetacomp.screening.campaigns import screened
from thetacomp.screening.record import as_read
from thetacomp.screening.repair import repaired

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


@dataclass(frozen=True)
class Screening:
    """What became of one campaign: its findings, the readings as used, and which stand as they were read (n, p)."""

    findings: tuple[Finding, ...]
    repaired: Temperatures
    believed: NDArray[np.bool_]


def machine_folder(tables: Sequence[Temperatures], role: SensorRole = "structure") -> MachineFolder:
    """Campaigns c0, c1, ... of a machine that measured temperatures alone."""
    sensors = tuple(Sensor(id=name, role=role) for name in tables[0].sensor_ids)
    made = tuple(Campaign(f"c{k}", CampaignSettings(), table) for k, table in enumerate(tables))
    return MachineFolder(Machine(name="network", sensors=sensors), made)


def screen(table: Temperatures, others: Sequence[Temperatures] | None = None) -> Screening:
    """The verdict on one campaign, judged by healthy others that it does not judge."""
    known = campaigns()[:4] if others is None else others
    folder = machine_folder([*known, table])
    out = screened(folder, [f"c{k}" for k in range(len(known))], (f"c{len(known)}",))
    used = out.folder.campaigns[-1].temperatures
    used = used.padded(table.sensor_ids)
    with np.errstate(invalid="ignore"):
        stands = np.isfinite(table.value_degC) & (used.value_degC == table.value_degC)
    assert {name for name, _ in out.findings} <= {folder.campaigns[-1].name}
    return Screening(tuple(f for _, f in out.findings), used, stands)


def healthy() -> Temperatures:
    return campaigns()[4]


def column(table: Temperatures, sensor: str = SENSOR) -> Floats:
    return table.value_degC[:, table.sensor_ids.index(sensor)]


def test_a_healthy_campaign_is_believed_as_it_is() -> None:
    result = screen(healthy())
    assert result.findings == ()
    assert result.believed.all()
    np.testing.assert_array_equal(result.repaired.value_degC, healthy().value_degC)


@pytest.mark.parametrize("size_K", [2.0, -5.0, 31.0])
def test_a_jump_is_found_at_once_and_shifted_back(size_K: float) -> None:
    result = screen(with_fault(healthy(), SENSOR, "jump", START_S, size_K=size_K))
    (found,) = result.findings
    assert (found.sensor, found.kind, found.repair) == (SENSOR, "jump", "shifted back")
    assert found.size_K == pytest.approx(size_K, abs=0.1)
    assert found.start_s == pytest.approx(START_S, abs=120.0)
    assert found.detected_s - START_S < 420.0  # five blocks of a minute show that it stays
    assert found.statistic > found.threshold
    assert np.max(np.abs(column(result.repaired) - column(healthy()))) < 0.1
    # No other sensor is touched.
    assert np.delete(result.believed, healthy().sensor_ids.index(SENSOR), axis=1).all()


@pytest.mark.parametrize(("start_s"), [START_S + 29.0, START_S + 31.0, START_S + 59.0])
def test_no_sample_of_a_jump_is_left_wherever_it_falls_in_a_block(start_s: float) -> None:
    result = screen(with_fault(healthy(), SENSOR, "jump", start_s, size_K=31.0))
    assert np.max(np.abs(column(result.repaired) - column(healthy()))) < 0.1


def test_a_jump_back_ends_the_shift() -> None:
    result = screen(with_fault(healthy(), SENSOR, "jump", START_S, size_K=5.0, duration_s=HOUR_S))
    (found,) = result.findings
    assert found.end_s == pytest.approx(START_S + HOUR_S, abs=120.0)
    assert np.max(np.abs(column(result.repaired) - column(healthy()))) < 0.1


def test_a_drift_is_rebuilt_from_before_its_begin() -> None:
    result = screen(with_fault(healthy(), SENSOR, "drift", START_S, rate_K_per_h=0.5))
    (found,) = result.findings
    assert (found.sensor, found.kind, found.repair) == (SENSOR, "drift", "reconstructed")
    assert found.start_s == pytest.approx(START_S, abs=1200.0)
    assert found.size_K == pytest.approx(3.0, abs=0.2)  # 0.5 K/h over the remaining 6 h
    assert SENSOR not in found.repaired_from
    error_K = column(result.repaired) - column(healthy())
    assert np.sqrt(np.mean(error_K**2)) < 0.1


def test_a_stuck_channel() -> None:
    (found,) = screen(with_fault(healthy(), SENSOR, "stuck", START_S)).findings
    assert (found.sensor, found.kind) == (SENSOR, "stuck")
    assert found.start_s == pytest.approx(START_S, abs=120.0)
    assert found.statistic > found.threshold  # both in seconds


def test_swapped_channels_are_exchanged_back() -> None:
    faulty = with_fault(healthy(), SENSOR, "swapped", START_S, partner="theta_9")
    result = screen(faulty)
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
    result = screen(table)
    (found,) = result.findings
    assert (found.kind, found.repair) == ("missing", "reconstructed")
    assert found.end_s == pytest.approx(START_S + HOUR_S, abs=120.0)
    assert np.max(np.abs(column(result.repaired) - column(healthy()))) < 0.3
    assert result.believed[healthy().t_s > START_S + HOUR_S + 60.0].all()


def test_one_missing_sample_is_no_fault_and_lies_between_its_neighbours() -> None:
    """A logger that drops single samples: nothing is found, and the line between the neighbours stands in."""
    table = replace(healthy(), t_s=healthy().t_s[::2], value_degC=healthy().value_degC[::2].copy())
    sampled = [replace(c, t_s=c.t_s[::2], value_degC=c.value_degC[::2]) for c in campaigns()[:4]]
    at = len(table.t_s) // 2
    neighbours = column(table)[[at - 1, at + 1]]
    column(table)[at] = np.nan
    assert screen(table, sampled).findings == ()
    bridged = repaired(as_read("c", table, 0.0), ()).table
    assert column(bridged)[at] == pytest.approx(neighbours.mean(), abs=1e-9)


def test_two_faulty_sensors_at_different_times() -> None:
    faulty = with_fault(healthy(), SENSOR, "jump", START_S, size_K=31.0)
    faulty = with_fault(faulty, "theta_6", "drift", START_S + HOUR_S, rate_K_per_h=1.0)
    result = screen(faulty)
    assert {(f.sensor, f.kind) for f in result.findings} == {(SENSOR, "jump"), ("theta_6", "drift")}
    error_K = result.repaired.value_degC - healthy().value_degC
    assert np.max(np.sqrt(np.mean(error_K**2, axis=0))) < 0.15


def test_a_sensor_that_no_other_can_rebuild_is_lost() -> None:
    rng = np.random.default_rng(3)
    loose = tuple(
        replace(c, value_degC=np.hstack([c.value_degC, np.cumsum(rng.normal(0.0, 0.05, (len(c.t_s), 1)), axis=0)]))
        for c in (replace(c, sensor_ids=(*c.sensor_ids, "coolant")) for c in campaigns())
    )
    result = screen(with_fault(loose[4], "coolant", "missing", START_S), loose[:4])
    (found,) = [f for f in result.findings if f.sensor == "coolant"]
    assert found.repair == "lost"
    assert np.isnan(column(result.repaired, "coolant")).all()


def test_another_operation_is_not_blamed_on_the_sensors() -> None:
    value = healthy().value_degC.copy()
    late = healthy().t_s > START_S
    value[np.ix_(late, np.arange(0, 15, 2))] += np.linspace(0.8, 3.0, 8)  # half of the sensors step at once
    found = screen(replace(healthy(), value_degC=value)).findings
    assert {f.kind for f in found} == {"unexplained"}


def test_a_pause_of_the_logger_is_no_fault() -> None:
    t = healthy().t_s
    for pause_s in (120.0, 1800.0, 30000.0):
        on = (t < 2.0 * HOUR_S) | (t > 2.0 * HOUR_S + pause_s)
        assert screen(Temperatures(t[on], healthy().sensor_ids, healthy().value_degC[on])).findings == ()


def test_a_fault_within_the_training_does_not_spoil_the_model() -> None:
    spoilt = with_fault(campaigns()[1], SENSOR, "jump", START_S, size_K=31.0)
    fitted = fit_screening([campaigns()[0], spoilt, *campaigns()[2:4]])
    j = healthy().sensor_ids.index(SENSOR)
    np.testing.assert_allclose(fitted.taught.weights(j), model().taught.weights(j), atol=0.01)
    assert fitted.step_K[j] == pytest.approx(model().step_K[j], rel=0.05)


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
    assert [(f.sensor, f.kind) for f in detector.findings()] == [(f.sensor, f.kind) for f in screen(faulty).findings]


def test_the_detector_refuses_what_it_cannot_use() -> None:
    detector = Detector(model())
    detector.update(0.0, healthy().value_degC[0])
    with pytest.raises(AnalysisError, match="order of time"):
        detector.update(0.0, healthy().value_degC[0])
    with pytest.raises(AnalysisError, match="15 temperatures was expected, 3 came"):
        detector.update(1.0, np.zeros(3))
    with pytest.raises(AnalysisError, match="other sensors"):
        fit_screening([healthy(), replace(healthy(), sensor_ids=tuple(f"s{i}" for i in range(15)))])
    with pytest.raises(AnalysisError, match="the 0 given have none"):
        fit_screening([])
    short = replace(healthy(), t_s=healthy().t_s[:20], value_degC=healthy().value_degC[:20])
    with pytest.raises(AnalysisError, match="30 samples each"):
        fit_screening([short, short, short])


def test_no_false_alarm_in_ten_days() -> None:
    """Nights, another season than in training and sampling by the minute; `bench/bench_screening.py` runs months."""
    table, _ = operate(network(1), 240.0, np.random.default_rng(11), step_s=60.0, season_degC=27.0)
    assert screen(table).findings == ()


def _recording(path: Path) -> list[Temperatures]:
    import pandas as pd

    data = pd.read_excel(path, engine="calamine").to_numpy(float)
    ids = tuple(f"t{i}" for i in range(1, 17))
    cuts = (0, 1951, 3871, 5791, 7711, 9631, 11115)
    return [Temperatures(data[a:b, 0] - data[a, 0], ids, data[a:b, 7:]) for a, b in pairwise(cuts)]


@pytest.mark.shared_data(DATA)
def test_real_recording(shared_data: Path) -> None:
    """Six campaigns of one recording: nothing is repaired in them as they are, and a jump is found in each sensor."""
    tables = _recording(shared_data)
    names = tuple(f"c{k}" for k in range(len(tables)))
    found = screened(machine_folder(tables), names).findings
    assert [f for _, f in found if f.repair != "none"] == []
    for sensor in ("t1", "t7", "t13"):
        faulty = [with_fault(t, sensor, "jump", 9000.0, size_K=31.0) if k == 2 else t for k, t in enumerate(tables)]
        (jump,) = [f for _, f in screened(machine_folder(faulty), names).findings if f.repair != "none"]
        assert (jump.sensor, jump.kind) == (sensor, "jump")
        assert jump.size_K == pytest.approx(31.0, abs=0.3)


def test_screening_runs_without_the_analysis_libraries() -> None:
    code = "import sys, thetacomp.screening\nassert not {'scipy', 'pandas', 'sklearn', 'matplotlib'} & set(sys.modules)"
    subprocess.run(
        [sys.executable, "-c", code], check=True, env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    )

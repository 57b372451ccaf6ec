"""Screening over days: noisy channels and sensors that come back.

The synthetic machine is `thermal_network`; what was put in is what is expected.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from thermal_network import network, operate

from thetacomp.arrays import Floats
from thetacomp.model.temperatures import Temperatures
from thetacomp.screening import Detector, Finding, ScreeningModel, fit_screening, with_fault
from thetatwin.trial.screened_year import as_read, screen_year
from thetatwin.year import Readings

HOUR_S = 3600.0
DAY_S = 86400.0
SENSOR = 2
BEGIN_S, END_S = 10.0 * HOUR_S, 34.0 * HOUR_S


@lru_cache
def record() -> Temperatures:
    return operate(network(1), 76.0, np.random.default_rng(11), step_s=60.0, season_degC=21.0)[0]


@lru_cache
def model() -> ScreeningModel:
    rng = np.random.default_rng(7)
    machine = network(1)
    return fit_screening([operate(machine, 24.0, rng, step_s=60.0, season_degC=s)[0] for s in (18.0, 24.0, 21.0)])


def noisy(sd_K: float) -> Temperatures:
    table = record()
    value = table.value_degC.copy()
    on = (table.t_s >= BEGIN_S) & (table.t_s < END_S)
    value[on, SENSOR] += sd_K * np.random.default_rng(3).normal(size=int(on.sum()))
    return Temperatures(table.t_s, table.sensor_ids, value)


def followed(
    table: Temperatures, knows: ScreeningModel | None = None
) -> tuple[Detector, Floats, list[Finding], list[str]]:
    """The detector after the record, the values (n,) and states of the sensor, and what was found."""
    detector, value, found, state = Detector(knows or model()), [], [], []
    for t_s, row in zip(table.t_s, table.value_degC, strict=True):
        verdict = detector.update(float(t_s), row)
        value.append(verdict.value_degC[SENSOR])
        state.append(verdict.state[SENSOR])
        found += verdict.findings
    return detector, np.array(value), found, state


def test_a_noisy_channel_is_one_fault_and_leaves_no_shift_behind() -> None:
    detector, value, found, state = followed(noisy(2.0))
    (event,) = [e for e in detector.monitor.events if e.kind == "noisy"]
    assert event.onset_s == pytest.approx(BEGIN_S, abs=300.0)
    assert [e for e in detector.monitor.events if e.kind == "jump"] == []
    assert [f.kind for f in found if f.kind == "noisy"]
    t_s = record().t_s
    bad = (t_s > BEGIN_S + HOUR_S) & (t_s < END_S)
    assert np.std(value[bad] - record().value_degC[bad, SENSOR]) < 0.5  # instead of 2 K
    # believed again a day after the noise ended, as it is read
    assert event.end_s == pytest.approx(END_S, abs=5.0 * HOUR_S)  # the longest horizon still looks back into the noise
    assert state[-1] == "believed"
    assert value[-1] == record().value_degC[-1, SENSOR]


@pytest.mark.parametrize("kind", ["missing", "stuck", "jump"])
def test_a_sensor_that_comes_back_is_believed_again_as_it_is_read(kind: str) -> None:
    table = with_fault(
        record(), record().sensor_ids[SENSOR], kind, BEGIN_S, size_K=5.0, duration_s=END_S - BEGIN_S  # type: ignore[arg-type]
    )  # fmt: skip
    _, value, _, state = followed(table)
    at_fault = int(np.searchsorted(table.t_s, END_S - HOUR_S))
    assert state[at_fault] in ("repaired", "lost")
    assert state[-1] == "believed"
    assert value[-1] == record().value_degC[-1, SENSOR]


def test_a_small_disagreement_after_a_long_silence_is_no_jump() -> None:
    """0.8 K are above the jump limit of the sensor (0.41 K) and below what its rebuilt value may be off (1.04 K)."""
    unsure = replace(model(), repair_sd_K=4.0 * model().repair_sd_K)
    table = with_fault(record(), record().sensor_ids[SENSOR], "missing", BEGIN_S, duration_s=END_S - BEGIN_S)
    value = table.value_degC.copy()
    value[table.t_s >= END_S, SENSOR] += 0.8
    detector, used, _, state = followed(Temperatures(table.t_s, table.sensor_ids, value), unsure)
    assert [e.kind for e in detector.monitor.events] == ["missing"]
    assert state[-1] == "believed"
    assert used[-1] == value[-1, SENSOR]


def test_a_drift_that_ends_is_believed_after_a_day() -> None:
    table = with_fault(
        record(), record().sensor_ids[SENSOR], "drift", BEGIN_S, rate_K_per_h=2.0, duration_s=END_S - BEGIN_S
    )
    detector, value, _, state = followed(table)
    (event,) = [e for e in detector.monitor.events if e.kind == "drift"]
    assert event.end_s == pytest.approx(END_S, abs=5.0 * HOUR_S)
    before = state[int(np.searchsorted(table.t_s, END_S + 0.9 * DAY_S))]
    assert before in ("repaired", "lost")
    assert value[-1] == record().value_degC[-1, SENSOR]
    assert detector.monitor.offset_K[SENSOR] == 0.0


def test_the_readings_of_a_year_are_judged_by_earlier_ones_only() -> None:
    table = noisy(2.0)
    cut = len(table.t_s) // 2
    whole = screen_year(model(), [Readings(table.t_s, table.value_degC, ())], [2.0 * DAY_S])
    wild = table.value_degC.copy()
    wild[cut:] += 20.0
    other = screen_year(model(), [Readings(table.t_s, wild, ())], [2.0 * DAY_S])
    first, second = (year.months[0].temperatures.value_degC[:cut] for year in (whole, other))
    np.testing.assert_array_equal(first, second)
    assert [f.kind for f in whole.findings] == ["noisy"]
    assert not np.array_equal(first, table.value_degC[:cut])


def test_a_sensor_that_was_left_out_is_told_as_lost() -> None:
    """Nothing rebuilds the sensor where a rebuilt value is said to be as uncertain as all that it moves."""
    table = with_fault(record(), record().sensor_ids[SENSOR], "missing", BEGIN_S, duration_s=END_S - BEGIN_S)
    table = Temperatures(table.t_s[: 36 * 60], table.sensor_ids, table.value_degC[: 36 * 60])
    poor = replace(model(), repair_sd_K=np.tile(model().scale_K[-1], (len(model().elapsed_s), 1)))
    year = screen_year(poor, [Readings(table.t_s, table.value_degC, ())], [2.0 * DAY_S])
    (found,) = [f for f in year.findings if f.kind == "missing"]
    assert found.repair == "lost"
    (month,) = year.months
    assert month.out[12 * 60, SENSOR]
    assert not month.out[5 * 60].any()
    assert np.isnan(month.temperatures.value_degC[12 * 60, SENSOR])


def test_months_follow_each_other_without_a_break() -> None:
    """The second month's lead is the end of the first as it was screened, not as the second month's logger read it."""
    table = record()
    begins = [0.0, 50.0 * HOUR_S]
    end = table.t_s <= begins[1]
    late = table.t_s > begins[1] - HOUR_S
    again = table.value_degC[late] + 0.01
    months = [Readings(table.t_s[end], table.value_degC[end], ()), Readings(table.t_s[late], again, ())]
    first, second = screen_year(model(), months, begins).months
    assert second.temperatures.t_s[0] == begins[1] - 2.0 * DAY_S
    lead = second.temperatures.t_s <= begins[1]
    np.testing.assert_array_equal(
        second.temperatures.value_degC[lead],
        first.temperatures.value_degC[first.temperatures.t_s >= begins[1] - 2 * DAY_S],
    )
    assert len(second.temperatures.t_s) == len(np.unique(second.temperatures.t_s))


def test_readings_as_they_are_stay_as_they_are() -> None:
    table = Temperatures(np.arange(0.0, 600.0, 60.0), ("a", "b"), np.full((10, 2), 20.0))
    table.value_degC[4, 1] = np.nan
    year = as_read(("a", "b"), [Readings(table.t_s, table.value_degC, ())])
    assert not year.judged
    assert not year.findings
    assert not year.months[0].out.any()
    np.testing.assert_array_equal(year.months[0].temperatures.value_degC, table.value_degC)

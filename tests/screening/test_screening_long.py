"""Screening over days: noisy channels and sensors that come back.

The synthetic machine is `thermal_network`; what was put in is what is expected.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from thermal_network import network, operate

from thetacomp.arrays import Floats
from thetacomp.model.temperatures import Temperatures
from thetacomp.screening import Detector, ScreeningModel, fit_screening, with_fault
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


def followed(table: Temperatures) -> tuple[Detector, Floats, list[str]]:
    """The detector after the record, the values (n,) and states of the sensor."""
    detector, value, state = Detector(model()), [], []
    for t_s, row in zip(table.t_s, table.value_degC, strict=True):
        verdict = detector.update(float(t_s), row)
        value.append(verdict.value_degC[SENSOR])
        state.append(verdict.state[SENSOR])
    return detector, np.array(value), state


def test_a_healthy_record_is_believed_as_it_is() -> None:
    detector, value, state = followed(record())
    assert detector.findings() == ()
    assert set(state) == {"believed"}
    np.testing.assert_array_equal(value, record().value_degC[:, SENSOR])


def test_a_noisy_channel_is_one_fault_and_leaves_no_shift_behind() -> None:
    detector, value, state = followed(noisy(2.0))
    (found,) = detector.findings()
    assert found.kind == "noisy"
    assert found.start_s == pytest.approx(BEGIN_S, abs=1800.0)
    t_s = record().t_s
    bad = (t_s > BEGIN_S + HOUR_S) & (t_s < END_S)
    assert np.std(value[bad] - record().value_degC[bad, SENSOR]) < 0.5  # instead of 2 K
    assert found.end_s == pytest.approx(END_S, abs=HOUR_S)
    assert state[-1] == "believed"
    assert value[-1] == record().value_degC[-1, SENSOR]


@pytest.mark.parametrize("kind", ["missing", "stuck", "jump"])
def test_a_sensor_that_comes_back_is_believed_again_as_it_is_read(kind: str) -> None:
    table = with_fault(
        record(), record().sensor_ids[SENSOR], kind, BEGIN_S, size_K=5.0, duration_s=END_S - BEGIN_S  # type: ignore[arg-type]
    )  # fmt: skip
    detector, value, state = followed(table)
    (found,) = detector.findings()
    assert found.kind == kind
    assert found.end_s == pytest.approx(END_S, abs=600.0)
    assert state[int(np.searchsorted(table.t_s, END_S - HOUR_S))] in ("repaired", "lost")
    assert state[-1] == "believed"
    assert value[-1] == record().value_degC[-1, SENSOR]


def test_a_small_disagreement_after_a_long_silence_is_no_jump() -> None:
    table = with_fault(record(), record().sensor_ids[SENSOR], "missing", BEGIN_S, duration_s=END_S - BEGIN_S)
    value = table.value_degC.copy()
    value[table.t_s >= END_S, SENSOR] += 0.8
    detector, used, state = followed(Temperatures(table.t_s, table.sensor_ids, value))
    assert [f.kind for f in detector.findings()] == ["missing"]
    assert state[-1] == "believed"
    assert used[-1] == value[-1, SENSOR]


def test_channels_that_change_places_are_exchanged_back() -> None:
    ids = record().sensor_ids
    table = with_fault(record(), ids[SENSOR], "swapped", BEGIN_S, partner=ids[8])
    detector, value, state = followed(table)
    (found,) = detector.findings()
    assert (found.kind, {found.sensor, found.partner}) == ("swapped", {ids[SENSOR], ids[8]})
    assert state[-1] == "repaired"
    late = table.t_s > BEGIN_S + 900.0
    np.testing.assert_array_equal(value[late], record().value_degC[late, SENSOR])


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
    """Nothing rebuilds a sensor that the others say nothing of."""

    def loose(table: Temperatures, seed: int) -> Temperatures:
        walk = np.cumsum(np.random.default_rng(seed).normal(0.0, 0.05, len(table.t_s)))
        value = table.value_degC.copy()
        value[:, SENSOR] = 20.0 + walk
        return Temperatures(table.t_s, table.sensor_ids, value)

    known = fit_screening([loose(record().take(slice(k * 1500, (k + 1) * 1500)), k) for k in range(3)])
    table = with_fault(loose(record(), 9), record().sensor_ids[SENSOR], "missing", BEGIN_S)
    table = table.take(slice(0, 36 * 60))
    year = screen_year(known, [Readings(table.t_s, table.value_degC, ())], [2.0 * DAY_S])
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

"""The one table of temperatures: its sensors by name, two parts as one recording, and what it was between samples."""

from __future__ import annotations

import numpy as np
import pytest

from thetacomp.errors import AnalysisError
from thetacomp.model.temperatures import Duty, Temperatures

NAN = np.nan


def table() -> Temperatures:
    """Three sensors over five minutes; b lacks its third sample."""
    value = np.arange(5.0)[:, None] + np.array([20.0, 30.0, 40.0])
    value[2, 1] = NAN
    return Temperatures(60.0 * np.arange(5.0), ("a", "b", "c"), value)


def test_named_sensors_come_in_the_order_asked_for() -> None:
    chosen = table().select(("c", "a"))
    assert chosen.sensor_ids == ("c", "a")
    np.testing.assert_array_equal(chosen.value_degC[:2], [[40.0, 20.0], [41.0, 21.0]])
    assert chosen.t_s.tolist() == table().t_s.tolist()
    assert table().select(()).value_degC.shape == (5, 0)


def test_a_sensor_that_is_absent_is_named() -> None:
    with pytest.raises(AnalysisError, match=r"no column x, y, which.*found a, b, c\. Fix: "):
        table().select(("x", "a", "y"))


def test_a_sensor_that_is_absent_is_missing_throughout_where_that_is_asked_for() -> None:
    padded = table().padded(("x", "c"))
    assert padded.sensor_ids == ("x", "c")
    assert np.isnan(padded.value_degC[:, 0]).all()
    np.testing.assert_array_equal(padded.value_degC[:, 1], table().value_degC[:, 2])


def test_some_sensors_are_left_out_whether_or_not_they_were_read() -> None:
    rest = table().without({"a", "x"})
    assert rest.sensor_ids == ("b", "c")
    np.testing.assert_array_equal(rest.value_degC, table().value_degC[:, 1:])


def test_two_parts_of_a_recording_are_joined_by_the_names_of_their_sensors() -> None:
    early, late = table().take(slice(None, 2)), table().take(slice(2, None))
    np.testing.assert_array_equal(early.joined(late.select(("c", "a", "b"))).value_degC, table().value_degC)
    assert early.select(("b", "c", "a")).joined(late).sensor_ids == ("b", "c", "a")


@pytest.mark.parametrize("sensors", [("a", "b"), ("a", "b", "c", "d")])
def test_parts_with_different_sensors_are_no_recording(sensors: tuple[str, ...]) -> None:
    with pytest.raises(AnalysisError, match=r"different sensors \((c|d)\)"):
        table().joined(table().padded(sensors))


def test_analysis_bridges_a_missing_sample_and_holds_the_ends_a_machine_does_not() -> None:
    at_s = np.array([-60.0, 30.0, 120.0, 150.0, 240.0, 270.0, 360.0])
    np.testing.assert_allclose(table().at(at_s)[:, 1], [30.0, 30.5, 32.0, 32.5, 34.0, 34.0, 34.0])
    np.testing.assert_allclose(table().unbridged_at(at_s)[:, 1], [NAN, 30.5, NAN, NAN, 34.0, 34.0, NAN])
    np.testing.assert_allclose(table().bridged().value_degC[:, 1], [30.0, 31.0, 32.0, 33.0, 34.0])


def test_a_good_sample_beside_a_missing_one_stands() -> None:
    np.testing.assert_array_equal(table().unbridged_at(table().t_s), table().value_degC)


def test_a_sensor_that_was_never_read_stays_empty_and_one_reading_is_held() -> None:
    value = np.full((3, 2), NAN)
    value[1, 1] = 21.0
    found = Temperatures(60.0 * np.arange(3.0), ("dead", "once"), value).at(np.array([-60.0, 30.0, 90.0, 600.0]))
    np.testing.assert_array_equal(found, [[NAN, 21.0]] * 4)


def test_the_interval_is_the_median_one_and_one_sample_has_none() -> None:
    assert table().take(np.array([0, 1, 2, 4])).interval_s == 60.0
    one = table().take(slice(1))
    assert one.interval_s == 0.0
    np.testing.assert_array_equal(one.unbridged_at(np.array([-1.0, 0.0, 1.0]))[:, 0], [NAN, 20.0, NAN])


def test_some_rows_keep_their_times() -> None:
    some = table().take(table().t_s > 100.0)
    assert (some.t_s.tolist(), some.value_degC[:, 0].tolist()) == ([120.0, 180.0, 240.0], [22.0, 23.0, 24.0])
    duty = Duty(60.0 * np.arange(3.0), {"spindle_rpm": np.array([0.0, 500.0, 900.0])}).take(slice(1, None))
    assert (duty.t_s.tolist(), duty.columns["spindle_rpm"].tolist()) == ([60.0, 120.0], [500.0, 900.0])


def test_duty_that_nobody_logged_before_counts_as_standstill() -> None:
    before = Duty(np.array([-60.0]), {"spindle_rpm": np.array([500.0]), "coolant": np.array([1.0])})
    later = Duty(np.array([0.0]), {"spindle_rpm": np.array([900.0]), "feed_mm_min": np.array([7.0])})
    whole = before.joined(later)
    assert whole.t_s.tolist() == [-60.0, 0.0]
    assert {name: value.tolist() for name, value in whole.columns.items()} == {
        "spindle_rpm": [500.0, 900.0],
        "feed_mm_min": [0.0, 7.0],
    }


@pytest.mark.parametrize(
    ("interval_s", "missing", "bridged"),
    [
        (1000.0, 2, True),  # three intervals between the readings that are there
        (1000.0, 3, False),
        (10.0, 59, True),  # ten minutes
        (10.0, 60, False),
    ],
)
def test_a_gap_of_three_intervals_or_ten_minutes_is_bridged_and_no_longer_one(
    interval_s: float, missing: int, bridged: bool
) -> None:
    """Readings rise by 1 K an interval, so a bridge lies on that line; the same holds after the last reading."""
    t_s, value = interval_s * np.arange(100.0), np.arange(100.0)
    gap = slice(20, 20 + missing)
    read = value.copy()
    read[gap] = NAN
    found = Temperatures(t_s, ("a",), read[:, None]).at(t_s)[:, 0]
    expected = np.where(np.isnan(read) & ~np.bool_(bridged), NAN, value)
    np.testing.assert_allclose(found, expected)
    limit_s = max(3.0 * interval_s, 600.0)
    whole = Temperatures(t_s, ("a",), value[:, None])
    after = whole.at(np.array([t_s[-1] + limit_s, t_s[-1] + limit_s + 1.0, -limit_s, -limit_s - 1.0]))
    np.testing.assert_allclose(after[:, 0], [99.0, NAN, 0.0, NAN])

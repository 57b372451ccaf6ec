"""The temperature field: rises, rates, lags, and the rules of sensor placement."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from thetacomp.arrays import Floats
from thetacomp.campaign import Campaign, CampaignSettings, CorrelationTable, MachineFolder
from thetacomp.machine import Axis, HeatSource, Machine, Sensor
from thetacomp.model.temperatures import Temperatures
from thetacomp.temperature.field import sensor_rises, steepest_rate_K_per_h
from thetacomp.temperature.lag import first_order_lag, first_order_response
from thetacomp.temperature.layout import layout_checks
from thetacomp.temperature.rises import LayoutCheck, SensorRise

MOTOR = HeatSource(name="X motor", sensor="motor", axis="X")
PUMP = HeatSource(name="pump", sensor="oil")
NUT = Sensor(id="nut", role="drive", axis="X")
SENSORS = (
    Sensor(id="motor", role="drive", axis="X"),
    NUT,
    Sensor(id="oil", role="fluid"),
    Sensor(id="room", role="ambient"),
)
AXIS = Axis(name="X", direction="+X", travel_mm=(0.0, 1000.0))


def folder(
    t_s: Floats,
    columns: dict[str, Floats],
    machine: Machine | None = None,
    reference_s: float | None = None,
    correlations: CorrelationTable | None = None,
) -> MachineFolder:
    machine = machine or Machine(name="M", axes=(AXIS,), sensors=SENSORS, heat_sources=(MOTOR, PUMP))
    temperatures = Temperatures(t_s, tuple(columns), np.column_stack(list(columns.values())))
    campaign = Campaign("A", CampaignSettings(reference_s=reference_s), temperatures)
    return MachineFolder(machine, (campaign,), None, correlations)


def rises(*args: object, **kwargs: object) -> dict[str, SensorRise]:
    return {rise.sensor: rise for rise in sensor_rises(folder(*args, **kwargs))}  # type: ignore[arg-type]


def warm_up(t_s: Floats, rise_K: float, tau_s: float) -> Floats:
    return np.asarray(rise_K * -np.expm1(-t_s / tau_s))


def lagged_warm_up(t_s: Floats, rise_K: float, tau_s: float, lag_s: float) -> Floats:
    """Closed form: response of a first-order lag to rise (1 - exp(-t/tau)), both at rest before."""
    e = (tau_s * np.exp(-t_s / tau_s) - lag_s * np.exp(-t_s / lag_s)) / (tau_s - lag_s)
    return np.asarray(rise_K * (1.0 - e))


def test_figures_of_a_plain_warm_up() -> None:
    t_s = np.arange(0.0, 8 * 3600.0 + 1, 3600.0)
    found = rises(t_s, {"motor": 20.0 + np.array([0, 4, 7, 9, 10, 10.5, 10.2, 8, 6])})["motor"]
    assert (found.start_degC, found.maximum_degC, found.maximum_at_s, found.rise_K) == (20.0, 30.5, 18000.0, 10.5)
    # Straight line through 0, 4, 7 at 0, 1, 2 h: slope (7 - 0) / 2.
    assert found.rate_K_per_h == pytest.approx(3.5)
    assert (found.lag_s, found.source, found.remark) == (0.0, "X motor", "")


def test_start_is_the_median_up_to_the_reference() -> None:
    t_s = np.arange(0.0, 3601.0, 60.0)
    value = np.where(t_s <= 600, 20.0, 25.0)
    value[3] = 24.0
    assert rises(t_s, {"motor": value}, reference_s=600.0)["motor"].start_degC == 20.0
    assert rises(t_s, {"motor": np.append(np.nan, value[1:])})["motor"].start_degC == 20.0


def test_a_spike_is_neither_maximum_nor_rate() -> None:
    rng = np.random.default_rng(7)
    t_s = np.arange(0.0, 40000.0, 15.0)
    value = 20.0 + warm_up(t_s, 8.0, 7200.0) + rng.normal(0.0, 0.03, len(t_s))
    clean = rises(t_s, {"motor": value})["motor"]
    value[700:702] += 31.0
    spiked = rises(t_s, {"motor": value})["motor"]
    assert spiked.maximum_degC == pytest.approx(clean.maximum_degC, abs=0.01)
    # Steepest at the start: mean slope of 8 (1 - exp(-t/2 h)) over the first 15 min is about 4 - 4 t/4 h.
    assert clean.rate_K_per_h == pytest.approx(3.76, abs=0.15)
    assert spiked.rate_K_per_h == pytest.approx(clean.rate_K_per_h, abs=0.05)


def test_rate_skips_missing_readings_and_equals_a_straight_fit() -> None:
    rng = np.random.default_rng(3)
    t_s = np.cumsum(rng.uniform(30.0, 90.0, 200))
    value = rng.normal(0.0, 1.0, (200, 3)).cumsum(axis=0)
    value[rng.random((200, 3)) < 0.2] = np.nan
    expected = []
    for column in value.T:  # the plain way: one polyfit a window
        slopes = []
        for i in range(198):
            j = max(int(np.searchsorted(t_s, t_s[i] + 900.0)), i + 2)
            if j < 200:
                good = np.isfinite(column[i : j + 1])
                if good.sum() >= 3:
                    slopes.append(np.polyfit(t_s[i : j + 1][good] / 3600.0, column[i : j + 1][good], 1)[0])
        expected.append(max(slopes))
    assert steepest_rate_K_per_h(t_s, value) == pytest.approx(expected, rel=1e-9)


def test_few_or_no_readings_are_said() -> None:
    t_s = np.array([0.0, 3600.0])
    found = rises(t_s, {"motor": np.array([20.0, 25.0]), "nut": np.array([np.nan, np.nan])})
    assert math.isnan(found["motor"].rate_K_per_h)
    assert "no rate" in found["motor"].remark
    assert (found["nut"].remark, math.isnan(found["nut"].rise_K)) == ("no reading", True)
    assert "5 common readings" in rises(t_s, {k: np.array([20.0, 25.0]) for k in ("motor", "nut")})["nut"].remark


def test_ramp_response_is_exact() -> None:
    """Closed form: k (t - lag (1 - exp(-t/lag))), whatever the ratio of step to lag."""
    for step_s in (1.0, 300.0, 5000.0):
        t_s = np.arange(0.0, 20000.0, step_s)
        expected = 0.002 * (t_s - 900.0 * -np.expm1(-t_s / 900.0))
        assert first_order_response(t_s, 0.002 * t_s, 900.0) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("lag_s", [120.0, 900.0, 5400.0])
def test_lag_of_a_ramp(lag_s: float) -> None:
    t_s = np.arange(0.0, 6 * 3600.0, 60.0)
    ramp = 20.0 + 0.001 * t_s
    sensor = 21.0 + 0.6 * 0.001 * (t_s - lag_s * -np.expm1(-t_s / lag_s))
    fit = first_order_lag(t_s, ramp, sensor)
    assert fit.lag_s == pytest.approx(lag_s, rel=0.01)
    assert fit.gain == pytest.approx(0.6, rel=0.01)


@pytest.mark.parametrize("step_s", [15.0, 300.0])
def test_lag_of_a_step(step_s: float) -> None:
    lag_s = 1800.0
    t_s = np.arange(0.0, 4 * 3600.0, step_s)
    sensor = np.where(t_s > 600.0, 5.0 * -np.expm1(-(t_s - 600.0) / lag_s), 0.0)
    fit = first_order_lag(t_s, 10.0 * (t_s > 600.0), sensor)
    # The source is known at its samples only: the moment of the step is uncertain by half a sample.
    assert fit.lag_s == pytest.approx(lag_s, abs=0.6 * step_s)


def test_lag_through_the_folder_with_noise_and_cooling() -> None:
    rng = np.random.default_rng(11)
    t_s = np.arange(0.0, 10 * 3600.0, 15.0)
    off_s = 5 * 3600.0
    motor = warm_up(t_s, 12.0, 5000.0) - np.where(t_s > off_s, warm_up(np.maximum(t_s - off_s, 0), 12.0, 5000.0), 0)
    nut = lagged_warm_up(t_s, 6.0, 5000.0, 1200.0) - np.where(
        t_s > off_s, lagged_warm_up(np.maximum(t_s - off_s, 0), 6.0, 5000.0, 1200.0), 0
    )
    noise = rng.normal(0.0, 0.05, (2, len(t_s)))
    found = rises(t_s, {"motor": 20.0 + motor + noise[0], "nut": 21.0 + nut + noise[1]})["nut"]
    assert found.source == "X motor"
    assert found.lag_s == pytest.approx(1200.0, rel=0.03)
    assert found.remark == ""


def test_lag_from_eight_hourly_states_is_told_or_refused() -> None:
    t_s = np.arange(8) * 3600.0
    motor = 20.0 + warm_up(t_s, 12.0, 4 * 3600.0)
    slow = rises(t_s, {"motor": motor, "nut": 20.0 + lagged_warm_up(t_s, 6.0, 4 * 3600.0, 7200.0)})["nut"]
    assert slow.lag_s == pytest.approx(7200.0, rel=0.15)
    fast = rises(t_s, {"motor": motor, "nut": 20.0 + lagged_warm_up(t_s, 6.0, 4 * 3600.0, 600.0)})["nut"]
    assert abs(fast.lag_s) < 1800.0
    assert "too coarse" in fast.remark


def test_a_sensor_nearer_to_the_heat_leads() -> None:
    t_s = np.arange(0.0, 6 * 3600.0, 60.0)
    nut = 20.0 + warm_up(t_s, 9.0, 3000.0)
    motor = 20.0 + lagged_warm_up(t_s, 6.0, 3000.0, 900.0)
    found = rises(t_s, {"motor": motor, "nut": nut})["nut"]
    assert found.lag_s == pytest.approx(-900.0, rel=0.02)
    assert "leads" in found.remark


def test_what_a_lag_cannot_be_told_for() -> None:
    rng = np.random.default_rng(1)
    t_s = np.arange(0.0, 6 * 3600.0, 60.0)
    motor = 20.0 + warm_up(t_s, 12.0, 3000.0)
    for column, word in (
        (20.0 + 0.1 * (t_s / t_s[-1]), "below 0.5 K"),
        (20.0 + 2.0 * np.sin(t_s / 1500.0) + rng.normal(0, 0.1, len(t_s)), "does not follow"),
    ):
        found = rises(t_s, {"motor": motor, "nut": column})["nut"]
        assert math.isnan(found.lag_s)
        assert word in found.remark
    room = rises(t_s, {"motor": motor, "room": motor})["room"]
    assert math.isnan(room.lag_s)
    assert "ambient" in room.remark


def test_without_a_source_on_the_axis_the_hottest_sensor_serves() -> None:
    t_s = np.arange(0.0, 6 * 3600.0, 60.0)
    columns = {"oil": 20.0 + warm_up(t_s, 3.0, 3000.0), "nut": 20.0 + lagged_warm_up(t_s, 9.0, 3000.0, 600.0)}
    machine = Machine(name="M", axes=(AXIS,), sensors=SENSORS, heat_sources=(PUMP,))
    found = rises(t_s, columns, machine)["nut"]
    assert (found.source, found.lag_s) == ("", 0.0)
    assert "the largest rise of all" in found.remark
    behind = rises(t_s, columns, replace_sources(machine, ()))["oil"]
    assert "lag behind nut, the sensor with the largest rise" in behind.remark
    assert behind.source == ""


def replace_sources(machine: Machine, sources: tuple[HeatSource, ...]) -> Machine:
    return Machine(name=machine.name, axes=machine.axes, sensors=machine.sensors, heat_sources=sources)


def test_field_of_a_long_recording_is_complete() -> None:
    """16 sensors, 11,115 samples, gaps: every figure is there."""
    rng = np.random.default_rng(5)
    t_s = np.arange(11115) * 15.0
    sensors = tuple(Sensor(id=f"t{i}", role="structure", axis="X") for i in range(16))
    machine = Machine(
        name="M", axes=(AXIS,), sensors=sensors, heat_sources=(HeatSource(name="s", sensor="t0", axis="X"),)
    )
    columns = {f"t{i}": 20 + lagged_warm_up(t_s, 10.0 - i / 4, 9000.0, 300.0 * i) for i in range(1, 16)}
    columns = {"t0": 20 + warm_up(t_s, 10.0, 9000.0), **columns}
    for column in columns.values():
        column += rng.normal(0.0, 0.05, len(t_s))
        column[rng.random(len(t_s)) < 0.01] = np.nan
    found = rises(t_s, columns, machine)
    lags = [found[f"t{i}"].lag_s for i in range(16)]
    # The lag averages the noise of the source, so a fit prefers lags that are too long: by about 40 s here.
    assert lags == pytest.approx([300.0 * i for i in range(16)], rel=0.05, abs=90.0)
    assert all(np.isfinite([r.rise_K, r.rate_K_per_h]).all() for r in found.values())


# --- rules of initial placement


def checks(machine: Machine, columns: dict[str, Floats] | None = None, **kwargs: object) -> dict[str, LayoutCheck]:
    t_s = np.arange(0.0, 3600.0, 60.0)
    columns = columns or {s.id: 20 + warm_up(t_s, 5.0 + i, 600.0 * (i + 1)) for i, s in enumerate(machine.sensors)}
    return {c.rule: c for c in layout_checks(folder(t_s, columns, machine, **kwargs))}  # type: ignore[arg-type]


def test_a_good_layout_passes() -> None:
    found = checks(Machine(name="M", axes=(AXIS,), sensors=SENSORS, heat_sources=(MOTOR, PUMP)))
    assert [c.finding for c in found.values() if not c.passed] == []
    assert len(found) == 5


def test_each_broken_rule_is_told() -> None:
    sources = (MOTOR, PUMP, HeatSource(name="spindle"), HeatSource(name="gear"))
    t_s = np.arange(0.0, 3600.0, 60.0)
    machine = Machine(name="M", axes=(AXIS,), sensors=(SENSORS[0], SENSORS[2]), heat_sources=sources)
    found = checks(machine, {"motor": 20 + warm_up(t_s, 5.0, 600.0)})
    assert not any(c.passed for c in found.values())
    assert "at least 3 more" in found["more sensors than heat sources"].finding
    assert "spindle, gear" in found["a sensor near every heat source"].finding
    assert "reference or ambient" in found["a reference temperature"].finding
    assert "oil" in found["every sensor was read"].finding
    assert "X has one" in found["redundancy"].finding


def test_no_heat_source_listed() -> None:
    found = checks(Machine(name="M", axes=(AXIS,), sensors=SENSORS))
    assert "lists no heat source" in found["more sensors than heat sources"].finding


def test_near_copies_are_named_from_the_campaigns_else_from_the_table() -> None:
    machine = Machine(name="M", axes=(AXIS,), sensors=SENSORS, heat_sources=(MOTOR, PUMP))
    t_s = np.arange(0.0, 3600.0, 60.0)
    motor = 20 + warm_up(t_s, 5.0, 600.0)
    columns = {"motor": motor, "nut": 3.0 + 2.0 * motor, "oil": 20 + np.sin(t_s), "room": 20 + np.cos(t_s)}
    assert "motor and nut (1.000)" in checks(machine, columns)["redundancy"].finding
    lower = CorrelationTable(("motor", "oil"), ("motor", "oil"), np.array([[1.0, np.nan], [-0.995, 1.0]]))
    found = checks(machine, {"motor": motor}, correlations=lower)["redundancy"].finding
    assert "motor and oil (0.995)" in found
    assert "published" in found


def test_empty_temperatures_do_not_fail() -> None:
    machine = Machine(name="M", axes=(AXIS,), sensors=SENSORS, heat_sources=(MOTOR,))
    empty = folder(np.empty(0), {"motor": np.empty(0)}, machine)
    assert sensor_rises(empty) == ()
    assert len(layout_checks(empty)) == 5
    assert len(layout_checks(replace(empty, campaigns=()))) == 5

"""Heat from work, the hall, instruments and geometry: each against figures worked out by hand or by statistics."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from thetacomp.errors import InputError
from thetatwin import duty
from thetatwin.campaigns import Twin
from thetatwin.conditions import Conditions, Pt100, load_conditions
from thetatwin.geometry import draw_geometry
from thetatwin.hall import hall_inputs, random_process
from thetatwin.instruments import (
    Fault,
    SensorTruth,
    TrackerDay,
    fit_frame,
    frame_design,
    read_sensors,
    track,
)
from thetatwin.operation import (
    History,
    Work,
    bearing_moments,
    known_inputs,
    rest_state,
    simulate,
    source_power_W,
    viscosity_mm2_per_s,
)
from thetatwin.virtual_machine import VirtualMachine

AXES = ("X", "Y", "W")


def test_powers_of_the_paper_run(coarse: VirtualMachine) -> None:
    work = duty.paper_run(1, AXES)
    power = {s.name: source_power_W(s, work)[0] for s in coarse.description.sources}
    # 15 Nm on a screw of 10 mm lead at 1000 mm/min: 15 x 2 pi x 100 / 60
    assert power["W feed screw nut"] == pytest.approx(157.08, abs=0.01)
    # 10 kN at 1/60 m/s
    assert power["X guides"] == pytest.approx(166.67, abs=0.01)
    assert power["hydraulics"] == pytest.approx(1800.0)
    assert power["headstock gears"] == pytest.approx(1.2 * 650)


def test_bearing_friction_after_palmgren(coarse: VirtualMachine) -> None:
    source = next(s for s in coarse.description.sources if s.name == "spindle front bearings")
    assert source.bearing is not None
    viscous, load = bearing_moments(source.bearing, np.array([650.0]))
    # M0 = 1e-7 x 2 x (32 x 650)^(2/3) x 340^3 N mm = 5.947 Nm; M1 = 0.0003 x 10 kN x 340 mm = 1.02 Nm; 68.07 rad/s
    assert viscous[0] * 32.0 ** (2 / 3) == pytest.approx(5.947 * 68.07, rel=1e-3)
    assert load[0] == pytest.approx(1.02 * 68.07, rel=1e-3)


def test_oil_is_thinner_when_warm(coarse: VirtualMachine) -> None:
    nu = viscosity_mm2_per_s(coarse.description.oil, np.array([20.0, 40.0]))
    # ISO VG 32 has 32 mm²/s at 40 °C; tables give 80 to 90 at 20 °C
    assert nu[1] == pytest.approx(32.0)
    assert 80.0 < nu[0] < 90.0


def still_air(n: int) -> np.ndarray:
    return np.zeros((n, 5))


def test_simulation_without_spindle_and_chiller_is_the_reduced_model(coarse: VirtualMachine) -> None:
    n = 200
    work = duty.idle(n, AXES, on=1.0)
    work.feed_m_min["W"][50:120] = 1.5
    history = simulate(coarse, work, still_air(n), np.zeros(n), np.zeros(len(coarse.reduced.rate_per_s)))
    u = known_inputs(coarse.description, coarse.reduced.inputs, work, still_air(n), np.zeros(n))
    expected = coarse.reduced.run(u, 60.0)[:, coarse.sensor_rows] + 20.0
    assert history.sensors_degC == pytest.approx(expected, abs=1e-9)


def test_kept_states_are_those_of_their_times(coarse: VirtualMachine) -> None:
    n = 3000
    start = np.zeros(len(coarse.reduced.rate_per_s))
    work = duty.paper_run(n, AXES)
    every = simulate(coarse, work, still_air(n), np.zeros(n), start)
    # seven does not divide the day by which the simulation proceeds
    seventh = simulate(coarse, work, still_air(n), np.zeros(n), start, keep=7)
    assert (seventh.kept_s == every.kept_s[::7]).all()
    assert (seventh.states == every.states[::7]).all()
    at = np.array([7 * 60.0 * 300])
    assert seventh.poses(coarse, at) == pytest.approx(every.poses(coarse, at))


def test_bearings_heat_less_once_their_oil_is_warm(coarse: VirtualMachine) -> None:
    """From a cold and a warm start the same run must not add the same rise: the films act back."""
    n = 120
    work, warm = duty.paper_run(n, AXES), np.zeros(5)
    warm[0] = 15.0
    rises = []
    for air in (np.zeros(5), warm):
        start = rest_state(coarse, air, float(air[0]))
        history = simulate(coarse, work, np.tile(air, (n, 1)), np.full(n, air[0]), start)
        rises.append(history.sensors_degC[-1, 0] - history.sensors_degC[0, 0])
    assert rises[1] < 0.8 * rises[0]


def test_the_chiller_holds_the_oil_near_its_set_point(coarse: VirtualMachine) -> None:
    n = 1200
    oil = [s.id for s in coarse.description.sensors].index("theta_14")
    ends = []
    for chiller in (0.0, 1.0):
        work = duty.with_chiller(duty.paper_run(n, AXES), np.full(n, chiller))
        start = np.zeros(len(coarse.reduced.rate_per_s))
        ends.append(simulate(coarse, work, still_air(n), np.zeros(n), start).sensors_degC[-1, oil])
    # 900 W/K on at most about 2.1 kW: less than 2.5 K above 22 °C
    assert 22.0 < ends[1] < 24.5 < ends[0]


def test_weeks_rest_on_sundays_and_work_on_mondays(standard: Conditions) -> None:
    work = duty.weeks(np.random.default_rng(1), 14, AXES, standard.work)
    on = work.on.reshape(14, 1440).mean(axis=1)
    assert (on[[6, 13]] == 0).all()
    assert (on[[0, 1, 2, 3, 4]] > 0.25).all()
    assert (work.rpm[work.on == 0] == 0).all()


@pytest.mark.parametrize(("preset", "low", "high"), [("standard", 12.0, 29.0), ("hard", 5.0, 33.0)])
def test_a_year_of_hall_air_stays_in_the_stated_seasons(preset: str, low: float, high: float) -> None:
    """Seasons of 8 to 30 °C in the hard hall, some K about them on single days; July is the warm end."""
    hall = load_conditions(preset).hall
    t_s = np.arange(0.0, 365 * 86400.0, 600.0)
    air, floor = hall_inputs(hall, np.random.default_rng(4), t_s, 0.0, np.ones(len(t_s)), 20.0)
    level = air[:, 0] + 20.0
    assert low < level.min() < 16.0
    assert 24.0 < level.max() < high
    month = level[: 360 * 144].reshape(12, -1).mean(axis=1)
    assert month.argmax() in (6, 7)
    assert month.argmin() in (0, 11)
    assert np.ptp(floor) < np.ptp(month)


def test_random_processes_have_their_stated_size_and_memory() -> None:
    x = random_process(np.random.default_rng(5), 400_000, 2.0, 3600.0, 60.0)
    assert x.std() == pytest.approx(2.0, rel=0.05)
    # after one correlation time the correlation is 1/e
    assert np.corrcoef(x[:-60], x[60:])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.03)


def test_draughts_come_only_while_people_work() -> None:
    hall = load_conditions("hard").hall
    t_s = np.arange(0.0, 20 * 86400.0, 60.0)
    air, _ = hall_inputs(hall, np.random.default_rng(6), t_s, 0.0, np.zeros(len(t_s)), 20.0)
    assert not air[:, 4].any()
    air, _ = hall_inputs(hall, np.random.default_rng(6), t_s, 0.0, np.ones(len(t_s)), 20.0)
    assert air[:, 4].max() > 3.0


PERFECT = Pt100(
    noise_K=0.0,
    resolution_K=0.0,
    offset_sd_K=0.0,
    air_share=(0.0, 0.0),
    lag_s=(60.0, 60.0),
    sample_s=60.0,
    fault_probability=0.0,
    missing=0.0,
)


def step_history(n: int = 400) -> History:
    """One sensor that jumps from 20 to 30 °C at minute 100, in air of 10 °C."""
    t_s = np.arange(float(n)) * 60.0
    value = np.where(t_s >= 6000.0, 30.0, 20.0)[:, None]
    return History(t_s, value, np.full((n, 1), 10.0), t_s[:1], np.zeros((1, 1)), np.zeros(1))


def read(
    sensor: SensorTruth, settings: Pt100 = PERFECT, faults: tuple[Fault, ...] = ()
) -> tuple[np.ndarray, np.ndarray]:
    t_s, value = read_sensors(np.random.default_rng(0), step_history(), (sensor,), faults, settings, 0.0)
    return t_s, value[:, 0]


def test_a_pt100_lags_by_its_time_constant() -> None:
    t_s, value = read(SensorTruth("a", 0.0, 0.0, 600.0))
    assert value[0] == pytest.approx(20.0)
    # 63.2 % of a step after one time constant; the step is held over the minute in which it falls
    assert np.interp(6000.0 + 600.0 - 60.0, t_s, value) == pytest.approx(20.0 + 10.0 * (1 - np.exp(-1.0)), abs=0.02)


def test_a_pt100_has_offset_air_share_and_resolution() -> None:
    _, value = read(SensorTruth("a", 0.3, 0.1, 1.0))
    assert value[0] == pytest.approx(0.9 * 20 + 0.1 * 10 + 0.3)
    _, value = read(SensorTruth("a", 0.13, 0.0, 1.0), PERFECT.model_copy(update={"resolution_K": 0.25}))
    assert value[0] == pytest.approx(20.25)


@pytest.mark.parametrize(
    ("kind", "last"), [("jump", 35.0), ("stuck", 20.0), ("detached", 0.3 * 30 + 0.7 * 10), ("dead", np.nan)]
)
def test_faults_of_a_pt100(kind: str, last: float) -> None:
    _, value = read(SensorTruth("a", 0.0, 0.0, 1.0), faults=(Fault("a", kind, 3000.0, 5.0),))
    assert value[10] == pytest.approx(20.0)
    assert value[-1] == pytest.approx(last, nan_ok=True)


def test_the_tracker_scatters_as_its_data_sheet_says(standard: Conditions) -> None:
    """Standard deviation of all parts together: U / 2 with U = 15 µm + 6 µm/m x distance."""
    tracker = standard.tracker.model_copy(
        update={"outliers": 0.0, "missing": 0.0, "tie_um": 0.0, "tie_urad": 0.0, "white_share": 0.6, "sweep_share": 0.4}
    )
    day = TrackerDay(np.zeros(3), np.zeros((3, 3)))
    n = 6000
    tool = np.tile(np.array([1.5, 1.5, -1.0]), (n, 1))  # 4 m from the tracker: U = 39 µm
    measured = track(np.random.default_rng(1), tracker, day, tool, np.zeros((n, 3)), np.arange(n))
    # the angle common to a sweep turns points about the tracker, so nothing of it lies along the beam (Z)
    assert measured[:, 2].std() == pytest.approx(19.5 * np.sqrt(0.6), rel=0.04)
    assert measured[:, :2].std() == pytest.approx(19.5, rel=0.04)


def test_a_tracker_frame_fitted_on_cold_points_ignores_gross_errors() -> None:
    rng = np.random.default_rng(2)
    tool = rng.uniform(-1, 1, (150, 3)) * np.array([2.0, 1.5, 0.5])
    true = np.array([50.0, -20.0, 10.0, 3.0, -5.0, 8.0])
    error = (frame_design(tool) @ true).reshape(-1, 3) + rng.normal(size=tool.shape)
    error[::30] += 800.0
    error[7] = np.nan
    assert fit_frame(tool, error) == pytest.approx(true, abs=0.6)


def test_geometry_is_a_function_of_position_and_approach_alone(twin: Twin, standard: Conditions) -> None:
    axes = twin.machine.description.machine_axes()
    geometry = draw_geometry(np.random.default_rng(9), axes, standard.geometry)
    at = {"X": np.linspace(0, 4000, 401), "Y": np.full(401, 1500.0), "W": np.full(401, 500.0)}
    up = {name: np.ones(401) for name in at}
    forth = geometry.error_um(twin.machine.tool, at, up, 100.0)
    back = geometry.error_um(twin.machine.tool, at, up | {"X": -np.ones(401)}, 100.0)
    lost = forth - back
    # the same reversal everywhere, along the axis 0.5 to 1.5 times the stated 5 µm
    assert np.ptp(lost, axis=0) == pytest.approx(0.0, abs=1e-9)
    assert 2.5 <= lost[0, 0] <= 7.5
    # a periodic error of 40 mm shows in the residual of a smooth curve
    smooth = np.polynomial.Polynomial.fit(at["X"], forth[:, 0], 12)(at["X"])
    spectrum = np.abs(np.fft.rfft(forth[:, 0] - smooth))
    assert spectrum[8:].argmax() + 8 == pytest.approx(4010 / 40, abs=1.0)


def test_conditions_with_an_unknown_key_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('name = "mine"\nmachine = "tk6920"\nweather = 3\n', encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_conditions(path)
    text = str(caught.value)
    assert "weather: Extra inputs" in text
    assert "hall: Field required" in text


def test_work_is_only_joined_minute_by_minute() -> None:
    work = duty.join([duty.idle(3, AXES), duty.paper_run(2, AXES)])
    assert isinstance(work, Work)
    assert list(work.rpm) == [0, 0, 0, 650, 650]
    assert list(work.feed_m_min["Y"]) == [0, 0, 0, 1, 1]

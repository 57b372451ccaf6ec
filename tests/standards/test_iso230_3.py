"""ISO 230-3: ranges and changes of displacements whose closed form is known; what is refused, and why."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from machine_folders import small_machine

from thetacomp.arrays import Floats
from thetacomp.campaign import Campaign, CampaignSettings, Drift, LeadIn, SweepPoints
from thetacomp.errors import AnalysisError
from thetacomp.machine import Axis
from thetacomp.model.temperatures import Duty, Temperatures
from thetacomp.standards.campaign_tests import AXIS, ETVE, SPINDLE, campaign_positioning, campaign_tests
from thetacomp.standards.figure_rows import axis_u_um
from thetacomp.standards.instrument import Instrument
from thetacomp.standards.iso230_3 import (
    Distortion,
    ThermalTest,
    axis_distortion,
    environmental_variation,
    range_within,
    spindle_distortion,
)

TAU_S = 3600.0
STEP_S = 60.0


def heat(t_s: Floats, before_K: float = 0.0) -> Temperatures:
    """One sensor, constant but for a rise of `before_K` over the record."""
    return Temperatures(t_s, ("theta_1",), (20.0 + before_K * (t_s - t_s[0]) / np.ptp(t_s))[:, None])


def displaced(t_s: Floats, x_um: Floats, rotation_urad: Floats | None = None) -> Drift:
    """Drift in X alone; Y rests, Z was not measured."""
    error = np.column_stack([x_um, np.zeros_like(x_um), np.full_like(x_um, np.nan)])
    return Drift(t_s, error, rotation_urad)


def campaign(drift: Drift, rpm: Floats | None, **others: object) -> Campaign:
    t_s = drift.t_s
    duty = None if rpm is None else Duty(t_s, {"spindle_rpm": rpm})
    made = Campaign("day", CampaignSettings(), heat(t_s), drift=drift, duty=duty)
    return replace(made, **others)  # type: ignore[arg-type]


def warm_up(run_h: float = 4.0, start_s: float = 7200.0, end_h: float = 10.0) -> Campaign:
    """At rest until `start_s`; then X grows as 100 (1 - exp(-t / 1 h)) µm while the spindle turns."""
    t_s = np.arange(0.0, end_h * 3600.0 + 1.0, STEP_S)
    since = np.clip(t_s - start_s, 0.0, run_h * 3600.0)
    x_um = 100.0 * (1.0 - np.exp(-since / TAU_S))
    rpm = np.where((t_s >= start_s) & (t_s < start_s + run_h * 3600.0), 650.0, 0.0)
    return campaign(displaced(t_s, x_um), rpm)


def line(test: ThermalTest, quantity: str, place: str = "") -> Distortion:
    (found,) = (one for one in test.lines if (one.quantity, one.place) == (quantity, place))
    return found


def grown(hours: float) -> float:
    return 100.0 * (1.0 - math.exp(-hours))


def test_spindle_distortion_has_the_closed_form_of_the_warm_up() -> None:
    test = spindle_distortion(warm_up())
    assert (test.start_s, test.end_s) == (7200.0, 7200.0 + 4 * 3600.0)
    x = line(test, "X")
    assert (x.first_hour, x.period, x.change) == pytest.approx((grown(1), grown(4), grown(4)), abs=1e-9)
    assert line(test, "Y").period == 0.0
    assert [one.quantity for one in test.lines] == ["X", "Y"]


def test_time_counts_from_the_start_of_the_spindle_and_the_range_from_the_reading_before_it() -> None:
    made = warm_up()
    assert made.drift is not None
    t_s = made.drift.t_s
    sparse = t_s[::20]  # a reading each 20 min; the last one before the start at 6600 s is that of 6000 s
    drift = Drift(sparse, sparse[:, None] / 100.0 * np.array([1.0, 0.0, 0.0]))
    duty = Duty(t_s, {"spindle_rpm": np.where(t_s >= 6600, 650.0, 0.0)})
    x = line(spindle_distortion(replace(made, drift=drift, duty=duty)), "X")
    # Readings up to 6600 + 3600 s and up to 6600 + 14400 s.
    assert (x.first_hour, x.period) == pytest.approx(((9600 - 6000) / 100.0, (20400 - 6000) / 100.0))


def test_the_period_ends_after_four_hours_or_when_the_spindle_stops() -> None:
    long = spindle_distortion(warm_up(run_h=6.0))
    assert line(long, "X").period == pytest.approx(grown(4), abs=1e-9)
    assert any("turned for longer" in remark for remark in long.remarks)
    short = spindle_distortion(warm_up(run_h=2.0))
    assert short.end_s == 7200.0 + 2 * 3600.0
    assert line(short, "X").period == pytest.approx(grown(2), abs=1e-9)
    assert any("ran for 2.0 h, less than 4 h" in remark for remark in short.remarks)


def test_a_standstill_of_up_to_an_hour_belongs_to_the_run_a_longer_one_ends_it() -> None:
    made = warm_up(run_h=6.0)
    assert made.duty is not None
    rpm = made.duty.columns["spindle_rpm"].copy()
    t_s = made.duty.t_s
    rpm[(t_s >= 10800) & (t_s < 10800 + 3000)] = 0.0
    pause = replace(made, duty=Duty(t_s, {"spindle_rpm": rpm}))
    assert spindle_distortion(pause).end_s == 7200.0 + 4 * 3600.0
    rpm = rpm.copy()
    rpm[(t_s >= 10800) & (t_s < 10800 + 4200)] = 0.0
    assert spindle_distortion(replace(made, duty=Duty(t_s, {"spindle_rpm": rpm}))).end_s == 10800.0


def test_a_recording_that_is_cut_at_the_start_takes_the_standstill_from_the_lead_in() -> None:
    made = warm_up(start_s=0.0)
    with pytest.raises(AnalysisError, match="never starts out of a recorded standstill"):
        spindle_distortion(made)
    ahead_s = np.arange(-7200.0, 0.0, STEP_S)
    lead_in = LeadIn(heat(ahead_s, before_K=3.0), Duty(ahead_s, {"spindle_rpm": np.zeros_like(ahead_s)}))
    test = spindle_distortion(replace(made, before=lead_in))
    assert test.start_s == 0.0
    assert line(test, "X").period == pytest.approx(grown(4), abs=1e-9)
    (settled,) = (remark for remark in test.remarks if "min before the start" in remark)
    # The lead-in rises by 3 K to 23 °C over its two hours; the campaign's own log begins at 20 °C.
    assert "no sensor moved by more than 3.0 K (theta_1)" in settled


def test_axes_that_move_meanwhile_and_a_start_without_history_are_told() -> None:
    made = warm_up(start_s=600.0)
    assert made.duty is not None
    feed = np.where(made.duty.columns["spindle_rpm"] > 0, 1000.0, 0.0)
    columns = {**made.duty.columns, "feed_mm_min": feed, "hydraulics_on": np.ones_like(feed)}
    remarks = " ".join(spindle_distortion(replace(made, duty=Duty(made.duty.t_s, columns))).remarks)
    assert "up to 1000 mm/min" in remarks
    assert "Only 10 min of temperatures before the start" in remarks


def test_etve_is_the_range_of_the_drift_at_rest() -> None:
    """A sine of 5 µm amplitude over a day at rest: 10 µm of range, although the tool ends where it began."""
    t_s = np.arange(0.0, 86400.0 + 1.0, 600.0)
    made = campaign(displaced(t_s, 5.0 * np.sin(2 * np.pi * t_s / 86400.0)), np.zeros_like(t_s))
    test = environmental_variation(made)
    x = line(test, "X")
    assert x.period == pytest.approx(10.0, abs=1e-9)
    assert x.change == pytest.approx(0.0, abs=1e-9)
    assert not any("cycle of a day" in remark for remark in test.remarks)


def test_etve_ends_where_the_machine_begins_to_run() -> None:
    test = environmental_variation(warm_up())
    assert (test.start_s, test.end_s) == (0.0, 7200.0)
    assert line(test, "X").period == 0.0
    assert any("covers 2.0 h at rest" in remark for remark in test.remarks)


def test_etve_is_refused_without_rest_and_without_knowledge_of_it() -> None:
    with pytest.raises(AnalysisError, match="rests for 30 min before it runs"):
        environmental_variation(warm_up(start_s=1800.0))
    with pytest.raises(AnalysisError, match="is running at the first drift reading"):
        environmental_variation(warm_up(start_s=0.0))
    with pytest.raises(AnalysisError, match=r"nothing says when the machine rested.*add duty.csv"):
        environmental_variation(replace(warm_up(), duty=None))
    hydraulics = Duty(np.array([0.0, 36000.0]), {"hydraulics_on": np.ones(2)})
    with pytest.raises(AnalysisError, match="nothing says when the machine rested"):
        environmental_variation(replace(warm_up(), duty=hydraulics))


def test_measured_tilts_are_evaluated_and_missing_directions_are_said() -> None:
    made = warm_up()
    assert made.drift is not None
    x_um = made.drift.error_um[:, 0]
    tilt = np.column_stack([np.full_like(x_um, np.nan), 0.5 * x_um, np.full_like(x_um, np.nan)])
    test = spindle_distortion(replace(made, drift=displaced(made.drift.t_s, x_um, tilt)))
    b = line(test, "B")
    assert (b.unit, b.u) == ("µrad", None)
    assert b.period == pytest.approx(0.5 * grown(4), abs=1e-9)
    said = " ".join(test.not_computed)
    assert "displacement Z: drift.csv has no dZ_um" in said
    assert "tilt A, C: drift.csv has no rA_urad, rC_urad" in said
    assert "(d1 - d2) / l" in said


def test_the_instrument_stands_beside_displacements() -> None:
    made = replace(warm_up(), settings=CampaignSettings(instrument_u_um=2.0))
    assert line(spindle_distortion(made), "X").u == pytest.approx(2.0 * math.sqrt(2.0))
    assert line(spindle_distortion(warm_up()), "X").u is None


def visited(axis: Axis, targets_mm: tuple[float, ...], hours: int = 6) -> Campaign:
    """Each hour out and back. Along the axis the error grows by 10 µm a metre and hour, across it by 3 µm an hour."""
    position = np.array([*targets_mm, *reversed(targets_mm)])
    approach = np.repeat([1, -1], len(targets_mm))
    rows = len(position)
    hour = np.repeat(np.arange(float(hours)), rows)
    error = np.full((hours * rows, 3), np.nan)
    error[:, "XYZ".index(axis.cartesian)] = axis.sign * np.tile(position, hours) / 1000.0 * 10.0 * hour
    error[:, 1] = 3.0 * hour
    points = SweepPoints(
        t_s=3600.0 * hour + np.tile(np.arange(float(rows)), hours),
        axis=(axis.name,) * (hours * rows),
        sweep=np.repeat(np.arange(hours), rows),
        position_mm=np.tile(position, hours),
        direction=np.tile(approach, hours).astype(np.int64),
        error_um=error,
    )
    t_s = np.arange(0.0, hours * 3600.0, 600.0)
    return Campaign("day", CampaignSettings(instrument_u_um=3.0, instrument_u_um_per_m=2.0), heat(t_s), sweeps=points)


def test_axis_distortion_has_the_closed_form_of_the_growth() -> None:
    axis = Axis(name="X", direction="+X", travel_mm=(0.0, 1000.0))
    test = axis_distortion(visited(axis, (0.0, 500.0, 1000.0)), axis)
    growth = line(test, "length", "0 to 1000 mm, approach +")
    # Visits at 0, 1, … h after the first one of the place: 60 min hold two of them, 4 h five.
    assert (growth.first_hour, growth.period, growth.change) == pytest.approx((10.0, 40.0, 40.0))
    assert growth.u == pytest.approx(math.hypot(3.0, 5.0))
    across = line(test, "Y", "1000 mm, approach -")
    assert (across.period, across.u) == pytest.approx((12.0, 3.0 * math.sqrt(2.0)))
    assert line(test, "X", "0 mm, approach +").period == 0.0
    assert any("does not show what moved between the visits" in remark for remark in test.remarks)


def test_what_ran_between_the_visits_is_told_and_a_hydraulic_unit_is_no_motion() -> None:
    axis = Axis(name="X", direction="+X", travel_mm=(0.0, 1000.0))
    made = visited(axis, (0.0, 500.0, 1000.0))
    t_s = np.array([0.0, 600.0, 3000.0])
    for columns, told in (
        (
            {"feed_X_mm_min": np.array([0.0, 800.0, 0.0]), "hydraulics_on": np.ones(3)},
            "Meanwhile: feed_X_mm_min up to 800.",
        ),
        ({"feed_X_mm_min": np.zeros(3), "hydraulics_on": np.ones(3)}, "Nothing moved between the visits"),
        ({"hydraulics_on": np.ones(3)}, "does not show what moved"),
    ):
        remarks = axis_distortion(replace(made, duty=Duty(t_s, columns)), axis).remarks
        assert any(told in remark for remark in remarks), told


def test_a_visit_may_come_five_minutes_late_but_not_six() -> None:
    axis = Axis(name="X", direction="+X", travel_mm=(0.0, 1000.0))
    made = visited(axis, (0.0, 500.0, 1000.0))
    assert made.sweeps is not None
    for late_s, hours in ((290.0, 4), (360.0, 3)):
        t_s = made.sweeps.t_s + np.where(made.sweeps.sweep == 4, late_s, 0.0)
        test = axis_distortion(replace(made, sweeps=replace(made.sweeps, t_s=t_s)), axis)
        assert line(test, "length", "0 to 1000 mm, approach +").change == pytest.approx(10.0 * hours)


def test_growth_counts_along_the_axis_whatever_its_direction() -> None:
    axis = Axis(name="W", direction="-Z", travel_mm=(0.0, 1000.0))
    test = axis_distortion(visited(axis, (0.0, 500.0, 1000.0)), axis)
    assert line(test, "length", "0 to 1000 mm, approach +").change == pytest.approx(40.0)
    assert line(test, "Z", "1000 mm, approach +").change == pytest.approx(-40.0)


def test_of_a_long_axis_two_metres_in_the_middle_are_taken() -> None:
    axis = Axis(name="X", direction="+X", travel_mm=(0.0, 4000.0))
    test = axis_distortion(visited(axis, (0.0, 1000.0, 2000.0, 3000.0, 4000.0)), axis)
    assert line(test, "length", "1000 to 3000 mm, approach -").change == pytest.approx(80.0)
    assert any("from 1000 to 3000 mm" in remark for remark in test.remarks)


@pytest.mark.parametrize(
    ("travel_mm", "told"),
    [((0.0, 2000.0), False), ((0.0, 2001.0), True), ((-1500.0, 501.0), True), ((1000.0, 2500.0), False)],
)
def test_the_travel_not_the_position_of_its_ends_makes_an_axis_a_long_one(
    travel_mm: tuple[float, float], told: bool
) -> None:
    """The standard covers 2 m of travel; where on the scale they lie is nothing to it."""
    axis = Axis(name="X", direction="+X", travel_mm=travel_mm)
    low, high = travel_mm
    remarks = axis_distortion(visited(axis, (low, (low + high) / 2, low + 1000.0)), axis).remarks
    found = [remark for remark in remarks if "ISO 230-3 covers 2 m" in remark]
    assert bool(found) == told
    assert not told or f"The axis has {high - low:g} mm" in found[0]


def test_visits_that_cover_less_than_four_hours_are_told() -> None:
    axis = Axis(name="X", direction="+X", travel_mm=(0.0, 1000.0))
    for hours, told in ((6, False), (5, False), (4, True)):
        test = axis_distortion(visited(axis, (0.0, 500.0, 1000.0), hours), axis)
        assert any("less than 4 h" in remark for remark in test.remarks) == told
        # The first visit is at 0 s; the last reading of an hour comes five seconds after it.
        assert (test.start_s, test.end_s) == (0.0, min(14400.0, 3600.0 * (hours - 1) + 5.0))


def test_an_axis_visited_twice_is_refused() -> None:
    axis = Axis(name="X", direction="+X", travel_mm=(0.0, 1000.0))
    with pytest.raises(AnalysisError, match="visited fewer than 3 times"):
        axis_distortion(visited(axis, (0.0, 500.0, 1000.0), hours=2), axis)


def test_a_reading_that_stands_apart_is_told_because_a_range_takes_it_in() -> None:
    axis = Axis(name="X", direction="+X", travel_mm=(0.0, 1000.0))
    made = visited(axis, (0.0, 500.0, 1000.0))
    assert made.sweeps is not None
    error = made.sweeps.error_um.copy()
    error[(made.sweeps.t_s == 7202.0), 0] += 300.0  # at 1000 mm, approach +, after two hours
    spoilt = replace(made, sweeps=replace(made.sweeps, error_um=error))
    told = [remark for remark in axis_distortion(spoilt, axis).remarks if "departs from its neighbours" in remark]
    assert any(remark.startswith("X at 1000 mm, approach +: the reading at 2.0 h") for remark in told)
    assert not any("departs" in remark for remark in axis_distortion(made, axis).remarks)


def test_two_readings_make_a_range_one_does_not() -> None:
    t_s, value = np.array([0.0, 10.0, 20.0]), np.array([1.0, np.nan, 4.0])
    assert range_within(t_s, value, 0.0, 20.0) == 3.0
    assert math.isnan(range_within(t_s, value, 0.0, 10.0))


def test_positioning_is_not_guessed_from_sweeps_without_run_or_direction() -> None:
    axis = Axis(name="X", direction="+X", travel_mm=(0.0, 1000.0))
    made = visited(axis, (0.0, 250.0, 500.0, 750.0, 1000.0))
    assert made.sweeps is not None
    named = replace(made.sweeps, run=tuple(str(k) for k in made.sweeps.sweep))
    assert campaign_positioning(replace(made, sweeps=named), axis).runs.count == 6
    with pytest.raises(AnalysisError, match="does not state the direction of every point"):
        campaign_positioning(replace(made, sweeps=replace(named, direction_given=False)), axis)


def test_the_distance_counts_in_the_uncertainty_of_accuracy_but_not_of_repeatability() -> None:
    axis = Axis(name="X", direction="+X", travel_mm=(0.0, 1000.0))
    made = visited(axis, (0.0, 250.0, 500.0, 750.0, 1000.0))
    assert made.sweeps is not None
    result = campaign_positioning(
        replace(made, sweeps=replace(made.sweeps, run=tuple(str(k) for k in made.sweeps.sweep))), axis
    )
    instrument = Instrument.of(made.settings)  # 3 µm + 2 µm/m, 1 m measured
    for symbol in ("A", "A_up", "E", "M"):
        assert axis_u_um(symbol, result, instrument) == pytest.approx(math.hypot(3.0, 5.0))
    for symbol in ("R", "R_down", "B", "B_mean"):
        assert axis_u_um(symbol, result, instrument) == pytest.approx(math.hypot(3.0, 3.0))


def test_a_campaign_says_of_every_test_whether_it_can_be_evaluated() -> None:
    machine = small_machine()
    done, refused = campaign_tests(machine, warm_up())
    assert [one.title for one in done] == [ETVE, SPINDLE]
    assert [one.reason for one in refused] == ["there are no sweeps of axis X, W (sweeps.csv)."]
    done, refused = campaign_tests(machine, visited(machine.axes[0], (0.0, 500.0, 1000.0)))
    assert [one.title for one in done] == [AXIS.format("X")]
    reasons = " ".join(one.reason for one in refused)
    assert "does not state the run of every point" in reasons
    assert "there is no drift.csv" in reasons

"""Twenty machines: the plan, the column's deviation, models as analyze stores them, and one machine from end to end."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from rigid_machine import MACHINE, P0_MM, REFERENCE_S, Rigid, draw_rigid, measure
from small_models import Part, component, document, term

from thetacomp.analysis import analyze_folder
from thetacomp.campaign import Campaign, CampaignSettings, LeadIn, MachineFolder
from thetacomp.fitting.training import train
from thetacomp.model.document import ModelDocument
from thetacomp.model.fallback import DECAY_S
from thetacomp.model.temperatures import Duty, Temperatures
from thetacomp.preparation import Prepared, prepare
from thetacomp.screening import ScreeningModel
from thetatwin.campaigns import Twin, plan_campaigns, run_campaign
from thetatwin.conditions import Conditions
from thetatwin.trial import online as online_module
from thetatwin.trial.clock import clock_error_um
from thetatwin.trial.many_machines import (
    Deviation,
    VerificationPlan,
    column_deviation_um,
    summaries,
    verify_machine,
    with_plan,
)
from thetatwin.trial.online import OnlineReadings, online_error_um, online_readings
from thetatwin.virtual_machine import VirtualMachine


def test_more_readings_make_the_points_better_and_nothing_else(standard: Conditions) -> None:
    plan = with_plan(standard, VerificationPlan(points=9, readings=4))
    old, new = standard.tracker, plan.tracker
    assert new.u_um**2 * new.white_share == pytest.approx(old.u_um**2 * old.white_share / 4)
    assert new.u_um**2 * new.sweep_share == pytest.approx(old.u_um**2 * old.sweep_share)
    day = old.u_um_per_m**2 * (1 - old.white_share - old.sweep_share)
    assert new.u_um_per_m**2 * (1 - new.white_share - new.sweep_share) == pytest.approx(day)
    assert plan.work.dwell_s == 4 * standard.work.dwell_s
    assert (plan.hall, plan.pt100) == (standard.hall, standard.pt100)


def test_the_plan_sets_the_cold_block_and_the_lead(twin: Twin, standard: Conditions) -> None:
    longer = with_plan(standard, VerificationPlan(points=9, cold_rounds=4, lead_h=20.0))
    record = run_campaign(replace(twin, conditions=longer), plan_campaigns(twin, 1)[0])
    cold = record.truth.t_s <= record.reference_s
    assert len(np.unique(record.truth.sweep[cold & (record.truth.axis == 1)])) == 4
    assert record.temperature_t_s[0] == -20 * 3600.0


def test_column_deviation_of_a_known_lean_with_a_gross_error(twin: Twin) -> None:
    """Geometry of 200 µm cancels, 30 µm/m of lean are 45 µm at the ends, one gross error does not count."""
    record = run_campaign(twin, plan_campaigns(twin, 1)[0])
    lever_m = (record.truth.positions_mm["Y"] - 1500.0) / 1000.0
    error = 200.0 * np.sin(record.truth.positions_mm["Y"]) + 30.0 * lever_m * (record.truth.t_s > record.reference_s)
    error += 5.0 * record.truth.direction  # reversal
    assert column_deviation_um(twin, record, error) == pytest.approx(45.0, abs=1.0)
    error[np.flatnonzero((record.truth.axis == 1) & (record.truth.t_s > record.reference_s))[40]] += 300.0
    assert column_deviation_um(twin, record, error) == pytest.approx(45.0, abs=1.0)


def test_two_gross_errors_at_one_position_of_a_sweep_do_not_count(twin: Twin, standard: Conditions) -> None:
    """There and back at the same place: least squares would bend so far that neither stands out."""
    nine = replace(twin, conditions=with_plan(standard, VerificationPlan(points=9)))
    record = run_campaign(nine, plan_campaigns(nine, 1)[0])
    truth, rng = record.truth, np.random.default_rng(4)
    error = rng.normal(0.0, 3.0, len(truth.t_s)) + 30.0 * (truth.positions_mm["Y"] - 1500.0) / 1000.0
    sweep = truth.sweep[(truth.axis == 1) & (truth.t_s > record.reference_s)][-1]
    error[(truth.sweep == sweep) & (truth.positions_mm["Y"] == 2250.0)] -= 170.0
    assert column_deviation_um(nine, record, error) < 15.0


def test_summary_over_machines_in_closed_form() -> None:
    """Reductions of 0, 10, … 100 % measured: 10th percentile 10, median 50; true ones are all 90 %."""
    rows = [Deviation(seed, "X", "clock", 100.0, 100.0 - 10.0 * seed, 50.0, 5.0) for seed in range(11)]
    (one,) = summaries(rows)
    assert (one.method, one.direction, one.machines) == ("clock", "X", 11)
    assert one.measured_percent == pytest.approx((10.0, 50.0))
    assert one.true_percent == pytest.approx((90.0, 90.0))
    assert one.measured_um == pytest.approx((100.0, 50.0))
    assert one.true_um == pytest.approx((50.0, 5.0))


# --- the machine while it runs


def with_fallback() -> ModelDocument:
    """Drift in X 10 µm/K on a, 4 µm/K on b where a is lost; along Y 5 and 2 µm/m and K. Joint form."""
    zero = {"a": 20.0, "b": 20.0}

    def law(name: str, sensor: str, per_K: float) -> tuple[str, Part]:
        slope = None if name == "DX" else term(0.0, per_K)
        constant = term(0.0, per_K if name == "DX" else 0.0)
        return name, component(name, constant, slope, {sensor: zero[sensor]}, p=(0.0, -3000.0, 3000.0))

    zero_to_twenty = {"a": (0.0, 20.0), "b": (0.0, 20.0)}
    first = dict([law("DX", "a", 10.0), law("EXY", "a", 5.0)])
    ready = dict([law("DX", "b", 4.0), law("EXY", "b", 2.0)])
    accuracy = {"full_rms_um": 1.0, "without_rms_um": 2.0, "nothing_rms_um": 9.0}
    fallback = {"lost": "a", "components": ready, "accuracy": dict.fromkeys(ready, accuracy)}
    return document({"Y": "+Y"}, first, zero_to_twenty, fallbacks=[fallback], form="joint")


def ten_degrees(lost: tuple[tuple[float, frozenset[str]], ...]) -> OnlineReadings:
    """Both sensors at 20 °C at the reference, 10 K warmer from one minute on."""
    t_s = 60.0 * np.arange(1000.0)
    return OnlineReadings(Temperatures(t_s, ("a", "b"), 20.0 + 10.0 * (t_s > 0)[:, None] * np.ones(2)), None, lost)


def test_a_lost_sensor_is_met_by_the_fallback_without_a_jump() -> None:
    """2 m from P0: 100 + 100 µm before the loss, 40 + 40 µm by the fallback; the difference decays with 4 h."""
    lost_s = 7200.0
    t_s = lost_s + np.array([-60.0, 0.0, DECAY_S])
    there = {"Y": np.full(3, 2000.0)}
    out = online_error_um(with_fallback(), ten_degrees(((lost_s, frozenset({"a"})),)), t_s, there, 0.0)
    np.testing.assert_allclose(out[:, 0], [200.0, 200.0, 80.0 + 120.0 / np.e])
    np.testing.assert_array_equal(out[:, 1:], 0.0)


def test_compensation_ends_softly_where_nothing_is_ready() -> None:
    lost = ((3600.0, frozenset({"a"})), (7200.0, frozenset({"a", "b"})))
    t_s = np.array([7200.0, 7200.0 + DECAY_S])
    out = online_error_um(with_fallback(), ten_degrees(lost), t_s, {"Y": np.zeros(2)}, 0.0)
    before = 40.0 + 60.0 * np.exp(-3600.0 / DECAY_S)
    np.testing.assert_allclose(out[:, 0], [before, before / np.e])


def test_a_sensor_that_came_back_stays_lost_and_the_lead_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    states = iter([("believed", "believed"), ("lost", "believed"), ("believed", "believed"), ("believed", "lost")])

    class Judge:
        def __init__(self, model: object) -> None:
            pass

        def update(self, t_s: float, value: np.ndarray) -> SimpleNamespace:
            return SimpleNamespace(value_degC=value + 1.0, state=next(states))

    monkeypatch.setattr(online_module, "Detector", Judge)
    table = Temperatures(np.array([0.0, 60.0]), ("a", "b"), np.full((2, 2), 20.0))
    earlier = Temperatures(np.array([-120.0, -60.0]), ("a", "b"), np.full((2, 2), 15.0))
    speed = {"spindle_rpm": np.array([500.0])}
    before = LeadIn(earlier, Duty(np.array([-120.0]), speed))
    campaign = Campaign("c", CampaignSettings(), table, duty=Duty(np.array([0.0]), speed), before=before)
    found = online_readings(campaign, ScreeningModel.__new__(ScreeningModel))
    assert found.lost == ((-60.0, frozenset({"a"})), (60.0, frozenset({"a", "b"})))
    assert found.ever_lost == {"a", "b"}
    np.testing.assert_array_equal(found.table.value_degC[:, 0], [16.0, 16.0, 21.0, 21.0])
    assert found.duty is not None
    np.testing.assert_array_equal(found.duty.t_s, [-120.0, 0.0])


def test_what_came_before_is_joined_by_the_names_of_the_sensors() -> None:
    """The loggers' columns stood in another order before the campaign began."""
    own = Temperatures(np.array([0.0, 60.0]), ("a", "b"), np.array([[20.0, 30.0], [21.0, 31.0]]))
    earlier = Temperatures(np.array([-120.0, -60.0]), ("b", "a"), np.array([[28.0, 18.0], [29.0, 19.0]]))
    found = online_readings(Campaign("c", CampaignSettings(), own, before=LeadIn(earlier)), None)
    np.testing.assert_array_equal(found.table.value_degC, [[18.0, 28.0], [19.0, 29.0], [20.0, 30.0], [21.0, 31.0]])


# --- drift counts once


@pytest.fixture(scope="module")
def rigid() -> tuple[Rigid, Prepared]:
    """A machine of rigid bodies whose guides do not twist, taught by three campaigns in the joint form."""
    rng = np.random.default_rng(7)
    machine = draw_rigid(rng, turning=False)
    heats = zip("abc", ((4000.0, 16000.0), (9000.0, 11000.0), (6000.0, 14000.0)), strict=True)
    campaigns = [measure(replace(machine, tau_s=tau), rng, name, point_sd_um=1.0) for name, tau in heats]
    folder = MachineFolder(MACHINE, tuple(campaigns))
    return replace(machine, tau_s=(6000.0, 14000.0)), prepare(folder, faults="ignore")


def left_over(found: np.ndarray, true: np.ndarray) -> float:
    """Share of the RMS that is left in the worst direction: 1 where drift is left out or counted twice."""
    return float((np.sqrt(np.mean((true - found) ** 2, axis=0)) / np.sqrt(np.mean(true**2, axis=0))).max())


def test_drift_is_counted_once_by_the_models_and_by_the_clock(rigid: tuple[Rigid, Prepared]) -> None:
    machine, prepared = rigid
    campaign = prepared.folder.campaign("c")
    assert prepared.separated.form == "joint"
    t_s = np.repeat(np.linspace(7200.0, 22000.0, 12), 3)
    y_mm = np.tile([0.0, 800.0, 1600.0], 12)
    true = np.array([machine.thermal({**P0_MM, "Y": y}, t)[:3] for t, y in zip(t_s, y_mm, strict=True)])
    middle = y_mm == P0_MM["Y"]  # all of the error is drift there
    there = {"X": np.full(36, P0_MM["X"]), "Y": y_mm, "W": np.full(36, P0_MM["W"])}
    live = online_readings(campaign, None)
    trained = train(prepared, ("Y", ""), lost=())
    for one, most in ((trained.model, 0.15), (trained.paper_model, 0.6)):
        found = online_error_um(one, live, t_s, there, REFERENCE_S)
        assert left_over(found, true) < most
        assert left_over(found[middle], true[middle]) < most
    assert campaign.sweeps is not None
    cold_s = campaign.sweeps.t_s[campaign.sweeps.t_s <= REFERENCE_S].mean()
    column = [states for states in prepared.training if states.axis in ("Y", "")]
    timed = clock_error_um(column, (t_s - cold_s) / 3600.0, {"Y": y_mm})
    assert left_over(timed, true) < 0.6
    assert left_over(timed[middle], true[middle]) < 0.6


# --- as analyze


def four_sensors(campaign: Campaign, rng: np.random.Generator) -> Campaign:
    """Two more sensors between the others, all with noise; in campaign b the last one dies in the middle."""
    own = campaign.temperatures
    value = np.column_stack([own.value_degC, own.value_degC @ np.array([[0.7, 0.2], [0.3, 0.8]])])
    value += rng.normal(0.0, 0.02, value.shape)
    if campaign.name == "b":
        value[len(value) // 2 :, 3] = np.nan
    return replace(campaign, temperatures=Temperatures(own.t_s, ("t1", "t2", "t3", "t4"), value))


@pytest.mark.slow
def test_the_models_are_those_that_analyze_stores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("thetacomp.analysis.sensor_curves", lambda training, progress: ())  # no part of the model
    rng = np.random.default_rng(3)
    machine = draw_rigid(rng)
    heats = zip("abcd", ((4e3, 16e3), (9e3, 11e3), (6e3, 14e3), (5e3, 20e3)), strict=True)
    campaigns = [
        four_sensors(measure(replace(machine, tau_s=tau), rng, name, rounds=10, angle_sd_urad=1.0), rng)
        for name, tau in heats
    ]
    sensors = tuple(MACHINE.sensors[0].model_copy(update={"id": name}) for name in ("t1", "t2", "t3", "t4"))
    folder = MachineFolder(MACHINE.model_copy(update={"sensors": sensors}), tuple(campaigns))
    analysis = analyze_folder(folder)
    assert analysis.screening is not None
    assert ("b", "t4") in {(name, finding.sensor) for name, finding in analysis.screening.findings}
    lost = "t1"
    trained = train(prepare(folder, mix=True), ("Y", ""), {lost})
    model, paper_model = trained.model, trained.paper_model
    told = {"held_out_um": None}
    for made, stored in ((model, analysis.model), (paper_model, analysis.paper_model)):
        assert made.form == stored.form == "joint"
        assert set(made.components) == set(stored.components)
        assert made.rotations == stored.rotations
        for name, component_ in stored.components.items():
            assert made.components[name] == component_.model_copy(update=told)
    assert set(model.prediction) == {"Y", ""}
    for axis, one in model.prediction.items():
        stored_axis = analysis.model.prediction[axis]
        assert one.layout == stored_axis.layout
        for name, stored_component in stored_axis.components.items():
            assert one.components[name] == stored_component.model_copy(update=told)
        assert one.fallbacks == tuple(f for f in stored_axis.fallbacks if f.lost == lost)
        assert len(one.fallbacks) == 1
    for axis, law in model.control.items():
        assert [f.lost for f in law.fallbacks] == [f.lost for f in analysis.model.control[axis].fallbacks]


@pytest.mark.slow
def test_a_verified_machine_loses_most_of_its_column_deviation(coarse: VirtualMachine, standard: Conditions) -> None:
    rows = verify_machine(coarse, standard, VerificationPlan(calibrations=4, points=9, readings=4), seed=3)
    found = {(row.method, row.direction): row for row in rows}
    assert found["default", "Z"].true_percent > 85.0
    assert found["default", "Z"].true_percent > found["one_sensor", "Z"].true_percent
    assert found["default", "X"].true_percent > 40.0
    assert found["clock", "Z"].true_percent < 60.0
    assert len(summaries(rows)) == 6

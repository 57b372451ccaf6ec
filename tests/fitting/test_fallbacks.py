"""Fallbacks: a lost sensor degrades the compensation instead of ending it, and the switch makes no bump."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from synthetic_campaigns import LAYOUT, SENSORS, WINTER, Recording, inputs_of, synthetic_machine

from thetacomp.axis_states import AxisStates, axis_states
from thetacomp.campaign import Campaign, CampaignSettings, Drift, MachineFolder, Parameters
from thetacomp.errors import AnalysisError
from thetacomp.fitting.build import build_document
from thetacomp.fitting.calibrated import calibrated_history
from thetacomp.fitting.fallbacks import axis_fallbacks, states_without, with_fallbacks
from thetacomp.fitting.key_point_law import AxisModel, clock, fit_axis
from thetacomp.fitting.ridge import HistoryRidge, history_candidates
from thetacomp.folds import hold_out
from thetacomp.machine import Axis, Machine, Sensor
from thetacomp.model.check import problems
from thetacomp.model.document import AxisLaw, ModelDocument, Training
from thetacomp.model.fallback import degraded, start_transfer, without_sensor
from thetacomp.model.filters import InputLayout, history_inputs
from thetacomp.model.law import Law, component_laws
from thetacomp.model.load import load_model
from thetacomp.model.temperatures import Temperatures
from thetacomp.separation import separate_folder

IDS = ("nut", "bearing", "bed")
MACHINE = Machine(
    name="two sensors tell nearly the same",
    axes=(Axis(name="Y", direction="+Y", travel_mm=(0.0, 2000.0), sensor="nut"),),
    sensors=tuple(Sensor(id=name, role="drive") for name in IDS),
)


def campaign(name: str, seed: int) -> Campaign:
    """Errors follow the nut (10 µm/K) and the bed (-6 µm/K); the bearing follows the nut to 0.5 K."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(10) * 3600.0
    nut = rng.uniform(6, 14) * (1 - np.exp(-t_s / rng.uniform(4000, 15000)))
    bed = np.concatenate([[0.0], np.cumsum(rng.normal(0.3, 0.4, 9))])
    bearing = 0.8 * nut + np.concatenate([[0.0], rng.normal(0, 0.5, 9)])
    error_um = 10.0 * nut - 6.0 * bed
    n = 10
    return Campaign(
        name=name,
        settings=CampaignSettings(),
        temperatures=Temperatures(t_s, IDS, 20.0 + np.column_stack([nut, bearing, bed])),
        parameters=Parameters(
            t_s=np.tile(t_s, 3),
            component=tuple(np.repeat(("EXY", "EYY", "EZY"), n)),
            intercept_um=np.concatenate([share * error_um + rng.normal(0, 1, n) for share in (1.0, -0.5, 0.7)]),
            slope_um_per_m=np.concatenate([share * error_um / 4 + rng.normal(0, 0.5, n) for share in (1.0, 0.4, -0.8)]),
            p0_mm=np.zeros(3 * n),
            p_min_mm=np.zeros(3 * n),
            p_max_mm=np.full(3 * n, 2000.0),
        ),
    )


FOLDER = MachineFolder(MACHINE, tuple(campaign(f"c{i}", i) for i in range(5)))
NAMES = [one.name for one in FOLDER.campaigns]


def procedure(states: AxisStates) -> AxisModel:
    """Nut before bearing, and the bed: what is there of it."""
    drive = "nut" if "nut" in states.sensors else "bearing"
    return fit_axis(states, tuple(name for name in (drive, "bed") if name in states.sensors))


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> ModelDocument:
    (states,) = axis_states(FOLDER, separate_folder(FOLDER), NAMES)
    model = procedure(states)
    folds = [(fold.train, fold.test) for fold in hold_out(states)[1]]
    ready = axis_fallbacks(states, model, procedure, folds)
    document = build_document(FOLDER, [(states, model)], "test", NAMES, fallbacks=ready)
    path: Path = tmp_path_factory.mktemp("model") / "model.json"
    document.save(path)
    return load_model(path)


def test_every_key_sensor_has_a_fallback_that_is_stored_with_its_accuracy(stored: ModelDocument) -> None:
    without_nut, without_bed = stored.control["Y"].fallbacks
    assert (without_nut.lost, without_bed.lost) == ("nut", "bed")
    assert without_nut.layout.sensors == ("bearing", "bed")
    assert without_bed.layout.sensors == ("nut",)
    for fallback in stored.control["Y"].fallbacks:
        assert fallback.accuracy.keys() == fallback.components.keys() == {"EXY", "EYY", "EZY"}
        for accuracy in fallback.accuracy.values():
            assert accuracy.full_rms_um < accuracy.without_rms_um < 0.4 * accuracy.nothing_rms_um


def test_accuracy_of_a_fallback_is_held_out(stored: ModelDocument) -> None:
    (states,) = axis_states(FOLDER, separate_folder(FOLDER), NAMES)
    rest = states_without(states, "nut")
    errors = []
    for fold in hold_out(rest)[1]:
        samples = rest.samples[0].take(np.isin(rest.samples[0].state, fold.test))
        errors.append(samples.value_um - procedure(rest.take(fold.train)).predict("EXY", rest, samples)[0])
    expected = np.sqrt(np.mean(np.concatenate(errors) ** 2))
    assert stored.control["Y"].fallbacks[0].accuracy["EXY"].without_rms_um == pytest.approx(expected)


def test_a_lost_sensor_degrades_the_model_and_two_may_end_a_component(stored: ModelDocument) -> None:
    whole = degraded(stored, ())
    assert whole.model.components == stored.components
    one = degraded(stored, {"nut"})
    assert set(one.replaced) == {"EXY", "EYY", "EZY"}
    assert one.ended == ()
    # the degraded model is a model: its laws are made from it and predict nearly what the whole one does
    state = {"nut": 28.0, "bearing": 26.4, "bed": 21.0}
    for name, law in component_laws(one.model.control).items():
        full = component_laws(stored.control)[name]

        def error_um(at):  # type: ignore[no-untyped-def]
            rises = at.rises_K(np.array([[state[sensor] for sensor in at.inputs]]))
            return at.error_um(rises, np.array([1000.0]))[0]

        assert error_um(law) == pytest.approx(error_um(full), abs=0.2 * abs(error_um(full)) + 3.0)
    two = degraded(stored, {"nut", "bed"})
    assert set(two.ended) == {"EXY", "EYY", "EZY"}
    assert two.model.control == {}
    # a sensor of the fallback alone is not missed while the key sensor is there
    assert degraded(stored, {"bearing"}).replaced == {}


def test_the_most_accurate_fallback_is_taken(stored: ModelDocument) -> None:
    law = stored.control["Y"]
    first, uses_the_nut = law.fallbacks
    accuracy = first.accuracy["EXY"].model_copy(update={"without_rms_um": 99.0})
    marked = first.components["EXY"].model_copy(update={"equation": "the worse one"})
    worse = first.model_copy(
        update={"accuracy": first.accuracy | {"EXY": accuracy}, "components": first.components | {"EXY": marked}}
    )
    changed = law.model_copy(update={"fallbacks": (worse, uses_the_nut, first)})
    document = stored.model_copy(update={"control": {"Y": changed}})
    assert degraded(document, {"nut"}).model.components["EXY"] == first.components["EXY"]


def test_models_without_fallbacks_are_read_as_before(stored: ModelDocument) -> None:
    raw = stored.model_dump(mode="json")
    del raw["control"]["Y"]["fallbacks"]
    assert ModelDocument.model_validate(raw).control["Y"].fallbacks == ()


def test_the_switch_makes_no_bump_and_decays() -> None:
    # intercept and slope are carried, so no position jumps
    carried = start_transfer(100.0, output=(40.0, -6.0), law=(31.0, -4.5), decay_s=3600.0)
    assert np.add((31.0, -4.5), carried.at(100.0)) == pytest.approx((40.0, -6.0))
    later = np.array([carried.at(100.0 + t) for t in range(0, 36000, 60)])
    # closed form: the fastest change is the value over the time constant
    assert np.max(np.abs(np.diff(later[:, 0]))) <= 9.0 / 3600.0 * 60.0 + 1e-12
    assert np.all(np.diff(np.abs(later), axis=0) < 0)
    assert carried.at(3700.0)[0] == pytest.approx(9.0 / np.e)
    kept = start_transfer(100.0, (40.0,), (31.0,), decay_s=None)
    assert kept.at(1e6) == (9.0,)
    # back to the whole model in the middle of the decay: again no bump
    output = 31.0 + carried.at(2000.0)[0]
    assert 35.0 + start_transfer(2000.0, (output,), (35.0,)).at(2000.0)[0] == pytest.approx(output)
    with pytest.raises(ValueError, match="before the change"):
        carried.at(0.0)


def test_the_clock_needs_no_fallback_and_one_sensor_has_none() -> None:
    (states,) = axis_states(FOLDER, separate_folder(FOLDER), NAMES)
    folds = [(fold.train, fold.test) for fold in hold_out(states)[1]]
    assert axis_fallbacks(states, clock(states), clock, folds) == ()

    def only_nut(some: AxisStates) -> AxisModel:
        if "nut" not in some.sensors:
            raise AnalysisError("no nut")
        return fit_axis(some, ("nut",))

    assert axis_fallbacks(states, only_nut(states), only_nut, folds) == ()


def test_history_model_goes_on_without_any_of_its_sensors() -> None:
    rng = np.random.default_rng(100)
    machine = synthetic_machine(rng)
    known, unseen = machine.record(rng, 20, WINTER), machine.record(rng, 20, WINTER)
    axis = with_history_fallbacks(drift_folder(known))
    assert tuple(fallback.lost for fallback in axis.fallbacks) == SENSORS
    kept = []
    for fallback in axis.fallbacks:
        rest = without_sensor(axis, fallback)
        assert problems(with_law(rest)) == []
        assert fallback.lost not in rest.layout.sensors
        columns = [SENSORS.index(name) for name in rest.layout.sensors]
        degC = unseen.temperature_degC[:, columns]
        values = Law.of_model(rest).at(inputs_of(unseen, rest.layout), degC)
        error_um = unseen.displacement_um - values.error_um("DX", 0.0)
        rms_um = float(np.sqrt(np.mean(error_um**2)))
        accuracy = fallback.accuracy["DX"]
        kept.append(rms_um / accuracy.without_rms_um)
        assert rms_um < 0.25 * accuracy.nothing_rms_um
        # the band is that of the full model, widened by what the loss costs
        assert np.mean(np.abs(error_um) <= values.half_width_um("DX", 0.0)) > 0.88
    # what was promised held out is what 20 new campaigns show, on average over the sensors
    assert np.mean(kept) == pytest.approx(1.0, abs=0.25)
    # a sensor that the others can replace costs nothing, but not every one can be that
    ratios = [f.accuracy["DX"].without_rms_um / f.accuracy["DX"].full_rms_um for f in axis.fallbacks]
    assert max(ratios) > 1.2
    # two lost at once: no fallback is ready, and there is no law on key temperatures to go on with
    both = degraded(with_law(axis), SENSORS[:2])
    assert (both.model.prediction, both.replaced) == ({}, {"DX": None})
    assert degraded(with_law(axis), {"theta_99"}).model.prediction == {"": axis}


def with_law(axis: AxisLaw) -> ModelDocument:
    """A model that predicts by this law alone."""
    training = Training(campaigns=(), mode="", instrument="", datum="campaign")
    return ModelDocument(
        version="0", created="", machine="", axes=(), sign="stated", method="", control={}, prediction={"": axis},
        training=training,
    )  # fmt: skip


def drift_folder(recording: Recording) -> MachineFolder:
    """The campaigns of a recording as drift logs in X."""
    made = []
    for label in np.unique(recording.campaign):
        own = recording.take(recording.campaign == label)
        error_um = np.full((len(own.t_s), 3), np.nan)
        error_um[:, 0] = own.displacement_um
        heat = Temperatures(own.t_s, SENSORS, own.temperature_degC)
        made.append(Campaign(f"c{label:03d}", CampaignSettings(), heat, drift=Drift(own.t_s, error_um)))
    machine = Machine(name="synthetic", axes=(), sensors=tuple(Sensor(id=name, role="structure") for name in SENSORS))
    return MachineFolder(machine, tuple(made))


def with_history_fallbacks(folder: MachineFolder) -> AxisLaw:
    separations, names = separate_folder(folder), [campaign.name for campaign in folder.campaigns]
    (states,) = axis_states(folder, separations, names)
    return with_fallbacks(states, calibrated_history(states))


def test_a_sensor_is_lost_in_the_middle_of_a_shift() -> None:
    rng = np.random.default_rng(101)
    machine = synthetic_machine(rng)
    known, shift = machine.record(rng, 20, WINTER), machine.record(rng, 1, WINTER)
    rest = LAYOUT.model_copy(update={"sensors": SENSORS[1:]})
    predicted = []
    for layout in (LAYOUT, rest):
        model = HistoryRidge(layout.blocks, history_candidates(layout, 3))
        model.fit(inputs_of(known, layout), known.displacement_um, known.campaign)
        predicted.append(model.predict(inputs_of(shift, layout)))
    full, fallback = predicted
    lost = 48
    carried = start_transfer(shift.t_s[lost], (full[lost],), (fallback[lost],))
    output = np.concatenate([full[:lost], [fallback[k] + carried.at(shift.t_s[k])[0] for k in range(lost, 96)]])
    # the step into the fallback is no larger than the steps that either model makes on its own
    own = max(np.abs(np.diff(full)).max(), np.abs(np.diff(fallback)).max())
    assert abs(output[lost] - output[lost - 1]) <= own
    assert np.sqrt(np.mean((shift.displacement_um - output)[lost:] ** 2)) < 0.25 * np.sqrt(
        np.mean(shift.displacement_um[lost:] ** 2)
    )


def test_states_without_a_sensor_keep_everything_else() -> None:
    (states,) = axis_states(FOLDER, separate_folder(FOLDER), NAMES)
    rest = states_without(states, "bearing")
    assert rest.sensors == ("nut", "bed")
    np.testing.assert_array_equal(rest.rise_K, states.rise_K[:, [0, 2]])
    np.testing.assert_array_equal(rest.samples[1].rise_K, states.samples[1].rise_K[:, [0, 2]])
    # heat history is what a machine would have recorded that never had the sensor
    layout = states.layout.without("bearing")
    names = [name for block in states.layout.blocks.values() for name in block]
    left = [name for block in layout.blocks.values() for name in block]
    own = [j for j, name in enumerate(left) if " x " not in name]
    np.testing.assert_allclose(rest.history[:, own], states.history[:, [names.index(left[j]) for j in own]])
    assert rest.layout == layout
    assert rest.samples[1].history.shape[1] == rest.history.shape[1] == len(left)
    assert rest.trajectory.inputs.shape[1] == len(left) + 2
    only = states_without(rest, "nut")
    assert states_without(only, "bed").layout is None


@pytest.mark.parametrize("products", [(), ("median", "level")])
def test_running_inputs_without_a_sensor_are_those_of_a_recording_without_it(products) -> None:
    rng = np.random.default_rng(3)
    layout = InputLayout(sensors=("a", "b", "c"), base_degC=21.0, products=products)
    t_s, degC, rpm = np.arange(0.0, 36000.0, 600.0), rng.uniform(20.0, 30.0, (60, 3)), rng.uniform(0.0, 4000.0, 60)
    expected = history_inputs(layout.without("b"), t_s, degC[:, [0, 2]], rpm)
    found = layout.running_without("b", history_inputs(layout, t_s, degC, rpm))
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-9)

"""The ruler of carrying over in bench/: its machines obey physics, its baselines and figures are what they say."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "bench"))

from carry import lumped, store
from carry.baselines import best_three, mean_curve
from carry.draws import drawn_lumped
from carry.lumped_machines import BED, LUMPED
from carry.measure import Figures, Row, measure
from carry.network import Drive, Network, network, simulate
from carry.page import BEGIN, END, put_into, summary, tables
from carry.work import Air

from thetacomp.campaign import MachineFolder
from thetacomp.folds import hold_out, training_states
from thetacomp.preparation import Prepared, prepare
from thetacomp.reading import check_folder, read_folder
from thetacomp.validation.outcome import DEFAULT, NOTHING


def driven(steps: int, heat_W: float, friction_W: float = 0.0, air_degC: float = 20.0) -> Drive:
    """Heat and friction in the first of two nodes, air at one level, no flow."""
    first = np.array([1.0, 0.0])
    return Drive(
        np.tile(heat_W * first, (steps, 1)),
        np.tile(friction_W * first, (steps, 1)),
        np.full((steps, 1), air_degC),
        np.zeros((steps, 1)),
    )


def two_nodes() -> Network:
    return network({"motor": 5.0, "bed": 20.0}, [("motor", "bed", 4.0)], still=[("bed", "air", 2.0)])


def test_a_lumped_machine_ends_where_its_heat_balance_says() -> None:
    """100 W through 2 W/K into air at 20 °C: the bed at 70 °C; through 4 W/K more: the motor at 95 °C."""
    end_degC = simulate(two_nodes(), driven(4000, 100.0), np.full(2, 20.0), 60.0)[-1]
    assert end_degC == pytest.approx([95.0, 70.0], abs=0.01)


def test_a_lumped_machine_keeps_its_energy() -> None:
    """Without air what a heater brings stays in the nodes: 100 W for an hour are 360 kJ."""
    alone = replace(two_nodes(), still_W_K=np.zeros((2, 1)))
    rise_K = simulate(alone, driven(60, 100.0), np.full(2, 20.0), 60.0)[-1] - 20.0
    assert rise_K @ alone.capacity_J_K == pytest.approx(360e3)


def test_friction_falls_as_the_lubricant_warms() -> None:
    """At the end heat in equals heat out: 2 W/K times the rise of the bed equals friction times its thinning."""
    motor_degC, bed_degC = simulate(two_nodes(), driven(4000, 0.0, friction_W=100.0), np.full(2, 20.0), 60.0)[-1]
    assert 2.0 * (bed_degC - 20.0) == pytest.approx(100.0 * np.exp(-0.012 * (motor_degC - 20.0)), rel=1e-4)


@pytest.mark.parametrize("name", LUMPED)
def test_every_lumped_machine_is_a_sound_folder(name: str, tmp_path: Path) -> None:
    lumped.make_folder(LUMPED[name], tmp_path / "machine", 2)
    _, problems = check_folder(tmp_path / "machine")
    assert [problem for problem in problems if problem.severity == "error"] == []
    sensors = {probe.id for probe in LUMPED[name].probes}
    assert set(read_folder(tmp_path / "machine").machine.sensor_ids) == sensors


def test_campaigns_start_at_levels_of_their_own(tmp_path: Path) -> None:
    lumped.make_folder(LUMPED["lathe"], tmp_path / "machine", 5)
    starts = [c.temperatures.value_degC[0].mean() for c in read_folder(tmp_path / "machine").campaigns]
    assert np.ptp(starts) > 3.0


def test_another_draw_is_another_machine_of_the_same_build() -> None:
    one, again, other = (drawn_lumped(BED, draw) for draw in (1, 1, 2))
    assert np.array_equal(one.network.link_W_K, again.network.link_W_K)
    assert np.array_equal(one.network.link_W_K, one.network.link_W_K.T)
    assert np.array_equal(one.network.link_W_K > 0, BED.network.link_W_K > 0)
    assert not np.allclose(one.network.capacity_J_K, other.network.capacity_J_K, rtol=0.02)
    assert not np.allclose(one.network.capacity_J_K, BED.network.capacity_J_K, rtol=0.02)
    assert len({BED.seed, one.seed, other.seed}) == 3


@pytest.fixture(scope="module")
def bed(tmp_path_factory: pytest.TempPathFactory) -> MachineFolder:
    path = tmp_path_factory.mktemp("bed") / "machine"
    steady = replace(BED, air=Air((20.0, 20.0), 0.0, 0.0), sample_s=60.0, plan=replace(BED.plan, drift_every_s=120.0))
    lumped.make_folder(steady, path, 3)
    return read_folder(path)


@pytest.fixture(scope="module")
def prepared(bed: MachineFolder) -> Prepared:
    return prepare(bed, faults="ignore")


def test_the_mean_curve_is_the_mean_of_the_other_campaigns(prepared: Prepared) -> None:
    (states,) = prepared.everything
    _, folds = hold_out(states)
    model = mean_curve(training_states(states, folds[0]))
    samples = states.samples[2].take(states.campaign[states.samples[2].state] == 0)
    predicted, _ = model.predict("DZ", states, samples)
    others = [states.campaign == label for label in (1, 2)]
    curves = [np.interp(samples.elapsed_h, states.elapsed_h[own], states.intercept_um[own, 2]) for own in others]
    assert predicted == pytest.approx(np.mean(curves, axis=0))


def test_every_component_has_its_own_best_three(tmp_path: Path) -> None:
    """Errors that are sums of three readings each: the search finds these."""
    lumped.make_folder(LUMPED["lathe"], tmp_path / "machine", 3)
    (states,) = prepare(read_folder(tmp_path / "machine"), faults="ignore").everything
    assert states.components == ("DX", "DZ")
    wanted = {"DX": ("s04", "s10", "s14"), "DZ": ("s03", "s08", "s16")}
    sums = [states.rise_K[:, [states.sensors.index(name) for name in names]].sum(axis=1) for names in wanted.values()]
    made = replace(states, intercept_um=np.column_stack(sums))
    assert {name: law.inputs for name, law in best_three(made).laws.items()} == wanted


def test_a_row_holds_the_default_and_all_baselines(prepared: Prepared) -> None:
    (row,) = measure("bed", prepared)
    assert {"nothing", "mean_curve", "one_sensor", "best_three", "all_sensors", "default"} <= set(row.models)
    value_um = np.concatenate([samples.value_um for samples in prepared.everything[0].samples])
    assert row.models[NOTHING].rms_um == pytest.approx(np.sqrt(np.mean(value_um**2)))
    apart = measure("bed", prepared, apart=True)
    assert [one.name for one in apart] == ["bed DX", "bed DY", "bed DZ"]
    pooled = np.mean([one.models[DEFAULT].rms_um ** 2 for one in apart])  # as many readings in each direction
    assert row.models[DEFAULT].rms_um == pytest.approx(np.sqrt(pooled))


def test_the_cache_gives_back_what_it_was_given(prepared: Prepared, tmp_path: Path) -> None:
    store.save(tmp_path / "prepared.npz", prepared)
    again: Prepared = store.load(tmp_path / "prepared.npz")
    assert repr(again) == repr(prepared)
    assert again.folder.machine == prepared.folder.machine
    (one,), (other,) = measure("bed", prepared), measure("bed", again)
    assert {name: figures.rms_um for name, figures in one.models.items()} == {
        name: figures.rms_um for name, figures in other.models.items()
    }


def test_the_cache_makes_no_foreign_objects(tmp_path: Path) -> None:
    np.savez(tmp_path / "foreign.npz", tree=np.array('{"class": "subprocess:Popen", "of": {"args": "true"}}'))
    with pytest.raises(ValueError, match="no class of the program"):
        store.load(tmp_path / "foreign.npz")


def figures(rms_um: float, by_component: dict[str, float], coverage: float = 95.0) -> Figures:
    return Figures(100, rms_um, 2 * rms_um, 1.5 * rms_um, coverage, coverage, 2 * rms_um, 1.0, by_component)


def test_the_ratio_is_to_the_best_baseline_of_the_row() -> None:
    models = {
        NOTHING: figures(20.0, {"DX": 10.0, "DY": 30.0}),
        "one_sensor": figures(5.0, {"DX": 2.0, "DY": 8.0}),
        "all_sensors": figures(8.0, {"DX": 4.0, "DY": 6.0}),
        "default": figures(6.0, {"DX": 3.0, "DY": 5.0}),
        "clock": figures(1.0, {"DX": 1.0, "DY": 1.0}),  # no baseline of the ruler: the mean curve stands for it
    }
    row = Row("machine", 5, "campaign", models)
    assert row.best_simple == "one_sensor"
    assert row.ratio() == pytest.approx(1.2)
    assert row.worst_component == ("DX", pytest.approx(1.5))
    assert "| machine | 5 | 20.0 | – | 5.00 | – | 8.00 | 6.00 | 6.00 | 1.20 |" in tables([row])
    assert "0 of 1 rows have a ratio of at most 1.05." in summary([row])


def test_the_page_keeps_what_stands_around_its_table(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"above\n{BEGIN}\nold\n{END}\nbelow\n", encoding="utf-8")
    put_into(page, "new")
    assert page.read_text(encoding="utf-8") == f"above\n{BEGIN}\n\nnew\n\n{END}\nbelow\n"


@pytest.mark.parametrize("text", ["", f"{END}\n{BEGIN}\n", f"{BEGIN}\n{END}\n{BEGIN}\n{END}\n"])
def test_a_page_without_its_two_marks_is_refused(text: str, tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match="once each"):
        put_into(page, "new")
    assert page.read_text(encoding="utf-8") == text

"""What is trained for which axes and sensors, and what happens to an axis that a procedure cannot serve."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rigid_machine import MACHINE as RIGID
from rigid_machine import TOOL_MM, draw_rigid, measure
from slow_column import MACHINE, campaign, folder

from thetacomp.axis_states import axis_states
from thetacomp.campaign import Campaign, CampaignSettings, Drift, MachineFolder
from thetacomp.errors import AnalysisError
from thetacomp.fitting.build import build_document
from thetacomp.fitting.key_point_law import fit_axis
from thetacomp.fitting.procedures import paper_procedure
from thetacomp.fitting.rotations import with_joint_form
from thetacomp.fitting.training import PAPER_METHOD, train
from thetacomp.model.check import problems
from thetacomp.preparation import Prepared, prepare
from thetacomp.separation import Separated, separate_all


def with_drift(seed: int, sd_um: float = 3.0) -> Campaign:
    """A slow column with a drift record of pure noise along X."""
    rng, one = np.random.default_rng(seed), campaign(seed)
    t_s = np.arange(600.0, 11.5 * 3600.0, 1800.0)
    error = np.full((len(t_s), 3), np.nan)
    error[:, 0] = rng.normal(0.0, sd_um, len(t_s))
    return replace(one, drift=Drift(t_s, error))


@pytest.fixture(scope="module")
def column() -> Prepared:
    return prepare(folder(1, 2, 3), faults="ignore")


@pytest.fixture(scope="module")
def beside_drift() -> Prepared:
    return prepare(MachineFolder(MACHINE, tuple(with_drift(seed) for seed in (1, 2, 3))), faults="ignore")


@pytest.mark.parametrize(("axes", "expected"), [(None, {"Y", ""}), ((), set()), (("Y",), {"Y"}), (("",), {""})])
def test_heat_history_is_fitted_for_the_axes_asked_for(
    axes: tuple[str, ...] | None, expected: set[str], beside_drift: Prepared
) -> None:
    trained = train(beside_drift, axes, lost=())
    assert set(trained.model.prediction) == expected
    assert set(trained.model.control) == {"Y", ""}
    for name, law in trained.model.prediction.items():
        (states,) = (one for one in beside_drift.training if one.axis == name)
        travel = (states.p0_mm, states.p_min_mm, states.p_max_mm) if name else (None, None, None)
        assert (law.axis, (law.p0_mm, law.p_min_mm, law.p_max_mm)) == (name, travel)
    assert problems(trained.model) == []


@pytest.mark.parametrize(("lost", "history", "static"), [((), (), 0), (("b",), ("b",), 1), (None, ("a", "b"), 1)])
def test_fallbacks_are_fitted_for_the_sensors_asked_for(
    lost: tuple[str, ...] | None, history: tuple[str, ...], static: int, column: Prepared
) -> None:
    model = train(column, lost=lost).model
    assert tuple(one.lost for one in model.prediction["Y"].fallbacks) == history
    assert min(len(model.control["Y"].fallbacks), 1) == static


def test_both_models_say_what_they_are(column: Prepared) -> None:
    trained = train(column, lost=())
    assert (trained.paper_model.method, trained.paper_model.prediction) == (PAPER_METHOD, {})
    assert trained.paper_model.training.campaigns == trained.model.training.campaigns == ("c1", "c2", "c3")
    assert len(trained.paper_model.control["Y"].layout.sensors) == 1
    told = repr(trained)
    assert told.startswith("Trained on c1, c2, c3: slow column, 1 components, separate form\n")
    assert f"key points of axis Y: {', '.join(trained.fitted[0][1].inputs)}" in told
    assert told.endswith("heat history: Y")
    assert repr(train(column, axes=(), lost=())).endswith("heat history: no axis")


def test_an_axis_that_the_paper_cannot_serve_is_left_out_of_its_model_alone() -> None:
    """A drift of nothing correlates with no sensor, so the paper's way finds none for it."""
    beside_rest = prepare(MachineFolder(MACHINE, tuple(with_drift(seed, 0.0) for seed in (1, 2, 3))), faults="ignore")
    trained = train(beside_rest, axes=(), lost=())
    assert (set(trained.model.control), set(trained.paper_model.control)) == ({"Y", ""}, {"Y"})
    (drift,) = (states for states in beside_rest.training if states.is_drift)
    with pytest.raises(AnalysisError, match=r"axis drift: no sensor correlates with any parameter\."):
        paper_procedure(MACHINE)(drift)
    (axis,) = (states for states in beside_rest.training if not states.is_drift)
    model = paper_procedure(MACHINE)(axis)
    assert len(model.inputs) == 1
    assert model.key_points is not None


@pytest.fixture(scope="module")
def rigid() -> tuple[MachineFolder, Separated]:
    rng = np.random.default_rng(11)
    machine = draw_rigid(rng)
    campaigns = [measure(machine, rng, name, angle_sd_urad=1.0, rounds=4, targets=5) for name in "ab"]
    return MachineFolder(RIGID, tuple(campaigns)), separate_all(RIGID, campaigns)


def test_the_joint_form_brings_the_tool_and_the_angles(rigid: tuple[MachineFolder, Separated]) -> None:
    given, separated = rigid
    assert separated.form == "joint"
    fitted = [(states, fit_axis(states, ("t1",))) for states in axis_states(given, separated.components, "ab")]
    plain = build_document(given, fitted, "test", "ab")
    document = with_joint_form(plain, given, separated, fitted, "ab")
    assert (document.form, document.tool_length_mm) == ("joint", TOOL_MM)
    assert set(document.rotations) == {"", "X", "Y", "W"}
    for axis, law in document.rotations.items():
        assert law.layout.sensors == ("t1",)
        assert law.border == document.control[axis].border
        assert set(law.components) == ({"DA", "DB", "DC"} if not axis else {f"E{d}{axis}" for d in "ABC"})
        for component in law.components.values():
            assert "[µrad;" in component.equation
            assert "[µm;" not in component.equation
    # an angle whose states carry no law is left out, the others stay; in the separate form there are none at all
    short = tuple(
        replace(one, intercept_um=np.full_like(one.intercept_um, np.nan)) if one.axis == "Y" else one
        for one in separated.angles
    )
    rest = with_joint_form(plain, given, replace(separated, angles=short), fitted, "ab")
    assert set(rest.rotations) == {"", "X", "W"}
    assert with_joint_form(plain, given, replace(separated, angles=()), fitted, "ab").rotations == {}
    assert with_joint_form(plain, given, replace(separated, form="separate"), fitted, "ab") == plain


def test_the_tool_of_the_first_training_campaign_is_that_of_the_model(rigid: tuple[MachineFolder, Separated]) -> None:
    given, separated = rigid
    longer = CampaignSettings(tool_length_mm=350.0, reference_s=2400.0)
    given = replace(given, campaigns=(given.campaigns[0], replace(given.campaigns[1], settings=longer)))
    fitted = [(states, fit_axis(states, ("t1",))) for states in axis_states(given, separated.components, "ab")]
    for train_on, expected in (("ab", TOOL_MM), ("ba", 350.0)):
        plain = build_document(given, fitted, "test", train_on)
        assert with_joint_form(plain, given, separated, fitted, train_on).tool_length_mm == expected

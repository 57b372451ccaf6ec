"""The spine of a verification on small runs: what is compared, from which size on, scaled by what, and said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rigid_machine
from rigid_machine import P0_MM
from small_models import component, document, nothing_predicts, term
from verification_runs import ANGLE_SD_URAD, AXES, LAW, Run, rises_K, true_model, write_folder

from thetacomp.axis_states import axis_states
from thetacomp.campaign import Campaign, MachineFolder, SweepPoints
from thetacomp.errors import AnalysisError
from thetacomp.machine import WantedLength
from thetacomp.model.document import ModelDocument
from thetacomp.reading import read_folder
from thetacomp.separation import separate_campaign
from thetacomp.verification import VerificationResult, verify_folder
from thetacomp.verification.expected_error import expected_from_fit, expected_from_model

ROUNDS = 5


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> MachineFolder:
    """Only the sweeps of X and Y of the known mill, off and on; on has 0.8 of the heat."""
    runs = [Run("off", rounds=ROUNDS), Run("on", "on", heat=0.8, share=1.0, rounds=ROUNDS)]
    read = read_folder(write_folder(tmp_path_factory.mktemp("m") / "m", runs))
    return replace(read, campaigns=tuple(only(c, ("X", "Y")) for c in read.campaigns))


def only(campaign: Campaign, axes: tuple[str, ...]) -> Campaign:
    points = campaign.sweeps
    assert points is not None
    return replace(campaign, sweeps=taken(points, np.isin(np.array(points.axis), axes)))


def taken(points: SweepPoints, rows: np.ndarray) -> SweepPoints:
    return replace(
        points, t_s=points.t_s[rows], axis=tuple(np.array(points.axis)[rows].tolist()), sweep=points.sweep[rows],
        position_mm=points.position_mm[rows], direction=points.direction[rows], error_um=points.error_um[rows],
    )  # fmt: skip


def changed(folder: MachineFolder, name: str, **settings: object) -> MachineFolder:
    def one(campaign: Campaign) -> Campaign:
        return replace(campaign, settings=campaign.settings.model_copy(update=settings))

    return replace(folder, campaigns=tuple(one(c) if c.name == name else c for c in folder.campaigns))


@pytest.fixture(scope="module")
def result(folder: MachineFolder) -> VerificationResult:
    return verify_folder(folder, ["off"], ["on"], true_model())


def expected_um(component: str, heat: float) -> float:
    """The largest error that the law gives over the run: at an end of the travel, at the warmest sweep."""
    intercept, slope = LAW[component]
    half_m = {"X": 1.0, "Y": 1.5}[component[2]]
    t_s = 3600.0 * np.arange(1, ROUNDS) + (900.0 if component[2] == "Y" else 0.0) + 60.0
    rise = rises_K(t_s, heat)[{"X": "tx", "Y": "ty"}[component[2]]].max()
    return float((abs(intercept) + abs(slope) * half_m) * rise)


def test_what_is_compared_and_where_it_stands(result: VerificationResult) -> None:
    names = [f"E{d}{a}" for a in "XY" for d in "XYZ"]
    assert [row.component for row in result.rows] == [*names, "column_X", "column_Z"]
    assert [line.component for line in result.states_off] == ["column_X", "column_Z", *names]
    for line, other in zip(result.states_off, result.states_on, strict=True):
        assert line.component == other.component
        assert np.median(line.largest_um) > 2.0 * np.median(other.largest_um)
    assert result.pattern == "model of 2026-03-02"
    assert result.go, result.causes
    # One drawn scatter for every component, the same in every call.
    assert result.heat_ratio == pytest.approx(0.8, abs=0.02)


def test_the_largest_size_of_each_component_is_that_of_the_law(result: VerificationResult) -> None:
    for share in result.shares:
        if share.part == "all":
            assert share.size_um == pytest.approx(expected_um(share.component, 0.8), rel=0.05)
            assert share.material == (share.size_um >= 0.1 * max(expected_um(c, 1.0) for c in LAW if c[2] != "W"))


def test_harm_is_allowed_up_to_a_quarter_of_the_largest_error_of_its_direction(result: VerificationResult) -> None:
    for one in result.harm:
        largest = max(expected_um(f"E{one.component[1]}{axis}", 1.0) for axis in "XY")
        assert one.limit_um == pytest.approx(0.25 * largest, rel=0.08)


@pytest.mark.parametrize("name", ["off", "on"])
def test_a_coarse_instrument_of_either_run_raises_what_can_be_judged(folder: MachineFolder, name: str) -> None:
    coarse = verify_folder(changed(folder, name, instrument_u_um=60.0), ["off"], ["on"], true_model())
    material = {share.component for share in coarse.shares if share.material and share.part == "all"}
    # A point at the far end of the travel is known to the stated 60 µm and 3 µm a metre.
    known_um = {axis: 60.0 + 2 * ANGLE_SD_URAD * AXES[axis][1] / 1000.0 for axis in "XY"}
    assert material == {c for c in LAW if c[2] != "W" and expected_um(c, 0.8) > known_um[c[2]]}
    assert expected_um("EXX", 0.8) > 60.0
    assert "EXX" not in material
    assert {"EXY", "EZY"} <= material < {c for c in LAW if c[2] != "W"}
    assert all(one.limit_um >= known_um[one.component[2]] for one in coarse.harm)
    assert not any("instrument_u_um" in note for note in coarse.notes)


def test_what_nobody_stated_is_said(folder: MachineFolder, result: VerificationResult) -> None:
    assert not any("operating mode" in note or "instrument_u_um" in note for note in result.notes)
    silent = changed(folder, "on", instrument_u_um=None)
    notes = verify_folder(silent, ["off"], ["on"], true_model()).notes
    assert sum("instrument_u_um" in note for note in notes) == 1
    model = true_model()
    model = model.model_copy(update={"training": model.training.model_copy(update={"mode": ""})})
    for name in ("off", "on"):
        silent = changed(silent, name, mode="")
    assert any(
        "no campaign states its operating mode" in n for n in verify_folder(silent, ["off"], ["on"], model).notes
    )


def test_a_wrong_sign_that_no_component_shows_alone_is_named_from_all_of_them(tmp_path: Path) -> None:
    """Four sweeps that scatter by a quarter of the error: the interval of most shares holds 0 as well as -1."""
    runs = [Run("off", rounds=5, rest_um=20.0), Run("on", "on", 0.9, share=-1.0, rounds=5, rest_um=20.0)]
    result = verify_folder(read_folder(write_folder(tmp_path / "m", runs)), ["off"], ["on"], true_model())
    whole = [share for share in result.shares if share.part == "all"]
    assert sum(share.high - share.low > 1.0 for share in whole) >= 6
    (group,) = result.pooled
    assert group.kind == "reversed"
    assert group.low < -1.0 < group.high < -0.1
    (cause,) = result.causes
    assert (cause.kind, set(cause.components)) == ("reversed", set(LAW))
    assert "all together -0." in cause.text


def test_the_steps_are_told_as_they_begin(folder: MachineFolder) -> None:
    told: list[str] = []
    verify_folder(folder, ["off"], ["on"], true_model(), told.append)
    assert told == [
        "screening temperatures", "separating geometry and heat",
        "relating temperatures and error with compensation off", "comparing off and on",
    ]  # fmt: skip


def test_what_only_one_run_measured_is_named_and_left_out(folder: MachineFolder) -> None:
    off, on = folder.campaigns
    one = replace(folder, campaigns=(only(off, ("X",)), on))
    result = verify_folder(one, ["off"], ["on"], true_model())
    assert {row.component for row in result.rows} == {"EXX", "EYX", "EZX"}
    assert "EXY, EYY, EZY: not measured in all campaigns of both runs; not compared" in result.notes
    assert not any("no heated state" in note for note in result.notes)
    with pytest.raises(AnalysisError, match="the two runs share no error component"):
        verify_folder(replace(folder, campaigns=(only(off, ("X",)), only(on, ("Y",)))), ["off"], ["on"], true_model())


def test_an_empty_campaign_and_one_without_heat_are_refused(folder: MachineFolder) -> None:
    off, on = folder.campaigns
    for pair in ((off, replace(on, sweeps=None)), (replace(off, sweeps=None), on)):
        with pytest.raises(AnalysisError, match=r"campaign (on|off): there are no sweeps, parameters or drift"):
            verify_folder(replace(folder, campaigns=pair), ["off"], ["on"], true_model())
    assert on.sweeps is not None
    silent = replace(on, sweeps=replace(on.sweeps, error_um=np.full_like(on.sweeps.error_um, np.nan)))
    with pytest.raises(AnalysisError, match="campaign on holds no sweeps, parameters or drift"):
        verify_folder(replace(folder, campaigns=(off, silent)), ["off"], ["on"], true_model())
    cold = replace(on, sweeps=taken(on.sweeps, on.sweeps.t_s < 3600.0))
    with pytest.raises(AnalysisError, match="neither run has heated states"):
        verify_folder(replace(folder, campaigns=(off, cold)), ["off"], ["on"], true_model())


def test_a_component_of_one_run_that_nothing_explains_is_compared_as_measured(folder: MachineFolder) -> None:
    """The model knows no X: no expected error there, so the size of harm in X comes from what was measured."""
    model = true_model()
    only_y = model.model_copy(update={"control": {"Y": model.control["Y"]}})
    result = verify_folder(folder, ["off"], ["on"], only_y)
    rows = {row.component: row.of("max") for row in result.rows}
    assert np.isnan(rows["EXX"].like_before_um)
    assert np.isfinite(rows["EXY"].like_before_um)
    assert {one.component for one in result.harm} == {"EXY", "EYY", "EZY"}
    assert {share.component for share in result.shares} == {"EXY", "EYY", "EZY"}
    measured = rows["EYX"].before_um
    limit = next(one.limit_um for one in result.harm if one.component == "EYY")
    assert limit == pytest.approx(0.25 * max(measured, expected_um("EYY", 1.0)), rel=0.08)


# --- the pattern of a stored model ------------------------------------------------------------------------------------


def pattern(
    folder: MachineFolder, model_update: dict[str, object]
) -> tuple[list[np.ndarray], list[np.ndarray], object]:
    """Expected intercepts and slopes of the axis X by the known model, and its states."""
    separations = [s for c in folder.campaigns for s in separate_campaign(folder.machine, c)]
    states = axis_states(folder, separations, ["off", "on"])[0]
    expected, notes = expected_from_model(true_model().model_copy(update=model_update), folder, states, separations)
    assert notes == ()
    return [e.intercept_um for e in expected], [e.slope_um_per_m for e in expected], states


@pytest.mark.parametrize(
    "update",
    [
        {},
        {"length": WantedLength(wanted="workpiece", workpiece_expansion_per_K=11.5e-6, workpiece_sensor="hall")},
    ],
)
def test_the_pattern_of_a_model_is_its_law_less_its_value_over_the_cold_block(
    folder: MachineFolder, update: dict[str, object]
) -> None:
    """Closed form: (a + b u) of the law times the rise of the drive's sensor since the cold sweeps.

    What length is wanted changes nothing: the tracker measures true metres.
    """
    intercepts, slopes, states = pattern(folder, update)
    for k, name in enumerate(("EXX", "EYX", "EZX")):
        samples = states.samples[k]  # type: ignore[attr-defined]
        rise = rises_K(samples.elapsed_h * 3600.0 + 315.0, 1.0)["tx"]
        heat = np.where(np.array(states.campaigns)[states.campaign[samples.state]] == "on", 0.8, 1.0)  # type: ignore[attr-defined]
        warm = rise > 1.0
        assert np.count_nonzero(warm) > 50
        ratio = intercepts[k][warm] / (heat * rise)[warm]
        assert np.median(ratio) == pytest.approx(LAW[name][0], rel=0.03)
        assert np.abs(ratio - LAW[name][0]).max() < 0.1 * abs(LAW[name][0])
        np.testing.assert_allclose(slopes[k][warm], intercepts[k][warm] * LAW[name][1] / LAW[name][0], rtol=1e-6)


def joint(**changes: float) -> ModelDocument:
    """A joint model of the rigid machine: 5 µm/K of drift in Z; Z leans with X, Y, W by 8, 3 and -6 µm/m a kelvin."""
    t1 = {"t1": 20.0}
    parts = {"DZ": component("DZ", term(0.0, 5.0), None, t1, through_zero=True)}
    for axis, slope in {"X": 8.0, "Y": 3.0, "W": -6.0, **changes}.items():
        low, high = rigid_machine.AXES[rigid_machine.NAMES.index(axis)].travel_mm
        for direction in "XYZ":
            name, own = f"E{direction}{axis}", slope if direction == "Z" else 0.0
            parts[name] = component(name, term(0.0, 0.0), term(0.0, own), t1, p=(P0_MM[axis], low, high))
    for direction in "XY":
        parts[f"D{direction}"] = component(f"D{direction}", term(0.0, 0.0), None, t1)
    made = document({a.name: a.direction for a in rigid_machine.AXES}, parts, {"t1": (0.0, 10.0)})
    return made.model_copy(update={"form": "joint", "tool_length_mm": rigid_machine.TOOL_MM})


@pytest.mark.parametrize("written_down", [True, False])
def test_a_joint_model_expects_the_drift_and_the_tilt_of_the_other_axes_where_they_stood(written_down: bool) -> None:
    """Closed form at P0 of X: 5 µm/K of drift and 3 · (y - P0) - 6 · (w - P0); W was moved on by 100 mm after 3 h.

    Where nobody wrote the positions down the others count as standing at P0.
    """
    rigid = rigid_machine.draw_rigid(np.random.default_rng(1))
    campaign = rigid_machine.measure(rigid, np.random.default_rng(1), "a", at=written_down)
    points = campaign.sweeps
    assert points is not None
    later = 3.0 * 3600.0
    at_mm = {n: np.where((points.t_s > later) & (n == "W"), p + 100.0, p) for n, p in points.at_mm.items()}
    campaign = replace(campaign, sweeps=replace(points, at_mm=at_mm))
    whole = MachineFolder(rigid_machine.MACHINE, (campaign,))
    separations = separate_campaign(whole.machine, campaign)
    states = next(s for s in axis_states(whole, separations, ["a"]) if s.axis == "X")
    expected, _ = expected_from_model(joint(), whole, states, separations)
    k = states.components.index("EZX")
    samples = states.samples[k]
    own = next(s for s in separations if s.component == "EZX")
    t_s = 3600.0 * samples.elapsed_h + float(own.zero_t_s.mean())
    rise_K = campaign.temperatures.at(t_s)[:, 0] - 20.0
    standing = rigid_machine.STAND_MM
    w_mm = np.where(t_s > later, standing["W"] + 100.0, standing["W"])
    tilt = 3.0 * (standing["Y"] - P0_MM["Y"]) / 1000.0 - 6.0 * (w_mm - P0_MM["W"]) / 1000.0
    np.testing.assert_allclose(expected[k].intercept_um, rise_K * (5.0 + (tilt if written_down else 0.0)), atol=1e-6)
    np.testing.assert_allclose(expected[k].slope_um_per_m, rise_K * 8.0, atol=1e-6)
    x = states.components.index("EXX")
    np.testing.assert_allclose(expected[x].intercept_um, 0.0, atol=1e-9)


def test_what_a_law_leaves_of_unseen_data_comes_with_what_it_expects(folder: MachineFolder) -> None:
    """A model states it, and a fit to one campaign cannot know it."""
    separations = [s for c in folder.campaigns for s in separate_campaign(folder.machine, c)]
    states = axis_states(folder, separations, ["off", "on"])[0]
    model = true_model()
    law = model.control["X"]
    stated = {"EXX": law.components["EXX"].model_copy(update={"held_out_um": (7.0, 8.0, 9.0)})}
    law = law.model_copy(update={"components": law.components | stated})
    expected, _ = expected_from_model(model.model_copy(update={"control": {"X": law}}), folder, states, separations)
    assert [(one.left_um, one.campaigns) for one in expected] == [(7.0, 1), (0.0, 1), (0.0, 1)]
    one, _ = expected_from_fit(folder, states, ["off"])
    assert [(found.left_um, found.campaigns) for found in one] == [(0.0, 1)] * 3


def test_two_campaigns_of_different_law_foretell_each_other_wrongly_by_the_difference(tmp_path: Path) -> None:
    """The second gives 1.3 times the error of the first per kelvin: each misses 0.3 times that of the first."""
    first = Run("a", rest_um=0.5, rounds=ROUNDS)
    second = replace(first, name="b", law=lambda _, t_h: 1.3 + 0.0 * t_h)
    folder = read_folder(write_folder(tmp_path / "m", [first, second]))
    separations = [s for c in folder.campaigns for s in separate_campaign(folder.machine, c)]
    states = next(s for s in axis_states(folder, separations, ["a", "b"]) if s.axis == "Y")
    expected, _ = expected_from_fit(folder, states, ["a", "b"])
    for one, samples in zip(expected, states.samples, strict=True):
        heated = ~states.cold[samples.state]
        factor = np.where(states.campaign[samples.state] == 0, 1.0, 1.3)
        missed_um = 0.3 * np.sqrt(np.mean((samples.value_um / factor)[heated] ** 2))
        assert one.campaigns == 2
        assert one.left_um == pytest.approx(missed_um, rel=0.2)


def test_what_a_model_does_not_predict_has_no_pattern_and_is_named(folder: MachineFolder) -> None:
    """EYX has no inputs, EZX is unknown: both are NaN at every sample."""
    travel_mm = AXES["X"][1]
    blind = nothing_predicts("EYX", p=(travel_mm / 2, 0.0, travel_mm))
    separations = [s for c in folder.campaigns for s in separate_campaign(folder.machine, c)]
    states = axis_states(folder, separations, ["off", "on"])[0]
    expected, notes = expected_from_model(true_model(("EZX",), EYX=blind), folder, states, separations)
    assert [bool(np.isfinite(e.intercept_um).all()) for e in expected] == [True, False, False]
    assert [note.split(":")[0] for note in notes] == ["EYX", "EZX"]
    assert np.isnan([*expected[1].intercept_um, *expected[1].slope_um_per_m]).all()


def test_a_fit_to_the_run_off_does_not_look_at_the_run_on(folder: MachineFolder) -> None:
    """The machine's law comes back from the off run, whatever is added to the other one."""
    off, on = folder.campaigns
    points = on.sweeps
    assert points is not None
    spoilt = replace(
        folder, campaigns=(off, replace(on, sweeps=replace(points, error_um=3.0 * points.error_um + 50.0)))
    )
    found = []
    for one in (folder, spoilt):
        separations = [s for c in one.campaigns for s in separate_campaign(one.machine, c)]
        states = axis_states(one, separations, ["off", "on"])[1]
        expected, notes = expected_from_fit(one, states, ["off"])
        assert notes == ()
        found.append(expected)
        k = states.components.index("EXY")
        samples = states.samples[k]
        rise = rises_K(samples.elapsed_h * 3600.0 + 900.0 + 315.0, 1.0)["ty"]
        heat = np.where(np.array(states.campaigns)[states.campaign[samples.state]] == "on", 0.8, 1.0)
        warm = rise > 2.0
        assert np.median(expected[k].intercept_um[warm] / (heat * rise)[warm]) == pytest.approx(LAW["EXY"][0], rel=0.12)
        assert np.median(expected[k].slope_um_per_m[warm] / (heat * rise)[warm]) == pytest.approx(
            LAW["EXY"][1], rel=0.12
        )
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one.intercept_um, other.intercept_um, atol=1e-9)
        np.testing.assert_allclose(one.slope_um_per_m, other.slope_um_per_m, atol=1e-9)


def test_a_run_off_that_no_sensor_explains_says_so(folder: MachineFolder) -> None:
    """Two heated sweeps cannot carry a fit; and errors without any heat in them have no sensor."""
    separations = [s for c in folder.campaigns for s in separate_campaign(folder.machine, c)]
    states = axis_states(folder, separations, ["off", "on"])[0]
    few = states.take(np.flatnonzero((states.campaign == 1) | (states.t_s < 4000.0)))
    expected, (note,) = expected_from_fit(folder, few, ["off"])
    assert note.startswith("axis X: ")
    assert all(np.isnan(e.intercept_um).all() and np.isnan(e.slope_um_per_m).all() for e in expected)

"""Heat that bends a component: parabolas in separation, states, heat history, prediction and volume, against truth."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import known_machine
import numpy as np
import pytest
import rigid_machine
from known_machine import measured_campaign
from rigid_machine import P0_MM, STAND_MM, draw_rigid, measure
from scipy import stats
from slow_column import LAG_S, MACHINE, NOISE_UM, folder

from thetacomp.analysis import analyze_folder
from thetacomp.analysis_result import AnalysisResult
from thetacomp.arrays import Floats
from thetacomp.axis_states import axis_states
from thetacomp.campaign import Campaign, MachineFolder
from thetacomp.files import write_files
from thetacomp.fitting.build import build_document
from thetacomp.fitting.calibrated import calibrated_history
from thetacomp.fitting.key_point_law import fit_axis
from thetacomp.fitting.rotations import with_joint_form
from thetacomp.model.axis_chain import chain_of
from thetacomp.model.check import problems
from thetacomp.model.document import ModelDocument
from thetacomp.model.filters import run_filters
from thetacomp.model.load import load_model
from thetacomp.model.prediction import predict
from thetacomp.model.volume import Part, ThermalParts, volume_error
from thetacomp.model.volumetric import predict_volume
from thetacomp.report.analysis_files import table_files
from thetacomp.separation import ComponentSeparation, separate_all, separate_campaign
from thetacomp.separation.component import mean_square_m2
from thetacomp.separation.form_choice import bent_components
from thetacomp.verification.expected_error import expected_from_model


@dataclass(frozen=True)
class Rows:
    t_s: Floats
    axis: tuple[str, ...]
    position_mm: Floats


def bend(campaign: Campaign, direction: int, value_um: Floats) -> Campaign:
    """The campaign with something added to one direction of its sweep points."""
    assert campaign.sweeps is not None
    error = campaign.sweeps.error_um.copy()
    error[:, direction] += value_um
    return replace(campaign, sweeps=replace(campaign.sweeps, error_um=error))


def bent_campaign(rng: np.random.Generator, um_per_m2: float, name: str = "warm-up") -> tuple[Campaign, object]:
    """A known machine whose error in X bends by `um_per_m2` times the warmth; Y and Z stay lines."""
    campaign, truth = measured_campaign(rng)
    points = campaign.sweeps
    assert points is not None
    lever_m = (points.position_mm - 1500.0) / 1000.0
    return replace(bend(campaign, 0, um_per_m2 * truth.warmth(points.t_s) * lever_m**2), name=name), truth


# ------------------------------------------------------------------------------------------------- separation
def test_stated_intervals_of_bent_sweeps_cover_the_truth() -> None:
    """50 random machines, 3 directions, 8 hot states each, known truth: 95 % intervals of I, S, C hold 93 to 97 %."""
    rng = np.random.default_rng(5)
    inside: dict[str, list[bool]] = {"I": [], "S": [], "C": []}
    for _ in range(50):
        size = float(rng.uniform(-40, 40))
        campaign, truth = measured_campaign(rng)
        points = campaign.sweeps
        assert points is not None
        curve_um = size * truth.warmth(points.t_s) * ((points.position_mm - 1500.0) / 1000.0) ** 2
        for direction in range(3):
            campaign = bend(campaign, direction, curve_um)
        for direction, s in enumerate(separate_campaign(known_machine.MACHINE, campaign, ("EXY", "EYY", "EZY"))):
            assert s.bend_um_per_m2 is not None
            assert s.bend_se_um_per_m2 is not None
            hot, wide = ~s.cold, stats.t.ppf(0.975, s.dof)
            for name, value, se, true in (
                ("I", s.intercept_um, s.intercept_se_um, truth.intercept(s.t_s, direction)),
                ("S", s.slope_um_per_m, s.slope_se_um_per_m, truth.slope(s.t_s, direction)),
                ("C", s.bend_um_per_m2, s.bend_se_um_per_m2, size * truth.warmth(s.t_s)),
            ):
                inside[name] += (np.abs(value - true)[hot] <= wide * se[hot]).tolist()
    assert all(0.93 <= np.mean(hits) <= 0.97 for hits in inside.values()), {k: np.mean(v) for k, v in inside.items()}


def test_bent_where_most_campaigns_say_so_and_in_all_campaigns_alike() -> None:
    rng = np.random.default_rng(3)
    campaigns = [bent_campaign(rng, size, name)[0] for size, name in ((25.0, "a"), (-20.0, "b"), (0.0, "c"))]
    found = separate_all(known_machine.MACHINE, campaigns)
    assert [s.component for s in found.components if s.bend_um_per_m2 is not None] == ["EXY"] * 3
    (note,) = (note for note in found.notes if "parabolas" in note)
    # closed form: 25 µm/m² times (1.5 m)², and the RMS of the warmth over the hot sweeps is 0.8 to 0.95
    size_um = float(re.findall(r"by (\d+) µm", note)[0])
    assert 0.75 * 56.0 < size_um < 56.0
    # where the bend is fitted nothing is left that a further change of shape would explain
    assert all(s.linearity is not None and s.linearity.holds for s in found.components)


@pytest.mark.parametrize("sizes", [(25.0, 0.0), (25.0, 0.0, 0.0), (0.0, 0.0, 0.0)])
def test_half_of_the_campaigns_are_not_enough(sizes: tuple[float, ...]) -> None:
    rng = np.random.default_rng(4)
    campaigns = [bent_campaign(rng, size, f"c{k}")[0] for k, size in enumerate(sizes)]
    found = separate_all(known_machine.MACHINE, campaigns)
    assert all(s.bend_um_per_m2 is None for s in found.components)
    assert not any("parabolas" in note for note in found.notes)


def test_few_positions_never_make_a_bend() -> None:
    rng = np.random.default_rng(4)
    campaign, _ = bent_campaign(rng, 25.0)
    (s, *_) = separate_campaign(known_machine.MACHINE, campaign)
    assert s.points is not None
    assert bent_components([s]) == ("EXY",)
    few = replace(s, points=replace(s.points, position_mm=np.round(s.points.position_mm / 1000.0) * 1000.0))
    assert bent_components([few]) == ()


def test_the_mean_bend_does_not_hide_in_the_geometry() -> None:
    """Only the heated sweeps bend, so the geometry is that of the same machine without heat (its own noise aside)."""
    rng = np.random.default_rng(8)
    away = []
    for _ in range(10):
        seed = int(rng.integers(1 << 30))
        plain, _ = bent_campaign(np.random.default_rng(seed), 0.0)
        bent, _ = bent_campaign(np.random.default_rng(seed), 30.0)
        curves = [separate_campaign(known_machine.MACHINE, c, ("EXY",))[0].geometry[0].value_um for c in (plain, bent)]
        away.append(np.abs(curves[1] - curves[0]).max())
    assert np.median(away) < 0.5


def test_another_p0_changes_intercept_and_slope_and_no_prediction() -> None:
    rng = np.random.default_rng(6)
    first, second = (bent_campaign(rng, 25.0, name)[0] for name in "ab")
    folder = MachineFolder(known_machine.MACHINE, (first, second))
    separations = separate_all(known_machine.MACHINE, folder.campaigns).components
    moved = [_about(s, s.p0_mm + 400.0) if s.campaign == "b" else s for s in separations]
    (plain,), (shifted,) = (axis_states(folder, some, "ab") for some in (separations, moved))
    for name in ("intercept_um", "slope_um_per_m", "bend_um_per_m2"):
        assert np.allclose(getattr(plain, name), getattr(shifted, name), atol=1e-9)


def _about(s: ComponentSeparation, p0_mm: float) -> ComponentSeparation:
    """The same curves about another P0, from their values at three positions."""
    position = np.array([0.0, 1500.0, 3000.0])
    fits = np.array([np.polyfit((position - p0_mm) / 1000.0, s.line_um(k, position), 2) for k in range(len(s.t_s))])
    bends = None if s.bend_um_per_m2 is None else fits[:, 0]
    return replace(s, p0_mm=p0_mm, intercept_um=fits[:, 2], slope_um_per_m=fits[:, 1], bend_um_per_m2=bends)


def test_a_law_without_bends_is_fitted_to_the_best_lines() -> None:
    rng = np.random.default_rng(6)
    campaigns = tuple(bent_campaign(rng, 25.0, name)[0] for name in "ab")
    folder = MachineFolder(known_machine.MACHINE, campaigns)
    separations = separate_all(known_machine.MACHINE, campaigns).components
    (states,) = axis_states(folder, separations, "ab")
    # another program: the line of numpy.polyfit through the parabola over the travel
    fine = np.linspace(0.0, 3000.0, 3001)
    own = [s for s in separations if s.component == "EXY"]
    lines = [np.polyfit((fine - 1500.0) / 1000.0, s.line_um(k, fine), 1) for s in own for k in range(len(s.t_s))]
    assert np.allclose(states.line_intercept_um[:, 0], np.array(lines)[:, 1], atol=0.02)
    assert np.allclose(np.concatenate([s.line_intercept_um for s in own]), states.line_intercept_um[:, 0])
    model = fit_axis(states, ("t1",))
    expected = fit_axis(
        replace(states, intercept_um=states.line_intercept_um, bend_um_per_m2=np.zeros((18, 3))), ("t1",)
    )
    assert np.allclose(model.regressions["EXY"].coef_, expected.regressions["EXY"].coef_)
    assert mean_square_m2(0.0, -1000.0, 1000.0) == pytest.approx(1.0 / 3.0)


# ------------------------------------------------------------------------------------------------ joint form
BEND_UM_PER_M2 = np.array([60.0, -35.0])  # of EXY for the two warmths: 37 µm at the ends of 1.6 m at full warmth


def bent_rigid(seed: int, name: str, tau_s: tuple[float, float]) -> tuple[Campaign, rigid_machine.Rigid]:
    """A rigid machine of known errors whose column bends: the tool moves in X with the square of Y, wherever Y is."""
    rigid = replace(draw_rigid(np.random.default_rng(seed), turning=False), tau_s=tau_s)
    campaign = measure(rigid, np.random.default_rng([seed, ord(name)]), name, rounds=12, point_sd_um=1.0)
    points = campaign.sweeps
    assert points is not None
    y_mm = np.where(np.array(points.axis) == "Y", points.position_mm, points.at_mm["Y"])
    u_m = (y_mm - P0_MM["Y"]) / 1000.0
    return bend(campaign, 0, rigid.warmth(points.t_s) @ BEND_UM_PER_M2 * u_m**2), rigid


def test_the_bend_of_a_standing_axis_is_taken_off_the_sweeps_of_the_others() -> None:
    campaigns, rigids = zip(*(bent_rigid(5, n, (6000.0, t)) for n, t in (("a", 9e3), ("b", 16e3))), strict=True)
    found = separate_all(rigid_machine.MACHINE, campaigns)
    assert found.form == "joint"
    assert {s.component for s in found.components if s.bend_um_per_m2 is not None} == {"EXY"}
    for campaign, rigid in zip(campaigns, rigids, strict=True):
        own = {s.component: s for s in found.components if s.campaign == campaign.name}
        exy, dx = own["EXY"], own["DX"]
        assert exy.bend_um_per_m2 is not None
        true = rigid.warmth(exy.t_s) @ BEND_UM_PER_M2
        assert np.abs(exy.bend_um_per_m2 - true)[~exy.cold].max() < 4.0
        drift = np.array([rigid.thermal(P0_MM, t)[0] for t in dx.t_s])
        # Y stands 300 mm off P0: up to 2 µm of bend would be in the drift that the sweeps of X and W see.
        assert np.sqrt(np.mean((dx.intercept_um - drift)[~dx.cold] ** 2)) < 1.3
        assert exy.points is not None
        assert np.abs(exy.points.line_um).max() > 20.0
        assert np.sqrt(np.mean(exy.points.residual_um**2)) < 1.5


def joint_model() -> tuple[ModelDocument, MachineFolder, tuple[ComponentSeparation, ...]]:
    taus = ((4000.0, 16000.0), (9000.0, 11000.0), (6000.0, 20000.0))
    campaigns = tuple(bent_rigid(5, name, tau)[0] for name, tau in zip("abc", taus, strict=True))
    whole = MachineFolder(rigid_machine.MACHINE, campaigns)
    separated = separate_all(rigid_machine.MACHINE, campaigns)
    states = axis_states(whole, separated.components, "abc")
    fitted = [(s, fit_axis(s, ("t1", "t2"))) for s in states]
    document = build_document(whole, fitted, "test", "abc", history=[calibrated_history(s).document for s in states])
    return with_joint_form(document, whole, separated, fitted, "abc"), whole, separated.components


def test_a_bent_column_is_predicted_anywhere() -> None:
    """Random positions of all axes against the exact transforms plus the known bend."""
    model, _, _ = joint_model()
    campaign, rigid = bent_rigid(5, "d", (5000.0, 14000.0))
    rng = np.random.default_rng(0)
    t_s = np.sort(rng.uniform(rigid_machine.REFERENCE_S + 600.0, 39000.0, 80))
    positions = {a.name: rng.uniform(*a.travel_mm, 80) for a in rigid_machine.AXES}
    found = predict_volume(model, campaign.temperatures, t_s, positions)
    u_m = (positions["Y"] - P0_MM["Y"]) / 1000.0
    true = np.array([rigid.thermal({n: float(p[i]) for n, p in positions.items()}, t)[:3] for i, t in enumerate(t_s)])
    bend_um = rigid.warmth(t_s) @ BEND_UM_PER_M2 * u_m**2
    true[:, 0] += bend_um
    rms_um = np.sqrt(np.mean((found.error_um - true) ** 2, axis=0))
    assert np.sqrt(np.mean(bend_um**2)) > 5.0
    assert rms_um.max() < 2.5, rms_um


def test_verification_expects_the_bend_where_the_point_is() -> None:
    model, whole, separations = joint_model()
    states = next(s for s in axis_states(whole, separations, "abc") if s.axis == "Y")
    k = states.components.index("EXY")
    samples = states.samples[k]
    expected, _ = expected_from_model(model, whole, states, separations)
    at_point = expected[k].intercept_um + expected[k].slope_um_per_m * samples.lever_m
    own = np.flatnonzero(states.campaign[samples.state] == 0)
    s = next(s for s in separations if s.campaign == "a" and s.component == "EXY")
    t_s = 3600.0 * samples.elapsed_h[own] + float(s.zero_t_s.mean())
    position = states.p0_mm + 1000.0 * samples.lever_m[own]
    heat = whole.campaign("a").temperatures

    def value(times: Floats, where: Floats) -> Floats:
        places = {n: np.full(len(times), p) for n, p in STAND_MM.items()} | {"Y": where}
        return predict_volume(model, heat, times, places, None, float(s.zero_t_s.mean())).error_um[:, 0]

    zero = [value(s.zero_t_s, np.full(len(s.zero_t_s), p)).mean() for p in position]
    assert np.allclose(at_point[own], value(t_s, position) - zero, atol=1e-6)


def test_a_longer_tool_follows_the_tangent_of_a_bent_ram() -> None:
    """Closed form: C (u + L)² less C L² at the tool tip, which is the tangent at u, for a ram along the spindle."""
    chain = tuple(axis for axis in chain_of(rigid_machine.AXES) if axis.name == "W")
    nothing = Part(np.zeros((1, 3)), np.zeros((1, 3)))
    bends = {"W": np.array([[40.0, 0.0, 0.0]])}
    parts = ThermalParts(nothing, {"W": nothing}, bends_um_per_m2=bends)
    at = {"W": np.array([400.0 - 300.0])}
    (plain, _), (longer, _) = (volume_error(chain, parts, at, np.array([mm])) for mm in (0.0, 200.0))
    u_m, length_m = -0.3, -0.2  # the tool sticks out along -Z, as the ram moves towards smaller W
    assert plain[0] == pytest.approx([40.0 * u_m**2, 0.0, 0.0])
    assert longer[0] == pytest.approx([40.0 * (u_m**2 + 2 * u_m * length_m), 0.0, 0.0])


# -------------------------------------------------------------------------------------------- default model
CURVE_UM_PER_M2_PER_K = -7.0


def lag_K(campaign: Campaign) -> Floats:
    heat = campaign.temperatures
    return run_filters(heat.t_s, heat.value_degC[:, :1] - 20.0, (LAG_S,))[0][:, 0, 0]


def bent_folder(*seeds: int) -> MachineFolder:
    """The slow column of the default model, which also bends by -7 µm/m² for each K, an hour behind its sensor."""
    campaigns = []
    for campaign in folder(*seeds).campaigns:
        points = campaign.sweeps
        assert points is not None
        lag = np.interp(points.t_s, campaign.temperatures.t_s, lag_K(campaign))
        u_m = (points.position_mm - 1000.0) / 1000.0
        campaigns.append(bend(campaign, 1, CURVE_UM_PER_M2_PER_K * lag * u_m**2))
    return MachineFolder(MACHINE, tuple(campaigns))


@pytest.fixture(scope="module")
def analysis() -> AnalysisResult:
    return analyze_folder(bent_folder(1, 2, 3, 4))


def test_heat_history_follows_the_bend_and_the_law_on_key_points_leaves_it(analysis: AnalysisResult) -> None:
    rows = {r.model: r for r in analysis.validation if (r.campaign, r.split, r.component) == ("all", "campaign", "EYY")}
    assert NOISE_UM <= rows["default"].rms_after_um < 1.7 * NOISE_UM
    assert rows["key_points"].rms_after_um > 2.0 * rows["default"].rms_after_um
    component = analysis.model.prediction["Y"].components["EYY"]
    assert len(component.terms) == 3
    assert any("parabolas" in note for note in analysis.model.notes)


def test_the_stored_bend_is_predicted_at_every_position(analysis: AnalysisResult, tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    analysis.model.save(path)
    (unseen,) = bent_folder(9).campaigns
    position = np.linspace(0.0, 2000.0, 9)
    rows = Rows(np.full(9, 30000.0), ("Y",) * 9, position)
    found = predict(load_model(path), unseen.temperatures, rows, 1800.0, duty=unseen.duty).error_um[:, 1]
    u_m, lag = (position - 1000.0) / 1000.0, float(np.interp(30000.0, unseen.temperatures.t_s, lag_K(unseen)))
    true = (6.0 + 10.0 * u_m + CURVE_UM_PER_M2_PER_K * u_m**2) * lag
    assert np.abs(found - true).max() < 3.0
    curve = np.polyfit(u_m, found, 2)[0]
    assert curve == pytest.approx(CURVE_UM_PER_M2_PER_K * lag, rel=0.1)


def test_the_separated_bend_is_written_beside_the_line(analysis: AnalysisResult, tmp_path: Path) -> None:
    write_files(tmp_path, table_files(analysis))
    lines = (tmp_path / "separation.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0].endswith("bend_um_per_m2,bend_se_um_per_m2")
    assert all(not line.endswith(",,") for line in lines[1:])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"coefficients": (1.0,)}, "bend has 1 coefficients"),
        ({"beyond": None}, "the bend and its prior do not come together"),
    ],
)
def test_a_bend_that_contradicts_the_layout_is_refused(
    analysis: AnalysisResult, change: dict[str, object], message: str
) -> None:
    axis = analysis.model.prediction["Y"]
    *line, bend = axis.components["EYY"].terms
    wrong = axis.components["EYY"].model_copy(update={"terms": (*line, bend.model_copy(update=change))})
    broken = {"Y": axis.model_copy(update={"components": {"EYY": wrong}, "fallbacks": ()})}
    (told,) = problems(analysis.model.model_copy(update={"prediction": broken}))
    assert message in told

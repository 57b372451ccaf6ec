"""Volumetric prediction: closed forms of the arms, a machine of rigid bodies, the command, and the export."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from rigid_machine import AXES, MACHINE, NAMES, REFERENCE_S, TOOL_MM, Rigid, draw_rigid, measure
from small_models import component, document, term
from typer.testing import CliRunner

from thetacomp.axis_states import axis_states
from thetacomp.campaign import Campaign, MachineFolder
from thetacomp.cli.main import app
from thetacomp.controllers.sinumerik import plan_registers
from thetacomp.controllers.sinumerik_settings import SinumerikSettings
from thetacomp.errors import AnalysisError, InputError
from thetacomp.fitting.build import build_document
from thetacomp.fitting.key_point_law import fit_axis
from thetacomp.fitting.rotations import with_joint_form
from thetacomp.machine import WantedLength
from thetacomp.model.axis_chain import ChainAxis, arms_behind_m, chain_of
from thetacomp.model.band import Band
from thetacomp.model.document import ModelDocument
from thetacomp.model.filters import InputLayout
from thetacomp.model.prediction import predict
from thetacomp.model.temperatures import Temperatures
from thetacomp.model.volume import Part, ThermalParts, volume_error
from thetacomp.model.volumetric import predict_volume
from thetacomp.separation import separate_all

CHAIN = chain_of(AXES)


def flat(value: tuple[float, float, float], half: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Part:
    return Part(np.array([value]), np.array([half]))


def parts(**changed: Part) -> ThermalParts:
    zero = flat((0.0, 0.0, 0.0))
    slopes = {name: changed.get(f"slope_{name}", zero) for name in NAMES}
    angles = {name: part for name in NAMES if (part := changed.get(f"angle_{name}")) is not None}
    return ThermalParts(changed.get("drift", zero), slopes, changed.get("angle"), angles)


def at(x: float, y: float, w: float) -> dict[str, np.ndarray]:
    return {"X": np.array([x]), "Y": np.array([y]), "W": np.array([w])}


def test_99_urad_over_600_mm_are_60_um() -> None:
    """The paper's lean of the column, 99 µrad, over an arm of 600 mm: 59.4 µm, by three ways that are the same turn."""
    # A turn about X moves a tool along -Z by +Y: rA x̂ × (-L ẑ) = rA L ŷ.
    turned, _ = volume_error(CHAIN, parts(angle=flat((99.0, 0.0, 0.0))), at(1000, 800, 400), np.array([600.0]))
    np.testing.assert_allclose(turned, [[0.0, 59.4, 0.0]], atol=1e-9)
    # The same turn is a slope of -99 µm/m of the ram W in Y; 600 mm of ram, or 600 mm of tool, are one arm.
    slope = parts(slope_W=flat((0.0, -99.0, 0.0)))
    ram, _ = volume_error(CHAIN, slope, at(1000, 800, 400 - 600), np.array([0.0]))
    tool, _ = volume_error(CHAIN, slope, at(1000, 800, 400), np.array([600.0]))
    np.testing.assert_allclose(ram, [[0.0, 59.4, 0.0]], atol=1e-9)
    np.testing.assert_allclose(tool, ram, atol=1e-9)


def test_a_guide_that_twists_turns_the_axes_behind_it_and_the_tool() -> None:
    """σ_Y = (0, 50, 0) µrad/m about Y, 0.6 m above P0: 30 µrad over 0.3 m of ram and 0.2 m of tool, W along +Z."""
    twist = parts(angle=flat((0.0, 0.0, 0.0)), angle_Y=flat((0.0, 50.0, 0.0), (0.0, 5.0, 0.0)))
    error, half = volume_error(CHAIN, twist, at(1900, 1400, 100), np.array([200.0]))
    # ŷ × (-0.3 ẑ) = -0.3 x̂ for the ram, -0.2 x̂ for the tool; X stands before Y and is not turned.
    np.testing.assert_allclose(error, [[30.0 * -0.5, 0.0, 0.0]], atol=1e-9)
    np.testing.assert_allclose(half, [[3.0 * 0.5, 0.0, 0.0]], atol=1e-9)


def test_drift_counts_once_and_half_widths_add_as_squares() -> None:
    given = parts(drift=flat((100.0, 0.0, 0.0), (3.0, 1.0, 1.0)), slope_X=flat((20.0, 0.0, 0.0), (4.0, 0.0, 0.0)))
    error, half = volume_error(CHAIN, given, at(2000, 800, 400), np.array([0.0]))
    np.testing.assert_allclose(error, [[120.0, 0.0, 0.0]])
    np.testing.assert_allclose(half, [[5.0, 1.0, 1.0]])


def test_a_band_over_the_travel_does_not_shrink_with_the_arm_and_one_reading_counts_once() -> None:
    """Two axes with bands of 5 µm, each with 3 µm from the scatter of one reading: √(16 + 16 + 9)."""
    slopes = parts(slope_X=flat((0.0, 0.0, 0.0), (5.0, 0.0, 0.0)), slope_Y=flat((0.0, 0.0, 0.0), (5.0, 0.0, 0.0)))
    five, three = np.array([[5.0, 0.0, 0.0]]), np.array([3.0, 0.0, 0.0])
    given = replace(
        slopes,
        there_um={"X": five, "Y": five, "W": 0.0 * five},
        reading_um={"X": three, "Y": three, "W": 0.0 * three},
    )
    _, half = volume_error(CHAIN, given, at(1010, 810, 400), np.array([0.0]))
    np.testing.assert_allclose(half, [[np.sqrt(41.0), 0.0, 0.0]])


def test_arms_are_made_of_the_axes_behind() -> None:
    arms = arms_behind_m(CHAIN, at(2000, 1000, 300))
    np.testing.assert_allclose(arms["X"], [[0.0, 0.2, -0.1]])
    np.testing.assert_allclose(arms["Y"], [[0.0, 0.0, -0.1]])
    np.testing.assert_allclose(arms["W"], [[0.0, 0.0, 0.0]])


def test_a_tool_on_a_cross_axis_is_not_guessed() -> None:
    chain: tuple[ChainAxis, ...] = CHAIN[:2]
    given = ThermalParts(flat((0, 0, 0)), {"X": flat((0, 0, 0)), "Y": flat((0, 0, 50.0))})
    positions = {"X": np.array([0.0]), "Y": np.array([0.0])}
    with pytest.raises(ValueError, match="length has no known effect"):
        volume_error(chain, given, positions, np.array([10.0]))


def fitted(rigid: Rigid, rng: np.random.Generator, *, at_columns: bool = True) -> tuple[ModelDocument, Campaign]:
    """A model from two campaigns of other speed of warming, on the two true inputs, and a third one to predict."""
    others = [replace(rigid, tau_s=tau) for tau in ((4000.0, 16000.0), (9000.0, 11000.0), (6000.0, 14000.0))]
    campaigns = [
        measure(one, rng, name, angle_sd_urad=1.0, at=at_columns) for one, name in zip(others, "abc", strict=True)
    ]
    folder = MachineFolder(MACHINE, tuple(campaigns[:2]))
    separated = separate_all(MACHINE, campaigns[:2])
    models = [(states, fit_axis(states, ("t1", "t2"))) for states in axis_states(folder, separated.components, "ab")]
    return with_joint_form(build_document(folder, models, "test", "ab"), folder, separated, models, "ab"), campaigns[2]


def test_a_rigid_machine_is_predicted_anywhere_and_the_naive_sum_is_not() -> None:
    """Three machines, a third campaign, random positions and tool lengths against the exact transforms."""
    joint_um, naive_um, drift_um, inside = [], [], [], []
    for seed in (11, 12, 13):
        rng = np.random.default_rng(seed)
        rigid = draw_rigid(rng)
        model, campaign = fitted(rigid, rng)
        alone, _ = fitted(rigid, rng, at_columns=False)
        assert (model.form, alone.form, model.tool_length_mm) == ("joint", "separate", TOOL_MM)
        assert sum(len(law.components) for law in model.rotations.values()) == 3 * 4
        n, truth = 60, replace(rigid, tau_s=(6000.0, 14000.0))
        t_s = np.sort(rng.uniform(REFERENCE_S + 600.0, 22000.0, n))
        positions = {axis.name: rng.uniform(*axis.travel_mm, n) for axis in AXES}
        length = rng.uniform(100.0, 700.0, n)
        found = predict_volume(model, campaign.temperatures, t_s, positions, length)
        warmth = 0.1 * (
            np.column_stack([np.interp(t_s, campaign.temperatures.t_s, v) for v in campaign.temperatures.value_degC.T])
            - 20.0
        )
        place = [{name: float(positions[name][i]) for name in NAMES} for i in range(n)]
        cold = np.zeros(2)
        true = np.array(
            [(truth.tool(place[i], warmth[i], length[i]) - truth.tool(place[i], cold, length[i]))[:3] for i in range(n)]
        )
        summed = sum(
            predict(alone, campaign.temperatures, _Rows(t_s, (name,) * n, positions[name])).error_um for name in NAMES
        )
        joint_um.append(found.error_um - true)
        naive_um.append(summed - true)
        drift_um.append(true)
        inside.append((found.lower_um <= true) & (true <= found.upper_um))
        assert found.in_domain.mean() > 0.9
    rms = [float(np.sqrt(np.mean(np.concatenate(e) ** 2))) for e in (joint_um, naive_um, drift_um)]
    # Measured: joint 1.3 µm, naive 154 µm, the error itself 77 µm; the bounds held all rows.
    assert rms[0] < 0.05 * rms[2]
    assert rms[1] > 0.5 * rms[2]
    assert np.mean(inside) >= 0.93


class _Rows:
    def __init__(self, t_s: np.ndarray, axis: tuple[str, ...], position_mm: np.ndarray) -> None:
        self.t_s, self.axis, self.position_mm = t_s, axis, position_mm


def small(last: str = "+Z", leave_out: tuple[str, ...] = ()) -> ModelDocument:
    """X and W with drift: E = D + S (p - P0), one sensor; joint form with a tool of 100 mm."""
    a = {"a": 20.0}
    made = {
        f"D{d}": component(f"D{d}", term(0.0, value), None, a, through_zero=True)
        for d, value in zip("XYZ", (1.0, 2.0, 3.0), strict=True)
    }
    for axis, slopes in (("X", (10.0, 0.0, 0.0)), ("W", (0.0, -9.9, 5.0))):
        for d, value in zip("XYZ", slopes, strict=True):
            name = f"E{d}{axis}"
            made[name] = component(name, term(0.0, 0.0), term(0.0, value), a, p=(500.0, 0.0, 1000.0))
    made = {name: one for name, one in made.items() if name not in leave_out}
    model = document({"X": "+X", "W": last}, made, {"a": (0.0, 10.0)})
    return model.model_copy(update={"form": "joint", "tool_length_mm": 100.0})


def warm() -> Temperatures:
    return Temperatures(np.array([0.0, 100.0]), ("a",), np.array([[20.0], [30.0]]))


def files(tmp_path: Path, model: ModelDocument, positions: str) -> list[str]:
    model.save(tmp_path / "model.json")
    (tmp_path / "T.csv").write_text("t_s,a\n0,20\n100,30\n", encoding="utf-8")
    (tmp_path / "P.csv").write_text(positions, encoding="utf-8")
    given = ["--temperatures", str(tmp_path / "T.csv"), "--positions", str(tmp_path / "P.csv")]
    return ["predict", str(tmp_path / "model.json"), *given, "--out", str(tmp_path / "E.csv")]


def test_the_command_predicts_all_axes_at_once(tmp_path: Path) -> None:
    arguments = files(tmp_path, small(), "t_s,X_mm,W_mm,tool_length_mm\n0,0,0,100\n100,700,400,700\n")
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert "a longer tool is assumed to tilt with the guide of W" in result.output
    rows = list(csv.DictReader((tmp_path / "E.csv").read_text(encoding="utf-8").splitlines()))
    assert list(rows[0])[:5] == ["t_s", "X_mm", "W_mm", "tool_length_mm", "dX_um"]
    assert [float(rows[0][f"d{d}_um"]) for d in "XYZ"] == [0.0, 0.0, 0.0]
    # a rises by 10 K: D = (10, 20, 30); X is 0.2 m off P0: 100 µm/m * 0.2; W -0.1 m and 0.6 m more tool: -0.7 m.
    assert [float(rows[1][f"d{d}_um"]) for d in "XYZ"] == pytest.approx([30.0, 20.0 + 99.0 * 0.7, 30.0 - 5.0])
    assert rows[1]["in_domain"] == "1"
    data = json.loads(CliRunner().invoke(app, [*arguments, "--json"]).output)
    assert data["largest"]["dY_um"] == pytest.approx(89.3)


@pytest.mark.parametrize(
    ("change", "positions", "message"),
    [
        ({"form": "separate"}, "t_s,X_mm,W_mm\n0,0,0\n", "adding them would count the drift once for each axis. Fix: "),
        ({}, "t_s,X_mm\n0,0\n", "no column W_mm; the model knows X, W. Fix: "),
        ({}, "t_s,X_mm,W_mm,Q_mm\n0,0,0,0\n", "Q_mm is no axis of the model"),
        ({}, "t_s,X_mm,W_mm\n0,0,\n", "P.csv, row 2: W_mm is empty. Fix: "),
        ({}, "t_s,X_mm,W_mm,tool_length_mm\n0,0,0,\n", "P.csv, row 2: tool_length_mm is empty. Fix: "),
        ({}, "t_s,axis,position_mm,X_mm,W_mm\n0,X,1,0,0\n", "stands beside X_mm, W_mm. Fix: "),
    ],
)
def test_what_the_command_refuses(tmp_path: Path, change: dict[str, str], positions: str, message: str) -> None:
    result = CliRunner().invoke(app, files(tmp_path, small().model_copy(update=change), positions))
    assert result.exit_code == 1
    assert message in result.output


def test_a_longer_tool_on_a_cross_axis_is_refused_with_the_cure() -> None:
    positions = {"X": np.array([0.0]), "W": np.array([0.0])}
    with pytest.raises(AnalysisError, match=r"last axis W does not run along the spindle.*measure rA_urad"):
        predict_volume(small("+Y"), warm(), np.array([50.0]), positions, np.array([300.0]))


def test_rows_outside_the_travel_of_any_axis_are_marked() -> None:
    positions = {"X": np.array([500.0, 500.0]), "W": np.array([500.0, 1100.0])}
    found = predict_volume(small(), warm(), np.array([50.0, 50.0]), positions)
    assert found.in_domain.tolist() == [True, False]
    assert [(b.kind, b.name, b.rows) for b in found.breaches] == [("position", "W", 1)]


def test_a_direction_that_was_not_measured_stays_empty() -> None:
    found = predict_volume(
        small(leave_out=("EYX",)),
        warm(),
        np.array([50.0]),
        {"X": np.array([0.0]), "W": np.array([0.0])},
    )
    assert np.isfinite(found.error_um[0]).tolist() == [True, False, True]
    assert found.absent == ("EYX",)


def test_an_angle_without_its_sensor_is_left_out_and_named() -> None:
    """The angles of the drift hang on a sensor that the table lacks: the rest is as in a model without angles."""
    drift = small().control[""]
    angles = {name: drift.components[f"D{d}"] for name, d in (("DA", "X"), ("DB", "Y"), ("DC", "Z"))}
    angle = drift.model_copy(update={"layout": InputLayout.plain(("b",)), "components": angles})
    positions, longer = {"X": np.array([700.0]), "W": np.array([400.0])}, np.array([700.0])
    with_angle = small().model_copy(update={"rotations": {"": angle}})
    found = predict_volume(with_angle, warm(), np.array([100.0]), positions, longer)
    plain = predict_volume(small(), warm(), np.array([100.0]), positions, longer)
    np.testing.assert_array_equal(found.error_um, plain.error_um)
    assert (found.absent, found.lost_angles, found.lean) == ((), ("DA", "DB", "DC"), plain.lean)
    assert not found.in_domain.any()
    both = Temperatures(np.array([0.0, 100.0]), ("a", "b"), np.array([[20.0, 20.0], [30.0, 30.0]]))
    turned = predict_volume(with_angle, both, np.array([100.0]), positions, longer)
    # 1 µrad/K about X at 10 K turns 0.6 m of tool along -Z by +Y: 6 µm; the lean of W is then in the angle.
    assert turned.error_um[0, 1] == pytest.approx(20.0 + 9.9 * 10.0 * 0.1 + 6.0)


def test_sinumerik_takes_k0_from_the_drift_of_the_joint_form() -> None:
    plan = plan_registers(small(), SinumerikSettings())
    sources = {one.axis.name: (one.drift_source, one.slope_source) for one in plan.axes}
    assert sources == {"X": ("DX", "EXX"), "W": ("DZ", "EZW")}
    assert plan.left_out == ()
    registers = next(one for one in plan.axes if one.axis.name == "W")
    warm_degC = {"a": np.array([30.0])}
    # D = 3 µm/K, slope 5 µm/m per K, P0 = 500 mm: K0 and tanβ give the volumetric error along Z.
    found_mm = registers.register_k0_mm.at(warm_degC) + registers.register_tan_beta.at(warm_degC) * (
        900.0 - registers.register_p0_mm
    )
    expected = predict_volume(small(), warm(), np.array([100.0]), {"X": np.array([500.0]), "W": np.array([900.0])})
    np.testing.assert_allclose(found_mm * 1000.0, expected.error_um[:, 2])
    with pytest.raises(InputError, match="the model is in the joint form, its drift is DX"):
        plan_registers(small(), SinumerikSettings(drift_source={"X": "EXX"}))


def test_the_form_is_kept_in_the_file(tmp_path: Path) -> None:
    from thetacomp.model.load import load_model

    small().save(tmp_path / "m.json")
    raw = json.loads((tmp_path / "m.json").read_text(encoding="utf-8"))
    assert load_model(tmp_path / "m.json").form == "joint"
    for key in ("form", "tool_length_mm", "rotations"):
        raw.pop(key)
    (tmp_path / "old.json").write_text(json.dumps(raw), encoding="utf-8")
    assert load_model(tmp_path / "old.json").form == "separate"


@pytest.mark.parametrize(("reference", "states"), [("model", 1.0), ("first_row", 2.0)])
@pytest.mark.parametrize("noise_um", [0.0, 3.0])
def test_the_scatter_of_one_reading_that_all_bands_hold_counts_once(
    reference: Literal["model", "first_row"], states: float, noise_um: float
) -> None:
    """Quantile 2; drift 1 µm; X 5 µm and W 4 µm in the direction X, in each of which one reading scatters by noise.

    In the square of the half width: the drift's own, what X and W have beside the reading, and the reading once.
    """
    model = small()
    sd_um = {"": 1.0, "X": 5.0, "W": 4.0}
    laws = {}
    for name, law in model.control.items():
        noise = noise_um if name else 0.0
        band = Band(quantile=2.0, sd=(sd_um[name],), growth=0.0, noise_sd_um=noise)
        made = {
            key: one.model_copy(update={"band": band, "through_zero": False}) for key, one in law.components.items()
        }
        laws[name] = law.model_copy(update={"components": made})
    positions = {"X": np.array([700.0]), "W": np.array([400.0])}
    found = predict_volume(model.model_copy(update={"control": laws}), warm(), np.array([100.0]), positions,
                           reference=reference)  # fmt: skip
    squares = sum(states * sd**2 for sd in sd_um.values()) - noise_um**2
    np.testing.assert_allclose((found.upper_um - found.error_um)[0, 0], 2.0 * np.sqrt(squares))


def test_a_band_without_a_quantile_holds_no_known_reading() -> None:
    model = small()
    w = model.control["W"]
    band = Band(quantile=None, sd=(1.0,), noise_sd_um=3.0)
    made = {key: one.model_copy(update={"band": band}) for key, one in w.components.items()}
    control = model.control | {"W": w.model_copy(update={"components": made})}
    positions = {"X": np.array([700.0]), "W": np.array([400.0])}
    found = predict_volume(model.model_copy(update={"control": control}), warm(), np.array([100.0]), positions)
    assert np.isnan(found.upper_um).all()
    assert np.isfinite(found.error_um).all()


def test_a_bend_goes_on_along_its_tangent_beyond_the_ram() -> None:
    """W runs along +Z and stands at u = -0.6 m; 0.2 m more tool make an arm of -0.8 m across, none along.

    Bends of 1, 7, 5 µm/m²: u² = 0.36 along; u² + 2 u (arm - u) = 0.36 + 0.24 across.
    """
    given = replace(parts(), bends_um_per_m2={"W": np.array([[1.0, 7.0, 5.0]])})
    error, _ = volume_error(CHAIN, given, at(1000, 800, 400 - 600), np.array([200.0]))
    np.testing.assert_allclose(error, [[0.6, 4.2, 5.0 * 0.36]])
    error, _ = volume_error(CHAIN, given, at(1000, 800, 400 + 600), np.array([0.0]))
    np.testing.assert_allclose(error, [[0.36, 7.0 * 0.36, 5.0 * 0.36]])


def test_what_a_longer_tool_leans_with_is_told() -> None:
    positions, longer = {"X": np.array([700.0]), "W": np.array([400.0])}, np.array([700.0])
    drift = small().control[""]
    angles = {name: drift.components[f"D{d}"] for name, d in (("DA", "X"), ("DB", "Y"), ("DC", "Z"))}
    measured = small().model_copy(update={"rotations": {"": drift.model_copy(update={"components": angles})}})
    for model, lean in (
        (small(), "a longer tool is assumed to tilt with the guide of W (no angles were measured)"),
        (measured, "the measured angles act on the change of the tool length"),
    ):
        assert predict_volume(model, warm(), np.array([100.0]), positions, longer).lean == lean
        assert predict_volume(model, warm(), np.array([100.0]), positions).lean == ""


def test_a_volume_that_follows_the_workpiece_gains_its_growth_along_each_axis() -> None:
    """11.5e-6 /K · 10 K · 0.2 m = 23 µm in X and -11.5 µm at -0.1 m in W, taken off the error; Y has no axis."""
    follow = WantedLength(wanted="workpiece", workpiece_expansion_per_K=11.5e-6, workpiece_sensor="a")
    positions = {"X": np.array([700.0]), "W": np.array([400.0])}
    plain = predict_volume(small(), warm(), np.array([100.0]), positions)
    found = predict_volume(small().model_copy(update={"length": follow}), warm(), np.array([100.0]), positions)
    np.testing.assert_allclose(found.error_um - plain.error_um, [[-23.0, 0.0, 11.5]], atol=1e-9)
    np.testing.assert_allclose(found.upper_um - found.error_um, plain.upper_um - plain.error_um)
    assert (found.in_domain.tolist(), found.breaches) == ([True], ())


def test_a_volume_flags_a_workpiece_outside_the_temperatures_at_which_it_is_followed() -> None:
    """Followed from 5 to 25 °C only; at 26 and 30 °C the flag is set, without a reading the row is missing."""
    follow = WantedLength(
        wanted="workpiece", workpiece_expansion_per_K=11.5e-6, workpiece_sensor="part", workpiece_degC=(5.0, 25.0)
    )
    value = np.array([[20.0, 25.0], [21.0, 26.0], [22.0, 30.0], [22.0, np.nan]])
    table = Temperatures(100.0 * np.arange(4.0), ("a", "part"), value)
    positions = {name: np.full(4, 500.0) for name in "XW"}
    found = predict_volume(small().model_copy(update={"length": follow}), table, table.t_s, positions)
    assert found.in_domain.tolist() == [True, False, False, False]
    assert found.missing.tolist() == [False, False, False, True]
    assert [(b.kind, b.name, b.rows, b.values) for b in found.breaches] == [("temperature", "part", 2, (25.0, 30.0))]

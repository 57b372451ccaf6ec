"""The length that is wanted: closed forms of the workpiece's expansion in prediction and registers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError
from small_models import component, document, term

from thetacomp.arrays import Floats
from thetacomp.controllers.sinumerik import plan_registers
from thetacomp.controllers.sinumerik_settings import SinumerikSettings
from thetacomp.errors import AnalysisError, InputError
from thetacomp.machine import WantedLength
from thetacomp.model.document import ModelDocument
from thetacomp.model.load import load_model
from thetacomp.model.prediction import predict
from thetacomp.model.temperatures import Temperatures
from thetacomp.model.wanted_length import length_error_um
from thetacomp.reading import read_machine

FOLLOW = {"wanted": "workpiece", "workpiece_expansion_per_K": 11.5e-6, "workpiece_sensor": "part"}


@dataclass(frozen=True)
class Rows:
    t_s: Floats
    axis: tuple[str, ...]
    position_mm: Floats


def model(**length: object) -> ModelDocument:
    parts = {
        "EXX": component("EXX", term(0.0, 2.0), term(0.0, 4.0), {"a": 20.0}, p=(1000.0, 0.0, 3000.0)),
        "EZW": component("EZW", term(0.0, 1.0), term(0.0, 3.0), {"a": 20.0}, p=(0.0, 0.0, 1000.0)),
    }
    made = document({"X": "+X", "W": "-Z"}, parts, {"a": (-10.0, 10.0)})
    return made.model_copy(update={"length": WantedLength.model_validate({**FOLLOW, **length})})


def heat(part_degC: float, a_degC: float = 20.0) -> Temperatures:
    return Temperatures(np.array([0.0, 100.0]), ("a", "part"), np.array([[20.0, part_degC], [a_degC, part_degC]]))


def test_three_metres_of_steel_at_ten_kelvin() -> None:
    # 11.5e-6 1/K x 10 K x 3 m = 345 µm: the example of the conventions
    follow = model(zero_mm={"X": 0.0})
    error_um = length_error_um(follow, follow.axes[0], np.array([30.0]), np.array([3000.0]))
    assert error_um[0] == pytest.approx(-345.0)


def test_prediction_gains_the_expansion_along_the_axis_alone() -> None:
    rows = Rows(np.array([100.0, 100.0]), ("X", "W"), np.array([3000.0, 1000.0]))
    true = predict(model(wanted="true"), heat(30.0, 25.0), rows)
    follow = predict(model(), heat(30.0, 25.0), rows)
    added = follow.error_um - true.error_um
    # zero at P0: 2 m from P0 on X; W runs along -Z, so its error along +Z turns over
    assert added[0, 0] == pytest.approx(-230.0)
    assert added[1, 2] == pytest.approx(115.0)
    assert np.isnan(added[0, 1])
    np.testing.assert_allclose(follow.upper_um - follow.lower_um, true.upper_um - true.lower_um)


def test_a_workpiece_at_twenty_degrees_changes_nothing() -> None:
    rows = Rows(np.array([100.0]), ("X",), np.array([3000.0]))
    follow, true = (predict(m, heat(20.0, 25.0), rows).error_um for m in (model(), model(wanted="true")))
    np.testing.assert_array_equal(follow, true)


def test_an_unbelievable_workpiece_raises_the_flag_and_a_missing_one_is_refused() -> None:
    rows = Rows(np.array([100.0]), ("X",), np.array([500.0]))
    assert predict(model(), heat(30.0), rows).in_domain.all()
    assert predict(model(), heat(30.0), rows).breaches == ()
    hot = predict(model(), heat(60.0), rows)
    assert not hot.in_domain.any()
    assert [(b.kind, b.name, b.rows, b.values) for b in hot.breaches] == [("temperature", "part", 1, (60.0, 60.0))]
    assert hot.breaches[0].trained == model().length.workpiece_degC
    without = Temperatures(np.array([0.0, 100.0]), ("a",), np.array([[20.0], [20.0]]))
    with pytest.raises(AnalysisError, match="no column part"):
        predict(model(), without, rows)


@pytest.mark.parametrize("zero_mm", [None, 0.0])
def test_registers_hold_the_error_that_is_predicted(zero_mm: float | None) -> None:
    follow = model(**({} if zero_mm is None else {"zero_mm": {"X": zero_mm, "W": 100.0}}))
    plan = plan_registers(follow, SinumerikSettings())
    degC = {"a": np.array([25.0]), "part": np.array([30.0])}
    for registers, position_mm, column in zip(plan.axes, (2500.0, 800.0), (0, 2), strict=True):
        k0_mm = registers.register_k0_mm.at(degC)[0]
        tan_beta = registers.register_tan_beta.at(degC)[0]
        entered_mm = k0_mm + tan_beta * (position_mm - registers.register_p0_mm)
        rows = Rows(np.array([100.0]), (registers.axis.name,), np.array([position_mm]))
        error_um = predict(follow, heat(30.0, 25.0), rows, "model").error_um[0, column]
        # the register holds the error along the axis' own direction: sign_temperature = 1 means +E
        assert 1e3 * entered_mm == pytest.approx(registers.axis.sign * error_um)
        assert abs(tan_beta) <= registers.clamp_tan_beta
        assert abs(k0_mm) <= registers.clamp_k0_mm


def test_choice_is_stored_and_read_back(tmp_path: Path) -> None:
    model().save(tmp_path / "model.json")
    assert load_model(tmp_path / "model.json").length == WantedLength.model_validate(FOLLOW)


def test_half_a_choice_is_refused() -> None:
    with pytest.raises(ValidationError, match="workpiece_expansion_per_K"):
        WantedLength.model_validate({"wanted": "workpiece"})


def test_machine_file_names_the_choice_or_says_what_is_wrong(tmp_path: Path) -> None:
    text = """format = 1
[machine]
name = "m"
[[axes]]
name = "X"
direction = "+X"
travel_mm = [0.0, 1000.0]
[[sensors]]
id = "part"
role = "workpiece"
[length]
wanted = "workpiece"
workpiece_expansion_per_K = 11.5e-6
workpiece_sensor = "{sensor}"
"""
    path = tmp_path / "machine.toml"
    path.write_text(text.format(sensor="part"), encoding="utf-8")
    assert read_machine(path).length.wanted == "workpiece"
    path.write_text(text.format(sensor="spare"), encoding="utf-8")
    with pytest.raises(InputError, match="length names the sensor 'spare'"):
        read_machine(path)

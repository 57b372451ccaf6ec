"""The equation in print, term by term from coefficients that were chosen by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from thetacomp.fitting.build import equation

SHARED, OWN = [[20.0, 22.0], [20.0, 22.0]], [[20.0, 22.0], [21.0, 22.0]]
RISES = "Δ: rise above the reference in K"


@pytest.mark.parametrize(
    ("intercept", "coefficients", "given", "expected"),
    [
        # 3 - 4 · 20 + 2 · 22 = -33 and 1 + 0.5 · 20 - 0 = 11
        ([3.0, 1.0], [[4.0, -2.0], [-0.5, 0.0]], {},
         "EXY = (11 - 0.5 a + 0 b) (Y - 500)/1000 + (-33 + 4 a - 2 b)   [µm; Y in mm, temperatures in °C]"),
        ([3.0, 1.0], [[4.0, -2.0], [-0.5, 0.0]], {"reference_degC": OWN},
         f"EXY = (1 - 0.5 Δa + 0 Δb) (Y - 500)/1000 + (3 + 4 Δa - 2 Δb)   [µm; Y in mm, {RISES}]"),
        # without a constant the first term bears a sign only where it is below zero
        ([0.0, 0.0], [[-4.0, 2.0], [0.5, -1.0]], {"reference_degC": OWN, "p0_mm": 0.0},
         f"EXY = (0.5 Δa - 1 Δb) Y/1000 + (- 4 Δa + 2 Δb)   [µm; Y in mm, {RISES}]"),
        ([3.0], [[4.0, -2.0]], {"is_drift": True}, "EXY = -33 + 4 a - 2 b   [µm; temperatures in °C]"),
        # joint form: an intercept that is exactly zero is the drift's
        ([0.0, 1.0], [[0.0, 0.0], [2.0, 1.0]], {"exact_zero": True, "reference_degC": OWN},
         f"EXY = (1 + 2 Δa + 1 Δb) (Y - 500)/1000   [µm; Y in mm, {RISES}]"),
    ],
)  # fmt: skip
def test_equation_by_hand(
    intercept: list[float], coefficients: list[list[float]], given: dict[str, Any], expected: str
) -> None:
    fields: dict[str, Any] = {
        "axis": "Y", "components": ("EXY",), "sensors": ("a", "b"), "reference_degC": SHARED, "p0_mm": 500.0,
        "is_drift": False, "exact_zero": False, "intercept_um": np.zeros((2, 1)),
    }  # fmt: skip
    states = SimpleNamespace(**(fields | given))
    states.reference_degC = np.array(states.reference_degC)
    fitted = SimpleNamespace(intercept_=np.array(intercept), coef_=np.array(coefficients))
    model = SimpleNamespace(inputs=("a", "b"), regressions={"EXY": fitted})
    assert equation(states, model, 0) == expected  # type: ignore[arg-type]

"""Does it help? Components and thirds of the travel in which a model adds error, from residuals made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from thetacomp.validation.harm import Harm, harm_notes, harmed
from thetacomp.validation.validate import Residuals

AT_MM = np.array([0.0, 300.0, 500.0, 700.0, 800.0, 900.0])


def residuals(component: str, model: str, after: list[float], before: float = 10.0, at_mm=AT_MM) -> Residuals:  # type: ignore[no-untyped-def]
    zero = np.zeros(6, dtype=np.int64)
    nan = np.full(6, np.nan)
    return Residuals(component, model, "campaign", zero, zero, at_mm, np.full(6, before), np.array(after), nan, nan)


NOTHING = residuals("EXY", "nothing", [10.0] * 6)


def test_the_third_that_is_worse_is_named_with_its_figures() -> None:
    """Thirds of 0 to 900 mm hold 1, 2 and 3 points... of 300 mm: 0 | 300, 500 | 700, 800, 900 is 0 | 2 | 3."""
    model = residuals("EXY", "default", [1.0, 1.0, 1.0, 12.0, 12.0, 12.0])
    (found,) = harmed([NOTHING, model])
    assert found == Harm("EXY", "default", 600.0, 900.0, pytest.approx(10.0), pytest.approx(12.0))
    assert harm_notes([NOTHING, model]) == [
        "EXY from 600 to 900 mm: the model does harm: held out it leaves 12.0 µm RMS, no compensation 10.0 µm"
    ]


def test_neighbouring_thirds_are_one_stretch_and_separate_ones_are_two() -> None:
    both = harmed([NOTHING, residuals("EXY", "key_points", [20.0] * 6)])
    assert [(one.low_mm, one.high_mm) for one in both] == [(0.0, 900.0)]
    ends = harmed([NOTHING, residuals("EXY", "default", [20.0, 1.0, 1.0, 20.0, 20.0, 20.0])])
    assert [(one.low_mm, one.high_mm) for one in ends] == [(0.0, 300.0), (600.0, 900.0)]


@pytest.mark.parametrize(("after_um", "harm"), [(14.9, False), (15.1, True)])
def test_a_loss_below_a_twentieth_of_the_largest_error_is_noise(after_um: float, harm: bool) -> None:
    """The machine's largest RMS is 100 µm, in another component: 5 µm on top of 10 are allowed."""
    largest = residuals("EZY", "nothing", [0.0] * 6, before=100.0)
    assert bool(harmed([NOTHING, largest, residuals("EXY", "default", [after_um] * 6)])) == harm


def test_drift_has_one_place_and_baselines_are_not_asked() -> None:
    still = residuals("DX", "default", [20.0] * 6, at_mm=np.zeros(6))
    assert harm_notes([NOTHING, still]) == [
        "DX: the model does harm: held out it leaves 20.0 µm RMS, no compensation 10.0 µm"
    ]
    for name in ("clock", "one_sensor", "nothing"):
        assert harmed([NOTHING, residuals("EXY", name, [20.0] * 6)]) == ()
    law = residuals("EXY", "key_points", [20.0] * 6)
    assert "the law on key points does harm" in harm_notes([NOTHING, law])[0]

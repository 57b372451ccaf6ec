"""What the table of held-out states takes from the residuals: one model's, the largest of each state, its own times."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from thetacomp.validation.validate import Residuals, held_out_states

# Five states, three in the first campaign; states 1 and 4 were not held out.
STATES = SimpleNamespace(
    campaigns=("a", "b"), campaign=np.array([0, 0, 0, 1, 1]), t_s=np.array([10.0, 20.0, 30.0, 40.0, 50.0])
)
STATE = np.array([0, 0, 2, 2, 3, 3])


def residuals(component: str, model: str, scale: float) -> Residuals:
    nothing = np.zeros(len(STATE))
    return Residuals(
        component, model, "campaign", STATE, STATES.campaign[STATE], position_mm=nothing,
        before_um=scale * np.array([1.0, -5.0, 3.0, 2.0, -7.0, 6.0]),
        after_um=scale * np.array([-0.5, 0.25, 1.0, -2.0, 0.0, 0.125]),
        half_width_um=nothing, in_sample_um=nothing,
    )  # fmt: skip


def test_only_the_rows_of_the_model_that_was_asked_for() -> None:
    """The other model's residuals are a hundred times as large and must not show; figures by hand from the lists."""
    given = [residuals("EXY", "clock", 100.0), residuals("EXY", "default", 1.0), residuals("EZY", "default", 2.0)]
    rows = held_out_states(STATES, given, "default")  # type: ignore[arg-type]
    assert [(row.component, row.campaign) for row in rows] == [("EXY", "a"), ("EXY", "b"), ("EZY", "a"), ("EZY", "b")]
    first, second, third, _ = rows
    assert (first.t_s.tolist(), second.t_s.tolist()) == ([10.0, 30.0], [40.0])
    assert (first.before_um.tolist(), first.after_um.tolist()) == ([5.0, 3.0], [0.5, 2.0])
    assert (second.before_um.tolist(), second.after_um.tolist()) == ([7.0], [0.125])
    assert third.before_um.tolist() == [10.0, 6.0]


@pytest.mark.parametrize("model", ["nothing", "clock"])
def test_a_model_without_residuals_has_no_rows(model: str) -> None:
    assert held_out_states(STATES, [residuals("EXY", "default", 1.0)], model) == ()  # type: ignore[arg-type]

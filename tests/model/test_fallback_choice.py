"""Which of several fallbacks serves an axis: the one with the least sum of squared held-out errors."""

from __future__ import annotations

from pathlib import Path

import pytest

from thetacomp.model.document import Fallback, ModelDocument
from thetacomp.model.fallback import degraded
from thetacomp.model.load import load_model

DATA = Path(__file__).parent / "data"


def with_errors(*choices: tuple[float, ...]) -> tuple[ModelDocument, tuple[Fallback, ...]]:
    """A model whose axis Y has a fallback for `a` for each of `choices`, held-out RMS (µm) by component."""
    model = load_model(DATA / "key_points.json")
    law = model.control["Y"]
    (first, *_) = law.fallbacks
    accuracy = first.accuracy["EYY"]
    made = tuple(
        first.model_copy(
            update={
                "reference": first.reference.model_copy(update={"campaign": f"choice {k}"}),
                "accuracy": {
                    name: accuracy.model_copy(update={"without_rms_um": rms_um})
                    for name, rms_um in zip(("EXY", "EYY", "EZY"), choice, strict=True)
                },
            }
        )
        for k, choice in enumerate(choices)
    )
    changed = law.model_copy(update={"fallbacks": made})
    return model.model_copy(update={"control": {"Y": changed}}), made


@pytest.mark.parametrize(
    ("choices", "taken"),
    [
        (((1.0, 1.0, 12.0), (5.0, 5.0, 5.0)), 1),  # squares 146 and 75, though the sums are 14 and 15
        (((5.0, 5.0, 5.0), (1.0, 1.0, 12.0)), 0),
        (((0.5, 0.5, 0.5), (0.1, 0.1, 0.8)), 1),  # squares 0.75 and 0.66
        (((2.0, 2.0, 2.0), (2.0, 2.0, 2.0)), 0),  # as good: the first
    ],
)
def test_the_least_sum_of_squares_over_the_components_is_taken(
    choices: tuple[tuple[float, ...], ...], taken: int
) -> None:
    model, made = with_errors(*choices)
    found = degraded(model, {"a"})
    assert found.model.control["Y"].reference.campaign == f"choice {taken}"
    assert found.replaced == made[taken].accuracy

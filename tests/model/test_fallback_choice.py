"""Which of several fallbacks serves an axis, what goes on without a sensor, and a change of laws without a bump."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from thetacomp.model.document import Fallback, ModelDocument
from thetacomp.model.fallback import degraded, start_transfer
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


def test_the_switch_makes_no_bump_and_decays() -> None:
    # intercept and slope are carried, so no position jumps
    carried = start_transfer(100.0, output=(40.0, -6.0), law=(31.0, -4.5), decay_s=3600.0)
    assert np.add((31.0, -4.5), carried.at(100.0)) == pytest.approx((40.0, -6.0))
    later = np.array([carried.at(100.0 + t) for t in range(0, 36000, 60)])
    # closed form: the fastest change is the value over the time constant
    assert np.max(np.abs(np.diff(later[:, 0]))) <= 9.0 / 3600.0 * 60.0 + 1e-12
    assert np.all(np.diff(np.abs(later), axis=0) < 0)
    assert carried.at(3700.0)[0] == pytest.approx(9.0 / np.e)
    kept = start_transfer(100.0, (40.0,), (31.0,), decay_s=None)
    assert kept.at(1e6) == (9.0,)
    # back to the whole model in the middle of the decay: again no bump
    output = 31.0 + carried.at(2000.0)[0]
    assert 35.0 + start_transfer(2000.0, (output,), (35.0,)).at(2000.0)[0] == pytest.approx(output)
    with pytest.raises(ValueError, match="before the change"):
        carried.at(0.0)


def test_a_transfer_needs_one_law_for_each_output() -> None:
    with pytest.raises(ValueError, match="is shorter than"):
        start_transfer(0.0, (1.0, 2.0), (1.0,))

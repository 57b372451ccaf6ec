"""Which of several fallbacks serves an axis, what goes on without a sensor, and a change of laws without a bump."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from small_models import component, document, term

from thetacomp.model.document import Accuracy, AxisLaw, Fallback, ModelDocument
from thetacomp.model.fallback import degraded, start_transfer
from thetacomp.model.load import load_model
from thetacomp.model.prediction import predict
from thetacomp.model.temperatures import Temperatures

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


def law(axis: str, *sensors: str, fallbacks: tuple[Fallback, ...] = ()) -> AxisLaw:
    """A law of EX<axis>, or of DX, on some sensors."""
    zero = dict.fromkeys(sensors, 20.0)
    slope = term(0.0, *[1.0] * len(sensors)) if axis else None
    name = f"EX{axis}" if axis else "DX"
    made = document({"X": "+X"}, {name: component(name, term(0.0, *[1.0] * len(sensors)), slope, zero)},
                    dict.fromkeys(sensors, (0.0, 10.0)))  # fmt: skip
    return made.control[axis].model_copy(update={"fallbacks": fallbacks})


def ready(lost: str, rest: AxisLaw, *, full_um: float = 1.0, without_um: float = 2.0) -> Fallback:
    accuracy = Accuracy(full_rms_um=full_um, without_rms_um=without_um, nothing_rms_um=9.0)
    return Fallback(
        lost=lost, layout=rest.layout, reference=rest.reference, components=rest.components,
        accuracy=dict.fromkeys(rest.components, accuracy), leverage=rest.leverage, border=rest.border,
    )  # fmt: skip


STATIC = {
    "X": law("X", "a", fallbacks=(ready("a", law("X", "b"), full_um=3.0, without_um=4.0),)),
    "Y": law("Y", "b"),
    "V": law("V", "g"),
    "W": law("W", "e", fallbacks=(ready("e", law("W", "f")),)),
    "": law("", "c"),
}
HISTORY = {
    "X": law("X", "a", "d", fallbacks=(ready("d", law("X", "a")),)),
    "Y": law("Y", "b", "h"),
    "V": law("V", "d"),
    "W": law("W", "a"),
}
TURNED = {"": law("", "a"), "X": law("X", "b")}


def sensors_of(laws: Mapping[str, AxisLaw]) -> dict[str, str]:
    """The sensors of every law as one text, such as "ad"."""
    return {name: "".join(one.layout.sensors) for name, one in laws.items()}


@pytest.mark.parametrize(
    ("lost", "history", "static", "turned", "replaced", "ended"),
    [
        # with no sensor of the law lost it stays as it is, whichever of them is
        ("", {}, {}, {}, {}, ()),
        ("f", {}, {}, {}, {}, ()),
        # its own fallback; an axis without one goes on with the law on key temperatures, at an unknown cost
        ("d", {"X": "a", "V": None}, {}, {}, {"EXX": (1.0, 2.0), "EXV": None}, ()),
        ("h", {"Y": None}, {}, {}, {"EXY": None}, ()),
        # neither the law nor its fallback can do without `a`: the fallback of the law on key temperatures takes over,
        # at a cost that counts from heat history, where its cost is known
        ("a", {"X": None, "W": None}, {"X": "b"}, {"": None}, {"EXX": (1.0, 4.0), "EXW": None}, ()),
        # the law on key temperatures is not in use: nothing is replaced and nothing ends
        ("e", {}, {"W": "f"}, {}, {}, ()),
        ("g", {}, {}, {}, {}, ()),
        ("ef", {}, {}, {}, {}, ()),
        # an axis without anything left ends, the others go on
        ("b", {"Y": None}, {"Y": None}, {"X": None}, {"EXY": None}, ("EXY",)),
        ("c", {}, {"": None}, {}, {}, ("DX",)),
        ("dg", {"X": "a", "V": None}, {"V": None}, {}, {"EXX": (1.0, 2.0), "EXV": None}, ("EXV",)),
        ("ab", {"X": None, "Y": None, "W": None}, {"X": None, "Y": None}, {"": None, "X": None},
         {"EXX": None, "EXY": None, "EXW": None}, ("EXX", "EXY")),
    ],
)  # fmt: skip
def test_every_axis_goes_on_with_the_best_that_is_left_and_the_others_as_they_were(
    lost: str,
    history: dict[str, str | None],
    static: dict[str, str | None],
    turned: dict[str, str | None],
    replaced: dict[str, tuple[float, float] | None],
    ended: tuple[str, ...],
) -> None:
    """What differs from the whole model by axis: the sensors of the law that takes over, None where there is none."""
    whole = document({}, {}, {}).model_copy(update={"control": STATIC, "prediction": HISTORY, "rotations": TURNED})
    found = degraded(whole, set(lost))
    for before, after, changes in (
        (HISTORY, found.model.prediction, history),
        (STATIC, found.model.control, static),
        (TURNED, found.model.rotations, turned),
    ):
        expected = {name: changes.get(name, text) for name, text in sensors_of(before).items()}
        assert sensors_of(after) == {name: text for name, text in expected.items() if text is not None}
        assert all(after[name] is before[name] for name in after if name not in changes)
    costs = {name: a and (a.full_rms_um, a.without_rms_um) for name, a in found.replaced.items()}
    assert (costs, found.ended) == (replaced, ended)


def test_a_prediction_names_what_was_replaced_on_the_axes_asked_for_alone() -> None:
    """`a` is missing in the table: X and W both change, and only one of them is asked for."""
    laws = {"X": STATIC["X"], "Y": law("Y", "a", fallbacks=(ready("a", law("Y", "b")),))}
    axes = document({"X": "+X", "Y": "+Y"}, {}, {})
    heat = Temperatures(np.array([0.0, 60.0]), ("b",), np.array([[20.0], [23.0]]))
    model = axes.model_copy(update={"control": laws})

    class Rows:
        t_s, axis, position_mm = np.array([60.0]), ("Y",), np.array([1000.0])

    found = predict(model, heat, Rows())
    assert found.replaced == laws["Y"].fallbacks[0].accuracy
    assert found.error_um[0, 0] == pytest.approx(3.0 + 3.0)

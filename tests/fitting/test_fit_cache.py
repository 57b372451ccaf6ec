"""A fit is made cached: equal states give the model that was made, another number anywhere gives another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from slow_column import folder

from thetacomp.axis_states import AxisStates
from thetacomp.fitting import training
from thetacomp.fitting.calibrated import CalibratedHistory, calibrated_history
from thetacomp.fitting.fit_cache import CachedProcedure
from thetacomp.fitting.training import train
from thetacomp.model.filters import InputLayout
from thetacomp.preparation import prepare
from thetacomp.validation.judge import judge


@pytest.fixture(scope="module")
def states() -> AxisStates:
    (one,) = prepare(folder(1, 2), faults="ignore").training
    return one


def test_equal_states_are_fitted_once_and_others_anew(states: AxisStates) -> None:
    made: list[AxisStates] = []
    cached = CachedProcedure(made.append)
    cached(states)
    cached(states.take(np.arange(len(states))))
    assert len(made) == 1
    samples = replace(states.samples[0], value_um=states.samples[0].value_um + 1e-9)
    others = [
        replace(states, axis="Z"),
        replace(states, samples=(samples, *states.samples[1:])),
        replace(states, rise_K=-states.rise_K),
        replace(states, sensors=states.sensors[::-1]),
        states.take(np.arange(1, len(states))),
    ]
    for other in others:
        cached(other)
    assert len(made) == 1 + len(others)
    assert all(a is not b for a, b in pairwise(made))


def changed(value: Any) -> Any:
    """Another value of the same kind."""
    if isinstance(value, np.ndarray):
        return ~value if value.dtype == bool else value + 1
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{field.name: changed(getattr(value, field.name)) for field in fields(value)[:1]})
    if isinstance(value, bool):
        return not value
    if isinstance(value, tuple):
        return (*value[:-1], changed(value[-1]))
    if isinstance(value, InputLayout):
        return value.model_copy(update={"base_degC": value.base_degC + 1e-9})
    return value + ("+" if isinstance(value, str) else 1)


@pytest.mark.parametrize("name", [field.name for field in fields(AxisStates)])
def test_whatever_differs_in_the_states_is_another_fit(name: str, states: AxisStates) -> None:
    made: list[AxisStates] = []
    cached = CachedProcedure(made.append)
    other = replace(states, **{name: changed(getattr(states, name))})
    for given in (states, other, states, other):
        cached(given)
    assert made == [states, other]


def test_the_same_bytes_in_another_shape_or_type_are_another_fit(states: AxisStates) -> None:
    made: list[AxisStates] = []
    cached = CachedProcedure(made.append)
    n = len(states)
    rises = np.arange(2.0 * n).reshape(n, 2)
    for rise_K in (rises, rises.reshape(2, n), rises.view(np.int64), np.asfortranarray(rises)):
        cached(replace(states, rise_K=rise_K))
    assert len(made) == 3  # how the numbers lie in memory is no difference


def test_the_whole_and_every_fold_are_fitted_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four campaigns: the stored model, four folds, and two of the campaigns for the split forward in time."""
    trained_on: list[tuple[int, ...]] = []

    def counted(states: AxisStates) -> CalibratedHistory:
        trained_on.append(tuple(np.unique(states.campaign).tolist()))
        return calibrated_history(states)

    procedure: Callable[[AxisStates], CalibratedHistory] = counted
    monkeypatch.setattr(training, "calibrated_history", procedure)
    prepared = prepare(folder(1, 2, 3, 4), faults="ignore")
    trained = train(prepared, lost=())
    judged = judge(prepared, trained)
    assert sorted(trained_on) == [(0, 1), (0, 1, 2), (0, 1, 2, 3), (0, 1, 3), (0, 2, 3), (1, 2, 3)]
    assert "fit for use" in repr(judged)

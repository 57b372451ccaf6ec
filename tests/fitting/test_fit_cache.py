"""A fit is made cached: equal states give the model that was made, another number anywhere gives another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from slow_column import folder

from thetacomp.axis_states import AxisStates
from thetacomp.fitting import training
from thetacomp.fitting.calibrated import CalibratedHistory, calibrated_history
from thetacomp.fitting.fit_cache import CachedProcedure
from thetacomp.fitting.training import train
from thetacomp.preparation import prepare
from thetacomp.validation.judge import judge


def test_equal_states_are_fitted_once_and_others_anew() -> None:
    (states,) = prepare(folder(1, 2), faults="ignore").training
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

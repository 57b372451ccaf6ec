"""For every key sensor a ready model without it, made by the same procedure, with its held-out accuracy."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thetacomp.campaign import Floats, Ints
from thetacomp.errors import AnalysisError
from thetacomp.models.axis_model import ELAPSED_TIME, AxisModel, Procedure
from thetacomp.models.document import Accuracy
from thetacomp.models.ridge import Candidate, HistoryRidge, history_candidates
from thetacomp.states import AxisStates
from thetacomp.temperature.history import HistoryLayout

Split = tuple[Ints, Ints]
"""Rows that train and rows that test."""


@dataclass(frozen=True)
class AxisFallback:
    """The model of one axis without the sensor `lost`, on `states` that do not have it."""

    lost: str
    states: AxisStates
    model: AxisModel
    accuracy: Mapping[str, Accuracy]


@dataclass(frozen=True)
class HistoryFallback:
    """The model with heat history without the sensor `lost`, and the layout of its inputs."""

    lost: str
    layout: HistoryLayout
    model: HistoryRidge
    accuracy: Accuracy


def states_without(states: AxisStates, sensor: str) -> AxisStates:
    """The same states and samples without one sensor.

    Heat history is left out: its products hold the mean rise of all sensors. `history_fallbacks` makes it anew.
    """
    column = states.sensors.index(sensor)
    return replace(
        states,
        sensors=tuple(name for name in states.sensors if name != sensor),
        rise_K=np.delete(states.rise_K, column, axis=1),
        reference_degC=np.delete(states.reference_degC, column, axis=1),
        history=np.empty((len(states), 0)),
        reference_history=np.empty((len(states), 0)),
        layout=None,
        samples=tuple(
            replace(
                samples,
                rise_K=np.delete(samples.rise_K, column, axis=1),
                history=np.empty((len(samples.value_um), 0)),
            )
            for samples in states.samples
        ),
    )


def axis_fallbacks(
    states: AxisStates, model: AxisModel, procedure: Procedure, folds: Sequence[Split]
) -> tuple[AxisFallback, ...]:
    """A fallback for every input of an axis model; the whole procedure runs again, also inside every fold.

    A sensor that the procedure cannot do without (AnalysisError) has none.
    """
    out = []
    full_um = _held_out_um(states, procedure, folds)
    for lost in model.inputs:
        if lost == ELAPSED_TIME:
            continue
        rest = states_without(states, lost)
        try:
            fallback, without_um = procedure(rest), _held_out_um(rest, procedure, folds)
        except AnalysisError:
            continue
        accuracy = {
            name: _accuracy(states.samples[k].value_um, full_um[k], without_um[k])
            for k, name in enumerate(states.components)
        }
        out.append(AxisFallback(lost, rest, fallback, accuracy))
    return tuple(out)


def history_fallbacks(
    layout: HistoryLayout,
    inputs_of: Callable[[HistoryLayout], Floats],
    error_um: Floats,
    campaign: NDArray[Any],
    folds: int,
    candidates_of: Callable[[HistoryLayout], tuple[Candidate, ...]] = history_candidates,
) -> tuple[HistoryFallback, ...]:
    """A fallback for every sensor of a layout with heat history.

    `inputs_of` gives the inputs (n, inputs) that a layout makes of the training recordings, `error_um` (n,) the errors
    and `campaign` (n,) their campaigns, which are held out in `folds` groups.
    Raises AnalysisError for a layout of one sensor, or as `HistoryRidge.fit` does.
    """
    if len(layout.sensors) < 2:
        raise AnalysisError("a model with one sensor has no fallback. Fix: keep at least two sensors in the model.")

    def fit(used: HistoryLayout, inputs: Floats, rows: Ints) -> HistoryRidge:
        return HistoryRidge(used.blocks, candidates_of(used)).fit(inputs[rows], error_um[rows], campaign[rows])

    def held_out_um(used: HistoryLayout, inputs: Floats) -> Floats:
        predicted = np.empty(len(error_um))
        for train, test in splits:
            predicted[test] = fit(used, inputs, train).predict(inputs[test])
        return predicted

    labels, index = np.unique(campaign, return_inverse=True)
    fold_of = (np.arange(len(labels)) % folds)[index]
    splits = [(np.flatnonzero(fold_of != fold), np.flatnonzero(fold_of == fold)) for fold in np.unique(fold_of)]
    full_um = held_out_um(layout, inputs_of(layout))
    out = []
    for lost in layout.sensors:
        rest = layout.model_copy(update={"sensors": tuple(name for name in layout.sensors if name != lost)})
        inputs = inputs_of(rest)
        accuracy = _accuracy(error_um, full_um, held_out_um(rest, inputs))
        out.append(HistoryFallback(lost, rest, fit(rest, inputs, np.arange(len(error_um))), accuracy))
    return tuple(out)


def _held_out_um(states: AxisStates, procedure: Procedure, folds: Sequence[Split]) -> list[Floats]:
    """Predictions of all samples of every component by models that did not see their states; NaN where untested."""
    out = [np.full(len(samples.value_um), np.nan) for samples in states.samples]
    for train, test in folds:
        model = procedure(states.take(train))
        for k, name in enumerate(states.components):
            chosen = np.isin(states.samples[k].state, test)
            out[k][chosen] = model.predict(name, states, states.samples[k].take(chosen))[0]
    return out


def _accuracy(measured_um: Floats, full_um: Floats, without_um: Floats) -> Accuracy:
    known = np.isfinite(full_um) & np.isfinite(without_um) & np.isfinite(measured_um)
    if not known.any():
        raise AnalysisError("no held-out sample is predicted with and without the sensor.")
    rms = [
        float(np.sqrt(np.mean(part[known] ** 2)))
        for part in (measured_um - full_um, measured_um - without_um, measured_um)
    ]
    return Accuracy(full_rms_um=rms[0], without_rms_um=rms[1], nothing_rms_um=rms[2])

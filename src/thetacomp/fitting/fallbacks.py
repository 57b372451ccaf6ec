"""For every sensor of a law a ready law without it, fitted by the same procedure, with its held-out accuracy."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thetacomp.arrays import Floats, Ints
from thetacomp.axis_states import AxisStates
from thetacomp.errors import AnalysisError
from thetacomp.fitting.calibrated import CalibratedHistory, component, left_out_um
from thetacomp.fitting.conformal import as_tuple
from thetacomp.fitting.history_model import history_procedure
from thetacomp.fitting.key_point_law import ELAPSED_TIME, AxisModel, Procedure
from thetacomp.model.document import Accuracy, AxisLaw, Fallback

Split = tuple[Ints, Ints]
"""Rows that train and rows that test."""


@dataclass(frozen=True)
class AxisFallback:
    """The model of one axis without the sensor `lost`, on `states` that do not have it."""

    lost: str
    states: AxisStates
    model: AxisModel
    accuracy: Mapping[str, Accuracy]


def states_without(states: AxisStates, sensor: str) -> AxisStates:
    """The same states and samples without one sensor, heat history too where it has it."""
    column = states.sensors.index(sensor)
    plain = replace(
        states,
        sensors=tuple(name for name in states.sensors if name != sensor),
        rise_K=np.delete(states.rise_K, column, axis=1),
        reference_degC=np.delete(states.reference_degC, column, axis=1),
        samples=tuple(replace(s, rise_K=np.delete(s.rise_K, column, axis=1)) for s in states.samples),
    )
    layout = states.layout
    if layout is None or sensor not in layout.sensors:
        return plain
    if len(layout.sensors) == 1:
        return _without_history(plain)
    columns, passed = layout.running, states.trajectory
    references = {int(c): states.reference_history[states.campaign == c][0] for c in np.unique(states.campaign)}

    def left(inputs: Floats, campaign: Ints) -> Floats:
        """Inputs of the smaller layout since the same references, from those of the layout."""
        out = np.empty((len(inputs), sum(map(len, layout.without(sensor).blocks.values()))))
        for label, reference in references.items():
            own = campaign == label
            running = layout.running_without(sensor, inputs[own, :columns] + reference)
            zero = layout.running_without(sensor, reference[None])[0]
            out[own] = layout.without(sensor).since(running, zero)
        return out

    inputs = sum(map(len, layout.blocks.values()))
    degC = np.delete(passed.inputs[:, inputs:], layout.sensors.index(sensor), axis=1)
    return replace(
        plain,
        layout=layout.without(sensor),
        history=left(states.history, states.campaign),
        reference_history=layout.running_without(sensor, states.reference_history),
        samples=tuple(replace(s, history=left(s.history, states.campaign[s.state])) for s in plain.samples),
        trajectory=replace(passed, inputs=np.hstack([left(passed.inputs[:, :inputs], passed.campaign), degC])),
    )


def _without_history(states: AxisStates) -> AxisStates:
    nothing = np.empty((len(states), 0))
    samples = tuple(replace(s, history=np.empty((len(s.value_um), 0))) for s in states.samples)
    return replace(states, layout=None, history=nothing, reference_history=nothing, samples=samples)


def axis_fallbacks(
    states: AxisStates, model: AxisModel, procedure: Procedure, folds: Sequence[Split]
) -> tuple[AxisFallback, ...]:
    """A fallback for every input of an axis model; the whole procedure runs again, also inside every fold.

    A sensor that the procedure needs (AnalysisError) has none.
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
            name: accuracy_of(states.samples[k].value_um, full_um[k], without_um[k])
            for k, name in enumerate(states.components)
        }
        out.append(AxisFallback(lost, rest, fallback, accuracy))
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


def with_fallbacks(states: AxisStates, whole: CalibratedHistory, wanted: Collection[str] | None = None) -> AxisLaw:
    """The document of an axis with a fallback for each sensor of its layout; none for a layout of one sensor.

    `states` are those that `whole` was fitted on. A fallback takes strengths and weights over from it. `wanted` names
    the sensors that need one, all by default.
    """
    axis = whole.document
    sensors = axis.layout.sensors if len(axis.layout.sensors) > 1 else ()
    made = [_history_fallback(states, whole, lost) for lost in sensors if wanted is None or lost in wanted]
    return axis.model_copy(update={"fallbacks": tuple(made)})


def _history_fallback(states: AxisStates, whole: CalibratedHistory, lost: str) -> Fallback:
    """The band is that of the full model times what the loss costs, never narrower."""
    rest = states_without(states, lost)
    model = history_procedure(rest, whole.model)
    accuracy, components = {}, {}
    for k, name in enumerate(states.components):
        known = accuracy_of(states.samples[k].value_um, whole.left_out_um[name], left_out_um(rest, model, k))
        full = whole.components[name].band
        factor = max(1.0, known.without_rms_um / known.full_rms_um) if known.full_rms_um > 0 else 1.0
        band = replace(full, quantile=factor * (full.quantile or 0.0))
        accuracy[name], components[name] = known, component(rest, model, k, band)
    zero = as_tuple(rest.reference_history[0])
    return Fallback(
        lost=lost,
        layout=model.layout,
        reference=whole.document.reference.model_copy(update={"inputs": zero}),
        components=components,
        accuracy=accuracy,
    )


def accuracy_of(measured_um: Floats, full_um: Floats, without_um: Floats) -> Accuracy:
    """Held-out RMS errors of n samples with and without a sensor, where both predict. AnalysisError where none does."""
    known = np.isfinite(full_um) & np.isfinite(without_um) & np.isfinite(measured_um)
    if not known.any():
        raise AnalysisError("no held-out sample is predicted with and without the sensor.")
    rms = [
        float(np.sqrt(np.mean(part[known] ** 2)))
        for part in (measured_um - full_um, measured_um - without_um, measured_um)
    ]
    return Accuracy(full_rms_um=rms[0], without_rms_um=rms[1], nothing_rms_um=rms[2])

"""For every sensor of a law a ready law without it, made by the same procedure, with its held-out accuracy."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thetacomp.arrays import Floats, Ints
from thetacomp.axis_states import AxisStates, axis_states
from thetacomp.campaign import MachineFolder
from thetacomp.errors import AnalysisError
from thetacomp.fitting.calibrated import CalibratedHistory, calibrated_history
from thetacomp.fitting.key_point_law import ELAPSED_TIME, AxisModel, Procedure
from thetacomp.model.document import Accuracy, AxisLaw, Component, Fallback
from thetacomp.separation.component import ComponentSeparation

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
    """The same states and samples without one sensor.

    Heat history is left out: its products hold the mean rise of all sensors.
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


def with_fallbacks(
    folder: MachineFolder,
    separations: Sequence[ComponentSeparation],
    campaigns: Sequence[str],
    states: AxisStates,
    whole: CalibratedHistory,
    wanted: Collection[str] | None = None,
) -> AxisLaw:
    """The document of an axis with a fallback for each sensor of its layout; none for a layout of one sensor.

    `states` are those that `whole` was fitted on, from `separations` of the training `campaigns`. `wanted` names the
    sensors that need one, all by default: every fallback is fitted on its own.
    """
    axis = whole.document
    own = [s for s in separations if (s.axis or "") == states.axis]
    sensors = axis.layout.sensors if len(axis.layout.sensors) > 1 else ()
    made = []
    for lost in sensors if wanted is None else [name for name in sensors if name in wanted]:
        (rest,) = axis_states(folder.without_sensors({lost}), own, campaigns)
        fitted = calibrated_history(rest)
        accuracy = {
            name: accuracy_of(states.samples[k].value_um, whole.left_out_um[name], fitted.left_out_um[name])
            for k, name in enumerate(states.components)
        }
        components = {name: _widened(c, axis.components[name], accuracy[name]) for name, c in fitted.components.items()}
        made.append(
            Fallback(
                lost=lost,
                layout=fitted.document.layout,
                reference=fitted.document.reference,
                components=components,
                accuracy=accuracy,
            )
        )
    return axis.model_copy(update={"fallbacks": tuple(made)})


def _widened(component: Component, full: Component, accuracy: Accuracy) -> Component:
    """The component with the band of the full model times what the loss costs, never narrower."""
    factor = max(1.0, accuracy.without_rms_um / accuracy.full_rms_um) if accuracy.full_rms_um > 0 else 1.0
    quantile, noise_sd_um = factor * (full.band.quantile or 0.0), component.band.noise_sd_um
    return component.model_copy(update={"band": replace(full.band, quantile=quantile, noise_sd_um=noise_sd_um)})


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

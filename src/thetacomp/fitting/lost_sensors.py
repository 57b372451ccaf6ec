"""For every sensor of a heat-history model a ready model without it, with its held-out accuracy."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

from thetacomp.axis_states import AxisStates, axis_states
from thetacomp.campaign import MachineFolder
from thetacomp.fitting.calibrated import CalibratedHistory, calibrated_history
from thetacomp.fitting.fallbacks import accuracy_of
from thetacomp.model.document import Accuracy, AxisLaw, Component, Fallback
from thetacomp.separation.component import ComponentSeparation


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

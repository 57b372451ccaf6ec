"""The thermal law of an axis on heat history: inputs in, errors and their 95 % bands out.

Numpy only. Inside the border of validity the model speaks alone, outside it fades towards the prior (`fade`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.errors import ModelFileError
from thetacomp.model.document import HistoryAxis, HistoryComponent
from thetacomp.model.fade import faded_um, model_weight
from thetacomp.model.leverage import Reach


@dataclass(frozen=True)
class HistoryMoments:
    """What a law needs to know of n moments.

    `moved` (n, k) are the inputs of the layout as differences from the reference, `temperature_degC` (n, p) the
    temperatures of its sensors.
    """

    moved: Floats
    temperature_degC: Floats


@dataclass(frozen=True)
class HistoryLaw:
    """The laws of one axis, with the work that its components share done once for n moments."""

    axis: HistoryAxis
    moments: HistoryMoments

    @cached_property
    def distance(self) -> Floats:
        """Distance from training, (n,): up to 1 inside the border, infinite where an input is missing."""
        return self.axis.validity.distance(np.hstack([self.moments.moved, self.moments.temperature_degC]))

    @cached_property
    def _leverage(self) -> Floats:
        return self.axis.reach.leverage(self.moments.moved)

    def error_um(self, component: str, lever_m: Floats) -> Floats:
        """Error of a component (n,) at distances `lever_m` (n,) from P0, which play no part for drift."""
        own = self.axis.components[component]
        error_um = self._faded(own.intercept_um, own.prior_intercept_um_per_K)
        for power, model, prior in (
            (1, own.slope_um_per_m, own.prior_slope_um_per_m_per_K),
            (2, own.bend_um_per_m2, own.prior_bend_um_per_m2_per_K),
        ):
            if model is not None and prior is not None:
                error_um = error_um + self._faded(model, prior) * lever_m**power
        return error_um

    def half_width_um(self, component: str) -> Floats:
        """Half of the 95 % band of a component, (n,), at any position of the travel."""
        return self.axis.components[component].band.half_width_um(self._leverage)

    def _faded(self, model: tuple[float, ...], prior: tuple[float, ...]) -> Floats:
        weight = model_weight(self.distance)
        rise_K = self.moments.moved[:, : len(prior)]
        return faded_um(self.moments.moved @ np.array(model), rise_K @ np.array(prior), weight)


def without_sensor(axis: HistoryAxis, lost: str) -> HistoryAxis | None:
    """The model of an axis without one of its sensors, from its fallback; None where there is no such fallback.

    Reach and border are those of the full model, seen in the inputs that are left.
    """
    ready = next((fallback for fallback in axis.fallbacks if fallback.lost == lost), None)
    if ready is None:
        return None
    sensors = axis.layout.sensors
    inputs = [name for block in axis.layout.blocks.values() for name in block]
    left = {name for block in ready.layout.blocks.values() for name in block}
    kept = [j for j, name in enumerate(inputs) if name in left]
    kept_border = kept + [len(inputs) + j for j, name in enumerate(sensors) if name != lost]
    validity = replace(
        axis.validity,
        reach=_of_inputs(axis.validity.reach, kept_border),
        middle=tuple(axis.validity.middle[j] for j in kept_border),
        half_span=tuple(axis.validity.half_span[j] for j in kept_border),
    )
    return axis.model_copy(
        update={
            "layout": ready.layout,
            "reference": axis.reference.model_copy(update={"inputs": ready.reference_inputs}),
            "reach": _of_inputs(axis.reach, kept),
            "validity": validity,
            "components": ready.components,
            "fallbacks": (),
        }
    )


def _of_inputs(reach: Reach, kept: Sequence[int]) -> Reach:
    return replace(
        reach,
        centre=tuple(reach.centre[j] for j in kept),
        scale=tuple(reach.scale[j] for j in kept),
        directions=tuple(tuple(direction[j] for j in kept) for direction in reach.directions),
    )


def check_history(name: str, axis: HistoryAxis) -> None:
    """Raise ModelFileError where the document of an axis contradicts itself."""
    inputs = sum(len(block) for block in axis.layout.blocks.values())
    sensors = len(axis.layout.sensors)
    found = []
    if len(axis.reference.inputs) != inputs or len(axis.reach.scale) != inputs:
        found.append(f"the layout has {inputs} inputs, the reference or the reach another number")
    if len(axis.validity.middle) != inputs + sensors:
        found.append(f"the border of validity is not one of {inputs + sensors} inputs")
    if (axis.axis or "") != name:
        found.append(f"it is the model of axis {axis.axis}")
    for label, component in axis.components.items():
        found += [f"{label}: {problem}" for problem in _problems(component, inputs, sensors, drift=axis.axis is None)]
    if found:
        told = "; ".join(found)
        raise ModelFileError(f"model history {name or 'drift'}: {told}. Fix: run `thetacomp analyze` again.")


def _problems(component: HistoryComponent, inputs: int, sensors: int, *, drift: bool) -> list[str]:
    out = []
    for what, values, size in (
        ("intercept", component.intercept_um, inputs),
        ("slope", component.slope_um_per_m, inputs),
        ("bend", component.bend_um_per_m2, inputs),
        ("prior of the intercept", component.prior_intercept_um_per_K, sensors),
        ("prior of the slope", component.prior_slope_um_per_m_per_K, sensors),
        ("prior of the bend", component.prior_bend_um_per_m2_per_K, sensors),
    ):
        if values is not None and len(values) != size:
            out.append(f"{what} has {len(values)} coefficients for {size} inputs")
        if "bend" not in what and (values is None) != (drift and "slope" in what):
            out.append(f"{what} {'missing' if values is None else 'of a drift'}")
    if (component.bend_um_per_m2 is None) != (component.prior_bend_um_per_m2_per_K is None):
        out.append("the bend and its prior do not come together")
    if drift and component.bend_um_per_m2 is not None:
        out.append("bend of a drift")
    return out

"""From fitted axis models to the stored document, with the equations in print."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np

from thetacomp import __version__
from thetacomp.campaign import MachineFolder
from thetacomp.fitting.fallbacks import AxisFallback
from thetacomp.fitting.key_point_law import AxisModel
from thetacomp.fitting.linear import ThermalRegression
from thetacomp.model.document import Component, Fallback, HistoryAxis, LinearTerm, ModelDocument, Reference, Training
from thetacomp.states import DRIFT, AxisStates


def build_document(
    folder: MachineFolder,
    fitted: Sequence[tuple[AxisStates, AxisModel]],
    method: str,
    train: Sequence[str],
    notes: Sequence[str] = (),
    fallbacks: Sequence[AxisFallback] = (),
    history: Sequence[HistoryAxis] = (),
) -> ModelDocument:
    """The document of all axes. The stored reference is that of the first training campaign of each axis."""
    campaigns = [folder.campaign(name) for name in train]
    components: dict[str, Component] = {}
    ranges: dict[str, tuple[float, float]] = {}
    rises: dict[str, tuple[float, float]] = {}
    for states, model in (*fitted, *((item.states, item.model) for item in fallbacks)):
        for name in model.inputs:
            column = states.sensors.index(name)
            rise = states.rise_K[:, column]
            reading = rise + states.reference_degC[:, column]
            rises[name] = _widen(rises.get(name), rise)
            ranges[name] = _widen(ranges.get(name), reading)
    for states, model in fitted:
        for k, component in enumerate(states.components):
            components[component] = component_of(states, model, k)
    unproven = any(campaign.settings.sign == "unproven" for campaign in campaigns)
    return ModelDocument(
        version=__version__,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        machine=folder.machine.name,
        axes=folder.machine.axes,
        length=folder.machine.length,
        sign="unproven" if unproven else "stated",
        method=method,
        components=components,
        training=Training(
            campaigns=tuple(train),
            mode="; ".join(dict.fromkeys(c.settings.mode for c in campaigns if c.settings.mode)),
            instrument="; ".join(dict.fromkeys(c.settings.instrument for c in campaigns if c.settings.instrument)),
            datum=campaigns[0].settings.datum,
            range_degC=ranges,
            range_rise_K=rises,
        ),
        notes=tuple(notes),
        fallbacks=_fallbacks(fallbacks),
        history={axis.axis or DRIFT: axis for axis in history},
    )


def _fallbacks(fallbacks: Sequence[AxisFallback]) -> tuple[Fallback, ...]:
    """One entry a lost sensor, with the components of all axes that use it."""
    return tuple(
        Fallback(
            lost=lost,
            components={
                name: component_of(item.states, item.model, k)
                for item in fallbacks
                if item.lost == lost
                for k, name in enumerate(item.states.components)
            },
            accuracy={name: value for item in fallbacks if item.lost == lost for name, value in item.accuracy.items()},
        )
        for lost in dict.fromkeys(item.lost for item in fallbacks)
    )


def _widen(span: tuple[float, float] | None, values: np.ndarray) -> tuple[float, float]:
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    return (low, high) if span is None else (min(low, span[0]), max(high, span[1]))


def component_of(states: AxisStates, model: AxisModel, k: int, direction: str = "") -> Component:
    """The stored component number k of an axis, with its equation in print; `direction` where no name says it."""
    name = states.components[k]
    regression = model.regressions[name]
    samples = states.samples[k]
    predicted, _ = model.predict(name, states, samples)
    residual = (samples.value_um - predicted)[np.isfinite(predicted)]
    columns = [states.sensors.index(sensor) for sensor in model.inputs]
    reference = Reference(
        campaign=states.campaigns[int(states.campaign[0])],
        t_s=float(states.reference_s[0]),
        temperature_degC={
            sensor: float(states.reference_degC[0, column])
            for sensor, column in zip(model.inputs, columns, strict=True)
        },
    )
    covariance = regression.residual_covariance_
    correlation = 0.0
    if not states.is_drift and covariance[0, 0] > 0 and covariance[1, 1] > 0:
        correlation = float(covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1]))
    drift = states.is_drift
    return Component.model_validate(
        {
            "direction": direction or name[1],
            "axis": None if drift else states.axis,
            "p0_mm": None if drift else states.p0_mm,
            "p_min_mm": None if drift else states.p_min_mm,
            "p_max_mm": None if drift else states.p_max_mm,
            "reference": reference,
            "inputs": model.inputs,
            "intercept": _term(regression, 0, len(model.inputs)),
            "slope": None if drift else _term(regression, 1, len(model.inputs)),
            "residual_correlation": correlation,
            "through_zero": states.exact_zero,
            "dof": int(regression.dof_),
            "states": int(regression.states_),
            "residual_um": (float(np.sqrt(np.mean(residual**2))), float(np.abs(residual).max())),
            "equation": equation(states, model, k),
        }
    )


def _term(regression: ThermalRegression, j: int, inputs: int) -> LinearTerm:
    covariance = regression.residual_covariance_[j, j] * regression.unscaled_covariance_
    return LinearTerm(
        constant=float(regression.intercept_[j]),
        coefficients_per_K=tuple(float(c) for c in regression.coef_[j, :inputs]),
        covariance=tuple(tuple(float(v) for v in row[: inputs + 1]) for row in covariance[: inputs + 1]),
        residual_sd=float(np.sqrt(regression.residual_covariance_[j, j])),
        r_squared=float(regression.r_squared_[j]),
    )


def equation(states: AxisStates, model: AxisModel, k: int) -> str:
    """The component's equation in print, as in the paper: µm, µm/m, °C; positions in mm.

    Absolute temperatures θ where all states share one reference, else rises Δθ above each campaign's reference.
    """
    name = states.components[k]
    regression = model.regressions[name]
    columns = [states.sensors.index(sensor) for sensor in model.inputs]
    coefficients = regression.coef_[:, : len(columns)]
    reference = states.reference_degC[:, columns]
    absolute = bool(np.all(np.abs(reference - reference[:1]) < 1e-9))
    zero = reference[0] if absolute else np.zeros(len(columns))
    terms = [
        _linear_text(float(regression.intercept_[j] - coefficients[j] @ zero), coefficients[j], model, absolute)
        for j in range(len(regression.intercept_))
    ]
    units = "temperatures in °C" if absolute else "Δ: rise above the reference in K"
    if states.is_drift:
        return f"{name} = {terms[0]}   [µm; {units}]"
    lever = f"({states.axis} - {states.p0_mm:g})" if states.p0_mm else states.axis
    if states.exact_zero and not np.any(states.intercept_um[:, k]):
        # Joint form: the drift of all axes is a component of its own.
        return f"{name} = ({terms[1]}) {lever}/1000   [µm; {states.axis} in mm, {units}]"
    return f"{name} = ({terms[1]}) {lever}/1000 + ({terms[0]})   [µm; {states.axis} in mm, {units}]"


def _linear_text(constant: float, coefficients: np.ndarray, model: AxisModel, absolute: bool) -> str:
    text = f"{constant:.4g}" if constant or not len(coefficients) else ""
    for sensor, coefficient in zip(model.inputs, coefficients, strict=True):
        sign = "-" if coefficient < 0 else "+" if text else ""
        text += f" {sign} {abs(coefficient):.4g} {'' if absolute else 'Δ'}{sensor}"
    return " ".join(text.split())

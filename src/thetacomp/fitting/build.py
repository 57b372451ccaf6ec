"""From fitted axis models to the stored document, with the equations in print."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import UTC, datetime

import numpy as np

from thetacomp import __version__
from thetacomp.arrays import CARTESIAN
from thetacomp.axis_states import AxisStates
from thetacomp.campaign import MachineFolder
from thetacomp.fitting.fallbacks import AxisFallback
from thetacomp.fitting.key_point_law import COVERAGE, AxisModel
from thetacomp.fitting.linear import ThermalRegression
from thetacomp.model.band import Band
from thetacomp.model.border import Border
from thetacomp.model.document import AxisLaw, Component, Fallback, ModelDocument, Reference, Term, Training
from thetacomp.model.filters import InputLayout
from thetacomp.model.leverage import Leverage, regression_leverage
from thetacomp.model.student import t_quantile


def build_document(
    folder: MachineFolder,
    fitted: Sequence[tuple[AxisStates, AxisModel]],
    method: str,
    train: Sequence[str],
    notes: Sequence[str] = (),
    fallbacks: Sequence[AxisFallback] = (),
    history: Sequence[AxisLaw] = (),
) -> ModelDocument:
    """The document of all axes. The stored reference is that of the first training campaign of each axis."""
    campaigns = [folder.campaign(name) for name in train]
    datum = campaigns[0].settings.datum
    # One box serves all axes: what one axis has shown of a sensor is known of the machine.
    ranges = training_ranges([*fitted, *((item.states, item.model) for item in fallbacks)])
    laws = {states.axis: key_point_law(states, model, ranges, datum) for states, model in fitted}
    for axis, law in laws.items():
        ready = tuple(_fallback(item, ranges, datum) for item in fallbacks if item.states.axis == axis)
        laws[axis] = law.model_copy(update={"fallbacks": ready})
    unproven = any(campaign.settings.sign == "unproven" for campaign in campaigns)
    return ModelDocument(
        version=__version__,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        machine=folder.machine.name,
        axes=folder.machine.axes,
        length=folder.machine.length,
        sign="unproven" if unproven else "stated",
        method=method,
        control=laws,
        prediction={law.axis: law for law in history},
        training=Training(
            campaigns=tuple(train),
            mode="; ".join(dict.fromkeys(c.settings.mode for c in campaigns if c.settings.mode)),
            instrument="; ".join(dict.fromkeys(c.settings.instrument for c in campaigns if c.settings.instrument)),
            datum=datum,
        ),
        notes=tuple(notes),
    )


def training_ranges(fitted: Iterable[tuple[AxisStates, AxisModel]]) -> Border:
    """What the training states of all axes show of every sensor in use: temperatures in °C and rises in K."""
    degC: dict[str, tuple[float, float]] = {}
    rises_K: dict[str, tuple[float, float]] = {}
    for states, model in fitted:
        for name in model.inputs:
            column = states.sensors.index(name)
            rise = states.rise_K[:, column]
            rises_K[name] = _widen(rises_K.get(name), rise)
            degC[name] = _widen(degC.get(name), rise + states.reference_degC[:, column])
    return Border(degC, rises_K)


def key_point_law(states: AxisStates, model: AxisModel, ranges: Border, datum: str) -> AxisLaw:
    """The stored law of one axis on its key temperatures, zero at the reference of its first campaign."""
    inputs, drift = model.inputs, states.is_drift
    columns = [states.sensors.index(sensor) for sensor in inputs]
    leverages = [_leverage(model.regressions[name], len(inputs)) for name in states.components]
    components = {}
    for k, name in enumerate(states.components):
        # Components of an axis share their states, but for those in which a value is missing.
        own = None if leverages[k] == leverages[0] else leverages[k]
        components[name] = _component(states, model, k, own)
    return AxisLaw(
        axis=states.axis,
        p0_mm=None if drift else states.p0_mm,
        p_min_mm=None if drift else states.p_min_mm,
        p_max_mm=None if drift else states.p_max_mm,
        layout=InputLayout.plain(inputs),
        reference=Reference(
            campaign=states.campaigns[int(states.campaign[0])],
            t_s=float(states.reference_s[0]),
            inputs=tuple(states.reference_degC[0, columns].tolist()),
        ),
        leverage=leverages[0],
        border=Border(
            temperature_degC={sensor: ranges.temperature_degC[sensor] for sensor in inputs},
            rise_K={sensor: ranges.rise_K[sensor] for sensor in inputs},
            rise_counts=datum == "campaign",
        ),
        components=components,
    )


def _fallback(item: AxisFallback, ranges: Border, datum: str) -> Fallback:
    law = key_point_law(item.states, item.model, ranges, datum)
    return Fallback(
        lost=item.lost,
        layout=law.layout,
        reference=law.reference,
        components=law.components,
        accuracy=dict(item.accuracy),
        leverage=law.leverage,
        border=law.border,
    )


def _widen(span: tuple[float, float] | None, values: np.ndarray) -> tuple[float, float]:
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    return (low, high) if span is None else (min(low, span[0]), max(high, span[1]))


def _component(states: AxisStates, model: AxisModel, k: int, leverage: Leverage | None) -> Component:
    """The stored component number k of an axis, with its equation in print."""
    name = states.components[k]
    regression = model.regressions[name]
    samples = states.samples[k]
    predicted, _ = model.predict(name, states, samples)
    residual = (samples.value_um - predicted)[np.isfinite(predicted)]
    covariance, dof = regression.residual_covariance_, int(regression.dof_)
    correlation = 0.0
    if not states.is_drift and covariance[0, 0] > 0 and covariance[1, 1] > 0:
        correlation = float(covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1]))
    return Component.model_validate(
        {
            "direction": name[1] if name[1] in CARTESIAN else CARTESIAN["ABC".index(name[1])],
            "terms": tuple(_term(regression, j, len(model.inputs)) for j in range(len(regression.intercept_))),
            "band": Band(
                quantile=t_quantile(0.5 + COVERAGE / 2, dof) if dof else None,
                sd=tuple(np.sqrt(np.diag(covariance)).tolist()),
                correlation=correlation,
            ),
            "leverage": leverage,
            "through_zero": states.exact_zero,
            "dof": dof,
            "states": int(regression.states_),
            "residual_um": (float(np.sqrt(np.mean(residual**2))), float(np.abs(residual).max())),
            "equation": equation(states, model, k),
        }
    )


def _leverage(regression: ThermalRegression, inputs: int) -> Leverage:
    return regression_leverage(regression.unscaled_covariance_[: inputs + 1, : inputs + 1])


def _term(regression: ThermalRegression, j: int, inputs: int) -> Term:
    return Term(
        constant=float(regression.intercept_[j]),
        coefficients=tuple(regression.coef_[j, :inputs].tolist()),
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

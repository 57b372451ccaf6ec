"""`model.json` of format 1, which had two kinds of law, made into one of format 2. It is read for good."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from thetacomp.arrays import Floats
from thetacomp.machine import Axis, Strict, WantedLength
from thetacomp.model import document as now
from thetacomp.model.band import Band
from thetacomp.model.border import Border, Validity
from thetacomp.model.filters import InputLayout
from thetacomp.model.leverage import Leverage, regression_leverage
from thetacomp.model.student import t_quantile

DRIFT = ""


class _Reference(Strict):
    campaign: str
    t_s: float
    temperature_degC: dict[str, float]


class _LinearTerm(Strict):
    constant: float
    coefficients_per_K: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    residual_sd: Annotated[float, Field(ge=0.0)]
    r_squared: float


class _Component(Strict):
    direction: Literal["X", "Y", "Z"]
    axis: str | None
    p0_mm: float | None
    p_min_mm: float | None
    p_max_mm: float | None
    reference: _Reference
    inputs: tuple[str, ...]
    intercept: _LinearTerm
    slope: _LinearTerm | None
    residual_correlation: float
    through_zero: bool = False
    dof: Annotated[int, Field(ge=0)]
    states: Annotated[int, Field(ge=0)]
    residual_um: tuple[float, float]
    held_out_um: tuple[float, float, float] | None = None
    equation: str

    @property
    def terms(self) -> dict[str, _LinearTerm]:
        return {"intercept": self.intercept} | ({} if self.slope is None else {"slope": self.slope})


class _Fallback(Strict):
    lost: str
    components: dict[str, _Component]
    accuracy: dict[str, now.Accuracy]


class _HistoryReference(Strict):
    campaign: str
    t_s: float
    inputs: tuple[float, ...]


class _Scale(Strict):
    base_um: Annotated[float, Field(ge=0.0)]
    growth_um: Annotated[float, Field(ge=0.0)]
    knee: float
    far: float


class _Band(Strict):
    level: float
    guaranteed_level: float
    attainable_level: float
    campaigns: int
    quantile: float
    scale: _Scale
    sentence: str


class _Reach(Strict):
    centre: tuple[float, ...]
    scale: tuple[float, ...]
    directions: tuple[tuple[float, ...], ...]
    moments: tuple[float, ...]
    floor: float


class _Validity(Strict):
    reach: _Reach
    middle: tuple[float, ...]
    half_span: tuple[float, ...]
    leverage_unit: float
    range_unit: float
    limit: float
    quiet_level: float
    campaigns: int
    sentence: str


class _HistoryComponent(Strict):
    direction: Literal["X", "Y", "Z"]
    intercept_um: tuple[float, ...]
    slope_um_per_m: tuple[float, ...] | None
    bend_um_per_m2: tuple[float, ...] | None = None
    prior_intercept_um_per_K: tuple[float, ...]
    prior_slope_um_per_m_per_K: tuple[float, ...] | None
    prior_bend_um_per_m2_per_K: tuple[float, ...] | None = None
    band: _Band
    residual_um: tuple[float, float]
    held_out_um: tuple[float, float, float] | None = None
    noise_sd_um: float = 0.0


class _HistoryFallback(Strict):
    lost: str
    layout: InputLayout
    reference_inputs: tuple[float, ...]
    components: dict[str, _HistoryComponent]
    accuracy: dict[str, now.Accuracy]


class _HistoryAxis(Strict):
    axis: str | None
    p0_mm: float | None
    p_min_mm: float | None
    p_max_mm: float | None
    layout: InputLayout
    reference: _HistoryReference
    reach: _Reach
    validity: _Validity
    components: dict[str, _HistoryComponent]
    campaigns: int
    candidates: int
    fallbacks: tuple[_HistoryFallback, ...] = ()


class _Training(Strict):
    campaigns: tuple[str, ...]
    mode: str
    instrument: str
    datum: Literal["campaign", "common"]
    range_degC: dict[str, tuple[float, float]]
    range_rise_K: dict[str, tuple[float, float]]


class _Document(Strict):
    kind: Literal["thetacomp model"]
    format: Literal[1]
    version: str
    created: str
    machine: str
    axes: tuple[Axis, ...]
    sign: Literal["stated", "unproven"]
    method: str
    components: dict[str, _Component]
    training: _Training
    failed_checks: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    fallbacks: tuple[_Fallback, ...] = ()
    history: dict[str, _HistoryAxis] = Field(default_factory=dict)
    failed_static_checks: tuple[str, ...] = ()
    form: Literal["separate", "joint"] = "separate"
    length: WantedLength = WantedLength()
    tool_length_mm: float = 0.0
    rotations: dict[str, _Component] = Field(default_factory=dict)


def from_format_1(raw: Mapping[str, Any]) -> now.ModelDocument:
    """The document of today from the parsed JSON of format 1. Raises ValueError where it contradicts itself."""
    old = _Document.model_validate(raw)
    control = {
        axis: _with_fallbacks(_static_law(parts, old.training), old) for axis, parts in _by_axis(old.components).items()
    }
    return now.ModelDocument(
        version=old.version,
        created=old.created,
        machine=old.machine,
        axes=old.axes,
        length=old.length,
        sign=old.sign,
        method=old.method,
        form=old.form,
        tool_length_mm=old.tool_length_mm,
        control=control,
        prediction={axis: _history_law(axis, law) for axis, law in old.history.items()},
        rotations={axis: _static_law(parts, old.training) for axis, parts in _by_axis(old.rotations).items()},
        training=now.Training(**old.training.model_dump(include=set(now.Training.model_fields))),
        failed_checks=old.failed_checks,
        failed_static_checks=old.failed_static_checks,
        notes=old.notes,
    )


def _by_axis(components: Mapping[str, _Component]) -> dict[str, dict[str, _Component]]:
    out: dict[str, dict[str, _Component]] = {}
    for name, component in components.items():
        out.setdefault(component.axis or DRIFT, {})[name] = component
    return out


def _static_law(parts: Mapping[str, _Component], training: _Training) -> now.AxisLaw:
    """The law of one axis on key temperatures; its inputs are those of all its components."""
    first = next(iter(parts.values()))
    sensors = tuple(dict.fromkeys(sensor for one in parts.values() for sensor in one.inputs))
    zero = _common_reference(parts)
    for name, one in parts.items():
        _check_sizes(name, one, training)
        if (one.p0_mm, one.p_min_mm, one.p_max_mm) != (first.p0_mm, first.p_min_mm, first.p_max_mm):
            raise ValueError(f"components.{name}: another P0 or travel than the rest of its axis")
    leverages = {name: _static_leverage(one, sensors) for name, one in parts.items()}
    shared = next(iter(leverages.values()))
    return now.AxisLaw(
        axis=first.axis or DRIFT,
        p0_mm=first.p0_mm,
        p_min_mm=first.p_min_mm,
        p_max_mm=first.p_max_mm,
        layout=InputLayout.plain(sensors),
        reference=now.Reference(
            campaign=first.reference.campaign, t_s=first.reference.t_s, inputs=tuple(zero[s] for s in sensors)
        ),
        leverage=shared,
        border=Border(
            temperature_degC={s: training.range_degC[s] for s in sensors},
            rise_K={s: training.range_rise_K[s] for s in sensors if s in training.range_rise_K},
            rise_counts=training.datum == "campaign",
        ),
        components={
            name: _static_component(one, sensors, None if leverages[name] == shared else leverages[name])
            for name, one in parts.items()
        },
    )


def _common_reference(parts: Mapping[str, _Component]) -> dict[str, float]:
    zero: dict[str, float] = {}
    for name, one in parts.items():
        lacking = [sensor for sensor in one.inputs if sensor not in one.reference.temperature_degC]
        if lacking:
            raise ValueError(f"components.{name}: no reference temperature for {', '.join(lacking)}")
        for sensor in one.inputs:
            if (
                zero.setdefault(sensor, one.reference.temperature_degC[sensor])
                != one.reference.temperature_degC[sensor]
            ):
                raise ValueError(f"components.{name}: another reference of {sensor} than the rest of its axis")
    return zero


def _check_sizes(name: str, one: _Component, training: _Training) -> None:
    size = len(one.inputs) + 1
    for label, term in one.terms.items():
        if len(term.coefficients_per_K) != len(one.inputs):
            told = f"{label} has {len(term.coefficients_per_K)} coefficients for {len(one.inputs)} inputs"
            raise ValueError(f"components.{name}: {told}")
        if [len(row) for row in term.covariance] != [size] * size:
            raise ValueError(f"components.{name}: the covariance of the {label} is not {size} by {size}")
    ranges = [training.range_degC] + [training.range_rise_K] * (training.datum == "campaign")
    lacking = [sensor for sensor in one.inputs if any(sensor not in known for known in ranges)]
    if lacking:
        raise ValueError(f"training: no training range for {', '.join(lacking)}, an input of {name}")


def _static_leverage(one: _Component, sensors: Sequence[str]) -> Leverage:
    """The leverage of the regression: covariance over residual variance, the same for both terms of a real fit."""
    found = [_unscaled(term) for term in one.terms.values() if term.residual_sd > 1e-9]
    if not found:
        # No scatter, no band: whatever the leverage is, it widens nothing.
        found = [np.zeros((len(one.inputs) + 1, len(one.inputs) + 1))]
    unscaled = max(found, key=lambda matrix: float(np.trace(matrix)))
    columns = [0, *(1 + sensors.index(sensor) for sensor in one.inputs)]
    whole = np.zeros((len(sensors) + 1, len(sensors) + 1))
    whole[np.ix_(columns, columns)] = unscaled
    return regression_leverage(whole)


def _unscaled(term: _LinearTerm) -> Floats:
    matrix = np.array(term.covariance) / term.residual_sd**2
    if not np.isfinite(matrix).all() or not np.allclose(matrix, matrix.T, rtol=1e-6, atol=1e-12 * np.abs(matrix).max()):
        raise ValueError("components: a covariance that is not symmetric")
    values = np.linalg.eigvalsh(matrix)
    if values.min() < -1e-9 * max(values.max(), 0.0) or values.max() > 1e15:
        raise ValueError("components: a covariance that is not one: a variance is below zero, or none was measured")
    return matrix


def _static_component(one: _Component, sensors: Sequence[str], leverage: Leverage | None) -> now.Component:
    return now.Component(
        direction=one.direction,
        terms=tuple(
            now.Term(
                constant=term.constant,
                coefficients=_spread(term.coefficients_per_K, one.inputs, sensors),
                r_squared=term.r_squared,
            )
            for term in one.terms.values()
        ),
        band=Band(
            quantile=t_quantile(0.975, one.dof) if one.dof else None,
            sd=tuple(term.residual_sd for term in one.terms.values()),
            correlation=one.residual_correlation,
        ),
        leverage=leverage,
        through_zero=one.through_zero,
        dof=one.dof,
        states=one.states,
        residual_um=one.residual_um,
        held_out_um=one.held_out_um,
        equation=one.equation,
    )


def _spread(values: Sequence[float], inputs: Sequence[str], sensors: Sequence[str]) -> tuple[float, ...]:
    if not inputs:
        return ()
    own = dict(zip(inputs, values, strict=True))
    return tuple(own.get(sensor, 0.0) for sensor in sensors)


def _with_fallbacks(law: now.AxisLaw, old: _Document) -> now.AxisLaw:
    made = []
    for fallback in old.fallbacks:
        parts = {name: one for name, one in fallback.components.items() if (one.axis or DRIFT) == law.axis}
        if parts:
            rest = _static_law(parts, old.training)
            made.append(
                now.Fallback(
                    lost=fallback.lost,
                    layout=rest.layout,
                    reference=rest.reference,
                    components=rest.components,
                    accuracy={name: fallback.accuracy[name] for name in parts if name in fallback.accuracy},
                    leverage=rest.leverage,
                    border=rest.border,
                )
            )
    return law.model_copy(update={"fallbacks": tuple(made)})


def _history_law(axis: str, old: _HistoryAxis) -> now.AxisLaw:
    if (old.axis or DRIFT) != axis:
        raise ValueError(f"history.{axis or 'drift'}: it is the model of axis {old.axis}")
    border = old.validity.model_dump(exclude={"reach"})
    return now.AxisLaw(
        axis=axis,
        p0_mm=old.p0_mm,
        p_min_mm=old.p_min_mm,
        p_max_mm=old.p_max_mm,
        layout=old.layout,
        reference=now.Reference(campaign=old.reference.campaign, t_s=old.reference.t_s, inputs=old.reference.inputs),
        leverage=Leverage(**old.reach.model_dump()),
        border=Border(distance=Validity(leverage=Leverage(**old.validity.reach.model_dump()), **border)),
        components={name: _history_component(axis, name, one) for name, one in old.components.items()},
        candidates=old.candidates,
        fallbacks=tuple(
            now.Fallback(
                lost=fallback.lost,
                layout=fallback.layout,
                reference=now.Reference(
                    campaign=old.reference.campaign, t_s=old.reference.t_s, inputs=fallback.reference_inputs
                ),
                components={name: _history_component(axis, name, one) for name, one in fallback.components.items()},
                accuracy=fallback.accuracy,
            )
            for fallback in old.fallbacks
        ),
    )


def _history_component(axis: str, name: str, old: _HistoryComponent) -> now.Component:
    pairs = [
        (old.intercept_um, old.prior_intercept_um_per_K),
        (old.slope_um_per_m, old.prior_slope_um_per_m_per_K),
        (old.bend_um_per_m2, old.prior_bend_um_per_m2_per_K),
    ]
    if any((model is None) != (prior is None) for model, prior in pairs) or (pairs[1][0] is None and pairs[2][0]):
        raise ValueError(f"history.{axis or 'drift'}: {name}: a slope or bend without its prior, or a bend alone")
    band, scale = old.band, old.band.scale
    # A scatter of zero is replaced by the smallest displacement possible, so that the growth keeps its scale.
    sd_um = max(scale.base_um, 1e-6)
    return now.Component(
        direction=old.direction,
        terms=tuple(
            now.Term(coefficients=model, beyond=prior)
            for model, prior in pairs
            if model is not None and prior is not None
        ),
        band=Band(
            quantile=band.quantile,
            sd=(sd_um,),
            growth=(scale.growth_um / sd_um) ** 2,
            knee=scale.knee,
            far=scale.far,
            noise_sd_um=old.noise_sd_um,
            **band.model_dump(exclude={"quantile", "scale"}),
        ),
        residual_um=old.residual_um,
        held_out_um=old.held_out_um,
    )

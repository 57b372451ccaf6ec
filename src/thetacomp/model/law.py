"""The thermal law at work: inputs in, errors and their 95 % bands out. Numpy only.

`E = Σ_k u^k (constant_k + c_k · (x - x_ref))`, u = (p - P0) / 1000. One evaluation serves one axis, the whole volume
and angles; inside its border the law speaks alone, outside it fades towards its prior where it has one (`fade`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import CARTESIAN, Bools, Floats
from thetacomp.model.border import Limit, travelled
from thetacomp.model.document import AxisLaw, Component
from thetacomp.model.fade import faded_um, model_weight

Box = Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class Law:
    """The law of an axis, tied to the inputs `zero` (k,) at which its error counts as zero.

    The constants of the fit are kept only with the reference stored in the model: with any other reference the error
    is zero there by definition, and a constant would be a jump.
    """

    axis: AxisLaw
    zero: Floats
    keeps_constant: bool

    @classmethod
    def of_model(cls, axis: AxisLaw) -> Law:
        """The law with the reference stored in it, constants kept."""
        return cls(axis, np.array(axis.reference.inputs, dtype=np.float64), keeps_constant=True)

    def u_m(self, position_mm: Floats) -> Floats:
        """Distances (n,) from P0 in metres; zero for drift, where positions play no part."""
        if self.axis.p0_mm is None:
            return np.zeros(len(position_mm))
        return np.asarray((np.asarray(position_mm, dtype=np.float64) - self.axis.p0_mm) / 1000.0)

    def states(self, component: Component) -> float:
        """How many states bring their residual into a prediction: 1, or 2 where the reference brings one too."""
        return 1.0 if self.keeps_constant or component.through_zero else 2.0

    def at(self, moved: Floats, temperature_degC: Floats) -> LawValues:
        """The law at n moments.

        `moved` (n, k) are the inputs as differences from `zero`, `temperature_degC` (n, p) the temperatures of the
        layout's sensors.
        """
        validity, weight, distance = self.axis.border.distance, None, None
        if validity is not None:
            distance = validity.distance(np.hstack([moved, temperature_degC]))
            weight = model_weight(distance)
        shared = self.axis.leverage.at(moved, from_centre=self.keeps_constant)
        components = self.axis.components
        return LawValues(
            law=self,
            terms={name: self._terms(c, moved, weight) for name, c in components.items()},
            leverage={
                name: shared if c.leverage is None else c.leverage.at(moved, from_centre=self.keeps_constant)
                for name, c in components.items()
            },
            distance=distance,
            temperature_degC=temperature_degC,
            rise_K=moved[:, : temperature_degC.shape[1]],
            missing=np.asarray(~np.isfinite(moved).all(axis=1)),
        )

    def _terms(self, component: Component, moved: Floats, weight: Floats | None) -> Floats:
        nothing = (0.0,) * moved.shape[1]
        value = np.array([term.coefficients or nothing for term in component.terms]) @ moved.T
        if self.keeps_constant:
            value = value + np.array([[term.constant] for term in component.terms])
        if weight is None or any(term.beyond is None for term in component.terms):
            return np.asarray(value)
        beyond = np.array([term.beyond for term in component.terms])
        return faded_um(value, beyond @ moved[:, : beyond.shape[1]].T, weight)


@dataclass(frozen=True)
class LawValues:
    """What the law of an axis says at n moments, at any position.

    By component `terms` (powers, n) and `leverage` (n,); `distance` (n,) from training for a law that has one;
    `temperature_degC` and `rise_K` (n, p) of its sensors; `missing` (n,) where an input is.
    """

    law: Law
    terms: Mapping[str, Floats]
    leverage: Mapping[str, Floats]
    distance: Floats | None
    temperature_degC: Floats
    rise_K: Floats
    missing: Bools

    def error_um(self, name: str, u_m: Floats | float) -> Floats:
        """Error of a component (n,) at distances u (n,) from P0."""
        error_um, *higher = self.terms[name]
        for power, term in enumerate(higher, start=1):
            error_um = error_um + term * u_m**power
        return np.asarray(error_um)

    def slope_um_per_m(self, name: str, u_m: Floats | float) -> Floats:
        """How the error of a component changes with the position there, (n,)."""
        slope = np.zeros(len(self.missing))
        for power, term in enumerate(self.terms[name][1:], start=1):
            slope = slope + power * term * u_m ** (power - 1)
        return np.asarray(slope)

    def half_width_um(self, name: str, u_m: Floats | float) -> Floats:
        """Half of the 95 % band of a component (n,) there; infinite where the fit left no degree of freedom."""
        component = self.law.axis.components[name]
        return component.band.half_width_um(self.leverage[name], u_m, self.law.states(component))

    def errors_um(self, u_m: Floats | float) -> Floats:
        """Errors (n, 3) along X, Y, Z at distances u (n,); NaN where the law has no such component."""
        return self._by_direction({name: self.error_um(name, u_m) for name in self.terms})

    def half_widths_um(self, u_m: Floats | float) -> Floats:
        """Half widths (n, 3) of the 95 % bands; NaN where there is no such component or no band."""
        halves = {name: self.half_width_um(name, u_m) for name in self.terms}
        return self._by_direction({name: np.where(np.isfinite(half), half, np.nan) for name, half in halves.items()})

    def term(self, power: int) -> Floats:
        """What u to a power carries, (n, 3) along X, Y, Z; zero where a component has no such term."""
        return self._by_direction({n: t[power] if power < len(t) else 0.0 * t[0] for n, t in self.terms.items()})

    def limits(self, position_mm: Floats) -> tuple[Limit, ...]:
        """Every limit of the training, at n positions of the axis."""
        axis = self.law.axis
        out = axis.border.limits(axis.layout.sensors, self.temperature_degC, self.rise_K)
        if self.distance is not None:
            distance = np.where(np.isfinite(self.distance), self.distance, np.nan)
            out.append(Limit("distance", axis.axis or "drift", distance, (0.0, 1.0), distance <= 1.0))
        if axis.p_min_mm is not None and axis.p_max_mm is not None:
            out.append(travelled(axis.axis, position_mm, axis.p_min_mm, axis.p_max_mm))
        return tuple(out)

    def _by_direction(self, values: Mapping[str, Floats]) -> Floats:
        out = np.full((len(self.missing), 3), np.nan)
        for name, value in values.items():
            out[:, CARTESIAN.index(self.law.axis.components[name].direction)] = value
        return out


def joined(parts: Sequence[LawValues]) -> LawValues:
    """The values of one law at several stretches of moments, as one."""
    first = parts[0]
    if len(parts) == 1:
        return first
    distances = [part.distance for part in parts if part.distance is not None]
    return LawValues(
        law=first.law,
        terms={name: np.concatenate([part.terms[name] for part in parts], axis=1) for name in first.terms},
        leverage={name: np.concatenate([part.leverage[name] for part in parts]) for name in first.leverage},
        distance=np.concatenate(distances) if distances else None,
        temperature_degC=np.concatenate([part.temperature_degC for part in parts]),
        rise_K=np.concatenate([part.rise_K for part in parts]),
        missing=np.concatenate([part.missing for part in parts]),
    )


@dataclass(frozen=True)
class ComponentLaw:
    """One component of a law on plain temperatures, as a control carries it."""

    name: str
    law: Law

    @property
    def component(self) -> Component:
        """The stored component."""
        return self.law.axis.components[self.name]

    @property
    def axis(self) -> str:
        """The moving axis, "" for drift."""
        return self.law.axis.axis

    @property
    def inputs(self) -> tuple[str, ...]:
        """Sensor ids of the inputs, k of them."""
        return self.law.axis.layout.sensors

    @property
    def travel_mm(self) -> tuple[float, float, float]:
        """P0 and the ends of the measured travel; ValueError for drift."""
        p0_mm, low_mm, high_mm = self.law.axis.p0_mm, self.law.axis.p_min_mm, self.law.axis.p_max_mm
        if p0_mm is None or low_mm is None or high_mm is None:
            raise ValueError(f"{self.name} is drift at a fixed position: it has no travel")
        return p0_mm, low_mm, high_mm

    def rises_K(self, temperature_degC: Floats) -> Floats:
        """Rises above the reference, shape (n, k), from temperatures of the inputs, shape (n, k)."""
        return np.asarray(temperature_degC, dtype=np.float64) - self.law.zero

    def terms(self, rises_K: Floats) -> Floats:
        """What each power of u carries at n states, (powers, n)."""
        return self._at(rises_K).terms[self.name]

    def error_um(self, rises_K: Floats, position_mm: Floats) -> Floats:
        """Error E at n states and positions, shape (n,); the position plays no part for drift."""
        return self._at(rises_K).error_um(self.name, self.law.u_m(position_mm))

    def half_width_um(self, rises_K: Floats, position_mm: Floats) -> Floats:
        """Half of the 95 % prediction interval of E, shape (n,); infinite where the fit left no degree of freedom."""
        return self._at(rises_K).half_width_um(self.name, self.law.u_m(position_mm))

    def largest(self, power: int, box_degC: Box) -> float:
        """Largest |value| of a term inside the box of temperatures, with its 95 % prediction bound, in its unit.

        The bound is left out where the fit has no degree of freedom left to estimate it.
        """
        coefficients = np.array(self.component.terms[power].coefficients or (0.0,) * len(self.inputs))
        span_K = np.array([box_degC[sensor] for sensor in self.inputs]).reshape(-1, 2) - self.law.zero[:, None]
        # The value is linear in the rises: its extremes are at the corners that the signs of the coefficients choose.
        corners_K = np.array([np.where(coefficients > 0, span_K[:, 1 - side], span_K[:, side]) for side in (0, 1)])
        values = self._at(corners_K)
        states = self.law.states(self.component)
        bound = self.component.band.half_width_of_term(power, values.leverage[self.name], states)
        return float(np.max(np.abs(values.terms[self.name][power]) + np.where(np.isfinite(bound), bound, 0.0)))

    def _at(self, rises_K: Floats) -> LawValues:
        return self.law.at(rises_K, rises_K + self.law.zero)


def component_laws(
    laws: Mapping[str, AxisLaw], reference_degC: Mapping[str, float] | None = None
) -> dict[str, ComponentLaw]:
    """The components of laws on plain temperatures, by name.

    `reference_degC` holds the temperature of every input at the moment of zero; None means the reference stored in
    each law, with the constant. Raises KeyError where `reference_degC` lacks an input.
    """
    out: dict[str, ComponentLaw] = {}
    for axis in laws.values():
        law = Law.of_model(axis)
        if reference_degC is not None:
            law = Law(axis, np.array([reference_degC[s] for s in axis.layout.sensors], dtype=np.float64), False)
        out |= {name: ComponentLaw(name, law) for name in axis.components}
    return out


def box_degC(laws: Mapping[str, ComponentLaw]) -> dict[str, tuple[float, float]]:
    """Lowest and highest temperature of every input: what the training covers, seen from the laws' references."""
    box: dict[str, tuple[float, float]] = {}
    for one in laws.values():
        for sensor, (low, high) in one.law.axis.border.box_degC(one.inputs, one.law.zero).items():
            known = box.get(sensor, (low, high))
            box[sensor] = (min(low, known[0]), max(high, known[1]))
    return box


def inputs_of(laws: Mapping[str, ComponentLaw]) -> tuple[str, ...]:
    """Sensor ids of the inputs of all these laws, each once, in the order of first use."""
    return tuple(dict.fromkeys(sensor for one in laws.values() for sensor in one.inputs))

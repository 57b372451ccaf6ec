"""The thermal law of one error: temperatures in, intercept, slope, error and its 95 % interval out. Numpy only.

`E(p, θ) = I(θ) + S(θ) (p - P0) / 1000` in µm (paper, eq. 1 and 2), with I and S linear in the rises of the inputs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.errors import ModelFileError
from thetacomp.model.document import Component, LinearTerm, ModelDocument
from thetacomp.model.student import t_quantile

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Law:
    """The law of one component, tied to the temperatures at which its error counts as zero.

    `reference_degC` has one value an input. The constant of the fit is kept only with the reference stored in the
    model: with any other reference the error is zero there by definition, and a constant would be a jump.
    """

    name: str
    component: Component
    reference_degC: Floats
    keeps_constant: bool

    @property
    def inputs(self) -> tuple[str, ...]:
        """Sensor ids of the inputs, k of them."""
        return self.component.inputs

    @property
    def slope(self) -> LinearTerm:
        """The term of the slope; ValueError for drift, which has none."""
        if self.component.slope is None:
            raise ValueError(f"{self.name} is drift at a fixed position: it has no slope")
        return self.component.slope

    @property
    def travel_mm(self) -> tuple[float, float, float]:
        """P0 and the ends of the measured travel; ValueError for drift."""
        p0_mm, low_mm, high_mm = self.component.p0_mm, self.component.p_min_mm, self.component.p_max_mm
        if p0_mm is None or low_mm is None or high_mm is None:
            raise ValueError(f"{self.name} is drift at a fixed position: it has no travel")
        return p0_mm, low_mm, high_mm

    @property
    def residual_states(self) -> float:
        """How many states bring their residual into a prediction: 1, or 2 where the reference brings one too."""
        return 1.0 if self.keeps_constant or self.component.through_zero else 2.0

    def rises_K(self, temperature_degC: Floats) -> Floats:
        """Rises above the reference, shape (n, k), from temperatures of the inputs, shape (n, k)."""
        return np.asarray(temperature_degC, dtype=np.float64) - self.reference_degC

    def line(self, rises_K: Floats) -> tuple[Floats, Floats]:
        """Intercept (µm) and slope (µm/m) at n states, each of shape (n,)."""
        return thermal_line(self.component, rises_K, keep_constant=self.keeps_constant)

    def error_um(self, rises_K: Floats, position_mm: Floats) -> Floats:
        """Error E at n states and positions, shape (n,); the position plays no part for drift."""
        intercept_um, slope_um_per_m = self.line(rises_K)
        return intercept_um + slope_um_per_m * self._arm_m(position_mm)

    def half_width_um(self, rises_K: Floats, position_mm: Floats) -> Floats:
        """Half of the 95 % prediction interval of E, shape (n,); infinite where the fit left no degree of freedom.

        With `x = (1, rises)`, `u = (p - P0) / 1000`, the covariances C_I and C_S of the two terms, their residual
        standard deviations s_I and s_S and the residual correlation ρ:

        `var = h_I + u² h_S + 2 u ρ √(h_I h_S) + m (s_I² + u² s_S² + 2 u ρ s_I s_S)`, `h = xᵀ C x`, `m = 1`.

        The cross term is exact where both terms were fitted by least squares on the same inputs. Without the
        constant the error is the difference of two states, this one and the reference: the constant cancels,
        `x = (0, rises)`, and both states bring their own residual, `m = 2`; `m = 1` where the fit runs through zero,
        since its residuals were already taken against the reference. The half width is the Student t quantile for
        `dof` times the root of var (prediction interval of linear regression).
        """
        component = self.component
        first = np.ones(len(rises_K)) if self.keeps_constant else np.zeros(len(rises_K))
        x = np.column_stack([first, rises_K])
        states = self.residual_states
        leverage_i, sd_i = _leverage(component.intercept, x), component.intercept.residual_sd
        var = leverage_i + states * sd_i**2
        if component.slope is not None:
            u, rho = self._arm_m(position_mm), component.residual_correlation
            leverage_s, sd_s = _leverage(component.slope, x), component.slope.residual_sd
            var = var + u**2 * (leverage_s + states * sd_s**2)
            var = var + 2 * u * rho * (np.sqrt(leverage_i * leverage_s) + states * sd_i * sd_s)
        return np.asarray(t_quantile(0.5 + CONFIDENCE / 2, component.dof) * np.sqrt(np.maximum(var, 0.0)))

    def _arm_m(self, position_mm: Floats) -> Floats:
        if self.component.p0_mm is None:
            return np.zeros(len(position_mm))
        return (np.asarray(position_mm, dtype=np.float64) - self.component.p0_mm) / 1000.0


def thermal_line(component: Component, rises_K: Floats, *, keep_constant: bool) -> tuple[Floats, Floats]:
    """Intercept (µm) and slope (µm/m), each of shape (n,), from rises of the inputs of shape (n, k).

    The slope is zero for drift at a fixed position.
    """
    intercept_um = _linear(component.intercept, rises_K, keep_constant)
    if component.slope is None:
        return intercept_um, np.zeros(len(rises_K))
    return intercept_um, _linear(component.slope, rises_K, keep_constant)


def laws(model: ModelDocument, reference_degC: Mapping[str, float] | None = None) -> dict[str, Law]:
    """The laws of all components by name.

    `reference_degC` holds the temperature of every input at the moment of zero; None means the reference stored in
    each component, with the constant. Raises ModelFileError where the document contradicts itself, and KeyError
    where `reference_degC` lacks an input.
    """
    out = {}
    for name, component in model.components.items():
        _check(name, component, model)
        source = component.reference.temperature_degC if reference_degC is None else reference_degC
        reference = np.array([source[sensor] for sensor in component.inputs], dtype=np.float64)
        out[name] = Law(name, component, reference, keeps_constant=reference_degC is None)
    return out


def inputs_of(laws_: Mapping[str, Law]) -> tuple[str, ...]:
    """Sensor ids of the inputs of all these laws, each once, in the order of first use."""
    return tuple(dict.fromkeys(sensor for law in laws_.values() for sensor in law.inputs))


def _linear(term: LinearTerm, rises_K: Floats, keep_constant: bool) -> Floats:
    value = np.asarray(rises_K, dtype=np.float64) @ np.array(term.coefficients_per_K, dtype=np.float64)
    return np.asarray(value + term.constant if keep_constant else value)


def _leverage(term: LinearTerm, x: Floats) -> Floats:
    covariance = np.array(term.covariance, dtype=np.float64)
    return np.asarray(np.maximum(((x @ covariance) * x).sum(axis=1), 0.0))


def _check(name: str, component: Component, model: ModelDocument) -> None:
    """A document that contradicts itself is refused before a number is made from it."""
    inputs, size = component.inputs, len(component.inputs) + 1
    positions = (component.p0_mm, component.p_min_mm, component.p_max_mm)
    found = []
    for label, term in (("intercept", component.intercept), ("slope", component.slope)):
        if term is not None and len(term.coefficients_per_K) != len(inputs):
            found.append(f"{label} has {len(term.coefficients_per_K)} coefficients for {len(inputs)} inputs")
        if term is not None and [len(row) for row in term.covariance] != [size] * size:
            found.append(f"the covariance of the {label} is not {size} by {size}")
    training = model.training
    for label, known in (
        ("reference temperature", set(component.reference.temperature_degC)),
        ("training range in °C", set(training.range_degC)),
        ("training range of the rise", set(training.range_rise_K if training.datum == "campaign" else inputs)),
    ):
        lacking = [sensor for sensor in inputs if sensor not in known]
        if lacking:
            found.append(f"no {label} for {', '.join(lacking)}")
    if name != (f"E{component.direction}{component.axis}" if component.axis else f"D{component.direction}"):
        found.append(f"the name does not fit direction {component.direction} and axis {component.axis}")
    if component.axis is None and component.slope is not None:
        found.append("a slope without an axis")
    if component.axis is not None and (component.slope is None or None in positions):
        found.append("an axis without a slope, P0 or range of positions")
    if component.axis is not None and component.axis not in {axis.name for axis in model.axes}:
        found.append(f"the axis {component.axis} is not among the axes of the model")
    if found:
        raise ModelFileError(f"model component {name}: {'; '.join(found)}. Fix: run `thetacomp analyze` again.")

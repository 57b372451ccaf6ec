"""What the stored model says at the states of a campaign, with its 95 % band. Used for pictures only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from thetacomp.analysis_result import Analysis
from thetacomp.arrays import Floats
from thetacomp.model.document import Component, LinearTerm
from thetacomp.separation.component import ComponentSeparation


@dataclass(frozen=True)
class PredictedStates:
    """Model at n states: `rise_K` (n, inputs) above the reference, intercept and slope (n,); slope absent at drift."""

    rise_K: Floats
    intercept_um: Floats
    slope_um_per_m: Floats | None


def term_at(term: LinearTerm, rise_K: Floats) -> Floats:
    """Value of one term for rises (n, inputs), in the term's unit, shape (n,)."""
    return np.asarray(term.constant + rise_K @ np.asarray(term.coefficients_per_K))


def half_band(term: LinearTerm, dof: int, rise_K: Floats) -> Floats:
    """Half width of the 95 % interval of a new state, shape (n,): Student's t times sqrt(x'Cx + s²)."""
    design = np.column_stack([np.ones(len(rise_K)), rise_K])
    covariance = np.asarray(term.covariance, dtype=float).reshape(design.shape[1], design.shape[1])
    variance = np.einsum("ij,jk,ik->i", design, covariance, design) + term.residual_sd**2
    return np.asarray(special.stdtrit(max(dof, 1), 0.975) * np.sqrt(np.clip(variance, 0.0, None)))


def explains(term: LinearTerm, dof: int, chance: float = 0.05) -> bool:
    """Whether the inputs explain this term: R² above zero, and coefficients that differ from zero (Wald's F test)."""
    coefficient = np.asarray(term.coefficients_per_K, dtype=float)
    if not len(coefficient) or not term.r_squared > 0.0:
        return False
    covariance = np.asarray(term.covariance, dtype=float)[1:, 1:]
    scale = np.sqrt(np.diag(covariance))
    if not np.all(scale > 0.0):
        return bool(np.any(coefficient != 0.0))  # a perfect fit has no scatter to test against
    z = coefficient / scale
    correlation = covariance / np.outer(scale, scale)
    statistic = float(z @ np.linalg.pinv(correlation, hermitian=True) @ z) / len(z)
    return bool(special.fdtrc(len(z), max(dof, 1), statistic) <= chance)


def reference_degC(analysis: Analysis, state: ComponentSeparation, component: Component) -> Floats | None:
    """Temperatures of the component's inputs where the error counts as zero; None where the campaign lacks one."""
    if analysis.model.training.datum == "common":
        return np.array([component.reference.temperature_degC[i] for i in component.inputs])
    while_cold = inputs_degC(analysis, state, component, state.zero_t_s)
    return None if while_cold is None else np.asarray(while_cold.mean(axis=0))


def inputs_degC(analysis: Analysis, state: ComponentSeparation, component: Component, t_s: Floats) -> Floats | None:
    """Temperatures of the component's inputs at times (n,), shape (n, inputs); None where the campaign lacks one."""
    measured = analysis.folder.campaign(state.campaign).temperatures
    if not set(component.inputs) <= set(measured.sensor_ids):
        return None
    return measured.select(component.inputs).at(t_s)


def drawn_law(analysis: Analysis) -> str:
    """What `predict_states` gives, in words: with heat history in use it is not what predictions come from."""
    return "the law on key points (not the heat history in use)" if analysis.model.history else "the stored model"


def predict_states(analysis: Analysis, state: ComponentSeparation) -> PredictedStates | None:
    """The law on key points at every state of one separated component; None where the model does not hold it."""
    component = analysis.model.components.get(state.component)
    if component is None:
        return None
    now = inputs_degC(analysis, state, component, state.t_s)
    start = reference_degC(analysis, state, component)
    if now is None or start is None:
        return None
    rise_K = now - start
    intercept = term_at(component.intercept, rise_K)
    if component.slope is None or component.p0_mm is None:
        return PredictedStates(rise_K, intercept, None)
    slope = term_at(component.slope, rise_K)
    # The model may count positions from another P0 than the separation; the line itself is the same.
    intercept = intercept + slope * (state.p0_mm - component.p0_mm) / 1000.0
    return PredictedStates(rise_K, intercept, slope)

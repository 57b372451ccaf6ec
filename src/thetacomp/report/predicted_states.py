"""What the stored model says at the states of a campaign, with its 95 % band. Used for pictures only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from thetacomp.analysis_result import AnalysisResult
from thetacomp.arrays import Floats
from thetacomp.model.law import ComponentLaw, component_laws
from thetacomp.separation.component import ComponentSeparation


@dataclass(frozen=True)
class PredictedStates:
    """Model at n states: `rise_K` (n, inputs) above the reference, intercept and slope (n,); slope absent at drift."""

    rise_K: Floats
    intercept_um: Floats
    slope_um_per_m: Floats | None


def half_band(law: ComponentLaw, power: int, rise_K: Floats) -> Floats:
    """Half width of the 95 % interval of a new state of one term, (n,): Student's t times s √(1 + leverage)."""
    component = law.component
    leverage = (component.leverage or law.law.axis.leverage).at(rise_K)
    return np.asarray(
        special.stdtrit(max(component.dof or 0, 1), 0.975) * component.band.sd[power] * np.sqrt(1.0 + leverage)
    )


def explains(law: ComponentLaw, power: int, chance: float = 0.05) -> bool:
    """Whether the inputs explain a term: R² above zero, and coefficients that differ from zero (Wald's F test)."""
    component = law.component
    term, sd = component.terms[power], component.band.sd[power]
    coefficient = np.array(term.coefficients)
    if not len(coefficient) or not (term.r_squared or 0.0) > 0.0:
        return False
    if not sd > 0.0:
        return bool(np.any(coefficient != 0.0))  # a perfect fit has no scatter to test against
    shape = component.leverage or law.law.axis.leverage
    along = np.array(shape.directions).reshape(-1, len(coefficient)) @ coefficient
    statistic = float(along**2 @ np.array(shape.moments)) / (sd**2 * len(coefficient))
    return bool(special.fdtrc(len(coefficient), max(component.dof or 0, 1), statistic) <= chance)


def reference_degC(analysis: AnalysisResult, state: ComponentSeparation, component: ComponentLaw) -> Floats | None:
    """Temperatures of the component's inputs where the error counts as zero; None where the campaign lacks one."""
    if analysis.model.training.datum == "common":
        return component.law.zero
    while_cold = inputs_degC(analysis, state, component, state.zero_t_s)
    return None if while_cold is None else np.asarray(while_cold.mean(axis=0))


def inputs_degC(
    analysis: AnalysisResult, state: ComponentSeparation, component: ComponentLaw, t_s: Floats
) -> Floats | None:
    """Temperatures of the component's inputs at times (n,), shape (n, inputs); None where the campaign lacks one."""
    measured = analysis.folder.campaign(state.campaign).temperatures
    if not set(component.inputs) <= set(measured.sensor_ids):
        return None
    return measured.select(component.inputs).at(t_s)


def drawn_law(analysis: AnalysisResult) -> str:
    """What `predict_states` gives, in words: with heat history in use it is not what predictions come from."""
    return "the law on key points (not the heat history in use)" if analysis.model.prediction else "the stored model"


def predict_states(analysis: AnalysisResult, state: ComponentSeparation) -> PredictedStates | None:
    """The law on key points at every state of one separated component; None where the model does not hold it."""
    component = component_laws(analysis.model.control).get(state.component)
    if component is None:
        return None
    now = inputs_degC(analysis, state, component, state.t_s)
    start = reference_degC(analysis, state, component)
    if now is None or start is None:
        return None
    rise_K = now - start
    intercept, *slopes = component.terms(rise_K)
    if not slopes:
        return PredictedStates(rise_K, intercept, None)
    # The model may count positions from another P0 than the separation; the line itself is the same.
    intercept = intercept + slopes[0] * (state.p0_mm - component.travel_mm[0]) / 1000.0
    return PredictedStates(rise_K, intercept, slopes[0])

"""The heat-history model as it is stored and used: fitted, with its border, its prior and its 95 % bands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from thetacomp.arrays import Bools, Floats
from thetacomp.axis_states import AxisStates, Samples, curve_um
from thetacomp.errors import AnalysisError
from thetacomp.fitting.border import calibrate_validity
from thetacomp.fitting.conformal import CampaignShapes, HeldOut, as_tuple, calibrate_band, held_out_leverage
from thetacomp.fitting.history_model import HistoryModel, history_procedure
from thetacomp.fitting.prior import fit_prior
from thetacomp.model.band import Band
from thetacomp.model.border import Border
from thetacomp.model.document import AxisLaw, Component, Reference, Term
from thetacomp.model.filters import InputLayout
from thetacomp.model.law import Law


@dataclass(frozen=True)
class CalibratedHistory:
    """The stored form of a heat-history model as a Predictor: what validation judges is what the machine gets.

    `left_out_um` holds for every component its samples (n,) as predicted by the models that left out their campaign,
    NaN where an input is missing.
    """

    document: AxisLaw
    left_out_um: Mapping[str, Floats]
    model: HistoryModel

    @property
    def components(self) -> Mapping[str, Component]:
        """The components of the document."""
        return self.document.components

    def predict(self, component: str, states: AxisStates, samples: Samples) -> tuple[Floats, Floats]:
        """Thermal error of samples in µm and the half width of its 95 % band, both (n,)."""
        layout = self.document.layout
        degC = _sensor_columns(layout, states, samples.rise_K + states.reference_degC[samples.state])
        values = Law.of_model(self.document).at(samples.history, degC)
        return values.error_um(component, samples.lever_m), values.half_width_um(component, samples.lever_m)


def calibrated_history(states: AxisStates) -> CalibratedHistory:
    """Fit, and calibrate border, prior and bands on the same training campaigns, each held out in turn.

    Raises AnalysisError as `history_procedure` does, and where the states carry no samples to calibrate on.
    """
    model = history_procedure(states)
    layout = model.layout
    known = np.isfinite(states.history).all(axis=1)
    moved, campaign = states.history[known], states.campaign[known]
    temperature_degC = _sensor_columns(layout, states, states.rise_K + states.reference_degC)[known]
    drift = states.is_drift
    document = AxisLaw(
        axis=states.axis,
        p0_mm=None if drift else states.p0_mm,
        p_min_mm=None if drift else states.p_min_mm,
        p_max_mm=None if drift else states.p_max_mm,
        layout=layout,
        reference=Reference(
            campaign=states.campaigns[int(states.campaign[0])],
            t_s=float(states.reference_s[0]),
            inputs=as_tuple(states.reference_history[0]),
        ),
        leverage=CampaignShapes.of(moved, campaign).leverage(),
        border=Border(
            distance=calibrate_validity(np.hstack([moved, temperature_degC]), campaign, states.trajectory),
        ),
        components={},
        candidates=len(model.ridge.candidates),
    )
    left_um = {name: left_out_um(states, model, k) for k, name in enumerate(states.components)}
    bands = {name: calibrate_band(_held_out(states, k, left_um[name])) for k, name in enumerate(states.components)}
    components = {name: component(states, model, k, bands[name]) for k, name in enumerate(states.components)}
    return CalibratedHistory(document.model_copy(update={"components": components}), left_um, model)


def component(states: AxisStates, model: HistoryModel, k: int, band: Band) -> Component:
    """The stored form of the k-th component, with its prior, its residuals and the noise of the instrument."""
    name, count = states.components[k], len(states.components)
    targets = [states.intercept_um[:, k]]
    if not states.is_drift:
        targets.append(states.slope_um_per_m[:, k])
        if np.any(np.nan_to_num(states.bend_um_per_m2[:, k])):
            targets.append(states.bend_um_per_m2[:, k])
    rise_K = states.history[:, : len(model.layout.sensors)]
    samples = states.samples[k]
    samples = samples.take(_complete(samples))
    in_sample_um = samples.value_um - model.predict(name, states, samples)[0]
    return Component.model_validate(
        {
            "direction": name[1],
            "terms": tuple(
                Term(
                    coefficients=as_tuple(model.ridge.coef_[power * count + k]),
                    beyond=fit_prior(model.layout.sensors, rise_K, target, states.campaign).coefficients_um_per_K,
                )
                for power, target in enumerate(targets)
            ),
            "band": replace(band, noise_sd_um=float(np.sqrt(np.mean(samples.noise_sd_um**2)))),
            "residual_um": (float(np.sqrt(np.mean(in_sample_um**2))), float(np.abs(in_sample_um).max())),
        }
    )


def left_out_um(states: AxisStates, model: HistoryModel, k: int) -> Floats:
    """Samples of one component (n,) as predicted by the models that left out their campaign."""
    samples = states.samples[k]
    campaign = np.searchsorted(model.ridge.groups_, states.campaign[samples.state])
    coefficients = model.ridge.left_out_coef_[np.minimum(campaign, len(model.ridge.groups_) - 1)]
    parameters: Floats = np.einsum("ij,imj->im", samples.history, coefficients)
    return curve_um(parameters, k, len(states.components), samples.lever_m)


def _held_out(states: AxisStates, k: int, left_um: Floats) -> HeldOut:
    """What a band is calibrated on: samples of heated states whose inputs are all there."""
    samples = states.samples[k]
    judged = _complete(samples)
    if states.exact_zero:
        judged = judged & ~states.cold[samples.state]
    if not judged.any():
        raise AnalysisError(f"{states.components[k]}: no sample of a heated state to calibrate a band on.")
    own = samples.take(judged)
    campaign = states.campaign[own.state]
    return HeldOut(own.value_um - left_um[judged], held_out_leverage(own.history, campaign), campaign)


def _sensor_columns(layout: InputLayout, states: AxisStates, values: Floats) -> Floats:
    return values[:, [states.sensors.index(name) for name in layout.sensors]]


def _complete(samples: Samples) -> Bools:
    return np.asarray(np.isfinite(samples.history).all(axis=1))

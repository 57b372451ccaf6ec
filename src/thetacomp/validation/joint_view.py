"""The joint form in validation: a measured point is judged by its whole error, the drift of that moment included.

Each axis' component alone would be judged without the largest part of the error. So the held-out error of a point is
what its axis adds plus the drift, predicted by the model of the axis plus the model of the drift, both fitted without
the held-out states. The share of the other axes, which stand still, is taken off as separated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thetacomp.arrays import Floats, Ints
from thetacomp.axis_states import AxisStates, Samples
from thetacomp.errors import AnalysisError
from thetacomp.fitting.key_point_law import AnyProcedure, Predictor


def with_drift(
    states: AxisStates, everything: Sequence[AxisStates], procedures: Mapping[str, AnyProcedure]
) -> tuple[AxisStates, dict[str, AnyProcedure]]:
    """States whose samples hold the drift, and procedures that predict it; both unchanged in the separate form."""
    drift = next((s for s in everything if s.is_drift), None)
    if drift is None or states.is_drift or not any(np.any(samples.drift_um) for samples in states.samples):
        return states, dict(procedures)
    samples = tuple(replace(s, value_um=s.value_um + s.drift_um) for s in states.samples)
    view = replace(states, samples=samples)
    return view, {name: _Both(states, drift, procedure) for name, procedure in procedures.items()}


@dataclass(frozen=True)
class _BothModels:
    """The model of an axis and that of the drift; their intervals add as squares, being fits of their own."""

    own: Predictor
    drift: Predictor
    drift_states: AxisStates

    def predict(self, component: str, states: AxisStates, samples: Samples) -> tuple[Floats, Floats]:
        """Axis plus drift in µm and the half width of the 95 % interval, both (n,)."""
        value_um, half_um = self.own.predict(component, states, samples)
        # The noise of the instrument is in the point once.
        nothing = np.zeros(len(samples.lever_m))
        row = _nearest_rows(states, self.drift_states)[samples.state]
        still = replace(samples, state=row, lever_m=nothing, noise_sd_um=nothing)
        drift_um, drift_half_um = self.drift.predict(f"D{component[1]}", self.drift_states, still)
        return value_um + drift_um, np.hypot(half_um, drift_half_um)


def _nearest_rows(states: AxisStates, drift: AxisStates) -> Ints:
    """For every state of an axis the drift's state of the same campaign that lies nearest in time."""
    rows = np.zeros(len(states), dtype=np.int64)
    for k in range(len(states)):
        own = np.flatnonzero(drift.campaign == drift.campaigns.index(states.campaigns[states.campaign[k]]))
        rows[k] = own[np.argmin(np.abs(drift.t_s[own] - states.t_s[k]))]
    return rows


class _Both:
    """A procedure that fits the axis alone and, without the states held out with it, the drift."""

    def __init__(self, states: AxisStates, drift: AxisStates, procedure: AnyProcedure) -> None:
        self._states, self._drift, self._procedure = states, drift, procedure

    def __call__(self, training: AxisStates) -> Predictor:
        if any(f"D{name[1]}" not in self._drift.components for name in training.components):
            raise AnalysisError(f"axis {training.axis}: the drift was not measured in all of its directions.")
        rows = _drift_rows(self._states, training, self._drift)
        own = self._procedure(_without_drift(self._states, training))
        return _BothModels(own, self._procedure(self._drift.take(rows)), self._drift)


def _without_drift(states: AxisStates, training: AxisStates) -> AxisStates:
    """The training states with their samples as the axis alone makes them, which its band is calibrated on."""
    kept = set(zip(training.campaign.tolist(), training.t_s.tolist(), strict=True))
    of_states = zip(states.campaign.tolist(), states.t_s.tolist(), strict=True)
    rows = np.array([k for k, state in enumerate(of_states) if state in kept], dtype=np.int64)
    return replace(states.take(rows), rise_K=training.rise_K)


def _drift_rows(states: AxisStates, training: AxisStates, drift: AxisStates) -> Ints:
    """Rows of the drift that may train: those whose nearest state of this axis, in the same campaign, trains too."""
    kept = set(zip(training.campaign.tolist(), training.t_s.tolist(), strict=True))
    rows = []
    for k, (campaign, t_s) in enumerate(zip(drift.campaign, drift.t_s, strict=True)):
        name = drift.campaigns[campaign]
        if name not in states.campaigns:
            rows.append(k)
            continue
        index = states.campaigns.index(name)
        own_s = states.t_s[states.campaign == index]
        nearest_s = float(own_s[np.argmin(np.abs(own_s - t_s))])
        if (index, nearest_s) in kept:
            rows.append(k)
    return np.array(rows, dtype=np.int64)

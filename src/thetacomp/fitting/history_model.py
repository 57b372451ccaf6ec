"""The heat-history model of one moving axis: intercepts, slopes and bends by averaged block ridge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.axis_states import AxisStates, Samples, curve_um
from thetacomp.errors import AnalysisError
from thetacomp.fitting.ridge import HistoryRidge, history_candidates
from thetacomp.model.filters import InputLayout

MIN_CAMPAIGNS = 2


@dataclass(frozen=True)
class HistoryModel:
    """A fitted heat-history model: the ridge predicts `AxisStates.targets` of `components`."""

    axis: str
    components: tuple[str, ...]
    layout: InputLayout
    ridge: HistoryRidge

    def predict(self, component: str, states: AxisStates, samples: Samples) -> tuple[Floats, Floats]:
        """Thermal error of samples in µm, (n,); no interval is stated, so the second array is NaN."""
        k = self.components.index(component)
        value = curve_um(self.ridge.predict(samples.history), k, len(self.components), samples.lever_m)
        return value, np.full(len(value), np.nan)


def history_procedure(states: AxisStates, like: HistoryModel | None = None) -> HistoryModel:
    """Fit on all components at once; everything is chosen by holding out campaigns inside the training states.

    `like` is a model of the same components with one more sensor, whose strengths and weights are taken over.

    Raises AnalysisError where no sensor was read in all campaigns or fewer than two campaigns train.
    """
    if states.layout is None:
        raise AnalysisError(f"axis {states.axis or 'drift'}: no sensor was read in all campaigns.")
    if len(np.unique(states.campaign)) < MIN_CAMPAIGNS:
        raise AnalysisError(f"axis {states.axis or 'drift'}: heat history needs {MIN_CAMPAIGNS} training campaigns.")
    candidates = history_candidates(states.layout, len(np.unique(states.campaign)))
    ridge = HistoryRidge(states.layout.blocks, candidates)
    ridge.fit(states.history, states.targets(), states.campaign, like.ridge if like is not None else None)
    return HistoryModel(states.axis, states.components, states.layout, ridge)

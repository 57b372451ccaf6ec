"""Simple ways to predict a thermal error that the program itself does not judge by: what any model has to beat."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.axis_states import AxisStates, Samples, curve_um
from thetacomp.fitting.key_point_law import AxisModel, Predictor, clock, fit_axis
from thetacomp.sensors.sensor_curve import campaign_summaries
from thetacomp.sensors.subset import best_subset

MEAN_CURVE, BEST_THREE = "mean_curve", "best_three"


@dataclass(frozen=True)
class MeanCurve:
    """The mean over training campaigns of what each target (`AxisStates.targets`) was at the same elapsed time.

    `curves` holds for each campaign its hours, ascending (n,), and its targets (n, m).
    """

    components: tuple[str, ...]
    curves: tuple[tuple[Floats, Floats], ...]

    def predict(self, component: str, states: AxisStates, samples: Samples) -> tuple[Floats, Floats]:
        """Thermal error in µm (n,); no interval is stated, so the second is NaN."""
        parameters = np.mean([_at(samples.elapsed_h, *curve) for curve in self.curves], axis=0)
        value = curve_um(parameters, self.components.index(component), len(self.components), samples.lever_m)
        return value, np.full(len(value), np.nan)


def _at(hour: Floats, known_h: Floats, targets: Floats) -> Floats:
    return np.column_stack([np.interp(hour, known_h, column) for column in targets.T])


def mean_curve(states: AxisStates) -> Predictor:
    """The clock as a mean curve over the training campaigns; of a single one, whose rows are held out, a line."""
    present = np.unique(states.campaign)
    if len(present) < 2 and len(states.campaigns) < 2:
        return clock(states)
    targets = states.targets()
    curves = []
    for label in present:
        rows = np.flatnonzero((states.campaign == label) & np.isfinite(targets).all(axis=1))
        rows = rows[np.argsort(states.elapsed_h[rows], kind="stable")]
        if len(rows):
            curves.append((states.elapsed_h[rows], targets[rows]))
    return MeanCurve(states.components, tuple(curves))


@dataclass(frozen=True)
class BestThree:
    """For every component its own law on three sensors."""

    laws: Mapping[str, AxisModel]

    def predict(self, component: str, states: AxisStates, samples: Samples) -> tuple[Floats, Floats]:
        """Thermal error in µm and the half width of its 95 % interval, both (n,)."""
        return self.laws[component].predict(component, states, samples)


def best_three(states: AxisStates) -> BestThree:
    """Least squares on the three sensors that do best when each training campaign is left out, proven by search.

    Raises AnalysisError where fewer than two campaigns train or three sensors cannot be told apart.
    """
    summaries = campaign_summaries(states)
    laws = {}
    for k, component in enumerate(states.components):
        ends = [f"{2 * k}", f"{2 * k + 1}"]  # a component has two targets, at the Gauss points of its travel
        found = best_subset(summaries, 3, score="held_out", targets=ends, weights_um=[1.0, 1.0])
        laws[component] = fit_axis(states, found.sensors)
    return BestThree(laws)

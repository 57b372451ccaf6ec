"""The linear model of one moving axis: fitting it, applying it, and the baselines it is compared with."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import special

from thetacomp.arrays import Floats, Ints
from thetacomp.axis_states import AxisStates, Samples
from thetacomp.errors import AnalysisError
from thetacomp.fitting.linear import ThermalRegression
from thetacomp.sensors.key_points import AxisKeyPoints

ELAPSED_TIME = "elapsed time"
COVERAGE = 0.95


@dataclass(frozen=True)
class AxisModel:
    """Fitted model of one axis. `inputs` are sensor ids, `ELAPSED_TIME` for the clock, or none (a constant).

    `regressions` holds for every component the regression of (intercept µm, slope µm/m), of the intercept alone for
    drift.
    """

    axis: str
    inputs: tuple[str, ...]
    regressions: Mapping[str, ThermalRegression]
    key_points: AxisKeyPoints | None = None

    def predict(self, component: str, states: AxisStates, samples: Samples) -> tuple[Floats, Floats]:
        """Thermal error of samples in µm with the half width of its 95 % prediction interval, both (n,).

        NaN where an input is missing. The interval holds the uncertainty of the coefficients, the scatter of the
        states about the line, and the noise of the instrument in the samples themselves (the law of propagation for a
        linear model).
        """
        regression = self.regressions[component]
        X = input_columns(self.inputs, states.sensors, samples.rise_K, samples.elapsed_h)
        value, half_width = np.full(len(X), np.nan), np.full(len(X), np.nan)
        known = np.flatnonzero(np.isfinite(X).all(axis=1))
        if not len(known):
            return value, half_width
        X = X[known]
        basis = np.column_stack([np.ones(len(X)), samples.lever_m[known]])[:, : len(regression.intercept_)]
        value[known] = np.sum(regression.predict(X) * basis, axis=1)
        scatter = np.einsum("ij,jk,ik->i", basis, regression.residual_covariance_, basis)
        variance = scatter * (1.0 + regression.leverage(X)) + samples.noise_sd_um[known] ** 2
        half_width[known] = special.stdtrit(regression.dof_, 0.5 + COVERAGE / 2) * np.sqrt(np.maximum(variance, 0.0))
        return value, half_width


class Predictor(Protocol):
    """Any fitted model of one axis: it predicts samples, and states an interval or NaN."""

    def predict(self, component: str, states: AxisStates, samples: Samples) -> tuple[Floats, Floats]:
        """Thermal error in µm and the half width of its 95 % interval, both (n,)."""


AnyProcedure = Callable[[AxisStates], Predictor]
Procedure = Callable[[AxisStates], AxisModel]
"""Everything that is chosen and fitted, from training states alone: what is repeated inside every fold."""


def input_columns(inputs: Sequence[str], sensors: Sequence[str], rise_K: Floats, elapsed_h: Floats) -> Floats:
    """Columns of the named inputs, shape (n, len(inputs)): rises in K, elapsed time in hours.

    Without inputs it is one column of zeros, since scikit-learn refuses a design without columns.
    """
    columns = [elapsed_h if name == ELAPSED_TIME else rise_K[:, list(sensors).index(name)] for name in inputs]
    return np.column_stack(columns) if columns else np.zeros((len(elapsed_h), 1))


def complete_rows(states: AxisStates, component: int, X: Floats) -> Ints:
    """Rows that carry information: the component and all inputs are known, and it is not zero by definition."""
    known = np.isfinite(states.intercept_um[:, component]) & np.isfinite(X).all(axis=1)
    if states.exact_zero:
        # Zero at zero holds by definition: as data it would only pretend to more degrees of freedom.
        known &= ~states.cold
    if not states.is_drift:
        known &= np.isfinite(states.slope_um_per_m[:, component])
    return np.flatnonzero(known)


def fit_axis(
    states: AxisStates, inputs: Sequence[str], key_points: AxisKeyPoints | None = None, constant: bool | None = None
) -> AxisModel:
    """Fit all components of an axis on the same inputs. Raises AnalysisError where the states are too few.

    Where the zero of the states is exact the regression runs through it: no rise, no thermal error. Without inputs it
    then predicts no error at all, which is no compensation. `constant` says otherwise.
    """
    constant = not states.exact_zero if constant is None else constant
    X = input_columns(inputs, states.sensors, states.rise_K, states.elapsed_h)
    regressions = {}
    for k, component in enumerate(states.components):
        rows = complete_rows(states, k, X)
        if len(rows) <= X.shape[1] + int(constant):
            raise AnalysisError(
                f"{component}: {len(rows)} complete heated states cannot determine a model with {len(inputs)} inputs;"
                f" at least {X.shape[1] + int(constant) + 1} are needed, more than ten make it useful."
                " Fix: measure more heated sweeps, or fill the missing values."
            )
        y = states.line_intercept_um[rows, k : k + 1]
        if not states.is_drift:
            y = np.column_stack([y, states.slope_um_per_m[rows, k]])
        regressions[component] = ThermalRegression(fit_intercept=constant).fit(X[rows], y)
    return AxisModel(states.axis, tuple(inputs), regressions, key_points)


def known_sensors(states: AxisStates) -> tuple[str, ...]:
    """Sensors that have a value in every state."""
    return tuple(name for j, name in enumerate(states.sensors) if np.isfinite(states.rise_K[:, j]).all())


def clock(states: AxisStates) -> AxisModel:
    """Baseline: regression on elapsed time alone, no thermometer; with a constant, which makes it harder to beat."""
    return fit_axis(states, (ELAPSED_TIME,), constant=True)


def training_mean(states: AxisStates) -> AxisModel:
    """Baseline where the datum is common: the mean of the training states."""
    return fit_axis(states, ())


def all_sensors(states: AxisStates) -> AxisModel:
    """Baseline: plain least squares on every sensor."""
    return fit_axis(states, known_sensors(states))

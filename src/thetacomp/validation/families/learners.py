"""Support vectors, Gaussian process, gradient boosting and neural network on rises and lags, from scikit-learn."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.neural_network import MLPRegressor
from sklearn.svm import SVR

from thetacomp.arrays import Floats
from thetacomp.validation.families.family import Family, Forecast, Rows, Table, one_by_one

SLOW_ROWS = 60
"""Rows of a campaign that train the families whose cost grows faster than the rows."""

_SEED = 0


def _standard(value: Floats) -> tuple[Floats, Floats]:
    """Mean and standard deviation of every column; 1 where it does not vary."""
    spread = value.std(axis=0)
    return value.mean(axis=0), np.where(spread > 1e-12, spread, 1.0)


class _Standardised:
    """Inputs and targets of a table with mean 0 and standard deviation 1, and the way back."""

    def __init__(self, table: Table) -> None:
        self._x, self._y = _standard(table.rows.x), _standard(table.y)
        self.x, self.y = self.inputs(table.rows), (table.y - self._y[0]) / self._y[1]

    def inputs(self, rows: Rows) -> Floats:
        return np.asarray((rows.x - self._x[0]) / self._x[1])

    def back(self, y: Floats) -> Floats:
        return np.asarray(y.reshape(len(y), -1) * self._y[1] + self._y[0])


def _support_vectors(table: Table, setting: tuple[float, float, float]) -> Forecast:
    cost, reach, tube = setting
    data = _Standardised(table)
    models = [SVR(C=cost, gamma=reach / data.x.shape[1], epsilon=tube).fit(data.x, y) for y in data.y.T]
    return lambda rows: data.back(np.column_stack([model.predict(data.inputs(rows)) for model in models]))


SUPPORT_VECTORS = Family(
    "support vectors",
    "rises and lags",
    tuple((cost, reach, tube) for cost in (1.0, 10.0, 100.0) for reach in (0.1, 1.0) for tube in (0.02, 0.1)),
    one_by_one(_support_vectors),
    max_rows=SLOW_ROWS,
)


def _gaussian_process(table: Table, setting: tuple[float, float]) -> Forecast:
    length, noise = setting
    data = _Standardised(table)
    kernel = ConstantKernel(1.0) * RBF(length * np.sqrt(data.x.shape[1])) + WhiteKernel(noise)
    model = GaussianProcessRegressor(kernel, optimizer=None).fit(data.x, data.y)
    return lambda rows: data.back(model.predict(data.inputs(rows)))


GAUSSIAN_PROCESS = Family(
    "Gaussian process",
    "rises and lags",
    tuple((length, noise) for length in (0.5, 1.0, 2.0, 4.0) for noise in (1e-3, 1e-2, 1e-1)),
    one_by_one(_gaussian_process),
    max_rows=SLOW_ROWS,
)


def _gradient_boosting(table: Table, settings: Sequence[tuple[int, float, int]]) -> list[Forecast | None]:
    """Trees are added one by one, so the model with many trees holds those with fewer."""
    data = _Standardised(table)
    most: dict[tuple[int, float], int] = {}
    for leaves, rate, trees in settings:
        most[leaves, rate] = max(trees, most.get((leaves, rate), 0))
    models = {
        (leaves, rate): [
            HistGradientBoostingRegressor(
                max_leaf_nodes=leaves, learning_rate=rate, max_iter=trees, min_samples_leaf=min(10, len(y) // 4),
                early_stopping=False, random_state=_SEED,
            ).fit(data.x, y)
            for y in data.y.T
        ]
        for (leaves, rate), trees in most.items()
    }  # fmt: skip

    def forecast(leaves: int, rate: float, trees: int) -> Forecast:
        return lambda rows: data.back(
            np.column_stack([_after(model, data.inputs(rows), trees) for model in models[leaves, rate]])
        )

    return [forecast(*setting) for setting in settings]


def _after(model: Any, x: Floats, trees: int) -> Floats:
    """The prediction after a number of trees."""
    for number, value in enumerate(model.staged_predict(x), 1):
        if number == trees:
            return np.asarray(value)
    return np.asarray(model.predict(x))


GRADIENT_BOOSTING = Family(
    "gradient boosting",
    "rises and lags",
    tuple((leaves, 0.2, trees) for leaves in (4, 8) for trees in (5, 10, 15, 20, 30, 40)),
    _gradient_boosting,
    max_rows=SLOW_ROWS,
)


def _neural_network(table: Table, setting: tuple[tuple[int, ...], float]) -> Forecast:
    layers, decay = setting
    data = _Standardised(table)
    model = MLPRegressor(
        hidden_layer_sizes=layers, activation="tanh", solver="lbfgs", alpha=decay, max_iter=40, random_state=_SEED
    )
    with warnings.catch_warnings():
        # Forty steps are the budget: stopping early is a part of the setting.
        warnings.simplefilter("ignore", ConvergenceWarning)
        model.fit(data.x, data.y if data.y.shape[1] > 1 else data.y[:, 0])
    return lambda rows: data.back(model.predict(data.inputs(rows)))


NEURAL_NETWORK = Family(
    "neural network",
    "rises and lags",
    tuple((layers, decay) for layers in ((4,), (12,), (12, 6)) for decay in (0.1, 1.0, 10.0, 100.0)),
    one_by_one(_neural_network),
    max_rows=SLOW_ROWS,
)

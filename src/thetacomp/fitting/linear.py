"""Multiple linear regression of the thermal parameters on temperature rises, with honest standard errors."""

from __future__ import annotations

from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from thetacomp.arrays import Floats
from thetacomp.fitting.estimator import Regressor


class ThermalRegression(Regressor):
    """Least squares of several parameters on the same inputs (paper, section 4).

    `fit(X, y)`: X (n, p) temperature rises in K, y (n,) or (n, m) parameters such as intercept (µm) and slope (µm/m).
    After fitting: `coef_` (m, p) per K, `intercept_` (m,), `residual_covariance_` (m, m), `dof_`, `r_squared_` (m,),
    and `unscaled_covariance_` (p + 1, p + 1), the inverse normal matrix for (constant, coefficients): the covariance
    of parameter j's coefficients is `residual_covariance_[j, j] * unscaled_covariance_`. With `fit_intercept=False`
    the regression runs through zero: no rise, no thermal error. Raises ValueError where there are not more rows than
    unknowns.
    """

    def __init__(self, fit_intercept: bool = True) -> None:
        self.fit_intercept = fit_intercept

    def fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Fit the regression; see the class for shapes and units."""
        inputs = self._checked_inputs(X)
        targets = np.asarray(y, dtype=float)
        if len(targets) != len(inputs) or not np.isfinite(targets).all():
            raise ValueError(f"y must have {len(inputs)} finite rows, found shape {targets.shape}")
        self.n_features_in_ = inputs.shape[1]
        self._single_ = targets.ndim == 1
        targets = targets.reshape(len(inputs), -1)
        n, p = inputs.shape
        unknowns = p + int(self.fit_intercept)
        if n <= unknowns:
            raise ValueError(f"{n} states cannot determine {unknowns} unknowns; more states or fewer inputs are needed")
        centre = inputs.mean(axis=0) if self.fit_intercept else np.zeros(p)
        design = np.column_stack([np.full(n, float(self.fit_intercept)), inputs - centre])
        inverse = np.linalg.pinv(design.T @ design, hermitian=True)
        beta = inverse @ (design.T @ targets)
        residual = targets - design @ beta
        self.states_ = n
        self.dof_ = n - np.linalg.matrix_rank(design)
        self.residual_covariance_ = residual.T @ residual / self.dof_
        # Undo the centring, which only keeps the normal matrix well conditioned.
        back = np.eye(p + 1)
        back[0, 1:] = -centre
        self.unscaled_covariance_ = back @ inverse @ back.T
        self.coef_ = beta[1:].T
        self.intercept_ = beta[0] - self.coef_ @ centre
        spread = np.sum((targets - targets.mean(axis=0)) ** 2, axis=0)
        left = np.sum(residual**2, axis=0)
        self.r_squared_ = np.where(spread > 0, 1.0 - left / np.where(spread > 0, spread, 1.0), 0.0)
        return self

    def predict(self, X: ArrayLike) -> Floats:
        """Parameters at temperature rises X (n, p): (n,) or (n, m) as in `fit`."""
        self._require_fit()
        inputs = self._checked_inputs(X, self.n_features_in_)
        out = inputs @ self.coef_.T + self.intercept_
        return np.asarray(out[:, 0] if self._single_ else out)

    def leverage(self, X: ArrayLike) -> Floats:
        """`x (X'X)^-1 x'` of each row, (n,): the factor by which the residual variance enters the coefficients."""
        self._require_fit()
        inputs = self._checked_inputs(X, self.n_features_in_)
        design = np.column_stack([np.ones(len(inputs)), inputs])
        return np.asarray(np.einsum("ij,jk,ik->i", design, self.unscaled_covariance_, design))

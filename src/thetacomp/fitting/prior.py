"""The physical prior: a static law of the mean temperature rise, from which single sensors may deviate a little.

Plausible everywhere, precise nowhere. It has no lags and no differences, so no pair of large coefficients of opposite
sign can run away where the temperatures no longer move together as they did in training.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thetacomp.arrays import Floats
from thetacomp.errors import AnalysisError

# ridge strength against the mean square of the rises; chosen on synthetic machines, where 0.03 to 0.3 are about equal
STRENGTH = 0.1


@dataclass(frozen=True)
class Prior:
    """`E = Σ coefficient × rise` with one coefficient a sensor; `um_per_K` is that of the mean rise alone."""

    sensors: tuple[str, ...]
    um_per_K: float
    coefficients_um_per_K: tuple[float, ...]

    def error_um(self, rise_K: Floats) -> Floats:
        """Error (n,) at rises (n, p) in K."""
        error: Floats = np.asarray(rise_K) @ np.array(self.coefficients_um_per_K)
        return error


def fit_prior(sensors: Sequence[str], rise_K: Floats, error_um: Floats, campaign: NDArray[Any]) -> Prior:
    """The prior of one component from rises (n, p), errors (n,) and campaigns (n,), which weigh the same.

    First `c = Σ u e / Σ u²` on the mean rise u. Then the deviations d of the sensors from c / p by ridge regression
    on what is left, with one common scale: `min Σ (e - c u - x d)² + STRENGTH × mean(x²) × |d|²`.
    Raises AnalysisError where no row is complete.
    """
    known = np.isfinite(rise_K).all(axis=1) & np.isfinite(error_um)
    if not known.any():
        raise AnalysisError("no complete row: a prior needs rises and errors at the same time.")
    x, e = rise_K[known], error_um[known]
    _, index, rows = np.unique(campaign[known], return_inverse=True, return_counts=True)
    weight = 1.0 / (len(rows) * rows[index])
    u = x.mean(axis=1)
    c = float(weight @ (u * e)) / max(float(weight @ u**2), 1e-12)
    moment = x.T @ (x * weight[:, None])
    strength = STRENGTH * max(float(np.trace(moment)), 1e-12) / len(sensors)
    deviation = np.linalg.solve(moment + strength * np.eye(len(sensors)), x.T @ (weight * (e - c * u)))
    coefficients = c / len(sensors) + deviation
    return Prior(tuple(sensors), c, tuple(float(value) for value in coefficients))

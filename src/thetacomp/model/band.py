"""The band around a prediction: its half width from the position and from the inputs of this moment. Numpy only.

`half width = quantile × √(scatter(u) × (states + growth × g(h)))` with u the distance from P0, h the leverage of the
inputs (`Leverage.at`) and `g = h / (h + knee) × (1 + h / far)`.

- A regression: the scatter of its residuals at u, `states` 1, or 2 where the reference has its own residual,
  and the uncertainty of the coefficients, which grows with the leverage. Knee and far of 1 make g = h: the prediction
  interval of linear regression, with Student's t as the quantile.
- A band that is calibrated on whole campaigns: near the reference h is small and the band is `quantile × sd`. Past
  the knee g stays near 1, since inside the training campaigns the error no longer grows with the leverage. Past
  `far`, the largest held-out leverage, g grows with h: nothing is known there, and the band widens in proportion to
  the distance. Its quantile comes from held-out campaigns, see `fitting.conformal`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from pydantic import ConfigDict

from thetacomp.arrays import Floats


@dataclass(frozen=True)
class Band:
    """The band of one component; see the module's head.

    `sd` holds the standard deviation of what each power of u leaves (µm, µm/m), `correlation` that of the first two.
    `quantile` is None where the fit left no degree of freedom: then no band is known. `noise_sd_um` is the scatter of
    one reading that the band holds. `level` is what was asked for; of a calibrated band `guaranteed_level` is what it
    reaches in the worst case and `attainable_level` the highest level that `campaigns` calibration campaigns can
    guarantee, m / (m + 1). `sentence` says in words what is guaranteed, and on which assumption.
    """

    quantile: float | None
    sd: tuple[float, ...]
    correlation: float = 0.0
    growth: float = 1.0
    knee: float = 1.0
    far: float = 1.0
    noise_sd_um: float = 0.0
    level: float = 0.95
    guaranteed_level: float | None = None
    attainable_level: float | None = None
    campaigns: int | None = None
    sentence: str = ""

    __pydantic_config__ = ConfigDict(extra="forbid", allow_inf_nan=False)

    def grown(self, leverage: Floats) -> Floats:
        """`growth × g(h)`, (n,): what the leverage adds to the variance, in units of the scatter."""
        return np.asarray(self.growth * leverage / (leverage + self.knee) * (1.0 + leverage / self.far))

    def half_width_um(self, leverage: Floats, u_m: Floats | float = 0.0, states: float = 1.0) -> Floats:
        """Half width (n,) of the band at inputs of these leverages (n,), at distances u (n,) from P0."""
        first, second = (*self.sd, 0.0)[:2]
        scatter = first**2 + u_m * (2.0 * self.correlation * first * second + u_m * second**2)
        return self._half_width(np.maximum(scatter, 0.0), leverage, states)

    def half_width_of_term(self, power: int, leverage: Floats, states: float) -> Floats:
        """Half width (n,) of what one power of u carries, in its own unit."""
        return self._half_width(np.asarray(self.sd[power] ** 2 if power < len(self.sd) else 0.0), leverage, states)

    def _half_width(self, scatter: Floats, leverage: Floats, states: float) -> Floats:
        if self.quantile is None:
            return np.full(len(leverage), math.inf)
        return np.asarray(self.quantile * np.sqrt(scatter * (states + self.grown(leverage))))

"""The band around a prediction: its half width from the inputs of this moment. Numpy only.

`half width = quantile × √(base² + growth² g(h))` with h the leverage of the inputs (see `Reach.leverage`) and
`g = h / (h + knee) × (1 + h / far)`. Near the reference h is small and the band is `quantile × base`. Past the knee g
stays near 1, since inside the training campaigns the error no longer grows with the leverage. Past `far`, the
largest held-out leverage, g grows with h: nothing is known there, and the band widens in proportion to the distance.
The quantile comes from held-out campaigns, see `validation.conformal`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats


@dataclass(frozen=True)
class Scale:
    """Typical size of the error in µm against the leverage; see the module's head."""

    base_um: float
    growth_um: float
    knee: float
    far: float

    def at(self, leverage: Floats) -> Floats:
        """Scale (n,) in µm at leverages (n,)."""
        bent = leverage / (leverage + self.knee) * (1.0 + leverage / self.far)
        scale_um: Floats = np.sqrt(self.base_um**2 + self.growth_um**2 * bent)
        return scale_um


@dataclass(frozen=True)
class Band:
    """A conformal band of one error component, in µm.

    `level` is what was asked for. `guaranteed_level` is what it reaches in the worst case, and `attainable_level` the
    highest level that `campaigns` calibration campaigns can guarantee, m / (m + 1). `quantile` is the factor on the
    scale. `sentence` says in words what holds, and on which assumption.
    """

    level: float
    guaranteed_level: float
    attainable_level: float
    campaigns: int
    quantile: float
    scale: Scale
    sentence: str

    def half_width_um(self, leverage: Floats) -> Floats:
        """Half width (n,) of the band at inputs of these leverages (n,)."""
        return self.quantile * self.scale.at(leverage)

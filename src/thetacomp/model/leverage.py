"""How far an input vector lies from the training campaigns: its leverage. Numpy only.

The leverage is `h(x) = zᵀ (C + floor · 1)⁻¹ z` with `z = (x - centre) / scale` and C the second moment of z over the
training campaigns, every campaign weighing the same. It is the squared Mahalanobis distance with a floor for the
directions that training hardly moved in. A ridge regression's variance grows in proportion to it (Hoerl and Kennard,
Technometrics 12, 1970, eq. 2.3, with the floor as the ridge). Only the leading directions of C are kept; what lies
outside them counts by the floor alone, as the Q statistic does beside Hotelling's T² in process monitoring (Jackson
and Mudholkar, Technometrics 21, 1979).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from thetacomp.arrays import Floats


@dataclass(frozen=True)
class Reach:
    """The shape of the training campaigns in k inputs: `centre`, `scale` (k,), `directions` (r, k), `moments` (r,).

    All in plain numbers, so that `dataclasses.asdict` gives JSON. A `scale` of 0 marks an input that never moved: its
    smallest believable change is unknown, so it is left out.
    """

    centre: tuple[float, ...]
    scale: tuple[float, ...]
    directions: tuple[tuple[float, ...], ...]
    moments: tuple[float, ...]
    floor: float

    @cached_property
    def _arrays(self) -> tuple[Floats, Floats, Floats, Floats]:
        scale = np.array(self.scale)
        inverse = np.divide(1.0, scale, out=np.zeros(len(scale)), where=scale > 0)
        return (
            np.array(self.centre),
            inverse,
            np.array(self.directions).reshape(-1, len(scale)),
            1.0 / (np.array(self.moments) + self.floor),
        )

    def leverage(self, inputs: Floats) -> Floats:
        """Leverage (n,) of inputs (n, k); about the number of directions on average over training. NaN in, NaN out."""
        centre, inverse_scale, directions, inverse_moments = self._arrays
        z = (np.asarray(inputs, dtype=np.float64) - centre) * inverse_scale
        along = z @ directions.T
        outside = np.maximum((z * z).sum(axis=1) - (along * along).sum(axis=1), 0.0)
        leverage: Floats = (along * along) @ inverse_moments + outside / self.floor
        return leverage

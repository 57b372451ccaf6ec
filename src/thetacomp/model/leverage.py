"""How far an input vector lies from the training campaigns: its leverage. Numpy only.

The leverage is `h(x) = at_centre + zᵀ (C + floor · 1)⁻¹ z` with `z = (x - centre) / scale` and C the second moment of z
over training. It is the squared Mahalanobis distance with a floor for the directions that training hardly moved in. A
ridge regression's variance grows in proportion to it (Hoerl and Kennard, Technometrics 12, 1970, eq. 2.3, with the
floor as the ridge). Only the leading directions of C are kept; what lies outside them counts by the floor alone, as
the Q statistic does next to Hotelling's T² in process monitoring (Jackson and Mudholkar, Technometrics 21, 1979).
Least squares is the case without a floor: there C is the sum of squares, and h is the textbook leverage.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from pydantic import ConfigDict

from thetacomp.arrays import Floats


@dataclass(frozen=True)
class Leverage:
    """The shape of training in k inputs: `centre`, `scale` (k,), `directions` (r, k), `moments` (r,).

    All in plain numbers, so that `dataclasses.asdict` gives JSON. A `scale` of 0 marks an input that never moved: its
    smallest believable change is unknown, so it is left out. Without a `floor` what lies outside the directions does
    not count. `at_centre` is the leverage of the centre itself: 1 / n of a regression with a constant.
    """

    centre: tuple[float, ...]
    scale: tuple[float, ...]
    directions: tuple[tuple[float, ...], ...]
    moments: tuple[float, ...]
    floor: float | None
    at_centre: float = 0.0

    __pydantic_config__ = ConfigDict(extra="forbid", allow_inf_nan=False)

    @cached_property
    def _arrays(self) -> tuple[Floats, Floats, Floats, Floats]:
        scale = np.array(self.scale)
        inverse = np.divide(1.0, scale, out=np.zeros(len(scale)), where=scale > 0)
        return (
            np.array(self.centre),
            inverse,
            np.array(self.directions).reshape(len(self.directions), len(scale)),
            1.0 / (np.array(self.moments) + (self.floor or 0.0)),
        )

    def at(self, inputs: Floats, *, from_centre: bool = True) -> Floats:
        """Leverage (n,) of inputs (n, k), about the number of directions on average over training. NaN in, NaN out.

        `from_centre` off counts from zero: the leverage of the difference from the reference.
        """
        centre, inverse_scale, directions, inverse_moments = self._arrays
        inputs = np.asarray(inputs, dtype=np.float64)
        z = (inputs - centre if from_centre and centre.any() else inputs) * inverse_scale
        along = z @ directions.T
        leverage: Floats = (along * along) @ inverse_moments + (self.at_centre if from_centre else 0.0)
        if self.floor is not None:
            # einsum squares and adds without an array of the squares
            outside = np.einsum("ij,ij->i", z, z) - np.einsum("ij,ij->i", along, along)
            leverage += np.maximum(outside, 0.0) / self.floor
        return leverage

    def of_inputs(self, kept: Sequence[int]) -> Leverage:
        """The same training seen in some of the inputs: their own second moments, and the directions of these.

        Leaving columns out of the directions would leave them short, and every row far away.
        """
        directions = np.array(self.directions).reshape(len(self.directions), len(self.scale))[:, list(kept)]
        moments, vectors = np.linalg.eigh(directions.T @ (directions * np.array(self.moments)[:, None]))
        led = moments > (1e-14 * moments.max(initial=0.0) if self.floor is None else self.floor)
        return replace(
            self,
            centre=tuple(self.centre[j] for j in kept),
            scale=tuple(self.scale[j] for j in kept),
            directions=tuple(tuple(vector) for vector in vectors[:, led].T.tolist()),
            moments=tuple(moments[led].tolist()),
        )


def regression_leverage(unscaled_covariance: Floats) -> Leverage:
    """The leverage of a regression from its inverse normal matrix (k + 1, k + 1) for (constant, coefficients)."""
    about_zero, mixed, inner = unscaled_covariance[0, 0], unscaled_covariance[0, 1:], unscaled_covariance[1:, 1:]
    centre = -np.linalg.pinv(inner, hermitian=True) @ mixed if len(inner) else np.zeros(0)
    values, vectors = np.linalg.eigh(inner) if len(inner) else (np.zeros(0), np.zeros((0, 0)))
    kept = values > 1e-14 * values.max(initial=0.0)
    return Leverage(
        centre=tuple(centre.tolist()),
        scale=(1.0,) * len(inner),
        directions=tuple(tuple(vector) for vector in vectors[:, kept].T.tolist()),
        moments=tuple((1.0 / values[kept]).tolist()),
        floor=None,
        at_centre=max(float(about_zero - centre @ inner @ centre), 0.0),
    )

"""Whether a model may be believed at this moment: one distance from range and leverage. Numpy only.

The distance is 1 at the border of what the training campaigns showed. Outside the prediction fades towards a prior,
see `fade`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from thetacomp.arrays import Floats
from thetacomp.model.leverage import Reach


@dataclass(frozen=True)
class Validity:
    """The border of validity in k inputs: those of the model, and absolute temperatures where the season counts.

    `middle` and `half_span` (k,) are the ranges of the training campaigns; a half span of 0 leaves an input out.
    `leverage_unit` and `range_unit` make the two measures comparable, `limit` puts their larger one to 1 at the
    border. `quiet_level` is the share of campaigns like those of training that never cross the border.
    """

    reach: Reach
    middle: tuple[float, ...]
    half_span: tuple[float, ...]
    leverage_unit: float
    range_unit: float
    limit: float
    quiet_level: float
    campaigns: int
    sentence: str

    @cached_property
    def _ranges(self) -> tuple[Floats, Floats]:
        return np.array(self.middle), np.array(self.half_span)

    def distance(self, inputs: Floats) -> Floats:
        """Distance (n,) of inputs (n, k): up to 1 inside. Infinite where an input is missing."""
        inputs = np.asarray(inputs, dtype=np.float64)
        far = furthest(self.reach, *self._ranges, inputs) / np.array([self.leverage_unit, self.range_unit])
        distance = far.max(axis=1) / self.limit
        return np.where(np.isfinite(distance), distance, np.inf)

    def inside(self, inputs: Floats) -> NDArray[np.bool_]:
        """The in-domain flag (n,): True where the distance is at most 1."""
        return np.asarray(self.distance(inputs) <= 1.0)


def furthest(reach: Reach, middle: Floats, half_span: Floats, inputs: Floats) -> Floats:
    """Two measures (n, 2) of inputs (n, k): root of the leverage, and the largest |x - middle| in half spans."""
    spans = np.divide(1.0, half_span, out=np.zeros(len(half_span)), where=half_span > 0)
    return np.column_stack([np.sqrt(reach.leverage(inputs)), np.max(np.abs(inputs - middle) * spans, axis=1)])

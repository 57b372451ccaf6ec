"""Where a law may be believed: the box of its training, and one distance from range and leverage. Numpy only.

A law on a few key temperatures has a box: temperatures and rises, each with a margin. A law with many inputs has a
distance, which is 1 at the border of what the training campaigns showed; outside the prediction fades towards a prior,
see `model.fade`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
from pydantic import ConfigDict

from thetacomp.arrays import Bools, Floats
from thetacomp.model.leverage import Leverage

MARGIN_OF_SPAN = 0.05
MARGIN_MM = 1.0


@dataclass(frozen=True)
class Limit:
    """One quantity of a law against its range in training: a temperature (°C), its rise (K) or a position (mm).

    A law with many inputs has a distance from training instead of temperatures and rises; it is 1 at the border.
    `name` is the sensor or the axis; `value` and `inside` are (n,), `inside` with the margin; a missing value is
    outside.
    """

    kind: Literal["temperature", "rise", "position", "distance"]
    name: str
    value: Floats
    trained: tuple[float, float]
    inside: Bools


@dataclass(frozen=True)
class Validity:
    """The border of validity in k inputs: those of the law, and absolute temperatures where the season counts.

    `middle` and `half_span` (k,) are the ranges of the training campaigns; a half span of 0 leaves an input out.
    `leverage_unit` and `range_unit` make the two measures comparable, `limit` puts their larger one to 1 at the
    border. `quiet_level` is the share of campaigns like those of training that never cross the border.
    """

    leverage: Leverage
    middle: tuple[float, ...]
    half_span: tuple[float, ...]
    leverage_unit: float
    range_unit: float
    limit: float
    quiet_level: float
    campaigns: int
    sentence: str

    __pydantic_config__ = ConfigDict(extra="forbid", allow_inf_nan=False)

    @cached_property
    def _ranges(self) -> tuple[Floats, Floats]:
        return np.array(self.middle), np.array(self.half_span)

    def distance(self, inputs: Floats) -> Floats:
        """Distance (n,) of inputs (n, k): up to 1 inside. Infinite where an input is missing."""
        inputs = np.asarray(inputs, dtype=np.float64)
        far = furthest(self.leverage, *self._ranges, inputs) / np.array([self.leverage_unit, self.range_unit])
        distance = far.max(axis=1) / self.limit
        return np.where(np.isfinite(distance), distance, np.inf)

    def inside(self, inputs: Floats) -> Bools:
        """The in-domain flag (n,): True where the distance is at most 1."""
        return np.asarray(self.distance(inputs) <= 1.0)

    def of_inputs(self, kept: Sequence[int]) -> Validity:
        """The same border seen in some of the inputs."""
        return replace(
            self,
            leverage=self.leverage.of_inputs(kept),
            middle=tuple(self.middle[j] for j in kept),
            half_span=tuple(self.half_span[j] for j in kept),
        )


@dataclass(frozen=True)
class Border:
    """What a law was trained on: by sensor the temperatures and their rises above the reference.

    The rises limit it only where errors count from each campaign's own reference (`rise_counts`). `distance` stands
    in place of the box for a law with many inputs.
    """

    temperature_degC: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    rise_K: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    rise_counts: bool = True
    distance: Validity | None = None

    __pydantic_config__ = ConfigDict(extra="forbid", allow_inf_nan=False)

    def limits(self, sensors: Sequence[str], temperature_degC: Floats, rise_K: Floats) -> list[Limit]:
        """The limits of the box, for temperatures and rises (n, p) of p sensors."""
        out = []
        for j, sensor in enumerate(sensors):
            if sensor in self.temperature_degC:
                out.append(_ranged("temperature", sensor, temperature_degC[:, j], self.temperature_degC[sensor]))
            if self.rise_counts and sensor in self.rise_K:
                out.append(_ranged("rise", sensor, rise_K[:, j], self.rise_K[sensor]))
        return out

    def box_degC(self, sensors: Sequence[str], zero_degC: Floats) -> dict[str, tuple[float, float]]:
        """Lowest and highest temperature of each sensor in the box, where the error counts from `zero_degC` (p,)."""
        out = dict(self.temperature_degC)
        for sensor, zero in zip(sensors, zero_degC.tolist(), strict=True):
            if self.rise_counts and sensor in self.rise_K:
                low, high = self.rise_K[sensor]
                out[sensor] = (zero + low, zero + high)
        return out


def furthest(leverage: Leverage, middle: Floats, half_span: Floats, inputs: Floats) -> Floats:
    """Two measures (n, 2) of inputs (n, k): root of the leverage, and the largest |x - middle| in half spans."""
    spans = np.divide(1.0, half_span, out=np.zeros(len(half_span)), where=half_span > 0)
    return np.column_stack([np.sqrt(leverage.at(inputs)), np.max(np.abs(inputs - middle) * spans, axis=1)])


def travelled(axis: str, position_mm: Floats, lowest_mm: float, highest_mm: float) -> Limit:
    """The limit of the measured travel at n positions."""
    inside = (position_mm >= lowest_mm - MARGIN_MM) & (position_mm <= highest_mm + MARGIN_MM)
    return Limit("position", axis, position_mm, (lowest_mm, highest_mm), inside)


def _ranged(kind: Literal["temperature", "rise"], name: str, value: Floats, trained: tuple[float, float]) -> Limit:
    margin = MARGIN_OF_SPAN * (trained[1] - trained[0])
    return Limit(kind, name, value, trained, (value >= trained[0] - margin) & (value <= trained[1] + margin))

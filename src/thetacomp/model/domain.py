"""Where a model holds: the temperatures, rises and positions it was trained on. Numpy only."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from thetacomp.arrays import Floats
from thetacomp.model.document import LinearTerm, Training
from thetacomp.model.history_law import HistoryLaw
from thetacomp.model.law import CONFIDENCE, Law
from thetacomp.model.student import t_quantile

MARGIN_OF_SPAN = 0.05
MARGIN_MM = 1.0

Box = Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class Limit:
    """One quantity of a law beside what it was trained on: a temperature (°C), its rise (K) or a position (mm).

    A law on heat history has a distance from training instead of temperatures and rises; it is 1 at the border.
    `name` is the sensor or the axis; `value` and `inside` are (n,), `inside` with the margin; a missing value is
    outside.
    """

    kind: Literal["temperature", "rise", "position", "distance"]
    name: str
    value: Floats
    trained: tuple[float, float]
    inside: NDArray[np.bool_]


def in_domain(law: Law, training: Training, temperature_degC: Floats, position_mm: Floats) -> NDArray[np.bool_]:
    """True where the model was trained, shape (n,), for temperatures (n, k) of the inputs and n positions.

    Every temperature must lie in its training range and, unless the datum is common to all campaigns, every rise in
    the range of its rises, each with a margin of 5 % of the span; the position in the measured travel with 1 mm.
    A missing value is outside.
    """
    inside = np.ones(len(temperature_degC), dtype=np.bool_)
    for limit in limits(law, training, temperature_degC, position_mm):
        inside &= limit.inside
    return inside


def limits(law: Law, training: Training, temperature_degC: Floats, position_mm: Floats) -> tuple[Limit, ...]:
    """Every limit that `in_domain` looks at, for temperatures (n, k) of the inputs and n positions."""
    out: list[Limit] = []
    rises_K = law.rises_K(temperature_degC)
    for j, sensor in enumerate(law.inputs):
        value, trained = temperature_degC[:, j], training.range_degC[sensor]
        out.append(Limit("temperature", sensor, value, trained, _within(value, trained)))
        if training.datum == "campaign":
            value, trained = rises_K[:, j], training.range_rise_K[sensor]
            out.append(Limit("rise", sensor, value, trained, _within(value, trained)))
    lowest, highest = law.component.p_min_mm, law.component.p_max_mm
    if lowest is not None and highest is not None:
        out.append(_travel(law.component.axis or "", position_mm, lowest, highest))
    return tuple(out)


def history_limits(law: HistoryLaw, position_mm: Floats) -> tuple[Limit, ...]:
    """The limits of a law on heat history at n positions."""
    axis = law.axis
    distance = np.where(np.isfinite(law.distance), law.distance, np.nan)
    out = [Limit("distance", axis.axis or "drift", distance, (0.0, 1.0), distance <= 1.0)]
    if axis.p_min_mm is not None and axis.p_max_mm is not None:
        out.append(_travel(axis.axis or "", position_mm, axis.p_min_mm, axis.p_max_mm))
    return tuple(out)


def training_box_degC(laws: Iterable[Law], training: Training) -> dict[str, tuple[float, float]]:
    """Lowest and highest temperature of every input: what the training covers, seen from the laws' references."""
    box: dict[str, tuple[float, float]] = {}
    for law in laws:
        for sensor, reference in zip(law.inputs, law.reference_degC, strict=True):
            low, high = training.range_degC[sensor]
            if training.datum == "campaign":
                low, high = (float(reference) + rise for rise in training.range_rise_K[sensor])
            known = box.get(sensor, (low, high))
            box[sensor] = (min(low, known[0]), max(high, known[1]))
    return box


def largest(law: Law, term: LinearTerm, box_degC: Box) -> float:
    """Largest |value| of a term of the law inside the box of temperatures, with its 95 % prediction bound.

    In the unit of the term. The bound is left out where the fit has no degree of freedom to tell it.
    """
    coefficients = np.array(term.coefficients_per_K)
    span = np.array([box_degC[sensor] for sensor in law.inputs]).reshape(-1, 2) - law.reference_degC[:, None]
    constant = term.constant if law.keeps_constant else 0.0
    quantile = t_quantile(0.5 + CONFIDENCE / 2, law.component.dof)
    covariance = np.array(term.covariance)
    out = 0.0
    for side in (0, 1):
        # The value is linear in the rises: its extremes are at the corners that the signs of the coefficients choose.
        rises_K = np.where(coefficients > 0, span[:, 1 - side], span[:, side])
        x = np.concatenate([[1.0 if law.keeps_constant else 0.0], rises_K])
        variance = float(x @ covariance @ x) + law.residual_states * term.residual_sd**2
        bound = quantile * float(np.sqrt(max(variance, 0.0))) if np.isfinite(quantile) else 0.0
        out = max(out, abs(constant + float(coefficients @ rises_K)) + bound)
    return out


def _travel(axis: str, position_mm: Floats, lowest: float, highest: float) -> Limit:
    inside = (position_mm >= lowest - MARGIN_MM) & (position_mm <= highest + MARGIN_MM)
    return Limit("position", axis, position_mm, (lowest, highest), inside)


def _within(value: Floats, limits: tuple[float, float]) -> NDArray[np.bool_]:
    margin = MARGIN_OF_SPAN * (limits[1] - limits[0])
    return np.asarray((value >= limits[0] - margin) & (value <= limits[1] + margin))

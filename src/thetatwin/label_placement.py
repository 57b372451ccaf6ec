"""Labels next to their dots: each takes the free place nearest to its dot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats

_DIRECTIONS = 16
_DISTANCES = (1.5, 2.1, 2.8, 3.7, 4.8)  # in letter heights
_LETTER_WIDTH, _LINE_HEIGHT, _DOT = 0.68, 1.5, 0.55


@dataclass(frozen=True)
class Label:
    """A text that belongs to a point (x, y) in pixels."""

    text: str
    point: tuple[float, float]


def place_labels(labels: Sequence[Label], letter_px: float) -> list[tuple[float, float]]:
    """Offset (x, y) in pixels of the middle of each label from its point, so that texts and dots overlap least."""
    points = np.array([label.point for label in labels]).reshape(-1, 2)
    half = np.array([[_LETTER_WIDTH * len(label.text) + 0.5, _LINE_HEIGHT] for label in labels]) * letter_px / 2
    dots = np.tile([_DOT * letter_px] * 2, (len(points), 1))
    angles = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS + np.pi / 4  # up and to the right comes first
    taken_at, taken_half = points, dots
    out = []
    for k in range(len(points)):
        offsets = [
            (letter_px * reach + half[k, 0] - half[k, 1]) * np.cos(a) * np.array([1.0, 0.0])
            + letter_px * reach * np.sin(a) * np.array([0.0, 1.0])
            for reach in _DISTANCES
            for a in angles
        ]
        costs = [
            _overlap(points[k] + offset, half[k], taken_at, taken_half) / letter_px**2 + 0.02 * i / _DIRECTIONS
            for i, offset in enumerate(offsets)
        ]
        best = offsets[int(np.argmin(costs))]
        taken_at, taken_half = np.vstack([taken_at, points[k] + best]), np.vstack([taken_half, half[k]])
        out.append((float(best[0]), float(best[1])))
    return out


def _overlap(middle: Floats, half: Floats, others: Floats, other_half: Floats) -> float:
    """Area that a rectangle shares with others, in square pixels."""
    shared = np.minimum(middle + half, others + other_half) - np.maximum(middle - half, others - other_half)
    return float(np.prod(np.clip(shared, 0.0, None), axis=1).sum())

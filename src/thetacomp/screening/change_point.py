"""When and how a residual left zero: the onset of a change, and whether it was a step or gradual."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats

TIME_CONSTANTS = (2.0, 4.0, 8.0, 16.0, 32.0, 64.0, np.inf)  # in blocks; inf is a ramp
MOST_ONSETS = 60


@dataclass(frozen=True)
class ResidualChange:
    """`onset` is the index of the first changed block; `size` in the unit of the residual, at the end of the record."""

    onset: int
    abrupt: bool
    size: float
    time_constant: float


def fit_change(residual: Floats, earliest: int = 2) -> ResidualChange:
    """The change that fits a residual (n,) best in least squares, over all begins and shapes.

    Shapes are a step, 1 - exp(-t / T) for several T, and a ramp. The block of the onset itself is left out of a step:
    a change within a block gives an intermediate mean. The step is kept unless another shape is clearly better.
    """
    n = len(residual)
    good = np.isfinite(residual)
    onsets = np.unique(np.linspace(earliest, n - 1, MOST_ONSETS).astype(int)) if n > earliest + 1 else np.array([n - 1])
    step = _best(residual, good, onsets.tolist(), 0.0)
    if len(onsets) < n - earliest:  # a long record was thinned: look again near the best
        step = _best(residual, good, _near(step[1], onsets, earliest, n), 0.0)
    others = [(*_best(residual, good, onsets.tolist(), tau), tau) for tau in TIME_CONSTANTS]
    slow = min(others, key=lambda o: o[0])
    abrupt = step[0] <= slow[0] * (1.0 + 6.0 / max(int(good.sum()), 1)) + 1e-12
    _, onset, size, tau = (*step, 0.0) if abrupt else slow
    return ResidualChange(onset, abrupt, size, tau)


def _near(onset: int, onsets: np.ndarray[tuple[int], np.dtype[np.int_]], earliest: int, n: int) -> range:
    gap = int(np.diff(onsets).max())
    return range(max(onset - gap, earliest), min(onset + gap, n - 1) + 1)


def _best(
    residual: Floats, good: np.ndarray[tuple[int], np.dtype[np.bool_]], onsets: Iterable[int], tau: float
) -> tuple[float, int, float]:
    """Smallest mean squared error, its onset, and the size reached at the end."""
    n = len(residual)
    index = np.arange(n)
    found = (np.inf, n - 1, 0.0)
    for onset in onsets:
        after = np.maximum(index - onset + 1.0, 0.0)
        if tau == 0.0:
            shape = (after > 0).astype(float)
        elif np.isinf(tau):
            shape = after
        else:
            shape = -np.expm1(-after / tau)
        used = good & (index != onset) if tau == 0.0 and onset < n - 1 else good
        y, s = residual[used], shape[used]
        if len(y) < 3:
            continue
        c = s - s.mean()
        power = float(c @ c)
        slope = float(c @ y) / power if power > 1e-12 else 0.0
        error = float(np.mean((y - y.mean() - slope * c) ** 2))
        if error < found[0]:
            found = (error, int(onset), slope * float(shape[-1]))
    return found

"""Readings of a campaign on an even grid, and what single readings show of themselves."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from thetacomp.arrays import Bools, Floats
from thetacomp.model.temperatures import Temperatures
from thetacomp.screening.faults import PLAUSIBLE_DEGC

BLOCK_S = 60.0
ROWS = 120  # so many means of a campaign are enough for slow courses
EARLY_S = 5400.0
FIRST_S = 180.0
LAG_S = 1800.0  # metal between a sensor and its neighbours follows in about half an hour


def plausible(value_degC: Floats) -> Bools:
    """Readings that a working thermometer on a machine can give."""
    with np.errstate(invalid="ignore"):
        return np.asarray((value_degC > PLAUSIBLE_DEGC[0]) & (value_degC < PLAUSIBLE_DEGC[1]))


def block_means(t_s: Floats, value: Floats, step_s: float) -> Floats:
    """Means (n, p) of blocks of `step_s` from the first sample on, NaN where a block holds no reading."""
    index = np.floor((t_s - t_s[0]) / step_s + 1e-6).astype(int)
    good = np.isfinite(value)
    first = np.flatnonzero(np.diff(index, prepend=-1))
    out: Floats = np.full((int(index[-1]) + 1, value.shape[1]), np.nan)
    count = np.add.reduceat(good, first, axis=0, dtype=float)
    total = np.add.reduceat(np.where(good, value, 0.0), first, axis=0)
    out[index[first]] = np.where(count > 0, total / np.maximum(count, 1.0), np.nan)
    return out


@dataclass(frozen=True)
class Course:
    """The slow course of a campaign on a few rows, p sensors.

    `t_s` (n,), `level_degC` (n, p) with gaps bridged, `read` (p,) False for a sensor without enough readings;
    `early_s` (m,) and `early_degC` (m, p) are the first EARLY_S in full, NaN where nothing was read.
    """

    t_s: Floats
    level_degC: Floats
    read: Bools
    early_s: Floats
    early_degC: Floats

    @cached_property
    def start_degC(self) -> Floats:
        """Levels (p,) at which the campaign starts."""
        return np.asarray(self.level_degC[: max(1, len(self.t_s) // 60)].mean(axis=0))

    @cached_property
    def inputs_K(self) -> Floats:
        """Rises and lagged rises side by side, (n, 2p)."""
        rise = self.level_degC - self.start_degC
        keep = np.exp(-(self.t_s[1] - self.t_s[0]) / LAG_S) if len(self.t_s) > 1 else 0.0
        lag = np.zeros_like(rise)
        for i in range(1, len(rise)):
            lag[i] = keep * lag[i - 1] + (1.0 - keep) * 0.5 * (rise[i] + rise[i - 1])
        return np.hstack([rise, lag])

    @cached_property
    def first_degC(self) -> Floats:
        """Levels (p,) of the first minutes, before heat has moved anything; NaN where nothing was read."""
        rows = self.early_s < max(FIRST_S, 1.5 * float(self.early_s[0]))
        good = np.isfinite(self.early_degC[rows])
        count = np.where(good.any(axis=0), good.sum(axis=0), np.nan)
        return np.asarray(np.where(good, self.early_degC[rows], 0.0).sum(axis=0) / count)

    @property
    def rise_K(self) -> Floats:
        """Rises (n, p) since the start."""
        return np.asarray(self.level_degC - self.start_degC)


def course(table: Temperatures, most_rows: int = ROWS) -> Course:
    """The course of a table without implausible readings; a sensor read less than half of the time is not used."""
    value = table.value_degC
    length_s = float(table.t_s[-1] - table.t_s[0])
    step_s = max(length_s / most_rows, table.interval_s, 1.0)
    mean = block_means(table.t_s, value, step_s)
    t_s = table.t_s[0] + step_s * (np.arange(len(mean)) + 0.5)
    good = np.isfinite(mean)
    read = good.mean(axis=0) >= 0.5
    for j in np.flatnonzero(~good.all(axis=0)):
        mean[:, j] = np.interp(t_s, t_s[good[:, j]], mean[good[:, j], j]) if good[:, j].any() else 0.0
    fine_s = max(BLOCK_S, table.interval_s)
    early = table.t_s < table.t_s[0] + EARLY_S
    fine = block_means(table.t_s[early], value[early], fine_s)
    early_s: Floats = fine_s * (np.arange(float(len(fine))) + 0.5)
    return Course(t_s, mean, read, early_s, fine)

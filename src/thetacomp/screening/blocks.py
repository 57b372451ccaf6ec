"""Samples gathered into blocks, and what single samples do within them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thetacomp.arrays import Floats
from thetacomp.model.temperatures import Temperatures
from thetacomp.screening.faults import PLAUSIBLE_DEGC

CHUNK = 5000


def block_means(table: Temperatures, step_s: float) -> tuple[Floats, Floats]:
    """Block end times (n,) and means (n, p) on an even grid; implausible readings count as missing."""
    index = np.floor((table.t_s - table.t_s[0]) / step_s + 1e-6).astype(int)
    n, p = int(index[-1]) + 1, len(table.sensor_ids)
    value = np.where(plausible(table.value_degC), table.value_degC, np.nan)
    total, count = np.zeros((n, p)), np.zeros((n, p))
    np.add.at(total, index, np.nan_to_num(value))
    np.add.at(count, index, np.isfinite(value))
    with np.errstate(invalid="ignore"):
        return table.t_s[0] + step_s * np.arange(1, n + 1), np.where(count > 0, total / np.maximum(count, 1), np.nan)


def plausible(value_degC: Floats) -> NDArray[np.bool_]:
    """Readings that a working thermometer on a machine can give."""
    with np.errstate(invalid="ignore"):
        return np.asarray((value_degC > PLAUSIBLE_DEGC[0]) & (value_degC < PLAUSIBLE_DEGC[1]))


def longest_held_s(table: Temperatures) -> Floats:
    """Longest run of exactly equal readings of each sensor (p,)."""
    out = np.zeros(len(table.sensor_ids))
    for j in range(len(out)):
        good = np.isfinite(table.value_degC[:, j])
        t, x = table.t_s[good], table.value_degC[good, j]
        if len(x) > 1:
            starts = np.concatenate([[0], np.flatnonzero(np.diff(x) != 0) + 1])
            ends = np.concatenate([starts[1:] - 1, [len(x) - 1]])
            out[j] = float(np.max(t[ends] - t[starts]))
    return out


def largest_step_K(table: Temperatures, step_s: float) -> Floats:
    """Largest deviation of a sample from the mean of the block before (p,)."""
    _, mean = block_means(table, step_s)
    index = np.floor((table.t_s - table.t_s[0]) / step_s + 1e-6).astype(int)
    later = index > 0
    deviation = np.abs(table.value_degC[later] - mean[index[later] - 1])
    return np.asarray(np.max(np.nan_to_num(deviation), axis=0))


def local_deviation_K(table: Temperatures, step_s: float) -> tuple[Floats, int]:
    """Deviation of samples from the median of a block's length before and after them (m, p), and the first index."""
    value = np.where(plausible(table.value_degC), table.value_degC, np.nan)
    half = max(2, round(step_s / float(np.median(np.diff(table.t_s)))))
    n = len(value)
    if n < 2 * half + 1:
        return np.empty((0, value.shape[1])), half
    out = np.empty((n - 2 * half, value.shape[1]))
    for begin in range(0, len(out), CHUNK):  # in pieces: months at 1 s would not fit into memory
        end = min(begin + CHUNK, len(out))
        window = np.lib.stride_tricks.sliding_window_view(value[begin : end + 2 * half], 2 * half + 1, axis=0)
        out[begin:end] = value[begin + half : end + half] - np.median(window, axis=-1)
    return out, half

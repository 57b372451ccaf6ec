"""Learning what a healthy machine's temperatures do, and the threshold for less than one false alarm a month."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from thetacomp.arrays import Floats
from thetacomp.errors import AnalysisError
from thetacomp.model.temperatures import Temperatures
from thetacomp.screening.blocks import block_means, largest_step_K, local_deviation_K, longest_held_s
from thetacomp.screening.model import ScreeningModel, ridge_weights

BLOCK_S = 60.0
LAG_S = 600.0
HORIZONS_S = (600.0, 3600.0, 14400.0)
ELAPSED_S = (600.0, 3600.0, 7200.0, 14400.0, 21600.0, 28800.0)
MONTH_H = 720.0
ALARMS_PER_MONTH = 0.25  # aim: a quarter of what is allowed, since the tail is extrapolated
LOWEST_THRESHOLD = 5.0
FEWEST_BLOCKS = 30
FEWEST_PIECES = 3


def fit_plain(campaigns: Sequence[Temperatures]) -> ScreeningModel:
    """Fit on tables taken as healthy. AnalysisError where they are too few, too short or of different sensors.

    Standard deviations and threshold come from residuals on pieces left out of the fit: whole campaigns, or thirds of
    each where there are fewer than three.
    """
    ids, sampling_s, step_s = _layout(campaigns)
    blocks = [block_means(c, step_s)[1] for c in campaigns]
    known = np.array([any(np.isfinite(b[:, j]).any() for b in blocks) for j in range(len(ids))])
    if known.sum() < 3:
        raise AnalysisError("screening needs at least three sensors with readings: each is predicted from the others")
    pieces = [inputs(b, known, step_s) for b in _pieces(blocks)]
    rows = max(np.isfinite(x[:, : len(ids)]).all(axis=1).sum() for x in pieces)
    wanted = sorted({2 * step_s if 2 * step_s < HORIZONS_S[0] else HORIZONS_S[0], *HORIZONS_S})
    steps = [round(h / step_s) for h in wanted if step_s <= h and 3 * round(h / step_s) <= 2 * rows]
    if not steps or rows < FEWEST_BLOCKS:
        raise AnalysisError(
            f"screening needs campaigns of at least {FEWEST_BLOCKS * step_s / 60:.0f} min with all sensors read at the"
            f" same time, sampled at least every 10 min; the longest such stretch has {rows} blocks of {step_s:g} s"
        )
    horizons = tuple(float(step_s * s) for s in steps)
    p = len(ids)
    fitted = [_Horizon(pieces, s, p) for s in steps]
    elapsed = [e for e in ELAPSED_S if e >= step_s and round(e / step_s) < rows - 5]
    healthy_h = sum(len(b) for b in blocks) * step_s / 3600.0
    model = ScreeningModel(
        sensor_ids=ids,
        sampling_s=sampling_s,
        step_s=step_s,
        lag_s=LAG_S,
        horizon_s=horizons,
        product_K2=np.array([h.product for h in fitted]),
        floor_K=np.array([h.floor_K for h in fitted]),
        share=np.array([h.share for h in fitted]),
        scale_K=np.array([h.scale_K for h in fitted]),
        activity_high=np.array([np.quantile(h.all_activity, 0.95) for h in fitted]),
        threshold=np.array([h.threshold(step_s, int(known.sum()), len(fitted)) for h in fitted]),
        elapsed_s=tuple(elapsed),
        repair_sd_K=np.array([fitted[-1].rms_after(pieces, round(e / step_s)) for e in elapsed]),
        held_s=np.max([longest_held_s(c) for c in campaigns], axis=0),
        gate_K=np.max([largest_step_K(c, step_s) for c in campaigns], axis=0),
        spike_K=np.max([_usual_deviation_K(c, step_s) for c in campaigns], axis=0),
        screened=tuple(bool(k) for k in known),
        healthy_h=healthy_h,
    )
    return replace(model, held_s=np.maximum(3.0 * model.held_s, np.maximum(300.0, 5.0 * sampling_s)))


def _layout(campaigns: Sequence[Temperatures]) -> tuple[tuple[str, ...], float, float]:
    if not campaigns:
        raise AnalysisError("screening needs at least one campaign of temperatures to learn from")
    ids = campaigns[0].sensor_ids
    for number, c in enumerate(campaigns, 1):
        if c.sensor_ids != ids:
            raise AnalysisError(f"campaign {number} of the training has other sensors, or another order, than the 1st")
        if len(c.t_s) < 3:
            raise AnalysisError(f"campaign {number} of the training has fewer than three samples")
    sampling_s = max(float(np.median(np.diff(c.t_s))) for c in campaigns)
    return ids, sampling_s, float(sampling_s * max(1.0, np.ceil(BLOCK_S / sampling_s - 1e-9)))


def _pieces(blocks: list[Floats]) -> list[Floats]:
    if len(blocks) >= FEWEST_PIECES:
        return blocks
    return [part for b in blocks for part in np.array_split(b, FEWEST_PIECES)]


def inputs(blocks: Floats, known: NDArray[np.bool_], step_s: float) -> Floats:
    """Temperatures and their lags, (n, 2p); gaps are bridged for the lag only; unknown sensors are zero."""
    x = np.where(known, blocks, 0.0)
    return np.hstack([x, lagged(x, step_s)])


def lagged(x: Floats, step_s: float) -> Floats:
    """First-order lag of each column, (n, p), at rest at the start; NaN where the column itself is missing."""
    gain = -np.expm1(-step_s / LAG_S)
    out = np.empty_like(x)
    state = np.where(np.isfinite(x[0]), x[0], 0.0)
    started = np.isfinite(x[0])
    for i, row in enumerate(x):
        known = np.isfinite(row)
        state = np.where(known, np.where(started, state + gain * (row - state), row), state)
        started = started | known
        out[i] = np.where(known, state, np.nan)
    return out


def activity(square: Floats, healthy: NDArray[np.bool_]) -> Floats:
    """How much the rest of the machine moves, seen from each sensor, (n, p): root mean square of scaled increments.

    `square` (n, p) are squared increments in units of the typical one. The sensor itself and the two that move most
    are left out: a faulty sensor must not excuse its own residual, nor that of another.
    """
    s = np.where(healthy & np.isfinite(square), square, 0.0)
    count = int(np.count_nonzero(healthy))
    drop = min(2, max((count - 1) // 4, 0))
    total = s.sum(axis=1, keepdims=True)
    left = max(count - 1 - drop, 1)
    if drop == 0:
        return np.asarray(np.sqrt(np.maximum(total - s, 0.0) / left))
    top = -np.sort(-s, axis=1)[:, : drop + 1]
    own_on_top = s >= top[:, drop - 1 : drop]
    rest = np.where(own_on_top, total - top.sum(1, keepdims=True), total - s - top[:, :drop].sum(1, keepdims=True))
    return np.asarray(np.sqrt(np.maximum(rest, 0.0) / left))


class _Horizon:
    """Fit and held-out residuals at one horizon of `step` blocks."""

    def __init__(self, pieces: Sequence[Floats], step: int, p: int) -> None:
        self.step, self.p = step, p
        increments = [x[step:] - x[:-step] for x in pieces]
        complete = [d[np.isfinite(d).all(axis=1)] for d in increments]
        self.products = [d.T @ d for d in complete]
        self.rows = [len(d) for d in complete]
        if not sum(self.rows):
            raise AnalysisError("no stretch of the training campaigns has all sensors read at the same time")
        self.product = np.sum(self.products, axis=0) / sum(self.rows)
        self.scale_K = np.sqrt(np.diag(self.product)[:p])
        unit = np.where(self.scale_K > 0, self.scale_K, 1.0)
        moving = self.scale_K > 0
        self.residual, self.activity = [], []
        for i, d in enumerate(complete):
            self.residual.append(d[:, :p] - d @ self.held_out_weights(i))
            self.activity.append(activity((d[:, :p] / unit) ** 2, moving))
        self.all_activity = np.vstack([a for a in self.activity if len(a)])
        self.floor_K, self.share = self._spread(np.vstack(self.residual))

    def held_out_weights(self, piece: int) -> Floats:
        """Weights (2p, p) fitted without one piece."""
        rest = sum(self.rows) - self.rows[piece]
        product = (np.sum(self.products, axis=0) - self.products[piece]) / rest if rest else self.product
        return np.stack([ridge_weights(product, frozenset(), j) for j in range(self.p)], axis=1)

    def _spread(self, residual: Floats) -> tuple[Floats, Floats]:
        """Floor from the quieter half of the time, growth with activity from the busier half."""
        floor, share = np.zeros(self.p), np.zeros(self.p)
        for j in range(self.p):
            r2, a = residual[:, j] ** 2, self.all_activity[:, j]
            quiet = a <= np.median(a)
            floor[j] = max(float(np.sqrt(np.mean(r2[quiet]))), 1e-6)
            low, high = 0.0, 10.0 * float(np.sqrt(r2.max() / max(float(np.mean(a**2)), 1e-12))) + 1e-9
            for _ in range(40):
                middle = 0.5 * (low + high)
                excess = np.mean(r2[~quiet] / (floor[j] ** 2 + (middle * a[~quiet]) ** 2)) if (~quiet).any() else 0.0
                low, high = (middle, high) if excess > 1.0 else (low, middle)
            share[j] = high if high > 1e-8 else 0.0
        return floor, share

    def peaks(self, step_s: float) -> Floats:
        """Largest standardised residuals of separate stretches, at least an hour or a horizon long."""
        length = max(self.step, round(3600.0 / step_s), 1)
        found = []
        for r, a in zip(self.residual, self.activity, strict=True):
            z = np.abs(r) / np.hypot(self.floor_K, self.share * a)
            found += [z[i : i + length].max(axis=0)[self.scale_K > 0] for i in range(0, len(z) - length // 2, length)]
        return np.concatenate(found) if found else np.empty(0)

    def threshold(self, step_s: float, sensors: int, horizons: int) -> float:
        """Threshold of this horizon, in standard deviations."""
        return _threshold(self.peaks(step_s), self.step * step_s, sensors, horizons)

    def rms_after(self, pieces: Sequence[Floats], steps: int) -> Floats:
        """Held-out error (p,) of a sensor rebuilt from the others so many blocks after its last good value."""
        total, count = np.zeros(self.p), 0
        for i, x in enumerate(pieces):
            if len(x) > steps:
                d = x[steps:] - x[:-steps]
                d = d[np.isfinite(d).all(axis=1)]
                total += np.sum((d[:, : self.p] - d @ self.held_out_weights(i)) ** 2, axis=0)
                count += len(d)
        return np.sqrt(total / max(count, 1))


def _threshold(peaks: Floats, horizon_s: float, sensors: int, horizons: int) -> float:
    """Threshold for the aimed rate of false alarms: exponential tail over the highest fifth of the peaks.

    Peaks over a threshold: P(z > u + x) = P(z > u) exp(-x / m). The mean excess m is taken two standard errors larger,
    since a month is extrapolated from days. Every horizon gets its equal share of the false alarms.
    """
    if len(peaks) < 10:
        raise AnalysisError("the training campaigns are too short to calibrate the screening: add campaigns")
    tests = sensors * MONTH_H * 3600.0 / max(horizon_s, 3600.0)
    u = float(np.quantile(peaks, 0.8))
    excess = peaks[peaks > u] - u
    mean = float(excess.mean()) * (1.0 + 2.0 / np.sqrt(len(excess))) if len(excess) else 0.0
    return max(u + mean * float(np.log(0.2 * tests * horizons / ALARMS_PER_MONTH)), LOWEST_THRESHOLD)


def _usual_deviation_K(table: Temperatures, step_s: float) -> Floats:
    """The deviation of a sample from the minutes around it that one in a hundred exceeds (p,)."""
    deviation = np.abs(local_deviation_K(table, step_s)[0])
    seen = np.isfinite(deviation).any(axis=0)
    out = np.zeros(len(table.sensor_ids))
    out[seen] = np.nanquantile(deviation[:, seen], 0.99, axis=0) if len(deviation) else 0.0
    return out

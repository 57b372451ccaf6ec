"""The last hours of a machine's temperatures in blocks, with lags, and predictions of increments within them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thetacomp.arrays import Floats
from thetacomp.screening.fit import activity
from thetacomp.screening.model import ScreeningModel

Healthy = NDArray[np.bool_]
BASE_BLOCKS = 10  # blocks averaged for the last good value
MOST_STACKS = 2000  # a year at 1 % missing readings meets some hundreds of sets of healthy sensors


class History:
    """Blocks `raw` (as read), `clean` (believed or rebuilt) and `lag`, addressed by their number since the start.

    `start` is the first block that windows may reach back to. Memory is bounded: old blocks are dropped.
    """

    def __init__(self, model: ScreeningModel) -> None:
        self.model = model
        self.p = len(model.sensor_ids)
        self.keep = int(1.3 * max(model.horizon_steps)) + 40
        self._room = np.full((2 * self.keep, 3 * self.p), np.nan)
        self.count = 0
        self.start = 0
        self._dropped = 0
        self._screened = np.array(model.screened)
        self._known = np.concatenate([self._screened, self._screened])
        self._gain = float(-np.expm1(-model.step_s / model.lag_s))
        self._unit_K = np.where(model.scale_K > 0, model.scale_K, 1.0)
        self._steps = np.array(model.horizon_steps)
        self._stacks: dict[frozenset[int], tuple[Floats, Floats, Healthy]] = {}

    @property
    def first(self) -> int:
        """The oldest block still held."""
        return max(self._dropped, self.count - self.keep)

    def rows(self, begin: int, end: int) -> Floats:
        """Blocks begin..end-1 as a view (rows, 3p): raw, clean, lag."""
        return self._room[begin - self._dropped : end - self._dropped]

    def append(self, raw: Floats) -> int:
        """Add a block as read and return its number; `clean` and `lag` are not yet set."""
        if self.count - self._dropped == len(self._room):
            self._room[: self.keep] = self._room[-self.keep :]
            self._room[self.keep :] = np.nan
            self._dropped = self.count - self.keep
            self.start = max(self.start, self._dropped)
        self.count += 1
        self.rows(self.count - 1, self.count)[0, : self.p] = raw
        return self.count - 1

    def inputs(self, begin: int, end: int) -> Floats:
        """Believed temperatures and lags (rows, 2p); 0 for sensors that training did not know."""
        return np.where(self._known, self.rows(begin, end)[:, self.p :], 0.0)

    def believe(self, block: int, value: Floats, healthy: Healthy) -> None:
        """Set the believed values (p,) of the healthy sensors and their lags, all at once."""
        row = self.rows(block, block + 1)[0]
        before = self.rows(block - 1, block)[0, 2 * self.p :] if block > self._dropped else value
        before = np.where(np.isfinite(before), before, value)
        row[self.p : 2 * self.p][healthy] = value[healthy]
        row[2 * self.p :][healthy] = (before + self._gain * (value - before))[healthy]

    def state(self, block: int) -> tuple[Floats, Floats]:
        """Believed values and lags (p,) of a block, copied."""
        row = self.rows(block, block + 1)[0]
        return row[self.p : 2 * self.p].copy(), row[2 * self.p :].copy()

    def set_lag(self, block: int, lag: Floats) -> None:
        """Set the lags (p,) of a block where they are known better; missing ones stay."""
        row = self.rows(block, block + 1)[0, 2 * self.p :]
        row[:] = np.where(np.isfinite(lag), lag, row)

    def set_clean(self, block: int, j: int, value: float) -> None:
        """Set a believed value and its lag, from the lag of the block before."""
        row = self.rows(block, block + 1)[0]
        row[self.p + j] = value
        before = self.rows(block - 1, block)[0, 2 * self.p + j] if block > self._dropped else value
        before = value if not np.isfinite(before) else before
        row[2 * self.p + j] = before + self._gain * (value - before)

    def rebuild(self, j: int, begin: int, excluded: frozenset[int], fresh: bool) -> None:
        """Rebuild sensor j from the healthy ones for the blocks from `begin` on: last good value + increments.

        `fresh` averages the last good value over the blocks before `begin`; otherwise the row before is continued.
        """
        w = self.model.weights(len(self.model.horizon_s) - 1, excluded | {j}, j)
        if begin <= self.first:
            base = begin
        else:
            base = max(begin - BASE_BLOCKS, self.first, self.start) if fresh else begin - 1
        base = min(base, begin - 1) if begin > self.first else begin
        predicted = self.predicted(w, base)
        good = self.rows(base, max(begin, base + 1))[:, self.p + j]
        level = float(np.nanmean(good - predicted[: len(good)])) if np.isfinite(good).any() else np.nan
        for block in range(begin, self.count):
            self.set_clean(block, j, level + float(predicted[block - base]))

    def predicted(self, weights: Floats, begin: int) -> Floats:
        """Inputs times weights (2p,) for the blocks from `begin` on; sensors without weight may lack values."""
        used = weights != 0.0
        return np.asarray(self.inputs(begin, self.count)[:, used] @ weights[used])

    def stack(self, excluded: frozenset[int]) -> tuple[Floats, Floats, Healthy]:
        """Weights (H, p, 2p) at all horizons, the growth of the residuals (H, p), and which sensors are judged (p,)."""
        if excluded not in self._stacks:
            if len(self._stacks) > MOST_STACKS:
                self._stacks.clear()
            horizons, sensors = range(len(self.model.horizon_s)), range(self.p)
            healthy = self._screened.copy()
            healthy[list(excluded)] = False
            self._stacks[excluded] = (
                np.array([[self.model.weights(h, excluded, j) for j in sensors] for h in horizons]),
                np.array([self.model.inflations(h, excluded) for h in horizons]),
                healthy,
            )
        return self._stacks[excluded]

    def statistic(self, excluded: frozenset[int]) -> Floats:
        """Residuals of the newest increments in standard deviations (H, p); 0 where none can be computed."""
        m, p, now = self.model, self.p, self.count - 1
        weights, growth, healthy = self.stack(excluded)
        earlier = now - self._steps
        reached = earlier >= max(self.start, self.first)
        rows = self._room[np.where(reached, earlier, now) - self._dropped, p:]
        increment = self._room[now - self._dropped, p:] - rows
        increment[~(np.isfinite(increment) & self._known)] = 0.0
        moved = activity((increment[:, :p] / self._unit_K) ** 2, healthy)
        sd = np.hypot(m.floor_K, m.share * moved) * growth
        residual = increment[:, :p] - (weights @ increment[:, :, None])[:, :, 0]
        return np.where(healthy, residual / sd, 0.0)

    def contributions(self, h: int, j: int, excluded: frozenset[int]) -> Floats:
        """How much each sensor (p,) moves the prediction of sensor j in the newest increment, K."""
        now, steps = self.count - 1, self.model.horizon_steps[h]
        increment = self.inputs(now, now + 1)[0] - self.inputs(now - steps, now - steps + 1)[0]
        parts = self.model.weights(h, excluded, j) * np.nan_to_num(increment)
        return np.asarray(np.abs(parts[: self.p] + parts[self.p :]))

    def residual(self, j: int, begin: int, excluded: frozenset[int], h: int, since: int, offset_K: float) -> Floats:
        """Reading less prediction of sensor j from block `begin` on; only its changes mean something.

        Before block `since` the believed values count, which earlier repairs have made continuous; from there on the
        raw ones less the shift.
        """
        rows = self.rows(begin, self.count)
        reading = rows[:, self.p + j].copy()
        late = max(since - begin, 0)
        reading[late:] = rows[late:, j] - offset_K
        return np.asarray(reading - self.predicted(self.model.weights(h, excluded | {j}, j), begin))

"""Screening of live temperatures, sample by sample, by the rules that need no later sample than some minutes.

Steps that stay, channels without reading, with one reading or with noise are found as in a whole record. Whether a slow
departure is heat shows only after the machine has cooled, and a swap or an offset only over a campaign: these wait for
the analysis of the record.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.errors import AnalysisError
from thetacomp.screening import silent, steps
from thetacomp.screening.faults import FaultKind, Finding, Repair
from thetacomp.screening.grid import LAG_S, plausible
from thetacomp.screening.live_model import ScreeningModel
from thetacomp.screening.repair import LOST_SHARE
from thetacomp.screening.single import BACK

State = Literal["believed", "repaired", "suspect", "lost"]
BLOCKS = 2 * steps.SIDE + 1
PAUSE_BLOCKS = 3  # a longer pause of the whole logger: what was before it says nothing of steps
TRUSTED_S = 8.0 * 3600.0  # a value rebuilt for longer does not contradict a reading that is back
AGREES = 4.0  # standard deviations of a rebuilt value


@dataclass(frozen=True)
class ScreenedSample:
    """One screened sample: the value to use (p,) and the state of every sensor.

    `lost` sensors hold NaN: use a model without them. `suspect` ones hold the last value that was believed or rebuilt.
    """

    t_s: float
    value_degC: Floats
    state: tuple[State, ...]


@dataclass
class _Out:
    """A sensor whose reading is not used, with number `finding`: a value and inputs (2p,) that were still good."""

    kind: FaultKind
    start_s: float
    value_degC: float
    inputs: Floats
    finding: int
    back: int = 0


@dataclass(frozen=True)
class _Help:
    """What the sensors in use say of one that is not: weights (2p,), and the uncertainty over the time since."""

    weights: Floats
    u_K: Floats


ELAPSED_S = np.linspace(0.0, 86400.0, 49)


class Detector:
    """Follows one machine. Feed every sample to `update`, in order of time; only the list of findings grows."""

    def __init__(self, model: ScreeningModel) -> None:
        self.model = model
        self.p = len(model.sensor_ids)
        self._clear_K = steps.clear_K(model.noise_K)
        self._found: list[Finding] = []
        self._offset_K = np.zeros(self.p)
        self._source = np.arange(self.p)
        self._jump: dict[int, int] = {}  # the sensor's shift that lasts, by the number of its finding
        self._out: dict[int, _Out] = {}
        self._help: dict[tuple[int, frozenset[int]], _Help] = {}
        self._ring = np.full((BLOCKS, self.p), np.nan)
        self._bend = np.zeros((steps.SCATTER_BLOCKS, self.p))
        self._sum, self._count = np.zeros(self.p), np.zeros(self.p)
        self._block = 0
        self._t0_s = self._last_s = np.nan
        self._used, self._lag = np.full(self.p, np.nan), np.full(self.p, np.nan)
        self._suspect_to = np.full(self.p, -1)  # a sensor that stepped is watched up to this block
        self._reading, self._same_since_s = np.full(self.p, np.nan), np.zeros(self.p)
        self._gone = np.zeros(self.p, int)

    def findings(self) -> tuple[Finding, ...]:
        """All faults so far as they stand now, by their begin."""
        return tuple(sorted(self._found, key=lambda f: f.start_s))

    def update(self, t_s: float, value_degC: Floats) -> ScreenedSample:
        """Take one sample, (p,) in the order of the model; NaN for a missing reading.

        AnalysisError where the time does not advance or the number of values is another.
        """
        value = np.asarray(value_degC, float)
        if value.shape != (self.p,):
            raise AnalysisError(f"a sample of {self.p} temperatures was expected, {value.size} came")
        if t_s <= self._last_s:
            raise AnalysisError(f"samples must come in order of time: {t_s:g} s came after {self._last_s:g} s")
        if np.isnan(self._t0_s):
            self._t0_s = self._last_s = t_s
        number = int((t_s - self._t0_s) / self.model.step_s + 1e-6)
        if number > self._block:
            self._close(number)
        value = np.where(plausible(value), value, np.nan)[self._source]
        self._silences(t_s, value)
        reading = value - self._offset_K
        good = np.isfinite(reading)
        self._sum[good] += reading[good]
        self._count += good
        used, state = self._usable(t_s, reading)
        keep = np.exp(-(t_s - self._last_s) / LAG_S)
        known = np.isfinite(used)
        self._used = np.where(known, used, self._used)
        self._lag = np.where(np.isnan(self._lag), self._used, keep * self._lag + (1.0 - keep) * self._used)
        self._last_s = t_s
        return ScreenedSample(t_s, used, state)

    def _silences(self, t_s: float, value: Floats) -> None:
        """Channels that give nothing, or one reading for too long."""
        read = np.isfinite(value)
        if not read.any():
            return  # a pause of the logger
        changed = read & (value != self._reading)
        self._same_since_s[changed] = t_s
        self._reading[changed] = value[changed]
        self._gone = np.where(read, 0, self._gone + 1)
        held_s = t_s - self._same_since_s
        for j in np.flatnonzero((self._gone >= silent.FEWEST_MISSING) | (held_s > self.model.held_s)).tolist():
            if j not in self._out and self._gone[j]:
                self._take_out(j, "missing", t_s - held_s[j], held_s[j], silent.FEWEST_MISSING * self.model.step_s)
            elif j not in self._out:
                self._take_out(j, "stuck", float(self._same_since_s[j]), held_s[j], self.model.held_s[j])

    def _take_out(self, j: int, kind: FaultKind, start_s: float, statistic: float, limit: float) -> None:
        inputs = np.concatenate([self._used, self._lag])
        self._out[j] = _Out(kind, start_s, float(self._used[j]), inputs, len(self._found))
        self._tell(j, kind, start_s, float("nan"), float(statistic), float(limit), "reconstructed")

    def _tell(
        self, j: int, kind: FaultKind, start_s: float, size_K: float, statistic: float, limit: float, repair: Repair
    ) -> None:
        ids = self.model.sensor_ids
        self._found.append(Finding(ids[j], kind, start_s, self._last_s, None, size_K, statistic, limit, repair))

    def _usable(self, t_s: float, reading: Floats) -> tuple[Floats, tuple[State, ...]]:
        """The values to use (p,), and the states."""
        with np.errstate(invalid="ignore"):
            far = np.abs(reading - self._used) > self.model.step_K
        self._suspect_to[far & (self._suspect_to < self._block)] = self._block + steps.SIDE + 2
        self._suspect_to[~far & np.isfinite(reading)] = -1
        odd = ~np.isfinite(reading) | (self._block <= self._suspect_to)
        odd &= np.isfinite(self._used)
        used = np.where(odd, self._used, reading)
        mended = (self._offset_K != 0.0) | (self._source != np.arange(self.p))
        state: list[State] = ["repaired" if m else "believed" for m in mended]
        for j in np.flatnonzero(odd).tolist():
            state[j] = "suspect"
        gone = frozenset(self._out)
        inputs = np.concatenate([used, self._lag])
        for j, out in self._out.items():
            known = self._helped(j, gone)
            if known.u_K[self._elapsed(out, t_s)] > LOST_SHARE * self.model.taught.moves_K(j):
                used[j], state[j] = np.nan, "lost"
            else:
                used[j] = out.value_degC + float(known.weights @ np.nan_to_num(inputs - out.inputs))
                state[j] = "repaired"
        return used, tuple(state)

    def _helped(self, j: int, gone: frozenset[int]) -> _Help:
        if (j, gone) not in self._help:
            taught = self.model.taught
            self._help[j, gone] = _Help(taught.weights(j, gone), taught.rebuilt_u_K(j, gone, ELAPSED_S))
        return self._help[j, gone]

    def _elapsed(self, out: _Out, t_s: float) -> int:
        return min(int(np.searchsorted(ELAPSED_S, t_s - out.start_s)), len(ELAPSED_S) - 1)

    def _close(self, number: int) -> None:
        """The block under way is full: look for steps in the middle of the last ones, for noise, and for returns."""
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = np.where(self._count > 0, self._sum / self._count, np.nan)
        pause = number - self._block - 1
        self._ring = np.vstack([self._ring[1:], mean])
        if pause > PAUSE_BLOCKS:
            self._ring[:] = np.nan
        self._sum, self._count, self._block = np.zeros(self.p), np.zeros(self.p), number
        bend = np.abs(self._ring[-1] - 2.0 * self._ring[-2] + self._ring[-3])
        self._bend = np.vstack([self._bend[1:], np.nan_to_num(bend)])
        self._steps()
        noisy = (self._bend > self.model.scatter_K).sum(axis=0) > steps.SCATTER_BLOCKS // 2
        for j in np.flatnonzero(noisy).tolist():
            if j not in self._out:
                first = int(np.argmax(self._bend[:, j] > self.model.scatter_K[j]))
                start_s = self._block_s(number - steps.SCATTER_BLOCKS + first)
                self._used[j] = float(np.nanmedian(self._ring[:, j]))
                self._take_out(j, "noisy", start_s, float(np.median(self._bend[:, j])), float(self.model.scatter_K[j]))
        for j, out in list(self._out.items()):
            alive = np.isfinite(self._ring[-1, j]) and self._last_s - self._same_since_s[j] < 2.0 * self.model.step_s
            out.back = out.back + 1 if alive and not noisy[j] else 0
            if out.back >= (steps.SCATTER_BLOCKS if out.kind == "noisy" else steps.SIDE):
                self._believe_again(j, out)

    def _block_s(self, number: int) -> float:
        return self._t0_s + number * self.model.step_s

    def _steps(self) -> None:
        across_K = np.abs(self._ring[steps.SIDE + 1] - self._ring[steps.SIDE - 1])
        if not (across_K > self._clear_K).any():
            return
        step_K, _ = steps.isolated(self._ring.T)
        step_K[list(self._out)] = 0.0
        for j in np.argsort(-np.abs(step_K)).tolist():
            size_K = float(step_K[j])
            if abs(size_K) <= self._clear_K[j]:
                return
            near = np.abs(step_K) > np.maximum(steps.TOGETHER * abs(size_K), steps.NOISE * self.model.noise_K)
            near[j] = False
            others = tuple(np.flatnonzero(near).tolist())
            step = steps.Step(j, steps.SIDE, size_K, float(self.model.step_K[j]), others, stays=True)
            other = steps.exchange(self._ring, steps.SIDE, step)
            if other is not None:
                self._exchange(step, *other)
                return
            if step.is_fault and abs(size_K) > self.model.step_K[j]:
                self._shift(step)

    def _shift(self, step: steps.Step) -> None:
        j, start_s = step.j, self._block_s(self._block - steps.SIDE - 1)
        self._offset_K[j] += step.size_K
        self._ring[steps.SIDE + 1 :, j] -= step.size_K
        self._ring[steps.SIDE, j] = 0.5 * (self._ring[steps.SIDE - 1, j] + self._ring[steps.SIDE + 1, j])
        self._suspect_to[j] = -1
        earlier = self._jump.pop(j, None)
        if earlier is not None and abs(self._offset_K[j]) < BACK * abs(step.size_K):
            self._ring[steps.SIDE + 1 :, j] += self._offset_K[j]
            self._offset_K[j] = 0.0
            self._found[earlier] = replace(self._found[earlier], end_s=start_s)
            return
        self._jump[j] = len(self._found)
        self._tell(j, "jump", start_s, step.size_K, abs(step.size_K), step.limit_K, "shifted back")

    def _exchange(self, step: steps.Step, k: int, times: float) -> None:
        pair, order = [step.j, k], [k, step.j]
        self._ring[steps.SIDE :, pair] = self._ring[steps.SIDE :, order]
        for kept in (self._source, self._reading, self._same_since_s, self._offset_K, self._gone):
            kept[pair] = kept[order]
        self._suspect_to[pair] = -1
        start_s = self._block_s(self._block - steps.SIDE - 1)
        self._tell(step.j, "swapped", start_s, step.size_K, times, steps.EXCHANGED, "swapped back")
        self._found[-1] = replace(self._found[-1], partner=self.model.sensor_ids[k])

    def _believe_again(self, j: int, out: _Out) -> None:
        """The channel lives again: as it reads, or shifted where it came back elsewhere soon after."""
        del self._out[j]
        begin_s = self._block_s(self._block - out.back)
        self._found[out.finding] = replace(self._found[out.finding], end_s=begin_s)
        off_K = float(np.nanmean(self._ring[-steps.SIDE :, j]) - self._used[j])
        u_K = float(self._helped(j, frozenset((*self._out, j))).u_K[self._elapsed(out, begin_s)])
        limit_K = max(steps.SMALLEST_K, AGREES * u_K)
        self._ring[: -steps.SIDE, j] = np.nan
        self._suspect_to[j] = -1
        if abs(off_K) > limit_K and begin_s - out.start_s <= TRUSTED_S and out.kind != "noisy":
            self._offset_K[j] += off_K
            self._ring[:, j] -= off_K
            self._jump[j] = len(self._found)
            self._tell(j, "jump", begin_s, off_K, abs(off_K), limit_K, "shifted back")
        else:
            self._used[j] = float(np.nanmean(self._ring[-steps.SIDE :, j]))

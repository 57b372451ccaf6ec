"""Screening of live temperatures, sample by sample: believed, repaired, suspect or lost."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.errors import AnalysisError
from thetacomp.screening.blocks import plausible
from thetacomp.screening.events import Event
from thetacomp.screening.fault_monitor import FaultMonitor
from thetacomp.screening.faults import Finding, Repair
from thetacomp.screening.model import ScreeningModel
from thetacomp.screening.window import Healthy

State = Literal["believed", "repaired", "suspect", "lost", "unscreened"]
PAUSE_BLOCKS = 3  # a longer pause of the whole logger starts the windows anew


@dataclass(frozen=True)
class ScreenedSample:
    """What one sample is worth: the value to use (p,), the state of every sensor, and what was found just now.

    `lost` sensors hold NaN: use a model without them. `suspect` ones hold the last value that was believed or rebuilt.
    """

    t_s: float
    value_degC: Floats
    state: tuple[State, ...]
    findings: tuple[Finding, ...]


@dataclass
class _Block:
    """Sums of the samples of one block; samples far from the last value count separately until it is full."""

    near: Floats
    far: Floats
    near_count: Floats
    far_count: Floats

    @classmethod
    def empty(cls, p: int) -> _Block:
        return cls(np.zeros(p), np.zeros(p), np.zeros(p), np.zeros(p))

    def add(self, value: Floats, good: Healthy, far: Healthy) -> None:
        near, away = good & ~far, good & far
        self.near[near] += value[near]
        self.near_count += near
        self.far[away] += value[away]
        self.far_count += away

    def mean(self) -> Floats:
        """A single spike is left out; where most samples are far, the level did move."""
        moved = self.far_count > self.near_count
        total, count = np.where(moved, self.far, self.near), np.where(moved, self.far_count, self.near_count)
        return np.where(count > 0, total / np.maximum(count, 1), np.nan)


class Detector:
    """Follows one machine. Feed every sample to `update`, in order of time; its state is bounded in size."""

    def __init__(self, model: ScreeningModel) -> None:
        self.model = model
        self.p = len(model.sensor_ids)
        self.monitor = FaultMonitor(model)
        self._screened = np.array(model.screened)
        self._gate_K = 2.0 * model.gate_K + 1e-9
        self._block = _Block.empty(self.p)
        self._number = 0
        self._t0_s = np.nan
        self._last_t_s = -np.inf
        self._same_since_s = np.full(self.p, np.nan)
        self._last_value = np.full(self.p, np.nan)
        self._found: list[Finding] = []

    def update(self, t_s: float, value_degC: Floats) -> ScreenedSample:
        """Take one sample, (p,) in the order of the model; NaN for a missing reading.

        AnalysisError where the time does not advance or the number of values is another.
        """
        value = np.asarray(value_degC, float)
        if value.shape != (self.p,):
            raise AnalysisError(f"a sample of {self.p} temperatures was expected, {value.size} came")
        if not t_s > self._last_t_s:
            raise AnalysisError(f"samples must come in order of time: {t_s:g} s came after {self._last_t_s:g} s")
        if np.isnan(self._t0_s):
            self._t0_s = t_s
        self._found = []
        number = int((t_s - self._t0_s) / self.model.step_s + 1e-6)
        if number > self._number:
            self._advance(number)
        self._last_t_s = t_s
        value = np.where(plausible(value), value, np.nan)[self.monitor.source]
        good = np.isfinite(value)
        changed = good & (value != self._last_value)
        self._same_since_s[changed] = t_s
        self._last_value[changed] = value[changed]
        far = self._far(value)
        self._block.add(value, good, far)
        return self._screened_sample(t_s, value, good & ~far)

    def findings(self) -> tuple[Finding, ...]:
        """All faults so far as they stand now, by their begin; an alarm that a later one explained is no fault."""
        events = sorted((e for e in self.monitor.events if e.decided), key=lambda e: e.onset_s)
        return tuple(finding(self.model, e, self.monitor.excluded - {e.j}, self._last_t_s) for e in events)

    def finish(self) -> tuple[Finding, ...]:
        """Close the block under way, for the end of a record; the findings it brings."""
        self._found = []
        self._advance(self._number + 1)
        return tuple(self._found)

    def _advance(self, number: int) -> None:
        self._close(self._block.mean())
        self._block = _Block.empty(self.p)
        pause = number - self._number - 1
        kept = min(pause, self.monitor.history.keep)
        nothing = np.full(self.p, np.nan)
        for _ in range(kept):
            self._number += 1
            self._close(nothing)
        if pause > PAUSE_BLOCKS:
            self.monitor.restart()
        self._t0_s += (pause - kept) * self.model.step_s
        self._number += 1

    def _close(self, mean: Floats) -> None:
        begin_s = self._t0_s + self._number * self.model.step_s
        held_s = np.nan_to_num(self._last_t_s - self._same_since_s)
        source = self.monitor.source.copy()
        for event in self.monitor.block(begin_s, mean, held_s):
            self._found.append(finding(self.model, event, self.monitor.excluded, begin_s + self.model.step_s))
        moved = self.monitor.source != source
        if moved.any():
            # The channels were exchanged back: what is remembered of them goes with them.
            order = np.array([int(np.flatnonzero(source == s)[0]) for s in self.monitor.source])
            self._last_value, self._same_since_s = self._last_value[order], self._same_since_s[order]

    def _far(self, value: Floats) -> Healthy:
        """Samples farther from the last block than any healthy one in training was."""
        history = self.monitor.history
        if history.count == 0:
            return np.zeros(self.p, bool)
        before = history.rows(history.count - 1, history.count)[0, : self.p]
        with np.errstate(invalid="ignore"):
            return np.asarray(np.abs(value - before) > self._gate_K)

    def _screened_sample(self, t_s: float, value: Floats, usable: Healthy) -> ScreenedSample:
        monitor, history = self.monitor, self.monitor.history
        out = value - monitor.offset_K
        mended = (monitor.offset_K != 0.0) | (monitor.source != np.arange(self.p))
        states: list[State] = ["repaired" if m else "believed" for m in mended]
        last = history.rows(history.count - 1, history.count)[0, self.p : 2 * self.p] if history.count else None
        for j in np.flatnonzero(~usable | ~self._screened).tolist() + list(monitor.open):
            event = monitor.open.get(j)
            if not self.model.screened[j]:
                states[j] = "unscreened"
            elif event is not None and self._lost(event):
                states[j], out[j] = "lost", np.nan
            elif event is not None or not usable[j]:
                states[j] = "repaired" if event is not None and event.decided else "suspect"
                out[j] = last[j] if last is not None else np.nan
        return ScreenedSample(t_s, out, tuple(states), tuple(self._found))

    def _lost(self, event: Event) -> bool:
        elapsed_s = (self.monitor.history.count - event.onset) * self.model.step_s
        return self.model.is_lost(event.j, elapsed_s, self.monitor.excluded)


def finding(model: ScreeningModel, event: Event, excluded: frozenset[int], until_s: float) -> Finding:
    """The report of an event as it stands at `until_s`, while the sensors `excluded` are not used."""
    if event.kind == "unexplained":
        return Finding(
            "", "unexplained", event.onset_s, event.detected_s, event.end_s, float("nan"), event.statistic,
            event.threshold, event.window_s, "none", (), float("nan"),
        )  # fmt: skip
    j = event.j
    ids = model.sensor_ids
    last_s = event.end_s if event.end_s is not None else until_s
    repair: Repair
    helpers: tuple[str, ...] = ()
    if event.kind == "swapped":
        repair, u_K = "swapped back", 0.0
    elif event.kind == "jump":
        repair, u_K = "shifted back", model.sd_K(min(1, len(model.horizon_s) - 1), j, 0.0)
    else:
        lost = model.is_lost(j, last_s - event.onset_s, excluded)
        u_K = model.reconstruction_u_K(j, last_s - event.onset_s, excluded)
        repair = "lost" if lost else "reconstructed"
    if repair in ("shifted back", "reconstructed"):
        out = excluded | model.unscreened | {j}
        helpers = tuple(ids[k] for k in range(len(ids)) if k not in out)
    partner = ids[event.partner] if event.partner is not None else ""
    return Finding(
        ids[j], event.kind, event.onset_s, event.detected_s, event.end_s, event.size_K, event.statistic,
        event.threshold, event.window_s, repair, helpers, u_K, partner,
    )  # fmt: skip

"""Faults as they are followed from block to block: found, watched, decided, repaired, and ended."""

from __future__ import annotations

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.screening.agreement import Agreement
from thetacomp.screening.change_point import fit_change
from thetacomp.screening.events import Event
from thetacomp.screening.faults import FaultKind
from thetacomp.screening.isolation import culprit, exchanged_with
from thetacomp.screening.model import ScreeningModel
from thetacomp.screening.window import History

CONFIRM_S = 300.0  # a change is watched that long before it is called a step, a spike or a slow departure
AGAIN_S = 7200.0  # a second change so soon after a step: it was no step
NOISY_ALARMS = 5  # so many alarms of one sensor within AGAIN_S
SILENT: tuple[FaultKind, ...] = ("stuck", "missing")


class FaultMonitor:
    """The state of all sensors of one machine, block by block.

    `offset_K` (p,) is taken off a sensor that jumped and stayed; `source` (p,) says which channel carries a sensor.
    """

    def __init__(self, model: ScreeningModel) -> None:
        self.model = model
        self.p = len(model.sensor_ids)
        self.history = History(model)
        self.events: list[Event] = []
        self.offset_K = np.zeros(self.p)
        self.source = np.arange(self.p)
        self.open: dict[int, Event] = {}
        self._jumped: dict[int, Event] = {}
        self._fresh: list[Event] = []
        self._alarmed: dict[int, list[Event]] = {}
        self.agreement = Agreement(self.history)
        self._screened = np.array(model.screened)
        self._held_s = np.where(self._screened, model.held_s, np.inf)
        self._confirm = max(2, round(CONFIRM_S / model.step_s))
        self._most_at_once = max(2, self.p // 3)
        self._time_s = 0.0
        self._read_s = np.inf
        self._at_pause: tuple[Floats, Floats] | None = None

    @property
    def excluded(self) -> frozenset[int]:
        """Sensors whose own reading is not used now."""
        return frozenset(self.open)

    def block(self, time_s: float, raw: Floats, held_s: Floats) -> list[Event]:
        """Take a block that began at `time_s`: its means (p,), and how long each sensor has shown one reading (p,).

        Returns the events that were decided or ended by it.
        """
        self._time_s = time_s
        now = self.history.append(raw)
        if not np.isfinite(raw[self._screened]).any():
            self._hold(now)
            return []
        pause_s = time_s - self._read_s - self.model.step_s
        self._read_s = time_s
        # Only events that are open, or shifts that last, can still change.
        known = list(dict.fromkeys([*self._jumped.values(), *self.open.values()]))
        before = [(e.decided, e.end) for e in known]
        self._fresh = []
        self._silent(now, raw, held_s)
        self._fill(now, raw)
        self._resume(now, pause_s)
        self._alarms(now)
        for event in list(self.open.values()):
            if self.open.get(event.j) is not event:
                continue  # its partner's decision took it along
            if event.kind in SILENT:
                self._returns(event, now, raw, held_s)
            if event.open and event.decided and self.agreement.agrees(event, now, raw, held_s, self.excluded):
                self._believe_again(event, now)
            if not event.decided and now >= event.alarm + self._confirm:
                self._decide(event, now, held_s)
        told = [e for e, was in zip(known, before, strict=True) if e.decided and was != (e.decided, e.end)]
        return [e for e in [*told, *(e for e in self._fresh if e.decided)] if not e.dropped]

    def restart(self) -> None:
        """Forget the windows: after a pause of the logger, or a change of operation that training never showed."""
        self.history.start = self.history.count

    def _block_time_s(self, block: int) -> float:
        return self._time_s - (self.history.count - 1 - block) * self.model.step_s

    def _hold(self, now: int) -> None:
        """No sensor was read: a pause of the logger, not a fault of sensors. The last values are kept."""
        if now > self.history.first:
            if self._at_pause is None:
                self._at_pause = self.history.state(now - 1)
            for j in range(self.p):
                value = self.history.rows(now - 1, now)[0, self.p + j]
                self.history.set_clean(now, j, float(value))

    def _resume(self, now: int, pause_s: float) -> None:
        """After a pause the lags are what a straight course through it would have left.

        First-order response to a ramp: lag(T) = x(T) - s τ + (lag(0) - x(0) + s τ) exp(-T / τ), s the slope.
        """
        if self._at_pause is None:
            return
        (x0, lag0), (x1, _), tau_s = self._at_pause, self.history.state(now), self.model.lag_s
        duration_s = pause_s + self.model.step_s
        behind = (x1 - x0) / duration_s * tau_s
        self.history.set_lag(now, x1 - behind + (lag0 - x0 + behind) * np.exp(-duration_s / tau_s))
        self._at_pause = None

    def _new(self, j: int, kind: FaultKind, onset: int, statistic: float, limit: float, window_s: float) -> Event:
        onset = max(onset, self.history.first)
        event = Event(
            j, kind, onset, self._block_time_s(onset), self._time_s + self.model.step_s, statistic, limit, window_s,
            alarm=self.history.count - 1, offset_before_K=float(self.offset_K[j]),
        )  # fmt: skip
        self._add(event)
        self.open[j] = event
        return event

    def _add(self, event: Event) -> None:
        self.events.append(event)
        self._fresh.append(event)

    def _drop(self, event: Event) -> None:
        """It was no fault of its own."""
        event.dropped = True
        self.events.remove(event)

    def _silent(self, now: int, raw: Floats, held_s: Floats) -> None:
        """Channels that give nothing, or the same reading for longer than any healthy run."""
        step_s = self.model.step_s
        silent = self._screened & (~np.isfinite(raw) | (held_s > self._held_s))
        for j in np.flatnonzero(silent).tolist():
            if j in self.open:
                continue
            if not np.isfinite(raw[j]):
                event = self._new(j, "missing", now, step_s, 0.0, step_s)
                event.decided = True
            else:
                onset = now - int(held_s[j] / step_s)
                event = self._new(j, "stuck", onset, float(held_s[j]), float(self.model.held_s[j]), float(held_s[j]))
                event.decided = True
                self._rebuild_from(event.onset, fresh=j)

    def _fill(self, now: int, raw: Floats) -> None:
        healthy = np.ones(self.p, bool)
        healthy[list(self.open)] = False
        self.history.believe(now, raw - self.offset_K, healthy)
        for j, event in self.open.items():
            self.history.rebuild(j, now, self.excluded, fresh=event.onset == now)

    def _rebuild_from(self, onset: int, fresh: int) -> None:
        """Rebuild sensor `fresh` from its onset, and the other open ones since then, which had used its readings."""
        self.history.rebuild(fresh, onset, self.excluded, fresh=True)
        for k, event in self.open.items():
            if k != fresh:
                self.history.rebuild(k, max(onset, event.onset), self.excluded, fresh=event.onset >= onset)

    def _restore(self, j: int, begin: int) -> None:
        """Believe the readings of a sensor again, less its shift, from a block on."""
        for block in range(max(begin, self.history.first), self.history.count):
            value = float(self.history.rows(block, block + 1)[0, j] - self.offset_K[j])
            if np.isfinite(value):
                self.history.set_clean(block, j, value)

    def _alarms(self, now: int) -> None:
        """Take out the sensor that explains most of the residuals, until the rest agrees (leave faulty out)."""
        while len(self.open) < self.p - 2:
            z = self.history.statistic(self.excluded)
            relative = np.abs(z) / self.model.threshold[:, None]
            if not np.max(relative) > 1.0:
                return
            waiting = sum(not e.decided for e in self.open.values())
            if waiting >= self._most_at_once:
                self._unexplained(z)
                return
            j = culprit(self.history, z, self.excluded)
            h = int(np.argmax(relative[:, j]))
            self._suspect(j, h, float(np.abs(z[h, j])), now)

    def _suspect(self, j: int, h: int, statistic: float, now: int) -> Event:
        steps = self.model.horizon_steps[h]
        begin = max(self.history.first, self.history.start, now - steps - 10)
        residual = self.history.residual(j, begin, self.excluded, h, now, float(self.offset_K[j]))
        found = fit_change(residual)
        onset = begin + found.onset
        if not found.abrupt:
            onset = max(begin + 1, onset - max(1, steps // 20))
        again = self._jumped.get(j)
        slow = again is not None and self._time_s - again.onset_s < AGAIN_S and again.onset > self.history.first
        event = self._new(j, "jump", onset, statistic, float(self.model.threshold[h]), self.model.horizon_s[h])
        if self._is_noisy(event):
            pass
        elif slow and again is not None and not found.abrupt:
            # What looked like a step goes on moving: undo the shift and rebuild from before it.
            event.onset, event.onset_s = again.onset, again.onset_s
            self.offset_K[j] = event.offset_before_K = again.offset_before_K
            self._drop(again)
            event.kind, event.decided = "drift", True
        event.helpers = tuple(k for k in range(self.p) if k not in self.open and self.model.screened[k])
        self._rebuild_from(event.onset, fresh=j)
        return event

    def _is_noisy(self, event: Event) -> bool:
        """A sensor with one alarm after the other has no shift to take off: it is noisy since the first of them."""
        j = event.j
        near = [e for e in self._alarmed.get(j, []) if self._time_s - e.onset_s < AGAIN_S]
        self._alarmed[j] = [*near, event]
        if len(near) + 1 < NOISY_ALARMS:
            return False
        first = near[0]
        event.onset, event.onset_s = max(first.onset, self.history.first), first.onset_s
        self.offset_K[j] = event.offset_before_K = first.offset_before_K
        for earlier in near:
            if not earlier.dropped:
                self._drop(earlier)
        if self._jumped.get(j) in near:
            del self._jumped[j]
        event.kind, event.decided = "noisy", True
        del self._alarmed[j]
        return True

    def _unexplained(self, z: Floats) -> None:
        """Too many sensors at once: no fault of sensors. Trust the readings and start the windows anew."""
        first = min((e.onset for e in self.open.values() if not e.decided), default=self.history.count - 1)
        for event in [e for e in self.open.values() if not e.decided]:
            del self.open[event.j]
            self._drop(event)
            self._alarmed.pop(event.j, None)
            self._restore(event.j, event.onset)
        before = self.history.state(max(first - 1, self.history.first))
        now = self.history.count - 1
        # A step of the operation is no step of the heat stored: the lags keep their distance.
        self.history.set_lag(now, self.history.state(now)[0] + before[1] - before[0])
        h, j = np.unravel_index(int(np.argmax(np.abs(z) / self.model.threshold[:, None])), z.shape)
        self._add(
            Event(
                -1, "unexplained", first, self._block_time_s(first), self._time_s + self.model.step_s,
                float(np.abs(z[h, j])), float(self.model.threshold[h]), self.model.horizon_s[int(h)],
                alarm=self.history.count - 1, decided=True, open=False, end=self.history.count - 1, end_s=self._time_s,
            )
        )  # fmt: skip
        self.restart()

    def _decide(self, event: Event, now: int, held_s: Floats) -> None:
        """Enough was seen since the alarm: stuck, spike, swap, step, or a slow departure."""
        j, h = event.j, min(1, len(self.model.horizon_s) - 1)
        begin = max(self.history.first, self.history.start, event.onset - 15)
        residual = self.history.residual(j, begin, self.excluded, h, event.onset, event.offset_before_K)
        before = residual[: max(event.onset - begin, 1)]
        deviation = residual - (np.nanmean(before) if np.isfinite(before).any() else np.nan)
        latest = float(np.nanmean(deviation[-2:])) if np.isfinite(deviation[-2:]).any() else np.nan
        event.decided = True
        event.size_K = latest
        small_K = 4.0 * self.model.sd_K(0, j, 0.0, self.excluded - {j})
        if held_s[j] > self._confirm * self.model.step_s and held_s[j] > (now - event.onset - 1) * self.model.step_s:
            event.kind = "stuck"
        elif abs(latest) <= max(small_K, 0.1 * float(np.nanmax(np.abs(deviation)))):
            event.kind, event.size_K = "spike", float(deviation[np.nanargmax(np.abs(deviation))])
            self._close(event, now)
            self._restore(j, now - 1)
        elif (partner := exchanged_with(self.history, event, self.offset_K, self.open)) is not None:
            self._swap(event, partner)
        elif fit_change(residual).abrupt:
            after = deviation[event.onset - begin + 1 :]
            self.offset_K[j] = event.offset_before_K + float(np.nanmedian(after))
            event.shift_K = event.size_K = float(np.nanmedian(after))
            self._closing_jump(event, small_K)
        else:
            event.kind = "drift"

    def _closing_jump(self, event: Event, small_K: float) -> None:
        j, earlier = event.j, self._jumped.get(event.j)
        if earlier is not None and abs(self.offset_K[j]) < small_K:
            # It jumped back: the earlier shift ends here.
            self.offset_K[j] = 0.0
            earlier.end, earlier.end_s = event.onset, event.onset_s
            self._drop(event)
            del self._jumped[j]
        else:
            self._jumped[j] = event
        event.open = False
        del self.open[j]
        self._restore(j, event.onset + 1)  # the block of the onset mixes old and new

    def _close(self, event: Event, end: int) -> None:
        event.open, event.end, event.end_s = False, end, self._block_time_s(end)
        del self.open[event.j]

    def _swap(self, event: Event, k: int) -> None:
        j = event.j
        event.kind, event.partner = "swapped", k
        rows = self.history.rows(event.onset, self.history.count)
        rows[:, [j, k]] = rows[:, [k, j]]
        self.source[[j, k]] = self.source[[k, j]]
        event.size_K = float(np.nanmean(rows[:, k] - rows[:, j]))
        event.open = False
        twin = self.open.get(k)
        if twin is not None:
            self._drop(twin)
            del self.open[k]
        del self.open[j]
        self._restore(j, event.onset + 1)
        self._restore(k, event.onset + 1)

    def _believe_again(self, event: Event, now: int) -> None:
        """It agreed with the others for a day: its reading counts again, less the shift that it had before."""
        self.offset_K[event.j] = event.offset_before_K
        self._close(event, now + 1 - self.agreement.blocks)
        self._restore(event.j, event.end or 0)

    def _returns(self, event: Event, now: int, raw: Floats, held_s: Floats) -> None:
        """A channel that was silent speaks again: believed if it agrees with the rebuilt value, else shifted."""
        j = event.j
        speaks = np.isfinite(raw[j]) and (event.kind == "missing" or held_s[j] < self.model.step_s)
        event.returned = min(event.returned + 1, self._confirm) if speaks else 0
        if event.returned == 0 or (event.returned < self._confirm and now - event.onset > 2):
            return
        begin = now + 1 - event.returned
        rows = self.history.rows(begin, now + 1)
        off_K = rows[:, j] - self.offset_K[j] - rows[:, self.p + j]
        deviation = float(np.nanmedian(off_K)) if np.isfinite(off_K).any() else np.nan
        elapsed_s = (now - event.onset) * self.model.step_s
        u_K = self.model.reconstruction_u_K(j, elapsed_s, self.excluded)
        limit = float(self.model.threshold[-1])
        if abs(deviation) > limit * u_K and elapsed_s > self.model.elapsed_s[-1]:
            return  # rebuilt for so long that nobody knows which of the two is wrong: it has to agree for a day
        event.size_K = deviation
        self._close(event, begin)
        if abs(deviation) > limit * u_K:
            self.offset_K[j] += deviation
            jump = self._new(j, "jump", begin, abs(deviation) / u_K, limit, elapsed_s)
            jump.decided, jump.open, jump.shift_K, jump.size_K = True, False, deviation, deviation
            del self.open[j]
            self._jumped[j] = jump
        elif event.onset > self.history.first:
            # Spread the small disagreement over the gap, so that the return itself is no step.
            gap = self.history.rows(event.onset, begin)[:, self.p + j].copy()
            for i, value in enumerate(gap):
                self.history.set_clean(event.onset + i, j, float(value + deviation * (i + 1) / (len(gap) + 1)))
        else:
            # Silent for longer than the windows: all that is left of the rebuilt course goes to where the sensor is.
            self.history.rows(self.history.first, begin)[:, [self.p + j, 2 * self.p + j]] += deviation
        self._restore(j, begin)

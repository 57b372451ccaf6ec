"""When a sensor that was taken out is used again: a day in which it agrees with the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.screening.events import Event
from thetacomp.screening.fit import activity
from thetacomp.screening.window import History

DAY_S = 86400.0  # a shift, a break and a night: a sensor without contact shows itself in one of them
LARGEST_RMS = 2.0  # root mean square of the standardised residuals over that day; healthy is 1
LEAST_READ = 0.95


@dataclass
class _Course:
    """What an open sensor did since block `begin`: readings, and the squares of its standardised residuals."""

    begin: int
    read: int = 0
    judged: int = 0
    square: float = 0.0


class Agreement:
    """Follows the readings of sensors that are not used, over the longest horizon of the model."""

    def __init__(self, history: History) -> None:
        self.history = history
        self.blocks = round(DAY_S / history.model.step_s)
        self._unit_K = np.where(history.model.scale_K[-1] > 0, history.model.scale_K[-1], 1.0)
        self._courses: dict[int, tuple[Event, _Course]] = {}

    def agrees(self, event: Event, now: int, raw: Floats, held_s: Floats, excluded: frozenset[int]) -> bool:
        """Take block `now` of an open sensor; True where the day that ends with it agrees with the other sensors."""
        j, model = event.j, self.history.model
        known = self._courses.get(j)
        course = known[1] if known is not None and known[0] is event else _Course(now)
        self._courses[j] = (event, course)
        residual = self._standardised(j, now, raw, excluded)
        if held_s[j] > model.held_s[j] or (residual is not None and abs(residual) > model.threshold[-1]):
            self._courses[j] = (event, _Course(now + 1))
            return False
        course.read += bool(np.isfinite(raw[j]))
        if residual is not None:
            course.judged += 1
            course.square += residual**2
        if now + 1 - course.begin < self.blocks:
            return False
        self._courses[j] = (event, _Course(now + 1))
        enough = course.read >= LEAST_READ * self.blocks and 2 * course.judged >= self.blocks
        return enough and course.square <= LARGEST_RMS**2 * course.judged

    def _standardised(self, j: int, now: int, raw: Floats, excluded: frozenset[int]) -> float | None:
        """Residual of the newest increment of a sensor's own readings, in standard deviations; None without reading."""
        history, model = self.history, self.history.model
        earlier = now - model.horizon_steps[-1]
        if earlier < max(history.first, history.start):
            return None
        before = history.rows(earlier, earlier + 1)[0, j]
        if not (np.isfinite(raw[j]) and np.isfinite(before)):
            return None
        weights, growth, healthy = history.stack(excluded)
        increment = history.inputs(now, now + 1)[0] - history.inputs(earlier, earlier + 1)[0]
        increment[~np.isfinite(increment)] = 0.0
        own = float(raw[j] - before)
        moved = activity(((increment[: history.p] / self._unit_K) ** 2)[None, :], healthy)[0, j]
        sd_K = float(np.hypot(model.floor_K[-1, j], model.share[-1, j] * moved) * growth[-1, j])
        return (own - float(weights[-1, j] @ increment)) / sd_K

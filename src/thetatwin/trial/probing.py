"""One five-minute probe a day: the tracker measures the tool at the stated places, and adaptation learns from it.

The station stands on the foundation all year. What its uncertainty keeps all year is in the datum as well and
cancels; noise from point to point, the angle of the round, what the tie to the foundation leaves, gross errors and
lost beams are drawn for every day.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.model.adaptation import Limits, Probe, acknowledge, correction_um, start_adaptation, take_probe
from thetatwin.campaigns import Twin
from thetatwin.hall import DAY_S
from thetatwin.instruments import TrackerDay, track

NO_BAND_UM = 50.0  # gate where a model states no band


class AtPlace(Protocol):
    """A place where the tool is measured."""

    @property
    def positions_mm(self) -> Mapping[str, float]:
        """Position of every axis."""


@dataclass(frozen=True)
class Course:
    """The daily probe: when, and how many readings a place; the median of them counts.

    Five minutes hold seven places: the axes travel 160 s at 6 m/min, three readings of 5 s at each place take 105 s.
    """

    hour: float = 10.0
    readings: int = 3


DAILY = Course()

# What adaptation may do: the offset follows within a day, tilts over each axis (µm/m) within some days.
LIMITS = Limits(
    probe_sd_um=8.0,
    offset_walk_um=1.5,
    offset_step_um=100.0,
    offset_most_um=1000.0,
    slope_walk=(0.5, 0.5, 0.5),
    slope_step=(50.0, 50.0, 50.0),
    slope_most=(500.0, 500.0, 500.0),
)


def adapt(
    twin: Twin,
    course: Course,
    places: Sequence[AtPlace],
    t_s: Floats,
    true_um: Floats,
    predicted_um: Floats,
    half_width_um: Floats,
) -> tuple[Floats, dict[str, int]]:
    """Correction (n, places, 3) that is added to the prediction, and how often probes were taken, limited or gated.

    All errors are (n, places, 3) at the times `t_s` (n,). A probe serves later rows only. In each direction the
    correction is an offset and a tilt over every axis, so that it holds at places that were not probed too. An alarm
    is acknowledged before the next day's probe: what was learnt before it stays.
    """
    rng = np.random.default_rng([twin.seed, 4])
    axes = twin.machine.description.axes
    lever_m = np.array([[(p.positions_mm[a.name] - 0.5 * sum(a.travel_mm)) / 1000.0 for a in axes] for p in places])
    begin_s = float(t_s[0])
    state = [start_adaptation(begin_s, LIMITS) for _ in range(3)]
    correction = np.zeros_like(true_um)
    log: Counter[str] = Counter()
    days = np.arange(np.floor(begin_s / DAY_S), np.ceil(t_s[-1] / DAY_S))
    moments = [s for s in days * DAY_S + course.hour * 3600.0 if begin_s <= s <= t_s[-1]]
    for number, moment_s in enumerate(moments):
        row = int(np.searchsorted(t_s, moment_s))
        measured = _measure(rng, twin, course, places, true_um[row])
        stop = int(np.searchsorted(t_s, moments[number + 1])) if number + 1 < len(moments) else len(t_s) - 1
        for d in range(3):
            if state[d].alarm:
                state[d], _ = acknowledge(state[d], moment_s, "somebody looked at it since yesterday")
            for k in range(len(places)):
                if not np.isfinite(measured[k, d]):
                    log["lost"] += 1
                    continue
                half = half_width_um[row, k, d]
                probe = Probe(
                    t_s=moment_s,
                    measured_um=float(measured[k, d]),
                    model_um=float(predicted_um[row, k, d]),
                    half_width_um=float(half) if np.isfinite(half) else NO_BAND_UM,
                    features=tuple(float(v) for v in lever_m[k]),
                )
                state[d], change = take_probe(state[d], probe, LIMITS)
                log[change.action] += 1
            correction[row + 1 : stop + 1, :, d] = correction_um(state[d], lever_m)
    return correction, dict(log)


def _measure(
    rng: np.random.Generator, twin: Twin, course: Course, places: Sequence[AtPlace], true_um: Floats
) -> Floats:
    """Measured errors (places, 3) of one round, NaN where the beam was lost in most readings."""
    at = {a.name: np.array([p.positions_mm[a.name] for p in places]) for a in twin.machine.description.axes}
    tool_m, _, _ = twin.machine.tool.levers_m(at, twin.conditions.work.tool_length_mm)
    repeated = np.repeat(tool_m, course.readings, axis=0)
    errors = np.repeat(true_um, course.readings, axis=0)
    none = TrackerDay(np.zeros(3), np.zeros((3, 3)))
    one_round = np.zeros(len(repeated), dtype=np.int64)
    read = track(rng, twin.conditions.tracker, none, repeated, errors, one_round)
    by_place = read.reshape(len(places), course.readings, 3)
    enough = np.isfinite(by_place).sum(axis=1) > course.readings // 2
    # A lost reading must not reach the median: it is replaced by the place's own middle reading.
    filled = np.where(
        np.isfinite(by_place), by_place, np.nanmedian(np.where(enough[:, None], by_place, 0.0), axis=1)[:, None]
    )
    return np.where(enough, np.median(filled, axis=1), np.nan)

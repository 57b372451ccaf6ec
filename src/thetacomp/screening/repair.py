"""Repair of a whole record: shifts taken off, channels exchanged back, gaps rebuilt from healthy sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from thetacomp.arrays import Floats
from thetacomp.model.temperatures import Temperatures
from thetacomp.screening.blocks import block_means, local_deviation_K, plausible
from thetacomp.screening.change_point import fit_change
from thetacomp.screening.events import Event
from thetacomp.screening.fit import inputs
from thetacomp.screening.model import ScreeningModel
from thetacomp.screening.window import BASE_BLOCKS

SPIKE_TIMES = 3.0
REBUILT = ("drift", "detached", "stuck", "saturated", "missing", "noisy", "spike")


def repaired(
    model: ScreeningModel, table: Temperatures, events: Sequence[Event]
) -> tuple[Temperatures, NDArray[np.bool_]]:
    """The table with every fault repaired as far as possible, and where a reading is unchanged (n, p).

    A lost sensor is NaN from its fault on. `events` get their final kind and size, since the whole record is known.
    """
    value = np.where(plausible(table.value_degC), table.value_degC, np.nan)
    for event in sorted(events, key=lambda e: e.onset_s):
        if event.kind == "swapped" and event.partner is not None:
            _exchange(table.t_s, value, event, model.step_s)
        elif event.kind == "jump":
            _shift(table.t_s, value, event, model.step_s)
    rebuilt = [e for e in events if e.kind in REBUILT]
    out_of = [(table.t_s >= _begin_s(e, model)) & (table.t_s < _end_s(e, table)) for e in rebuilt]
    readings = value.copy()
    for event, gone in zip(rebuilt, out_of, strict=True):
        value[gone, event.j] = np.nan
    for event in events:
        if event.kind == "jump":
            _refine(model, table, value, event)
    base = value.copy()
    for event, gone in zip(rebuilt, out_of, strict=True):
        helpers = frozenset(e.j for e, g in zip(rebuilt, out_of, strict=True) if (g & gone).any())
        known = replace(table, value_degC=base)
        value[gone, event.j] = _rebuild(model, known, event, helpers, readings[:, event.j], gone)
    _bridge(table.t_s, value, [(e.j, g) for e, g in zip(rebuilt, out_of, strict=True)])
    with np.errstate(invalid="ignore"):
        believed = np.isfinite(table.value_degC) & (value == table.value_degC)
    return replace(table, value_degC=value), believed


def _begin_s(event: Event, model: ScreeningModel) -> float:
    """A fault that begins late in a block shows in the next one; a missing channel is known to the sample."""
    return event.onset_s - (model.step_s if event.kind != "missing" and event.window_s > 0.0 else 0.0)


def _end_s(event: Event, table: Temperatures) -> float:
    return float(table.t_s[-1]) + 1.0 if event.end_s is None else event.end_s


def sample_spikes(model: ScreeningModel, table: Temperatures) -> list[Event]:
    """Single samples, or a few, that stand out of the minutes around them; too short to move the mean of a block much.

    The statistic counts in deviations that one healthy sample in a hundred exceeds.
    """
    if not 0.67 < float(np.median(np.diff(table.t_s))) / model.sampling_s < 1.5:
        return []  # the usual deviation holds for the sampling it was learnt at
    deviation, half = local_deviation_K(table, model.step_s)
    times = np.nan_to_num(np.abs(deviation) / np.maximum(model.spike_K, 1e-6))
    events = []
    for j in np.flatnonzero((times > SPIKE_TIMES).any(axis=0)):
        rows = np.flatnonzero(times[:, j] > SPIKE_TIMES)
        for run in np.split(rows, np.flatnonzero(np.diff(rows) > half) + 1):
            worst = int(run[np.argmax(times[run, j])])
            first, last = int(run[0]) + half, int(run[-1]) + half
            if not _stands_out_of_both_sides(
                table, int(j), first, last, worst + half, SPIKE_TIMES * model.spike_K[j] / 2.0
            ):
                continue
            end_s = float(table.t_s[min(last + 1, len(table.t_s) - 1)])
            events.append(
                Event(
                    int(j), "spike", first, float(table.t_s[first]), end_s, float(times[worst, j]), SPIKE_TIMES, 0.0,
                    alarm=first, decided=True, open=False, end=last, end_s=end_s, size_K=float(deviation[worst, j]),
                )
            )  # fmt: skip
    return events


def _stands_out_of_both_sides(table: Temperatures, j: int, first: int, last: int, worst: int, limit_K: float) -> bool:
    """A spike fits the course of neither side. The sharp peak of a fast sensor, where a heat source stops, fits both.

    Each side is carried on as a straight line through its two samples next to the spike; it fits within `limit_K`.
    """
    off_K = []
    for near, far in ((first - 1, first - 2), (last + 1, last + 2)):
        if min(near, far) < 0 or max(near, far) >= len(table.t_s):
            continue
        (t_near, t_far), (near_K, far_K) = table.t_s[[near, far]], table.value_degC[[near, far], j]
        carried = near_K + (near_K - far_K) * (table.t_s[worst] - t_near) / (t_near - t_far)
        off_K.append(abs(float(table.value_degC[worst, j] - carried)))
    return not min((k for k in off_K if np.isfinite(k)), default=np.inf) <= limit_K


def _level_before(t_s: Floats, column: Floats, onset_s: float) -> float:
    before = column[(t_s < onset_s) & np.isfinite(column)][-5:]
    return float(np.median(before)) if len(before) else np.nan


def _shift(t_s: Floats, value: Floats, event: Event, step_s: float) -> None:
    """Take the shift off; within a block around the onset, known to a block, each sample is judged by where it lies."""
    column = value[:, event.j]
    end_s = np.inf if event.end_s is None else event.end_s
    level = _level_before(t_s, column, event.onset_s - step_s)
    with np.errstate(invalid="ignore"):
        moved = (column - level) * np.sign(event.shift_K) > abs(event.shift_K) / 2.0
    sure = (t_s >= event.onset_s + 2.0 * step_s) & (t_s < end_s - step_s)
    unsure = (t_s >= event.onset_s - step_s) & (t_s < end_s + 2.0 * step_s) & ~sure
    column[sure | (unsure & moved)] -= event.shift_K


def _exchange(t_s: Floats, value: Floats, event: Event, step_s: float) -> None:
    j, k = event.j, event.partner
    before_s = event.onset_s - step_s
    own, other = _level_before(t_s, value[:, j], before_s), _level_before(t_s, value[:, k], before_s)
    unsure = (t_s >= before_s) & (t_s < event.onset_s + 2.0 * step_s)
    crossed = np.abs(value[:, j] - other) + np.abs(value[:, k] - own)
    straight = np.abs(value[:, j] - own) + np.abs(value[:, k] - other)
    swap = (unsure & (crossed < straight)) | (t_s >= event.onset_s + 2.0 * step_s)
    value[swap, j], value[swap, k] = value[swap, k], value[swap, j].copy()


def _inputs(model: ScreeningModel, table: Temperatures) -> tuple[Floats, Floats, Floats]:
    """Block times (middle), temperatures and their inputs for prediction; gaps bridged for the inputs only."""
    end_s, x = block_means(table, model.step_s)
    bridged = x.copy()
    for j in range(x.shape[1]):
        good = np.isfinite(x[:, j])
        bridged[:, j] = np.interp(end_s, end_s[good], x[good, j]) if good.any() else 0.0
    return end_s - model.step_s / 2, x, inputs(bridged, np.array(model.screened), model.step_s)


def _refine(model: ScreeningModel, table: Temperatures, value: Floats, event: Event) -> None:
    """Better shift from blocks on both sides, now that later ones are known."""
    t_s, x, phi = _inputs(model, replace(table, value_degC=value))
    h = min(1, len(model.horizon_s) - 1)
    end_s = _end_s(event, table)
    residual = x[:, event.j] - phi @ model.weights(h, frozenset({event.j}), event.j)
    before = residual[t_s < event.onset_s - model.step_s][-BASE_BLOCKS:]
    after = residual[(t_s > event.onset_s + 2.0 * model.step_s) & (t_s < end_s - model.step_s)][:BASE_BLOCKS]
    if np.isfinite(before).sum() >= 3 and np.isfinite(after).sum() >= 3:
        more_K = float(np.nanmean(after) - np.nanmean(before))
        # Only the noise of the first estimate is corrected here; more than that would be another fault.
        if abs(more_K) < 0.25 * abs(event.shift_K):
            on = np.abs(table.value_degC[:, event.j] - value[:, event.j] - event.shift_K) < 1e-9
            value[on, event.j] -= more_K
            event.shift_K += more_K
            event.size_K = event.shift_K


def _rebuild(
    model: ScreeningModel,
    table: Temperatures,
    event: Event,
    helpers_out: frozenset[int],
    reading: Floats,
    gone: NDArray[np.bool_],
) -> Floats:
    """Values of one sensor during its fault, anchored before it, and after it where it ended."""
    j, end_s = event.j, _end_s(event, table)
    t_s, x, phi = _inputs(model, table)
    predicted = phi @ model.weights(len(model.horizon_s) - 1, helpers_out | {j}, j)
    off = x[:, j] - predicted
    before, after = off[t_s < _begin_s(event, model)][-BASE_BLOCKS:], off[t_s > end_s][:BASE_BLOCKS]
    if not np.isfinite(before).any() or model.is_lost(j, min(end_s, table.t_s[-1]) - event.onset_s, helpers_out):
        return np.full(int(gone.sum()), np.nan)
    level = np.full(len(t_s), float(np.nanmean(before)))
    if event.end_s is not None and np.isfinite(after).any():
        share = np.clip((t_s - event.onset_s) / max(end_s - event.onset_s, 1e-9), 0.0, 1.0)
        level += share * (float(np.nanmean(after)) - level)
    rebuilt = np.interp(table.t_s, t_s, predicted + level)
    _final_kind(event, reading, rebuilt, gone, model)
    return np.asarray(rebuilt[gone])


def _final_kind(event: Event, reading: Floats, rebuilt: Floats, gone: NDArray[np.bool_], model: ScreeningModel) -> None:
    """What the whole course of the deviation says: contact lost or drift, stuck or saturated; and its size."""
    deviation = (reading - rebuilt)[gone]
    read = np.isfinite(deviation)
    if not read.any():
        return
    if event.kind == "drift":
        every = max(1, round(model.step_s / model.sampling_s), len(deviation) // 300)
        course = np.concatenate([np.zeros(5), deviation[::every]])
        found = fit_change(course, earliest=4)
        if not found.abrupt and 3.0 * found.time_constant < len(course):
            event.kind = "detached"
        event.size_K = float(np.nanmean(course[-5:]))
    elif event.kind == "stuck":
        held = float(reading[gone][read][-1])
        level = float(np.nanmedian(deviation))
        rest = reading[np.isfinite(reading)]
        # Only a channel that came back shows that it was at its limit and not dead while the machine warmed up.
        near_K = float(model.spike_K[event.j])
        if event.end is not None and (
            (held >= rest.max() - near_K and level < 0) or (held <= rest.min() + near_K and level > 0)
        ):
            event.kind = "saturated"
        event.size_K = float(deviation[read][np.argmax(np.abs(deviation[read]))])


def _bridge(t_s: Floats, value: Floats, rebuilt: Sequence[tuple[int, NDArray[np.bool_]]]) -> None:
    """Single missing samples between good ones are bridged in time; sensors that are lost stay missing."""
    for j in range(value.shape[1]):
        hole = ~np.isfinite(value[:, j])
        for k, gone in rebuilt:
            if k == j:
                hole &= ~gone
        good = np.isfinite(value[:, j])
        if hole.any() and good.any():
            value[hole, j] = np.interp(t_s[hole], t_s[good], value[good, j], left=np.nan, right=np.nan)

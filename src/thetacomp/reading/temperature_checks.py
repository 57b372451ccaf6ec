"""What no format check can find in a table of temperatures: units, stray first readings, open inputs, jumps, gaps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thetacomp.arrays import Bools, Floats, Ints
from thetacomp.instrument import frozen
from thetacomp.model.temperatures import Temperatures
from thetacomp.reading.problems import ProblemList, quoted
from thetacomp.reading.tables import Table

LOWEST_DEGC, HIGHEST_DEGC = -60.0, 250.0
JUMP_K, JUMP_K_PER_S = 2.0, 1.0 / 60.0
SETTLED = 0.25  # of the step behind a stray first reading: what follows stays together
FAR_K = 15.0
FEWEST_READINGS = 15  # fewer do not show where a sensor goes on
CODES_DEGC = (85.0, 0.0, -127.0)  # what sensors say before they convert, or when nothing is connected


def without_stray_starts(table: Table, data: Temperatures, problems: ProblemList) -> Temperatures:
    """The table with a first reading that its sensor cannot have measured as missing, which is told.

    It lies a jump away from the next reading, from which the sensor goes on, and it is a code or lies far from the
    other sensors, which the next one does not. A start is what everything counts from.
    """
    value = data.value_degC.copy()
    for j, name in enumerate(data.sensor_ids):
        good = np.flatnonzero(np.isfinite(value[:, j]))
        if len(good) < FEWEST_READINGS:
            continue
        first, second, third = value[good[:3], j]
        step = abs(second - first)
        goes_on = abs(third - second) <= SETTLED * step
        others = [k for k in range(value.shape[1]) if k != j and np.isfinite(value[good[0], k])]
        usual = float(np.median(value[good[0], others])) if others else np.nan
        stray = float(first) in CODES_DEGC or abs(first - usual) > max(FAR_K, abs(second - usual))
        if goes_on and stray and step > JUMP_K and step > JUMP_K_PER_S * (data.t_s[good[1]] - data.t_s[good[0]]):
            value[good[0], j] = np.nan
            problems.warning(
                "stray-reading",
                table.file,
                f"the first reading, {first:g} °C, is no measurement: the next one is {second:g} °C, and the sensor"
                " goes on from there. It counts as missing.",
                "leave the cell empty; give the sensor time to convert before the log begins.",
                [int(table.rows[good[0]])],
                table.header(name),
            )
    return replace(data, value_degC=value)


def temperatures(table: Table, data: Temperatures, problems: ProblemList) -> None:
    """Range, unit, sensors that do not move or hang, open inputs, jumps between neighbours, gaps."""
    value = data.value_degC
    outside = (value < LOWEST_DEGC) | (value > HIGHEST_DEGC)
    for j in np.flatnonzero(outside.any(axis=0)):
        where = np.flatnonzero(outside[:, j])
        kelvin = np.all(value[np.isfinite(value[:, j]), j] > HIGHEST_DEGC)
        problems.error(
            "temperature-range",
            table.file,
            f"found {value[where[0], j]:g} °C, expected {LOWEST_DEGC:g} to {HIGHEST_DEGC:g} °C"
            + (": is the column in kelvin?" if kelvin else "."),
            "give °C; leave the cell empty where the sensor failed (no codes such as -999 or 850).",
            table.rows[where].tolist(),
            table.header(data.sensor_ids[j]),
        )
    if outside.any() or not np.isfinite(value).any():
        return
    coldest = float(np.nanmin(value))
    if coldest > 50:
        problems.warning(
            "temperature-unit",
            table.file,
            f"no temperature is below {coldest:g} °C: are they in degrees Fahrenheit?",
            "give °C.",
        )
    _resting_sensors(table, data, problems)
    hung = _frozen(table, data, problems)
    _jumps(table, data, _open_inputs(table, data, problems) | hung, problems)
    _gaps(table, data, problems)


def _resting_sensors(table: Table, data: Temperatures, problems: ProblemList) -> None:
    if len(data.t_s) < 10:
        return
    lowest, highest = np.nanmin(data.value_degC, axis=0), np.nanmax(data.value_degC, axis=0)
    resting = [name for name, rests in zip(data.sensor_ids, lowest == highest, strict=True) if rests]
    if not resting:
        return
    everyone = len(resting) == len(data.sensor_ids)
    problems.warning(
        "temperature-constant",
        table.file,
        "no temperature changes at all." if everyone else f"these sensors never change: {', '.join(resting)}.",
        "check the logger and the cables; without a change of temperature nothing can be learnt.",
        (),
        None if everyone else table.header(resting[0]),
    )


def _is_jump(step: Floats, pause_s: Floats) -> Bools:
    return np.asarray((np.abs(step) > JUMP_K) & (np.abs(step) > JUMP_K_PER_S * pause_s))


def _open_inputs(table: Table, data: Temperatures, problems: ProblemList) -> Bools:
    """Readings (n, sensors) of an open or shorted input: one value again and again, reached and left by a jump.

    It is the lowest or the highest reading of the sensor: zero, the end of the scale, a code.
    """
    found = np.zeros(data.value_degC.shape, dtype=bool)
    for j, name in enumerate(data.sensor_ids):
        good = np.flatnonzero(np.isfinite(data.value_degC[:, j]))
        value, t_s = data.value_degC[good, j], data.t_s[good]
        jump = _is_jump(np.diff(value), np.diff(t_s))
        for end in (value.min(initial=np.inf), value.max(initial=-np.inf)):
            rows = np.flatnonzero(value == end)
            entered = (rows == 0) | np.append(False, jump)[rows] | np.append(False, np.diff(rows) == 1)[: len(rows)]
            left = (rows == len(value) - 1) | np.append(jump, False)[rows]
            left |= np.append(np.diff(rows) == 1, False)[: len(rows)]
            repeated = len(rows) > 1 or end in CODES_DEGC
            if len(rows) and repeated and len(rows) < len(value) / 2 and entered.all() and left.all():
                found[good[rows], j] = True
                problems.warning(
                    "sensor-open",
                    table.file,
                    f"the sensor reads exactly {end:g} °C {len(rows)} times, reached and left by a jump: an open or"
                    " shorted input, no temperature.",
                    "leave these cells empty, and look at the plug and the cable.",
                    table.rows[good[rows]].tolist(),
                    table.header(name),
                )
    return found


def _frozen(table: Table, data: Temperatures, problems: ProblemList) -> Bools:
    """Readings (n, sensors) that were repeated instead of measured."""
    hung = np.column_stack([frozen(data.t_s, column) for column in data.value_degC.T])
    for j in np.flatnonzero(hung.any(axis=0)):
        rows = np.flatnonzero(hung[:, j])
        problems.warning(
            "temperature-frozen",
            table.file,
            f"the sensor repeats {len(rows)} readings for longer than it ever stands still (from"
            f" {data.t_s[rows[0]] / 3600:.2f} h): it was not read.",
            "check the logger; leave these cells empty.",
            table.rows[rows].tolist(),
            table.header(data.sensor_ids[j]),
        )
    return np.asarray(hung)


def _jumps(table: Table, data: Temperatures, explained: Bools, problems: ProblemList) -> None:
    """A step that no mass of a machine can make: more than 2 K, and faster than 1 K a minute.

    What was `explained` (n, sensors) by another finding is not told again.
    """
    for j, name in enumerate(data.sensor_ids):
        good = np.flatnonzero(np.isfinite(data.value_degC[:, j]) & ~explained[:, j])
        step, pause = np.diff(data.value_degC[good, j]), np.diff(data.t_s[good])
        jumps = np.flatnonzero(_is_jump(step, pause))
        if len(jumps):
            k = int(jumps[0])
            problems.warning(
                "temperature-jump",
                table.file,
                f"the temperature jumps by {step[k]:+.1f} K within {pause[k]:g} s"
                f" (at {data.t_s[good[k + 1]] / 3600:.2f} h).",
                "look at the sensor and its plug; leave the cells empty where it failed.",
                table.rows[good[jumps + 1]].tolist(),
                table.header(name),
            )


def _gaps(table: Table, data: Temperatures, problems: ProblemList) -> None:
    """Pauses in which a sensor has no temperature: by its own sampling, as an analysis judges them too."""
    if len(data.t_s) < 4 or (np.diff(data.t_s) <= 0.0).any():
        return
    told: dict[tuple[int, ...], list[int]] = {}
    for j in range(len(data.sensor_ids)):
        rows = _after_gaps(data, j)
        if len(rows):
            told.setdefault(tuple(rows.tolist()), []).append(j)
    for ends, sensors in told.items():
        own = data.sampling(sensors[0])
        assert own is not None
        i = ends[0]
        earlier = own.t_s[own.t_s < data.t_s[i]]
        begin_s = float(earlier[-1]) if len(earlier) else float(data.t_s[0])
        everyone = len(sensors) == len(data.sensor_ids)
        which = "" if everyone else f" of {quoted([data.sensor_ids[j] for j in sensors])}"
        problems.warning(
            "time-gap",
            table.file,
            f"{(data.t_s[i] - begin_s) / 60:.0f} min without a temperature{which} (usual: {own.interval_s:g} s); what"
            " was measured meanwhile is not used with "
            + ("these sensors." if everyone or len(sensors) > 1 else "this sensor."),
            "check the logger; leave out campaigns with long gaps during heating.",
            [int(table.rows[row]) for row in ends],
            table.header("t_s" if everyone else data.sensor_ids[sensors[0]]),
        )


def _after_gaps(data: Temperatures, j: int) -> Ints:
    """Rows at which the gaps of a sensor end; the last row of the table where its readings break off before."""
    own = data.sampling(j)
    if own is None:
        return np.zeros(0, dtype=np.int64)
    after_s = own.t_s[1:][own.is_gap]
    if own.t_s[0] - data.t_s[0] > own.limit_s:
        after_s = np.append(own.t_s[:1], after_s)
    if data.t_s[-1] - own.t_s[-1] > own.limit_s:
        after_s = np.append(after_s, data.t_s[-1])
    return np.searchsorted(data.t_s, after_s)

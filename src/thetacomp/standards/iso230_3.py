"""ISO 230-3:2020, thermal effects: environmental temperature variation error, spindle and linear-axis distortion.

Every figure is a range (largest less smallest value) or a change of a displacement in a stated time. Ranges do not
depend on the sign of the data, changes do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from thetacomp.arrays import CARTESIAN, Floats
from thetacomp.campaign import Campaign, Drift, SweepPoints
from thetacomp.errors import AnalysisError
from thetacomp.machine import Axis
from thetacomp.standards.environment import all_motion, ambient_words, other_motion, speed_words, speeds, unsettled
from thetacomp.standards.instrument import Instrument

FIRST_S = 3600.0
PERIOD_S = 4 * 3600.0
LONGEST_LINEAR_MM = 2000.0
STOP_S = 3600.0
SHORTEST_REST_S = 3600.0
DAY_S = 86400.0
VISITS = 3
LATE_S = 300.0
ROTATIONS = ("A", "B", "C")

Kind = Literal["etve", "spindle", "axis"]


@dataclass(frozen=True)
class Series:
    """One displacement over time: `value` (n,) less its first value, in `unit` (µm or µrad).

    `quantity` is X, Y, Z, A, B, C or length; `place` is "" at a fixed position, else target and approach.
    """

    quantity: str
    place: str
    unit: str
    t_s: Floats
    value: Floats


@dataclass(frozen=True)
class Distortion:
    """One line of the result: range in the first 60 min, range and change over the period; NaN: not measured."""

    quantity: str
    place: str
    unit: str
    first_hour: float
    period: float
    change: float
    u: float | None


@dataclass(frozen=True)
class ThermalTest:
    """One evaluated test: when it ran, its figures, its curves, remarks, and what the data do not show.

    `start_s` to `end_s` is the period of the figures; the series may go on beyond it.
    """

    kind: Kind
    axis: str
    start_s: float
    end_s: float
    lines: tuple[Distortion, ...]
    series: tuple[Series, ...]
    remarks: tuple[str, ...]
    not_computed: tuple[str, ...]


def range_within(t_s: Floats, value: Floats, start_s: float, end_s: float) -> float:
    """Largest less smallest value from `start_s` to `end_s`; NaN with fewer than two readings."""
    inside = value[(t_s >= start_s) & (t_s <= end_s) & np.isfinite(value)]
    return float(np.ptp(inside)) if len(inside) > 1 else float("nan")


def change_within(t_s: Floats, value: Floats, start_s: float, end_s: float) -> float:
    """Last less first value from `start_s` to `end_s`; NaN with fewer than two readings."""
    inside = value[(t_s >= start_s) & (t_s <= end_s) & np.isfinite(value)]
    return float(inside[-1] - inside[0]) if len(inside) > 1 else float("nan")


def environmental_variation(campaign: Campaign, ambient: Sequence[str] = ()) -> ThermalTest:
    """Environmental temperature variation error: range of the drift while the machine rests, from the start on.

    `ambient` names the sensors in the air around the machine, here and in the other tests. Raises AnalysisError where
    the campaign has no drift log, where nobody knows whether the machine rested, or where it rested for less than an
    hour.
    """
    drift, running_s, running = _drift_and_motion(campaign)
    start_s = float(drift.t_s[0])
    moving = running_s[running & (running_s >= start_s)]
    before = running_s <= start_s
    if before.any() and running[before][-1]:
        raise AnalysisError("the machine is running at the first drift reading, so it does not rest.")
    end_s = min(float(drift.t_s[-1]), float(moving[0]) if len(moving) else np.inf)
    if end_s - start_s < SHORTEST_REST_S:
        raise AnalysisError(
            f"the machine rests for {(end_s - start_s) / 60:.0f} min before it runs, expected an hour at least."
            " Fix: log the drift of the resting machine over a day and a night."
        )
    series = _drift_series(drift, start_s, end_s, end_s)
    remarks = []
    if end_s - start_s < DAY_S:
        remarks.append(
            f"The log covers {(end_s - start_s) / 3600:.1f} h at rest: the cycle of a day and a night is not in it."
        )
    return ThermalTest(
        "etve",
        "",
        start_s,
        end_s,
        _lines(series, start_s, end_s, Instrument.of(campaign.settings)),
        series,
        (*remarks, ambient_words(campaign, ambient, start_s, end_s), *unsettled(campaign, start_s)),
        _not_measured(drift),
    )


def spindle_distortion(campaign: Campaign, ambient: Sequence[str] = ()) -> ThermalTest:
    """Thermal distortion by the spindle: from its first start out of rest, for 4 h or as long as it turns.

    A standstill of up to 60 min belongs to the run. Zero is the last reading before the start, and the first of the
    ranges. Raises AnalysisError where the campaign has no drift log or spindle speed, or the spindle never starts from
    rest.
    """
    drift, _, _ = _drift_and_motion(campaign)
    speed = speeds(campaign, "_rpm")
    if speed is None:
        raise AnalysisError("duty.csv has no column ending in _rpm, so the spindle speed is not known.")
    t_s, rpm = speed
    start_s, stop_s = _first_run(t_s, rpm > 0)
    zero_s = _zero_s(drift, start_s)
    end_s = min(stop_s, start_s + PERIOD_S, float(drift.t_s[-1]))
    series = _drift_series(drift, zero_s, end_s, float(drift.t_s[-1]))
    remarks = [speed_words(t_s, rpm, start_s, end_s)]
    if stop_s > start_s + PERIOD_S:
        remarks.append("The spindle turned for longer; the figures hold for the first 4 h.")
    elif end_s - start_s < PERIOD_S - 60.0:
        remarks.append(f"The spindle ran for {(end_s - start_s) / 3600:.1f} h, less than 4 h.")
    remarks += other_motion(campaign, start_s, end_s)
    remarks += _settling(series, start_s, end_s)
    return ThermalTest(
        "spindle",
        "",
        start_s,
        end_s,
        _lines(series, start_s, end_s, Instrument.of(campaign.settings)),
        series,
        (*remarks, ambient_words(campaign, ambient, start_s, end_s), *unsettled(campaign, start_s)),
        _not_measured(drift),
    )


def axis_distortion(campaign: Campaign, axis: Axis, ambient: Sequence[str] = ()) -> ThermalTest:
    """Thermal distortion of a linear axis: two targets near its ends, visited again and again, for 4 h.

    ISO 230-3 covers 2 m: of a longer axis the widest pair of measured targets within 2 m nearest to the middle of the
    travel is taken. Zero is the first visit; 60 min and 4 h count from there, a visit may come 5 min late. Raises
    AnalysisError where the ends were visited fewer than three times.
    """
    points = campaign.sweeps
    if points is None or axis.name not in points.axis:
        raise AnalysisError(f"there are no sweeps of axis {axis.name}.")
    mine = np.array(points.axis) == axis.name
    low_mm, high_mm = _end_targets(points, mine, axis)
    series = _visits(points, mine, axis, (low_mm, high_mm))
    if not series:
        raise AnalysisError(
            f"axis {axis.name}: the ends at {low_mm:g} and {high_mm:g} mm were visited fewer than {VISITS} times from"
            f" the same side. Fix: sweep the axis again at intervals, for 4 h."
        )
    start_s = min(float(one.t_s[0]) for one in series)
    last_s = max(float(one.t_s[-1]) for one in series)
    end_s = min(start_s + PERIOD_S, last_s)
    travel = axis.travel_mm[1] - axis.travel_mm[0]
    remarks = []
    if travel > LONGEST_LINEAR_MM:
        remarks.append(
            f"ISO 230-3 covers 2 m. The axis has {travel:g} mm: the figures hold from {low_mm:g} to {high_mm:g} mm."
        )
    if last_s < start_s + PERIOD_S:
        remarks.append(f"The visits cover {(last_s - start_s) / 3600:.1f} h, less than 4 h.")
    return ThermalTest(
        "axis",
        axis.name,
        start_s,
        end_s,
        _visit_lines(series, Instrument.of(campaign.settings), high_mm - low_mm),
        series,
        (
            *remarks,
            *_standing_apart(series),
            *all_motion(campaign, start_s, end_s),
            ambient_words(campaign, ambient, start_s, end_s),
            *unsettled(campaign, start_s),
        ),
        _not_measured(points, "sweeps.csv"),
    )


def _drift_and_motion(campaign: Campaign) -> tuple[Drift, Floats, np.ndarray]:
    """The drift log, and when the machine moved; AnalysisError where one of the two is missing."""
    if campaign.drift is None:
        raise AnalysisError("there is no drift.csv.")
    speed = speeds(campaign, "_rpm", "_mm_min")
    if speed is None:
        raise AnalysisError(
            "nothing says when the machine rested and when it ran. Fix: add duty.csv with spindle_rpm and feed_mm_min"
            " (0 at rest); one row at the start is enough for a machine that rested throughout."
        )
    return campaign.drift, speed[0], speed[1] > 0


def _first_run(t_s: Floats, runs: np.ndarray) -> tuple[float, float]:
    """When the spindle of this campaign first starts out of rest, and when it stops for more than STOP_S."""
    starts = [int(i) for i in np.flatnonzero(np.diff(runs.astype(int)) == 1) + 1 if t_s[i] >= 0.0]
    if not starts:
        raise AnalysisError("the spindle never starts out of a recorded standstill.")
    turning = np.flatnonzero(runs)
    turning = turning[turning >= starts[0]]
    # A sample holds until the next one: the run ends at the sample after the last one that turned.
    stop_s = t_s[np.minimum(turning + 1, len(t_s) - 1)]
    pause_s = np.append(t_s[turning[1:]], np.inf) - stop_s
    return float(t_s[starts[0]]), float(stop_s[int(np.argmax(pause_s > STOP_S))])


def _zero_s(drift: Drift, start_s: float) -> float:
    """The last reading before the start; where a recording is cut at the start, the first one within a minute of it."""
    earlier = drift.t_s[drift.t_s <= start_s]
    zero_s = float(earlier[-1]) if len(earlier) else float(drift.t_s[0])
    if zero_s > start_s + 60.0:
        raise AnalysisError(
            f"the drift log begins {zero_s - start_s:.0f} s after the spindle start, so there is no zero."
            " Fix: start the log before the spindle."
        )
    return zero_s


def _drift_series(drift: Drift, zero_s: float, zero_until_s: float, last_s: float) -> tuple[Series, ...]:
    """Measured directions from `zero_s` to `last_s`, less the first reading; less than two readings are left out."""
    inside = (drift.t_s >= zero_s) & (drift.t_s <= last_s)
    return _measured(drift.t_s[inside], _columns(drift.error_um, drift.rotation_urad, inside), "", zero_until_s)


def _columns(error_um: Floats, rotation_urad: Floats | None, rows: np.ndarray) -> list[tuple[str, str, Floats]]:
    columns = [(letter, "µm", error_um[rows, k]) for k, letter in enumerate(CARTESIAN)]
    if rotation_urad is not None:
        columns += [(letter, "µrad", rotation_urad[rows, k]) for k, letter in enumerate(ROTATIONS)]
    return columns


def _measured(
    t_s: Floats, columns: Sequence[tuple[str, str, Floats]], place: str, until_s: float
) -> tuple[Series, ...]:
    found = []
    for quantity, unit, value in columns:
        good = np.isfinite(value)
        if np.count_nonzero(good & (t_s <= until_s)) > 1:
            kept = value[good]
            found.append(Series(quantity, place, unit, t_s[good], kept - kept[0]))
    return tuple(found)


def _end_targets(points: SweepPoints, mine: np.ndarray, axis: Axis) -> tuple[float, float]:
    """The widest pair of targets within 2 m; of equally wide ones that nearest to the middle of the travel."""
    targets: list[float] = np.unique(np.round(points.position_mm[mine], 3)).tolist()
    middle = float(sum(axis.travel_mm)) / 2
    pairs = [(low, high) for i, low in enumerate(targets) for high in targets[i + 1 :]]
    allowed = [pair for pair in pairs if pair[1] - pair[0] <= LONGEST_LINEAR_MM + 0.5]
    if not allowed:
        raise AnalysisError(f"axis {axis.name}: no two measured targets lie within 2 m of each other.")
    return max(allowed, key=lambda p: (round(p[1] - p[0]), -abs((p[0] + p[1]) / 2 - middle)))


def _visits(points: SweepPoints, mine: np.ndarray, axis: Axis, ends_mm: tuple[float, float]) -> tuple[Series, ...]:
    """Displacements at both ends visit by visit, and the growth of the length between them, by approach."""
    found: list[Series] = []
    growth: list[Series] = []
    along = CARTESIAN.index(axis.cartesian)
    for direction, sign in ((1, "+"), (-1, "-"), (0, "")):
        here = mine & (points.direction == direction)
        rows = [_one_a_sweep(points, here, end) for end in ends_mm]
        if min(map(len, rows)) < VISITS:
            continue
        for end, visit in zip(ends_mm, rows, strict=True):
            place = f"{end:g} mm" + (f", approach {sign}" if sign else "")
            found += _measured(points.t_s[visit], _columns(points.error_um, points.rotation_urad, visit), place, np.inf)
        low, high = _same_sweep(points, rows[0], rows[1])
        length = axis.sign * (points.error_um[high, along] - points.error_um[low, along])
        place = f"{ends_mm[0]:g} to {ends_mm[1]:g} mm" + (f", approach {sign}" if sign else "")
        later = np.maximum(points.t_s[low], points.t_s[high])
        growth += _measured(later, [("length", "µm", length)], place, np.inf)
    return (*growth, *found)


def _one_a_sweep(points: SweepPoints, here: np.ndarray, end_mm: float) -> np.ndarray:
    """First reading at a target in each sweep."""
    rows = np.flatnonzero(here & (np.abs(points.position_mm - end_mm) <= 0.001))
    return rows[np.unique(points.sweep[rows], return_index=True)[1]]


def _same_sweep(points: SweepPoints, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Readings at both ends that belong to one sweep."""
    _, i, j = np.intersect1d(points.sweep[low], points.sweep[high], return_indices=True)
    return low[i], high[j]


def _lines(series: Sequence[Series], start_s: float, end_s: float, instrument: Instrument) -> tuple[Distortion, ...]:
    """Figures of the series of one drift log, from their zero to 60 min after the start and to the end."""
    return tuple(_line(one, min(start_s + FIRST_S, end_s), end_s, instrument.difference_u_um()) for one in series)


def _visit_lines(series: Sequence[Series], instrument: Instrument, apart_mm: float) -> tuple[Distortion, ...]:
    """Figures of visits. Each place counts time from its own first visit; a visit may come LATE_S late."""
    lines = []
    for one in series:
        first_s = float(one.t_s[0]) + LATE_S
        u = instrument.difference_u_um(apart_mm if one.quantity == "length" else 0.0)
        lines.append(_line(one, first_s + FIRST_S, first_s + PERIOD_S, u))
    return tuple(lines)


def _line(one: Series, hour_s: float, end_s: float, u_um: float | None) -> Distortion:
    """Range to `hour_s`, range and change to `end_s`. Of angles the instrument's share is not known."""
    return Distortion(
        one.quantity,
        one.place,
        one.unit,
        range_within(one.t_s, one.value, float(one.t_s[0]), hour_s),
        range_within(one.t_s, one.value, float(one.t_s[0]), end_s),
        change_within(one.t_s, one.value, float(one.t_s[0]), end_s),
        u_um if one.unit == "µm" else None,
    )


def _not_measured(data: Drift | SweepPoints, file: str = "drift.csv") -> tuple[str, ...]:
    """Which of the six displacements the data do not hold."""
    missing = [letter for k, letter in enumerate(CARTESIAN) if not np.isfinite(data.error_um[:, k]).any()]
    notes = [f"displacement {letter}: {file} has no d{letter}_um." for letter in missing]
    angles = data.rotation_urad
    lost = [c for k, c in enumerate(ROTATIONS) if angles is None or not np.isfinite(angles[:, k]).any()]
    if lost:
        notes.append(
            f"tilt {', '.join(lost)}: {file} has no {', '.join(f'r{c}_urad' for c in lost)}. Of two displacement"
            " sensors a distance l apart the tilt is (d1 - d2) / l: l must be known."
        )
    return tuple(notes)


def _settling(series: Sequence[Series], start_s: float, end_s: float) -> list[str]:
    """How much the last hour still moves, compared with the first."""
    if end_s - start_s < 2 * FIRST_S:
        return []
    parts = []
    for one in series:
        first = range_within(one.t_s, one.value, start_s, start_s + FIRST_S)
        last = range_within(one.t_s, one.value, end_s - FIRST_S, end_s)
        if first > 0 and np.isfinite(last):
            parts.append(f"{one.quantity} {last:.1f} {one.unit} ({100 * last / first:.0f} %)")
    if not parts:
        return []
    return [f"Still moving in the last 60 min, and in percent of the first 60 min: {', '.join(parts)}."]


def _standing_apart(series: Sequence[Series]) -> list[str]:
    """Visits that depart from both neighbours by more than half of the range of all others: a range takes them in."""
    remarks = []
    for one in series:
        middle = np.median(np.stack([one.value[:-2], one.value[1:-1], one.value[2:]]), axis=0)
        off = np.abs(one.value[1:-1] - middle)
        worst = int(np.argmax(off)) + 1
        others = np.delete(one.value, worst)
        if len(others) > 3 and off[worst - 1] > np.ptp(others) / 2:
            remarks.append(
                f"{one.quantity} at {one.place}: the reading at {one.t_s[worst] / 3600:.1f} h departs from its"
                f" neighbours by {off[worst - 1]:.0f} {one.unit}. It is part of the range; check it."
            )
    return remarks

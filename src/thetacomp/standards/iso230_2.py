"""ISO 230-2:2014, accuracy and repeatability of positioning of a linear axis: A, E, M, R, B by direction.

Symbols of the standard: i counts the target positions, j the runs, ↑ is the approach towards higher positions (`up`),
↓ the other (`down`). The deviation x_ij is actual minus target position, along the axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats, Ints
from thetacomp.errors import AnalysisError
from thetacomp.instrument import jump_that_stays, step_scatter

RUNS = 5
RUNS_TO_COMPARE = 3
TARGETS = 5
TARGETS_PER_M = 5.0
LONG_AXIS_MM = 2000.0
_SAME_TARGET_MM = 0.001
_SHOWN = 4


@dataclass(frozen=True)
class Readings:
    """Positioning deviations of one axis as they were read, n rows in any order.

    `direction` is +1 (approach towards higher positions) or -1; `run` names the run; a missing deviation is NaN.
    """

    axis: str
    target_mm: Floats
    run: tuple[str, ...]
    direction: Ints
    deviation_um: Floats
    t_s: Floats | None = None


@dataclass(frozen=True)
class Runs:
    """Deviations x_ij of m targets and n runs in each direction: `up_um` and `down_um` (m, n), all present."""

    axis: str
    target_mm: Floats
    up_um: Floats
    down_um: Floats
    up_runs: tuple[str, ...]
    down_runs: tuple[str, ...]

    @property
    def length_mm(self) -> float:
        """Distance from the first to the last target."""
        return float(self.target_mm[-1] - self.target_mm[0])

    @property
    def count(self) -> int:
        """Runs in each direction."""
        return int(self.up_um.shape[1])


@dataclass(frozen=True)
class Targets:
    """What ISO 230-2 defines at each target position, all (m,) in µm. `s`, `repeatability`: NaN for a single run."""

    target_mm: Floats
    mean_up_um: Floats
    mean_down_um: Floats
    mean_um: Floats
    reversal_um: Floats
    s_up_um: Floats
    s_down_um: Floats
    repeatability_up_um: Floats
    repeatability_down_um: Floats
    repeatability_um: Floats


@dataclass(frozen=True)
class AxisFigures:
    """The figures of the axis in µm. A and R are NaN where one run in each direction was evaluated."""

    A_um: float
    A_up_um: float
    A_down_um: float
    R_um: float
    R_up_um: float
    R_down_um: float
    E_um: float
    E_up_um: float
    E_down_um: float
    M_um: float
    B_um: float
    B_mean_um: float


@dataclass(frozen=True)
class Positioning:
    """The evaluation of one axis. `run_drift_um`: mean of the last runs less that of the first; NaN for one run.

    `span_s`: time of the first and the last reading; NaN where the readings carry no time.
    """

    runs: Runs
    targets: Targets
    figures: AxisFigures
    run_drift_um: float
    remarks: tuple[str, ...]
    span_s: tuple[float, float] = (float("nan"), float("nan"))


def positioning(readings: Readings, travel_mm: float | None = None) -> Positioning:
    """Evaluate one axis. `travel_mm`: length of the axis, where it is known (else that of the measured targets).

    Up to 2 m of measured length: five runs or more in both directions at every target. Beyond (ISO 230-2, 6.2 of the
    2014 edition) the first run in each direction is evaluated, without s, R and A. Raises AnalysisError with what is
    missing: which target, which run, which approach.
    """
    runs = arranged(readings)
    long = runs.length_mm > LONG_AXIS_MM
    remarks = _remarks(runs, travel_mm)
    drift_um = float("nan")
    if long:
        first = (runs.up_um[:, :1], runs.down_um[:, :1], runs.up_runs[:1], runs.down_runs[:1])
        used = Runs(runs.axis, runs.target_mm, *first)
    else:
        _refuse_few_runs(runs)
        used = runs
        both = (runs.up_um + runs.down_um) / 2
        drift_um = float(np.mean(both[:, -1] - both[:, 0]))
    targets = at_targets(used)
    figures = axis_figures(targets)
    if abs(drift_um) > figures.R_um / 4:
        remarks += (
            f"From the first run to the last the deviations moved by {drift_um:.1f} µm on average: the machine or the"
            " instrument was not settled, and R and A include this drift.",
        )
    return Positioning(used, targets, figures, drift_um, remarks, _span_s(readings, used))


def arranged(readings: Readings) -> Runs:
    """Readings as complete tables of targets and runs; runs keep the order in which they were read.

    Raises AnalysisError where an approach is missing altogether, where a target was not read in every run, or was read
    twice in one.
    """
    axis = readings.axis
    directions = set(readings.direction.tolist())
    for sign, name, other in ((1, "+", "-"), (-1, "-", "+")):
        if sign not in directions:
            raise AnalysisError(
                f"axis {axis}: there is no reading with approach {name}; ISO 230-2 needs both approaches at every"
                f" target. Fix: measure the targets with approach {name} too, not with {other} alone."
            )
    target_mm = _unique_targets(readings.target_mm)
    tables, names = [], []
    faults: list[str] = []
    for sign, name in ((1, "+"), (-1, "-")):
        mine = np.flatnonzero(readings.direction == sign)
        labels = tuple(dict.fromkeys(readings.run[i] for i in mine))
        table = np.full((len(target_mm), len(labels)), np.nan)
        for i in mine:
            row = int(np.argmin(np.abs(target_mm - readings.target_mm[i])))
            column = labels.index(readings.run[i])
            if np.isfinite(table[row, column]) and np.isfinite(readings.deviation_um[i]):
                faults.append(f"target {target_mm[row]:g} mm was read twice in run {labels[column]}, approach {name}")
            if np.isfinite(readings.deviation_um[i]):
                table[row, column] = readings.deviation_um[i]
        faults += [
            f"target {target_mm[i]:g} mm has no reading in run {labels[j]}, approach {name}"
            for i, j in np.argwhere(np.isnan(table)).tolist()
        ]
        tables.append(table)
        names.append(labels)
    if faults:
        _refuse(axis, faults)
    if len(names[0]) != len(names[1]):
        raise AnalysisError(
            f"axis {axis}: {len(names[0])} runs with approach +, {len(names[1])} with approach -; ISO 230-2 needs as"
            " many in both directions. Fix: complete the runs, or leave the surplus ones out."
        )
    if len(target_mm) < TARGETS:
        raise AnalysisError(
            f"axis {axis}: {len(target_mm)} target positions, ISO 230-2 needs at least {TARGETS}."
            " Fix: measure at more positions."
        )
    return Runs(axis, target_mm, tables[0], tables[1], *names)


def at_targets(runs: Runs) -> Targets:
    """Mean deviations, reversal, estimators s and repeatabilities at every target (ISO 230-2:2014, clause 3)."""
    several = runs.count > 1
    nothing = np.full(len(runs.target_mm), np.nan)
    mean_up, mean_down = runs.up_um.mean(axis=1), runs.down_um.mean(axis=1)
    s_up = runs.up_um.std(axis=1, ddof=1) if several else nothing
    s_down = runs.down_um.std(axis=1, ddof=1) if several else nothing
    reversal = mean_up - mean_down
    spread = np.stack([2 * s_up + 2 * s_down + np.abs(reversal), 4 * s_up, 4 * s_down])
    return Targets(
        target_mm=runs.target_mm,
        mean_up_um=mean_up,
        mean_down_um=mean_down,
        mean_um=(mean_up + mean_down) / 2,
        reversal_um=reversal,
        s_up_um=s_up,
        s_down_um=s_down,
        repeatability_up_um=4 * s_up,
        repeatability_down_um=4 * s_down,
        repeatability_um=spread.max(axis=0),
    )


def axis_figures(targets: Targets) -> AxisFigures:
    """The figures of the axis from those of its targets (ISO 230-2:2014, clause 3)."""
    up, down = targets.mean_up_um, targets.mean_down_um
    high = np.stack([up + 2 * targets.s_up_um, down + 2 * targets.s_down_um])
    low = np.stack([up - 2 * targets.s_up_um, down - 2 * targets.s_down_um])
    return AxisFigures(
        A_um=float(high.max() - low.min()),
        A_up_um=float(high[0].max() - low[0].min()),
        A_down_um=float(high[1].max() - low[1].min()),
        R_um=float(targets.repeatability_um.max()),
        R_up_um=float(targets.repeatability_up_um.max()),
        R_down_um=float(targets.repeatability_down_um.max()),
        E_um=float(max(up.max(), down.max()) - min(up.min(), down.min())),
        E_up_um=float(np.ptp(up)),
        E_down_um=float(np.ptp(down)),
        M_um=float(np.ptp(targets.mean_um)),
        B_um=float(np.abs(targets.reversal_um).max()),
        B_mean_um=float(targets.reversal_um.mean()),
    )


def _unique_targets(target_mm: Floats) -> Floats:
    """Target positions in rising order; readings within 1 µm belong to one target."""
    ordered = np.unique(target_mm)
    return np.asarray(ordered[np.concatenate([[True], np.diff(ordered) > _SAME_TARGET_MM])])


def _span_s(readings: Readings, used: Runs) -> tuple[float, float]:
    if readings.t_s is None:
        return float("nan"), float("nan")
    names = {1: used.up_runs, -1: used.down_runs}
    taken = [run in names[d] for run, d in zip(readings.run, readings.direction.tolist(), strict=True)]
    t_s = readings.t_s[np.array(taken)]
    return float(t_s.min()), float(t_s.max())


def _refuse(axis: str, faults: Sequence[str]) -> None:
    more = f"; and {len(faults) - _SHOWN} more" if len(faults) > _SHOWN else ""
    raise AnalysisError(
        f"axis {axis}: {'; '.join(faults[:_SHOWN])}{more}. ISO 230-2 needs one reading of every target in every run and"
        " approach. Fix: measure what is missing, or leave the target or the run out altogether. The ends of a run need"
        " an overrun, so that they too are approached from both sides."
    )


def _refuse_few_runs(runs: Runs) -> None:
    if runs.count < RUNS:
        raise AnalysisError(
            f"axis {runs.axis}: {runs.count} run{'s' if runs.count > 1 else ''} in each direction"
            f" ({', '.join(runs.up_runs)}), ISO 230-2 needs {RUNS} at every target of an axis up to 2 m."
            f" Fix: measure {RUNS - runs.count} more in each direction, right after the others."
        )


def _jumps(runs: Runs) -> list[str]:
    """Runs in which the deviation jumps on the way, against the median of all runs in that direction."""
    if runs.count < RUNS_TO_COMPARE:
        return []
    found = []
    ways = [("+", runs.up_um, runs.up_runs, 1), ("-", runs.down_um, runs.down_runs, -1)]
    rest = [
        (sign, (um - np.median(um, axis=1, keepdims=True)).T[:, ::way], names, way) for sign, um, names, way in ways
    ]
    scatter = step_scatter([run for _, left, _, _ in rest for run in left])
    for sign, left, names, way in rest:
        for run, name in zip(left, names, strict=True):
            jump = jump_that_stays(run, scatter)
            if jump is not None:
                found.append(
                    f"Run {name}, direction {sign}: the deviation jumps by {jump[1]:+.0f} µm at"
                    f" {runs.target_mm[::way][jump[0]]:g} mm and stays there; all figures include it. Did the machine,"
                    " a clamp or the instrument move?"
                )
    return found


def _remarks(runs: Runs, travel_mm: float | None) -> tuple[str, ...]:
    """What a reader must know about the conditions of this evaluation."""
    remarks = []
    length = runs.length_mm
    per_m = len(runs.target_mm) / (length / 1000.0)
    if length > LONG_AXIS_MM:
        remarks.append(
            f"The targets span {length:g} mm, more than 2 m: the first run in each direction is evaluated, and neither"
            " s nor R nor A, as ISO 230-2 rules for long axes. For these, measure five runs over an agreed section of"
            " at most 2 m and put them into a table of their own."
        )
    elif travel_mm is not None and travel_mm > LONG_AXIS_MM:
        remarks.append(
            f"The axis is {travel_mm:g} mm long: all figures are valid for the section from {runs.target_mm[0]:g} to"
            f" {runs.target_mm[-1]:g} mm, not for the whole axis."
        )
    if length <= LONG_AXIS_MM and per_m < TARGETS_PER_M:
        remarks.append(f"{per_m:.1f} targets per metre; ISO 230-2 asks for at least {TARGETS_PER_M:g}.")
    if travel_mm is not None and length < 0.9 * min(travel_mm, LONG_AXIS_MM):
        remarks.append(f"The targets cover {length:g} mm of {travel_mm:g} mm travel.")
    if np.ptp(np.diff(runs.target_mm)) < 1e-3 * length / len(runs.target_mm):
        remarks.append("The targets are equally spaced: periodic errors of screw or scale may stay unseen.")
    remarks += _jumps(runs)
    if runs.count > RUNS and length <= LONG_AXIS_MM:
        remarks.append(f"{runs.count} runs in each direction were evaluated; ISO 230-2 takes {RUNS}.")
    return tuple(remarks)

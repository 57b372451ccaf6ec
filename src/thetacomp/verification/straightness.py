"""Straightness and squareness in the sense of ISO 230-1, separate from the column deviation."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.machine import Axis, Machine
from thetacomp.separation import ComponentSeparation
from thetacomp.separation.component import Points
from thetacomp.verification.outcome import Squareness, Straightness

LEAST_SQUARES, END_POINTS = "least squares", "end points"


def straightness_um(position_mm: Floats, error_um: Floats, line: str) -> float:
    """Peak to valley of the deviations from the reference line, in µm (ISO 230-1: a pure tilt vanishes).

    `position_mm` and `error_um` are (n,); values at one position are averaged first. `line` is the least-squares line
    or the one through the end points.
    """
    position, index = np.unique(np.round(position_mm, 3), return_inverse=True)
    value = np.bincount(index, weights=error_um) / np.bincount(index)
    if line == LEAST_SQUARES:
        slope, offset = np.polyfit(position, value, 1)
    else:
        slope = (value[-1] - value[0]) / (position[-1] - position[0])
        offset = value[0] - slope * position[0]
    return float(np.ptp(value - slope * position - offset))


def straightness(
    machine: Machine, separations: Sequence[ComponentSeparation], off: Sequence[str], on: Sequence[str]
) -> tuple[Straightness, ...]:
    """Straightness of every motion across its axis, geometry included: cold, and the largest of the heated sweeps."""
    out = []
    cartesian = {axis.name: axis.cartesian for axis in machine.axes}
    for component in dict.fromkeys(s.component for s in separations):
        runs = [[s for s in separations if s.component == component and s.campaign in names] for names in (off, on)]
        parts = [part for run in runs for part in run]
        if not all(runs) or any(p.points is None or p.axis is None or cartesian[p.axis] == p.direction for p in parts):
            continue
        for line in (LEAST_SQUARES, END_POINTS):
            (cold_off, off_um), (cold_on, on_um) = (_cold_and_heated(run, line) for run in runs)
            out.append(Straightness(component, line, cold_off, cold_on, off_um, on_um))
    return tuple(out)


def _cold_and_heated(run: Sequence[ComponentSeparation], line: str) -> tuple[float, float]:
    found: dict[bool, list[float]] = {True: [], False: []}
    for part in run:
        points = part.points
        assert points is not None
        for sweep, cold in zip(part.sweep, part.cold, strict=True):
            value = _of_sweep(points, int(sweep), line)
            if value is not None:
                found[bool(cold)].append(value)
    cold_um = float(np.mean(found[True])) if found[True] else float("nan")
    return cold_um, max(found[False], default=float("nan"))


def _of_sweep(points: Points, sweep: int, line: str) -> float | None:
    rows = (points.sweep == sweep) & ~points.outlier
    if len(np.unique(np.round(points.position_mm[rows], 3))) < 3:
        return None
    return straightness_um(points.position_mm[rows], points.error_um[rows], line)


def squareness(
    machine: Machine, separations: Sequence[ComponentSeparation], off: Sequence[str], on: Sequence[str]
) -> tuple[Squareness, ...]:
    """Largest tilt of every line against its cold reference, and largest change of the angle between two axes.

    With the axes u and v the angle between their lines is 90° less (slope of E_uv + slope of E_vu), both along the
    positive Cartesian directions; the second line is read at the times of the first.
    """
    own = {s.component: s for s in separations}
    out = []
    for component, first in own.items():
        axis = next((a for a in machine.axes if a.name == first.axis), None)
        if axis is not None and axis.cartesian != first.direction:
            out.append(Squareness(component, *(_largest_tilt(separations, component, names) for names in (off, on))))
    for one, other in combinations(machine.axes, 2):
        pair = f"E{one.cartesian}{other.name}", f"E{other.cartesian}{one.name}"
        if one.cartesian != other.cartesian and all(name in own for name in pair):
            changes = (_largest_change(separations, pair, (other, one), names) for names in (off, on))
            out.append(Squareness(f"{one.name}-{other.name}", *changes))
    return tuple(out)


def _largest_tilt(separations: Sequence[ComponentSeparation], component: str, names: Sequence[str]) -> float:
    slopes = [s.slope_um_per_m for s in separations if s.component == component and s.campaign in names]
    known = np.abs(np.concatenate(slopes)) if slopes else np.zeros(0)
    return float(np.nanmax(known)) if np.isfinite(known).any() else float("nan")


def _largest_change(
    separations: Sequence[ComponentSeparation], pair: tuple[str, str], moving: tuple[Axis, Axis], names: Sequence[str]
) -> float:
    largest = float("nan")
    for name in names:
        lines = [next((s for s in separations if s.campaign == name and s.component == c), None) for c in pair]
        if lines[0] is None or lines[1] is None:
            continue
        first, second = lines[0], lines[1]
        other = np.interp(first.t_s, second.t_s, second.slope_um_per_m)
        change = moving[0].sign * first.slope_um_per_m + moving[1].sign * other
        if np.isfinite(change).any():
            largest = float(np.nanmax([largest, np.nanmax(np.abs(change))]))
    return largest

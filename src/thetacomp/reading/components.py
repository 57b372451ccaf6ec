"""The error components of a campaign as they were measured, each with its own times: before any separation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import CARTESIAN, Floats, Ints
from thetacomp.campaign import Campaign


@dataclass(frozen=True)
class MeasuredComponent:
    """One component, n readings: `EYX` from sweeps, `DZ` from drift. A missing error is NaN.

    `lever` (n,) runs from -1 to 1 over the positions, 0 throughout at a fixed one; readings of one row of `place`
    (n, k) share their geometry; `sweep` (n,) is the number of the sweep, 0 for drift.
    """

    name: str
    t_s: Floats
    lever: Floats
    place: Floats
    sweep: Ints
    error_um: Floats


def measured_components(campaign: Campaign) -> list[MeasuredComponent]:
    """Every component with at least one reading, of sweeps first and then of drift."""
    found = []
    sweeps, drift = campaign.sweeps, campaign.drift
    for axis in dict.fromkeys(sweeps.axis) if sweeps is not None else ():
        assert sweeps is not None
        mine = np.array([name == axis for name in sweeps.axis])
        lever = lever_of(sweeps.position_mm[mine])
        place = np.column_stack([np.round(lever, 2), sweeps.direction[mine]])
        found += [
            MeasuredComponent(
                f"E{letter}{axis}", sweeps.t_s[mine], lever, place, sweeps.sweep[mine], sweeps.error_um[mine, k]
            )
            for k, letter in enumerate(CARTESIAN)
        ]
    if drift is not None:
        n = len(drift.t_s)
        stood = np.column_stack([np.zeros(n), *(np.round(p, 3) for p in drift.at_mm.values())])
        found += [
            MeasuredComponent(
                f"D{letter}", drift.t_s, np.zeros(n), stood, np.zeros(n, dtype=np.int64), drift.error_um[:, k]
            )
            for k, letter in enumerate(CARTESIAN)
        ]
    return [component for component in found if np.isfinite(component.error_um).any()]


def lever_of(position_mm: Floats) -> Floats:
    """Positions as -1 at the low end to 1 at the high end; 0 where there is one position only."""
    half = np.ptp(position_mm) / 2.0 if len(position_mm) else 0.0
    if half == 0.0:
        return np.zeros(len(position_mm))
    return np.asarray((position_mm - (position_mm.max() + position_mm.min()) / 2.0) / half)

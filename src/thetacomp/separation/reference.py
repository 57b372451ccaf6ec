"""Which sweeps are the cold block: the state at which the thermal error counts as zero."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thetacomp.campaign import Campaign, Floats, Ints, SweepPoints
from thetacomp.errors import AnalysisError


@dataclass(frozen=True)
class SweepTable:
    """One row a sweep, in order of time: its number, axis, first, middle and last moment."""

    sweep: Ints
    axis: tuple[str, ...]
    start_s: Floats
    middle_s: Floats
    end_s: Floats


def sweep_table(points: SweepPoints) -> SweepTable:
    """Start, middle (mean time of the points) and end of every sweep."""
    numbers = np.unique(points.sweep)
    rows = [np.flatnonzero(points.sweep == number) for number in numbers]
    return SweepTable(
        sweep=numbers,
        axis=tuple(points.axis[row[0]] for row in rows),
        start_s=np.array([points.t_s[row].min() for row in rows]),
        middle_s=np.array([points.t_s[row].mean() for row in rows]),
        end_s=np.array([points.t_s[row].max() for row in rows]),
    )


def reference_time_s(campaign: Campaign) -> float:
    """The moment of zero: `reference_s` of campaign.toml, else the end of the cold block.

    The cold block is the opening run of sweeps before an axis comes back after another axis was measured; with a
    single axis it is the first sweep. Where no sweeps exist it is the first sample of the parameters or the drift.
    """
    if campaign.settings.reference_s is not None:
        return campaign.settings.reference_s
    if campaign.sweeps is not None:
        table = sweep_table(campaign.sweeps)
        return float(table.end_s[_cold_block_length(table.axis) - 1])
    for data in (campaign.parameters, campaign.drift):
        if data is not None:
            return float(data.t_s.min())
    raise AnalysisError(
        f"campaign {campaign.name}: there are no sweeps, parameters or drift, so there is nothing to refer to."
    )


def _cold_block_length(axes: tuple[str, ...]) -> int:
    if len(set(axes)) == 1:
        return 1
    done: set[str] = set()
    for index, axis in enumerate(axes):
        if index and axis != axes[index - 1]:
            done.add(axes[index - 1])
        if axis in done:
            return index
    return len(axes)


def cold_block_change_K(campaign: Campaign, reference_s: float) -> Floats:
    """How much every sensor moves from the first measured point to the reference, in K, (sensors,)."""
    start_s = reference_s if campaign.sweeps is None else min(reference_s, float(campaign.sweeps.t_s.min()))
    first, last = campaign.temperatures.at(np.array([start_s, reference_s]))
    return np.asarray(last - first)


def reference_temperatures_degC(campaign: Campaign, reference_s: float) -> Floats:
    """Temperatures of the cold state, shape (sensors,).

    The mean over the samples of the cold block (from the first measured point to `reference_s`), which is the time
    in which the cold geometry was measured; with fewer than two samples there, the value at `reference_s`.
    """
    temperatures = campaign.temperatures
    start_s = reference_s
    if campaign.sweeps is not None:
        start_s = min(start_s, float(campaign.sweeps.t_s.min()))
    inside = (temperatures.t_s >= start_s) & (temperatures.t_s <= reference_s)
    at_reference: Floats = temperatures.at(np.array([reference_s]))[0]
    if np.count_nonzero(inside) < 2:
        return np.asarray(at_reference)
    block = temperatures.value_degC[inside]
    counts = np.isfinite(block).sum(axis=0)
    sums = np.nansum(block, axis=0)
    return np.where(counts > 0, sums / np.maximum(counts, 1), at_reference)

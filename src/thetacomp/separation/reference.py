"""Which sweeps are the cold block: the state at which the thermal error counts as zero."""

from __future__ import annotations

import numpy as np

from thetacomp.arrays import Bools, Floats
from thetacomp.campaign import Campaign
from thetacomp.cold_block import cold_block_length, sweep_table
from thetacomp.errors import AnalysisError

DRIFT_WINDOW_S = 300.0


def reference_time_s(campaign: Campaign) -> float:
    """The moment of zero: `reference_s` of campaign.toml, else the end of the cold block.

    The cold block is the opening run of sweeps before an axis comes back after another axis was measured; with a
    single axis it is the first sweep. Where no sweeps exist it is the first sample of the parameters or the drift.
    """
    if campaign.settings.reference_s is not None:
        return campaign.settings.reference_s
    if campaign.sweeps is not None:
        table = sweep_table(campaign.sweeps)
        return float(table.end_s[cold_block_length(table.axis) - 1])
    for data in (campaign.parameters, campaign.drift):
        if data is not None:
            return float(data.t_s.min())
    raise AnalysisError(
        f"campaign {campaign.name}: there are no sweeps, parameters or drift, so there is nothing to refer to."
    )


def drift_window(t_s: Floats, reference_s: float) -> Bools:
    """Samples of a drift record in which its zero is taken: the five minutes up to the reference, else the nearest."""
    inside = (t_s <= reference_s) & (t_s >= reference_s - DRIFT_WINDOW_S)
    if not inside.any():
        inside = np.arange(len(t_s)) == int(np.argmin(np.abs(t_s - reference_s)))
    return np.asarray(inside, dtype=bool)


def cold_block_change_K(campaign: Campaign, reference_s: float) -> Floats:
    """How much every sensor moves from the first measured point to the reference, in K, (sensors,)."""
    start_s = reference_s if campaign.sweeps is None else min(reference_s, float(campaign.sweeps.t_s.min()))
    first, last = campaign.temperatures.at(np.array([start_s, reference_s]))
    return np.asarray(last - first)


def cold_block_notes(campaign: Campaign) -> list[str]:
    """A cold block that warms up is no reference: its heat is taken for geometry."""
    if campaign.sweeps is None:
        return []
    change_K = cold_block_change_K(campaign, reference_time_s(campaign))
    span_K = np.nanmax(campaign.temperatures.value_degC, axis=0) - np.nanmin(campaign.temperatures.value_degC, axis=0)
    moved = np.flatnonzero((np.abs(change_K) > 0.5) & (np.abs(change_K) > 0.1 * span_K))
    if not len(moved):
        return []
    worst = ", ".join(f"{campaign.temperatures.sensor_ids[j]} {change_K[j]:+.1f} K" for j in moved[:4])
    return [
        f"campaign {campaign.name}: {len(moved)} sensors move during the cold block ({worst}), more than a tenth of"
        " their span: part of the thermal error is taken for geometry; measure the cold block before any heat"
    ]


def refuse_reference_in_a_sweep(campaign: Campaign, reference_s: float) -> None:
    """The cold block ends between two sweeps. Raises AnalysisError where the stated reference cuts one."""
    if campaign.sweeps is None:
        return
    table = sweep_table(campaign.sweeps)
    for axis, start_s, end_s in zip(table.axis, table.start_s, table.end_s, strict=True):
        if start_s < reference_s < end_s - 1.0:
            raise AnalysisError(
                f"campaign {campaign.name}: reference_s = {reference_s:g} lies inside a sweep of axis {axis}"
                f" ({start_s:g} to {end_s:g} s), so it is not clear whether that sweep is cold."
                " Fix: set reference_s to the end of the last cold sweep, or leave it out."
            )

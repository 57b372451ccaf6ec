"""Heat-history inputs of a campaign as differences from its reference, at any time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.campaign import Campaign
from thetacomp.model.filters import SPEED, HistoryLayout, recorded_inputs
from thetacomp.model.temperatures import Duty, Temperatures


@dataclass(frozen=True)
class HistoryTrack:
    """Inputs (n, k) of one campaign at the samples `t_s` (n,), and their values at the reference (k,)."""

    t_s: Floats
    inputs: Floats
    reference: Floats

    def at(self, t_s: Floats) -> Floats:
        """Differences from the reference at other times, (len(t_s), k): linear between samples."""
        return self.absolute(t_s) - self.reference

    def absolute(self, t_s: Floats) -> Floats:
        """The inputs themselves at other times, (len(t_s), k)."""
        columns = [np.interp(t_s, self.t_s, self.inputs[:, j]) for j in range(self.inputs.shape[1])]
        return np.column_stack(columns) if columns else np.zeros((len(t_s), 0))


def history_layout(campaigns: Sequence[Campaign]) -> HistoryLayout | None:
    """The inputs that all campaigns can give: sensors read in each, the speed where each has it. None without sensors.

    A sensor with a missing sample at the start of a campaign is left out: its filter would have no state to start from.
    """
    common = [
        {
            name
            for j, name in enumerate(campaign.temperatures.sensor_ids)
            if np.isfinite(campaign.temperatures.value_degC[0, j])
        }
        for campaign in campaigns
    ]
    sensors = tuple(name for name in campaigns[0].temperatures.sensor_ids if all(name in ids for ids in common))
    if not sensors:
        return None
    first = campaigns[0].temperatures
    start_degC = [first.value_degC[0, first.sensor_ids.index(name)] for name in sensors]
    with_speed = all(c.duty is not None and SPEED in c.duty.columns for c in campaigns)
    return HistoryLayout(
        sensors=sensors, base_degC=float(np.mean(start_degC)), speed_powers=(1, 2) if with_speed else ()
    )


def history_track(campaign: Campaign, layout: HistoryLayout, zero_t_s: Floats) -> HistoryTrack:
    """Run the filters over a campaign; at rest on its first sample or on that of what came before."""
    parts = [(campaign.temperatures, campaign.duty)]
    if campaign.before is not None:
        parts.insert(0, (campaign.before.temperatures, campaign.before.duty))
    t_s, inputs = recorded_inputs(layout, parts)
    own = t_s >= campaign.temperatures.t_s[0]
    track = HistoryTrack(t_s[own], inputs[own], np.zeros(inputs.shape[1]))
    return replace(track, reference=track.absolute(zero_t_s).mean(axis=0))


def unbroken(campaign: Campaign) -> tuple[Temperatures, Duty | None]:
    """Temperatures and duty of a campaign with what came before it as one recording, for filters to run through.

    Where nobody logged the duty before the campaign the machine counts as standing still, as in `history_track`.
    """
    own, duty, before = campaign.temperatures, campaign.duty, campaign.before
    if before is None or not len(before.temperatures.t_s):
        return own, duty
    earlier = before.temperatures
    columns = [earlier.sensor_ids.index(name) for name in own.sensor_ids]
    value_degC = np.vstack([earlier.value_degC[:, columns], own.value_degC])
    whole = replace(own, t_s=np.concatenate([earlier.t_s, own.t_s]), value_degC=value_degC)
    if duty is None:
        return whole, None
    past = before.duty or Duty(earlier.t_s[:1], {name: np.zeros(1) for name in duty.columns})
    names = [name for name in duty.columns if name in past.columns]
    joined = {name: np.concatenate([past.columns[name], duty.columns[name]]) for name in names}
    return whole, Duty(np.concatenate([past.t_s, duty.t_s]), joined)

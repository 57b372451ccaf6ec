"""Heat-history inputs of a campaign as differences from its reference, at any time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.campaign import Campaign
from thetacomp.model.filters import LEVEL_CAMPAIGNS, SPEED, InputLayout, recorded_inputs
from thetacomp.model.temperatures import between_samples


@dataclass(frozen=True)
class HistoryTrack:
    """Running inputs (n, k) of one campaign at the samples `t_s` (n,), and their values at the reference (k,).

    Without a `layout` there are none.
    """

    layout: InputLayout | None
    t_s: Floats
    inputs: Floats
    reference: Floats

    def at(self, t_s: Floats) -> Floats:
        """All inputs of the layout since the reference at other times, (len(t_s), inputs): linear between samples."""
        return self.since(self.absolute(t_s))

    def since(self, absolute: Floats) -> Floats:
        """All inputs of the layout since the reference, from running inputs (n, k)."""
        return self.layout.since(absolute, self.reference) if self.layout is not None else absolute

    def absolute(self, t_s: Floats) -> Floats:
        """The running inputs at other times, (len(t_s), k): held at the ends."""
        return between_samples(self.t_s, self.inputs, t_s)


def history_layout(campaigns: Sequence[Campaign]) -> InputLayout | None:
    """The inputs that all campaigns can give: sensors read in each, the speed where each has it. None without sensors.

    A sensor that is not read near the start of a campaign is left out: its filter would have no state to start from.
    """
    first = campaigns[0].temperatures
    starts = np.array([c.temperatures.padded(first.sensor_ids).at(c.temperatures.t_s[:1])[0] for c in campaigns])
    known = np.isfinite(starts).all(axis=0)
    sensors = tuple(name for name, read in zip(first.sensor_ids, known, strict=True) if read)
    if not sensors:
        return None
    with_speed = all(c.duty is not None and SPEED in c.duty.columns for c in campaigns)
    return InputLayout(
        sensors=sensors,
        base_degC=float(np.median(starts[:, known], axis=1).mean()),
        speed_powers=(1, 2) if with_speed else (),
        products=("median", "level") if len(campaigns) >= LEVEL_CAMPAIGNS else ("median",),
    )


def history_track(campaign: Campaign, layout: InputLayout, zero_t_s: Floats) -> HistoryTrack:
    """Run the filters over a campaign; at rest on its first sample or on that of what came before."""
    t_s, inputs = recorded_inputs(layout, *campaign.recording())
    own = t_s >= campaign.temperatures.t_s[0]
    track = HistoryTrack(layout, t_s[own], inputs[own], np.zeros(inputs.shape[1]))
    return replace(track, reference=track.absolute(zero_t_s).mean(axis=0))

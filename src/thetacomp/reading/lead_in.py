"""What the loggers recorded before a campaign began: the rows at negative times, separate from the campaign."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.campaign import Campaign, LeadIn


def with_lead_in(campaign: Campaign) -> Campaign:
    """The campaign with its temperatures and duty before the start in `before`.

    It starts at 0, or earlier where something was measured or the reference lies earlier. The last sample up to the
    start stays with the campaign, so that its first points find temperatures on both sides.
    """
    heat, duty = campaign.temperatures, campaign.duty
    start_s = _start_s(campaign)
    first = int(np.searchsorted(heat.t_s, start_s, side="right")) - 1
    if first < 1 or heat.t_s[-1] <= start_s:
        return campaign
    earlier, own = heat.take(slice(None, first)), heat.take(slice(first, None))
    if duty is None:
        return replace(campaign, temperatures=own, before=LeadIn(earlier))
    # An entry holds until the next one: the campaign begins with the one that is in force.
    row = max(int(np.searchsorted(duty.t_s, own.t_s[0], side="right")) - 1, 0)
    before = LeadIn(earlier, duty.take(slice(None, row)) if row else None)
    return replace(campaign, temperatures=own, duty=duty.take(slice(row, None)), before=before)


def _start_s(campaign: Campaign) -> float:
    tables = (campaign.sweeps, campaign.drift, campaign.parameters)
    measured: list[Floats] = [table.t_s for table in tables if table is not None]
    first = [float(t_s.min()) for t_s in measured if len(t_s)]
    return min([0.0, campaign.settings.reference_s or 0.0, *first])

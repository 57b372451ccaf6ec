"""Screening of a machine folder before anything is fitted: which temperatures and labels can be used.

A campaign is judged by what the others teach, and a campaign that is only tested teaches nobody. Where a fault is
found, the repaired temperatures go on into the analysis; a sensor that cannot be repaired is left out of its campaign.
The files on disk are never changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.campaign import Campaign, LeadIn, MachineFolder
from thetacomp.screening.campaign_labels import HeldLabels, labels_note, without_held_labels
from thetacomp.screening.errors_held_out import check_by_errors
from thetacomp.screening.faults import Finding
from thetacomp.screening.judge import MIN_SAMPLES, Judge
from thetacomp.screening.notes import campaign_notes, join
from thetacomp.screening.record import Record, as_read
from thetacomp.screening.repair import Repaired, repaired

ALONE = (
    f"there is no other training campaign with the same sensors and {MIN_SAMPLES} samples to compare with, so only"
    " steps, missing readings and channels that stand still could be found"
)
CUT_S = 600.0
HOUR_S = 3600.0


@dataclass(frozen=True)
class ScreenedChannel:
    """One sensor of one campaign in which a fault was found, n samples.

    `raw_degC` (n,) as read; `used_degC` (n,) as the analysis uses it; `repaired_degC` (n,) as it would be repaired, NaN
    where it cannot be; `u_K` (n,) the standard deviation of a repaired value, 0 where the reading stands. `left_out`
    says that no value of this campaign is used.
    """

    campaign: str
    sensor: str
    t_s: Floats
    raw_degC: Floats
    repaired_degC: Floats
    used_degC: Floats
    u_K: Floats
    findings: tuple[Finding, ...]
    left_out: bool


@dataclass(frozen=True)
class ScreenedFolder:
    """A machine folder as the analysis uses it, with the evidence.

    `findings` are all faults by campaign, also those of no single sensor; `repair` is False where they were only
    reported. `unscreened` names the campaigns that could not be judged, with the reason.
    """

    folder: MachineFolder
    repair: bool
    findings: tuple[tuple[str, Finding], ...]
    channels: tuple[ScreenedChannel, ...]
    held: tuple[HeldLabels, ...]
    unscreened: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]


def screened(
    folder: MachineFolder, train: Sequence[str], test: Sequence[str] = (), repair: bool = True
) -> ScreenedFolder:
    """Screen the named campaigns and repair them, or only report what was found where `repair` is False.

    Every campaign is judged by the other campaigns of `train`; those of `test` teach nobody. The other campaigns of the
    folder stay as they are. Raises nothing: a campaign that cannot be judged is named.
    """
    names = [*train, *test]
    judge = Judge({s.id: s.role for s in folder.machine.sensors}, tuple(train), check_by_errors(folder.campaigns))
    records, unscreened = {}, []
    for name in names:
        campaign = folder.campaign(name)
        count = len(campaign.temperatures.t_s)
        if count < MIN_SAMPLES:
            unscreened.append((name, f"fewer than {MIN_SAMPLES} samples"))
            continue
        # A fault that began before the campaign continues in it.
        records[name] = as_read(name, campaign.recording()[0], float(campaign.temperatures.t_s[0]))
    records = judge.verdict(records)
    others = {name: judge.others(record, records) for name, record in records.items()}
    results = {name: _Result(record, repaired(record, others[name])) for name, record in records.items()}
    unscreened += [(name, ALONE) for name in records if not others[name]]
    channels = [channel for name, result in results.items() for channel in _channels(name, result, repair)]
    campaigns, held = [], []
    for campaign in folder.campaigns:
        result = results.get(campaign.name)
        if repair and result is not None and result.changes:
            campaign = _repaired(campaign, result)
        if campaign.name in names:
            campaign, frozen = without_held_labels(campaign, repair)
            held += frozen
        campaigns.append(campaign)
    findings = tuple((name, f) for name, r in results.items() for f in r.findings)
    out = replace(folder, campaigns=tuple(campaigns))
    notes = [note for name in results for note in campaign_notes(name, [f for n, f in findings if n == name], repair)]
    notes += [note for name in names for note in _cut_off(folder.campaign(name))]
    notes += [labels_note(entry, repair) for entry in held] + _unscreened_notes(unscreened)
    return ScreenedFolder(out, repair, findings, tuple(channels), tuple(held), tuple(unscreened), tuple(notes))


@dataclass(frozen=True)
class _Result:
    """The verdict on a campaign, and what was made of it."""

    record: Record
    repaired: Repaired

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings that touch the campaign itself, not only what came before it."""
        first_s = self.record.first_s
        return tuple(f for f in self.repaired.findings if f.end_s is None or f.end_s > first_s)

    @property
    def changes(self) -> bool:
        """Whether anything is put right or left out."""
        return any(f.repair != "none" for f in self.findings)

    @property
    def left_out(self) -> tuple[str, ...]:
        """Sensors that cannot be repaired."""
        return tuple(dict.fromkeys(f.sensor for f in self.findings if f.repair == "lost"))


def _repaired(campaign: Campaign, result: _Result) -> Campaign:
    """The campaign with repaired temperatures; a sensor that cannot be repaired has no column any more."""
    table = result.repaired.table
    kept = table.without(result.left_out)
    earlier = table.t_s < result.record.first_s
    before = campaign.before
    if before is not None:
        before = LeadIn(kept.take(earlier), before.duty)
    return replace(campaign, temperatures=kept.take(~earlier), before=before)


def _cut_off(campaign: Campaign) -> list[str]:
    """A log of temperatures that ends before the measurements do, as by a loss of power."""
    table = campaign.temperatures
    tables = (campaign.drift, campaign.sweeps, campaign.parameters)
    last_s = max((float(np.max(t.t_s)) for t in tables if t is not None and len(t.t_s)), default=-np.inf)
    end_s = float(table.t_s[-1])
    if last_s <= end_s + max(3.0 * table.interval_s, CUT_S):
        return []
    return [
        f"campaign {campaign.name}: the temperatures end at {end_s / HOUR_S:.2f} h, the measurements go on to"
        f" {last_s / HOUR_S:.2f} h; what was measured after the end of the log cannot be used"
    ]


def _channels(name: str, result: _Result, repair: bool) -> list[ScreenedChannel]:
    own = result.record.table.t_s >= result.record.first_s
    channels = []
    for j, sensor in enumerate(result.record.table.sensor_ids):
        mine = tuple(f for f in result.findings if sensor in (f.sensor, f.partner) and f.repair != "none")
        if not mine:
            continue
        raw, mended = result.record.table.value_degC[own, j], result.repaired.table.value_degC[own, j]
        used = np.full(len(raw), np.nan) if sensor in result.left_out else mended
        channels.append(
            ScreenedChannel(
                campaign=name,
                sensor=sensor,
                t_s=result.record.table.t_s[own],
                raw_degC=raw,
                repaired_degC=mended,
                used_degC=used if repair else raw,
                u_K=result.repaired.u_K[own, j],
                findings=mine,
                left_out=repair and sensor in result.left_out,
            )
        )
    return channels


def _unscreened_notes(unscreened: Sequence[tuple[str, str]]) -> list[str]:
    """One note a reason."""
    return [
        f"temperatures of campaign {join([n for n, why in unscreened if why == reason])} were not screened for all"
        f" faults: {reason}"
        for reason in dict.fromkeys(why for _, why in unscreened)
    ]

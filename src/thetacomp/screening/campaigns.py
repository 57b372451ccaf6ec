"""Screening of a machine folder before anything is fitted: what every campaign's temperatures and labels are worth.

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
from thetacomp.errors import AnalysisError
from thetacomp.model.temperatures import Temperatures
from thetacomp.screening.campaign_labels import HeldLabels, labels_note, without_held_labels
from thetacomp.screening.faults import Finding
from thetacomp.screening.fit import fit_plain
from thetacomp.screening.model import ScreeningModel
from thetacomp.screening.notes import campaign_notes, join
from thetacomp.screening.screen import Screening, cleaned, screen

MIN_TEACHERS = 2
MIN_SAMPLES = 100


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

    Every campaign is screened by a model of the other campaigns of `train`; those of `test` teach nobody. The other
    campaigns of the folder stay as they are. Raises nothing: a campaign that cannot be screened is named.
    """
    names = [*train, *test]
    # Most campaigns are healthy: only those in which a first look finds a fault are cleaned before they teach.
    first, _ = _screen_all(folder, train, train, ())
    suspects = [name for name, result in first.items() if result.screening.findings]
    known = {name: result for name, result in first.items() if not set(suspects) - {name}}
    results, unscreened = _screen_all(folder, [name for name in names if name not in known], train, suspects)
    results = {name: {**known, **results}[name] for name in names if name in known or name in results}
    channels = [channel for name, result in results.items() for channel in _channels(name, result, repair)]
    campaigns, held = [], []
    for campaign in folder.campaigns:
        result = results.get(campaign.name)
        if repair and result is not None and result.screening.findings:
            campaign = _repaired(campaign, result)
        if campaign.name in names:
            campaign, frozen = without_held_labels(campaign, repair)
            held += frozen
        campaigns.append(campaign)
    findings = tuple((name, f) for name, r in results.items() for f in r.findings)
    out = replace(folder, campaigns=tuple(campaigns))
    notes = [note for name in results for note in campaign_notes(name, [f for n, f in findings if n == name], repair)]
    notes += [labels_note(entry, repair) for entry in held] + _unscreened_notes(unscreened)
    return ScreenedFolder(out, repair, findings, tuple(channels), tuple(held), tuple(unscreened), tuple(notes))


@dataclass(frozen=True)
class _Result:
    """The screened record of a campaign, with what came before it where the recording is unbroken."""

    model: ScreeningModel
    record: Temperatures
    first_s: float
    screening: Screening

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings that touch the campaign itself, not only what came before it."""
        return tuple(f for f in self.screening.findings if f.end_s is None or f.end_s > self.first_s)

    @property
    def left_out(self) -> tuple[str, ...]:
        """Sensors that cannot be repaired."""
        return tuple(dict.fromkeys(f.sensor for f in self.findings if f.repair == "lost"))


def _screen_all(
    folder: MachineFolder, names: Sequence[str], train: Sequence[str], suspects: Sequence[str]
) -> tuple[dict[str, _Result], list[tuple[str, str]]]:
    """The named campaigns, each screened by the others of `train`; and those that cannot be, with the reason."""
    results: dict[str, _Result] = {}
    refused: list[tuple[str, str]] = []
    for name in names:
        campaign = folder.campaign(name)
        try:
            model = fit_plain(_teachers(folder, campaign, train, suspects))
            record, _ = campaign.recording()  # a fault that came before the campaign goes on into it
            results[name] = _Result(model, record, float(campaign.temperatures.t_s[0]), screen(model, record))
        except AnalysisError as exc:
            refused.append((name, str(exc)))
    return results, refused


def _teachers(
    folder: MachineFolder, campaign: Campaign, train: Sequence[str], suspects: Sequence[str]
) -> list[Temperatures]:
    """Tables of the other training campaigns with the same sensors; suspects are cleaned by the healthy ones."""
    ids = campaign.temperatures.sensor_ids
    others = {name: folder.campaign(name).temperatures for name in train if name != campaign.name}
    tables = {
        name: table.select(ids)
        for name, table in others.items()
        if set(ids) <= set(table.sensor_ids) and len(table.t_s) >= MIN_SAMPLES
    }
    if len(tables) < MIN_TEACHERS:
        raise AnalysisError(
            f"screening learns from at least {MIN_TEACHERS} other training campaigns with the same sensors and"
            f" {MIN_SAMPLES} samples each; there {'is' if len(tables) == 1 else 'are'} {len(tables)}"
        )
    healthy = [table for name, table in tables.items() if name not in suspects]
    return [
        _cleaned(table, healthy or [t for other, t in tables.items() if other != name]) if name in suspects else table
        for name, table in tables.items()
    ]


def _cleaned(table: Temperatures, judges: Sequence[Temperatures]) -> Temperatures:
    try:
        return cleaned(table, judges)
    except AnalysisError:
        return table  # one short campaign cannot judge another


def _repaired(campaign: Campaign, result: _Result) -> Campaign:
    """The campaign with repaired temperatures; a sensor that cannot be repaired has no column any more."""
    table = result.screening.repaired
    kept = table.without(result.left_out)
    earlier = table.t_s < result.first_s
    before = campaign.before
    if before is not None:
        before = LeadIn(kept.take(earlier), before.duty)
    return replace(campaign, temperatures=kept.take(~earlier), before=before)


def _channels(name: str, result: _Result, repair: bool) -> list[ScreenedChannel]:
    own = result.record.t_s >= result.first_s
    channels = []
    for j, sensor in enumerate(result.record.sensor_ids):
        mine = tuple(f for f in result.findings if sensor in (f.sensor, f.partner))
        if not mine:
            continue
        raw, repaired = result.record.value_degC[own, j], result.screening.repaired.value_degC[own, j]
        used = np.full(len(raw), np.nan) if sensor in result.left_out else repaired
        channels.append(
            ScreenedChannel(
                campaign=name,
                sensor=sensor,
                t_s=result.record.t_s[own],
                raw_degC=raw,
                repaired_degC=repaired,
                used_degC=used if repair else raw,
                u_K=_uncertainty_K(result, j, mine)[own],
                findings=mine,
                left_out=repair and sensor in result.left_out,
            )
        )
    return channels


def _uncertainty_K(result: _Result, j: int, findings: Sequence[Finding]) -> Floats:
    """Standard deviation of the repaired values of sensor j, (n,): of a rebuilt one it grows with the time since."""
    t_s, ids = result.record.t_s, result.record.sensor_ids
    out = np.zeros(len(t_s))
    for f in findings:
        on = (t_s >= f.start_s) & (t_s < (np.inf if f.end_s is None else f.end_s))
        u_K: Floats | float = f.repair_u_K
        if f.repair == "reconstructed":
            excluded = frozenset(k for k, name in enumerate(ids) if name not in (*f.repaired_from, ids[j]))
            last_u_K = result.model.reconstruction_u_K(j, 0.0, excluded)
            grown = np.interp(t_s[on] - f.start_s, result.model.elapsed_s, result.model.repair_sd_K[:, j])
            u_K = last_u_K * grown / max(float(result.model.repair_sd_K[0, j]), 1e-12)
        if np.isfinite(u_K).all():
            out[on] = np.maximum(out[on], u_K)
    with np.errstate(invalid="ignore"):
        changed = result.screening.repaired.value_degC[:, j] != result.record.value_degC[:, j]
    return np.where(changed, out, 0.0)


def _unscreened_notes(unscreened: Sequence[tuple[str, str]]) -> list[str]:
    """One note a reason."""
    return [
        f"temperatures of campaign {join([n for n, why in unscreened if why == reason])} were not screened for faulty"
        f" channels: {reason}"
        for reason in dict.fromkeys(why for _, why in unscreened)
    ]

"""What screening found, in sentences for the notes of an analysis: which sensor, when, what was seen, what was done."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thetacomp.screening.faults import Finding

HOUR_S = 3600.0


def campaign_notes(campaign: str, findings: Sequence[Finding], repair: bool) -> list[str]:
    """One sentence a fault; several spikes of one sensor share one."""
    notes = []
    for sensor in dict.fromkeys(f.sensor for f in findings):
        mine = [f for f in findings if f.sensor == sensor]
        spikes = [f for f in mine if f.kind == "spike"]
        single = [f for f in mine if f.kind != "spike"] if len(spikes) > 1 else mine
        who = f"campaign {campaign}, sensor {sensor}: " if sensor else f"campaign {campaign}: "
        notes += [who + sentence(f, repair) for f in single]
        if len(spikes) > 1:
            notes.append(who + _spikes(spikes, repair))
    return notes


def sentence(f: Finding, repair: bool) -> str:
    """One finding: what was seen with the evidence, and what was done, with the uncertainty."""
    return f"{_seen(f)} ({_evidence(f)}). {_done(f, repair)}"


def _seen(f: Finding) -> str:
    size = f"{f.size_K:+.2f} K" if np.isfinite(f.size_K) else ""
    what = {
        "jump": f"jump of {size}",
        "spike": f"spike of {size}",
        "drift": f"drift away from the other sensors, {size} at its end",
        "detached": f"contact lost, off by {size} at its end",
        "stuck": "stuck at one reading" + (f", up to {size} off" if size else ""),
        "saturated": "at the limit of its range" + (f", up to {size} off" if size else ""),
        "swapped": f"exchanged with {f.partner}",
        "missing": "no reading",
        "noisy": "noisy: one alarm after the other",
        "unexplained": "more sensors changed at once than faults can explain",
    }[f.kind]
    return f"{what} {_when(f)}"


def _when(f: Finding) -> str:
    begin = f"from {f.start_s / HOUR_S:.2f} h" if f.start_s >= 0.0 else "since before the campaign"
    if f.kind in ("spike", "unexplained"):
        return f"at {f.start_s / HOUR_S:.2f} h"
    return f"{begin} to {f.end_s / HOUR_S:.2f} h" if f.end_s is not None else f"{begin} on"


def _evidence(f: Finding) -> str:
    if f.kind in ("stuck", "saturated", "missing"):
        return f"for {f.statistic / 60.0:.0f} min when it was seen, healthy at most {f.threshold / 60.0:.0f} min"
    if f.window_s == 0.0:
        return f"{f.statistic:.1f} times the usual deviation of a sample, limit {f.threshold:.1f}"
    return (
        f"{f.statistic:.1f} standard deviations over {f.window_s / 60.0:.0f} min, limit {f.threshold:.1f}; seen"
        f" {max(f.detected_s - f.start_s, 0.0) / 60.0:.0f} min after its start"
    )


def _done(f: Finding, repair: bool) -> str:
    if f.repair == "none":
        return "The machine did something that the other campaigns do not show; no temperature was changed"
    u = f"u = {f.repair_u_K:.2g} K, one standard deviation" if np.isfinite(f.repair_u_K) else "u unknown"
    if not repair:
        return "Used as read, because repair is switched off"
    if f.repair == "shifted back":
        return f"Used after subtracting the jump ({u})"
    if f.repair == "swapped back":
        return "The two channels were exchanged back"
    if f.repair == "reconstructed":
        return f"Rebuilt from {len(f.repaired_from)} healthy sensors, anchored just before the fault ({u} at its end)"
    return (
        "It cannot be rebuilt well enough, so no reading of it in this campaign is used: where this campaign trains,"
        " the choice of inputs sees a sensor without reading, and where it is held out, a model without it is used"
    )


def _spikes(spikes: Sequence[Finding], repair: bool) -> str:
    worst = max(spikes, key=lambda f: abs(f.size_K))
    times = join([f"{f.start_s / HOUR_S:.2f} h" for f in spikes[:4]]) if len(spikes) <= 4 else "over its whole length"
    done = "Rebuilt from healthy sensors" if repair else "Used as read, because repair is switched off"
    return f"{len(spikes)} spikes at {times}, the largest {worst.size_K:+.2f} K ({_evidence(worst)}). {done}"


def join(names: Sequence[str]) -> str:
    """Names as a list in a sentence."""
    return ", ".join(names)

"""What screening found, in sentences for the notes of an analysis: which sensor, when, what was seen, what was done."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thetacomp.screening.faults import Finding

HOUR_S = 3600.0
SHOWN = 4


def campaign_notes(campaign: str, findings: Sequence[Finding], repair: bool) -> list[str]:
    """One sentence a fault; several of one kind that were only told, or several gaps of one sensor, share one."""
    notes = []
    for sensor, kind in dict.fromkeys((f.sensor, f.kind) for f in findings):
        mine = [f for f in findings if (f.sensor, f.kind) == (sensor, kind)]
        who = f"campaign {campaign}, sensor {sensor}: "
        if len(mine) > 1 and kind in ("missing", "unexplained"):
            notes.append(who + _several(mine, repair))
        else:
            notes += [who + sentence(f, repair) for f in mine]
    return notes


def sentence(f: Finding, repair: bool) -> str:
    """One finding: what was seen with the evidence, and what was done, with the uncertainty."""
    return f"{_seen(f)} {_when(f)} ({_evidence(f)}). {_done(f, repair)}"


def _seen(f: Finding) -> str:
    size = f"{f.size_K:+.2f} K" if np.isfinite(f.size_K) else ""
    return {
        "jump": f"jump of {size}",
        "offset": f"off by {size} at rest",
        "drift": f"drift away from the other sensors, {size} at its end",
        "stuck": "stuck at one reading" + (f", up to {size} off" if size else ""),
        "swapped": f"exchanged with {f.partner}",
        "missing": "no reading",
        "noisy": "noisy",
        "unexplained": f"departs by {size}",
    }[f.kind]


def _when(f: Finding) -> str:
    begin = f"from {f.start_s / HOUR_S:.2f} h" if f.start_s >= 0.0 else "since before the campaign"
    if f.kind == "unexplained":
        return f"at {f.start_s / HOUR_S:.2f} h"
    return f"{begin} to {f.end_s / HOUR_S:.2f} h" if f.end_s is not None else f"{begin} on"


def _evidence(f: Finding) -> str:
    if f.kind in ("stuck", "missing"):
        return f"for {f.statistic / 60.0:.0f} min, healthy at most {f.threshold / 60.0:.0f} min"
    if f.kind == "swapped":
        return f"exchanged back, the misfit falls {f.statistic:.1f} times, limit {f.threshold:.1f}"
    usual = {
        "jump": "sharper than any sensor of its kind changes, limit",
        "offset": "against its other campaigns and the machine at rest, limit",
        "drift": "while the machine cools too, limit",
        "noisy": "times the usual scatter, limit",
    }.get(f.kind, "limit")
    return f"{f.statistic:.2g} K: {usual} {f.threshold:.2g} K"


def _done(f: Finding, repair: bool) -> str:
    if f.repair == "none":
        return "A machine can do that, so no temperature was changed"
    u = f"u = {f.repair_u_K:.2g} K, one standard deviation" if np.isfinite(f.repair_u_K) else "u unknown"
    if not repair:
        return "Used as read, because repair is switched off"
    if f.repair == "shifted back":
        return f"Used after subtracting the {f.kind} ({u})"
    if f.repair == "swapped back":
        return "The two channels were exchanged back"
    if f.repair == "reconstructed":
        return f"Rebuilt from {len(f.repaired_from)} healthy sensors, anchored just before the fault ({u} at its end)"
    return (
        "It cannot be rebuilt well enough, so no reading of it in this campaign is used: where this campaign trains,"
        " the choice of inputs sees a sensor without reading, and where it is held out, a model without it is used"
    )


def _several(found: Sequence[Finding], repair: bool) -> str:
    times = join([f"{f.start_s / HOUR_S:.2f} h" for f in found[:SHOWN]])
    more = f" and {len(found) - SHOWN} times more" if len(found) > SHOWN else ""
    worst = max(found, key=lambda f: f.statistic)
    return f"{len(found)} times {_seen(worst)}, at {times}{more} ({_evidence(worst)}). {_done(worst, repair)}"


def join(names: Sequence[str]) -> str:
    """Names as a list in a sentence."""
    return ", ".join(names)

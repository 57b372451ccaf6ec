"""Does it help? Components and stretches of the travel in which a model adds error to what it has not seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.validation.acceptance import MAX_HARM_SHARE
from thetacomp.validation.outcome import DEFAULT, KEY_POINTS, NOTHING
from thetacomp.validation.validate import Residuals

PARTS = 3


@dataclass(frozen=True)
class Harm:
    """RMS in µm without and with a model, over the held-out points of a component from `low_mm` to `high_mm`."""

    component: str
    model: str
    low_mm: float
    high_mm: float
    before_um: float
    after_um: float


def harmed(residuals: Sequence[Residuals]) -> tuple[Harm, ...]:
    """Thirds of the travel in which a model adds RMS error, neighbours as one; drift has one place.

    As in the acceptance a loss below a twentieth of the largest uncompensated RMS of the machine is noise.
    """
    largest = max((_rms(r.before_um) for r in residuals if r.model == NOTHING), default=0.0)
    out: list[Harm] = []
    for one in residuals:
        if one.model in (DEFAULT, KEY_POINTS) and len(one.after_um):
            out += _harmed_parts(one, MAX_HARM_SHARE * largest)
    return tuple(out)


def harm_notes(residuals: Sequence[Residuals]) -> list[str]:
    """One sentence for every component and stretch in which a model does harm."""
    names = {DEFAULT: "the model", KEY_POINTS: "the law on key points"}
    return [
        f"{harm.component}{_place(harm)}: {names[harm.model]} does harm: held out it leaves {harm.after_um:.1f} µm RMS,"
        f" no compensation {harm.before_um:.1f} µm"
        for harm in harmed(residuals)
    ]


def _harmed_parts(one: Residuals, least_um: float) -> list[Harm]:
    edges = np.linspace(one.position_mm.min(), one.position_mm.max(), PARTS + 1)
    part = np.clip(np.searchsorted(edges, one.position_mm, side="right") - 1, 0, PARTS - 1)
    # Where all points share one position, all lie in the last part.
    worse = [_adds(one, part == k, least_um) for k in range(PARTS)]
    out, first = [], 0
    while first < PARTS:
        end = first
        while end < PARTS and worse[end]:
            end += 1
        if end > first:
            rows = (part >= first) & (part < end)
            figures = _rms(one.before_um[rows]), _rms(one.after_um[rows])
            out.append(Harm(one.component, one.model, float(edges[first]), float(edges[end]), *figures))
        first = end + 1
    return out


def _adds(one: Residuals, rows: np.ndarray, least_um: float) -> bool:
    return bool(rows.any()) and _rms(one.after_um[rows]) > _rms(one.before_um[rows]) + least_um


def _place(harm: Harm) -> str:
    return f" from {harm.low_mm:.0f} to {harm.high_mm:.0f} mm" if harm.high_mm > harm.low_mm else ""


def _rms(value_um: Floats) -> float:
    return float(np.sqrt(np.mean(value_um**2))) if len(value_um) else 0.0

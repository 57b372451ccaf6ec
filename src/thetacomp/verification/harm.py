"""Does no harm, by position: where and when the residual is larger than the uncompensated error at the same heat."""

from __future__ import annotations

import numpy as np

from thetacomp.verification.outcome import HarmMap
from thetacomp.verification.runs import RunPoints

MOST_POSITIONS = 40


def harm_map(component: str, off: RunPoints, on: RunPoints, limit_um: float) -> HarmMap | None:
    """Harm of one component in every sweep and position of the run with compensation on, approaches averaged.

    The uncompensated error at the same heat is the expected one, times what the run with compensation off shows of it.
    None where no error can be expected from the temperatures.
    """
    if not (off.explained and on.explained):
        return None
    gain = float(off.expected_um @ off.value_um) / float(off.expected_um @ off.expected_um)
    lever, column = np.unique(np.round(on.lever_m, 3), return_inverse=True)
    if len(lever) > MOST_POSITIONS:
        edges = np.linspace(lever[0], lever[-1], MOST_POSITIONS + 1)
        column = np.clip(np.searchsorted(edges, on.lever_m, side="right") - 1, 0, MOST_POSITIONS - 1)
        lever = 0.5 * (edges[1:] + edges[:-1])
    shape = (len(on.t_s), len(lever))
    cell = on.state * shape[1] + column
    count = np.bincount(cell, minlength=shape[0] * shape[1]).astype(float)
    count[count == 0] = np.nan
    residual, expected = (
        (np.bincount(cell, weights=value, minlength=len(count)) / count).reshape(shape)
        for value in (on.value_um, gain * on.expected_um)
    )
    harm = np.abs(residual) - np.abs(expected)
    k, j = np.unravel_index(int(np.nanargmax(harm)), shape)
    position_mm = on.p0_mm + 1000.0 * lever
    return HarmMap(
        component=component,
        t_s=on.t_s,
        position_mm=position_mm,
        harm_um=harm,
        limit_um=limit_um,
        largest_um=float(harm[k, j]),
        largest_at_s=float(on.t_s[k]),
        largest_at_mm=float(position_mm[j]),
    )

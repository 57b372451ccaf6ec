"""Does a repair help? The errors that were measured in a campaign, predicted by what the other campaigns teach."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from thetacomp.arrays import Bools, Floats
from thetacomp.campaign import Campaign, Drift
from thetacomp.screening.judge import Check
from thetacomp.screening.others import WEIGHT_K
from thetacomp.screening.record import Record
from thetacomp.screening.whole import Mended

WORSE = 1.1


def check_by_errors(campaigns: Sequence[Campaign]) -> Check:
    """The check by the drift that the campaigns measured; without any, every repair that has its evidence stands."""
    measured = {c.name: c.drift for c in campaigns if c.drift is not None}

    def no_worse(mended: Mended, others: Sequence[Record]) -> bool:
        taught = [o for o in others if o.name in measured]
        if mended.before.name not in measured or not taught:
            return True
        before, after = (_missed_um(r, taught, measured) for r in (mended.before, mended.after))
        return bool(np.nansum(after) <= WORSE**2 * np.nansum(before))

    return no_worse


def _missed_um(record: Record, taught: Sequence[Record], measured: Mapping[str, Drift]) -> Floats:
    """Mean squares (3,) of what the campaigns `taught` leave of the drift of another one."""
    used: Bools = np.all([r.course.read for r in (record, *taught)], axis=0)
    rows = [_rows(r, measured[r.name], used) for r in (record, *taught)]
    out = np.full(3, np.nan)
    for d in range(3):
        known = [np.isfinite(y[:, d]) for _, y in rows]
        if not known[0].any() or not any(k.any() for k in known[1:]):
            continue
        x = np.vstack([a[k] for (a, _), k in zip(rows[1:], known[1:], strict=True)])
        y = np.concatenate([b[k, d] for (_, b), k in zip(rows[1:], known[1:], strict=True)])
        w = np.linalg.solve(x.T @ x + WEIGHT_K**2 * len(x) * np.eye(x.shape[1]), x.T @ y)
        out[d] = np.mean((rows[0][1][known[0], d] - rows[0][0][known[0]] @ w) ** 2)
    return out


def _rows(record: Record, drift: Drift, used: Bools) -> tuple[Floats, Floats]:
    """Inputs (n, q) and errors (n, 3), both from the first measured one on."""
    inputs = record.course.inputs_K[:, np.concatenate([used, used])]
    at = np.column_stack([np.interp(drift.t_s, record.course.t_s, column) for column in inputs.T])
    return at - at[0], drift.error_um - drift.error_um[0]

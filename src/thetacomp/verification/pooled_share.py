"""The applied share of several components together: what each alone leaves open, all of them may decide.

With a law from two campaigns the share of one component is known to some tenths only, and from so few independent
sweeps that its interval holds every case. But a wrong sign turns all components, or those of one direction or one axis:
their shares are averaged, weighted by their variances, and their degrees of freedom add up. What a law is wrong by has
another sign in every component, so most of it averages out; where the shares scatter by more than their standard
deviations say, the interval of the mean is widened by it (Birge's ratio).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import special

from thetacomp.verification.applied_share import ALL, MARGIN, SPECIAL, named_share
from thetacomp.verification.outcome import PooledShare, Share, ShareKind

COVERAGE = 0.95
# In standard deviations: a component further from the mean is not of its group, and the group decides nothing.
FURTHEST = 3.0
# What only the size of the correction says is not told from a mean: all components may share the law's own miss.
DECIDED: tuple[ShareKind, ...] = ("reversed", "not active", "applied", "doubled")


def with_pooled(shares: Sequence[Share]) -> tuple[tuple[Share, ...], tuple[PooledShare, ...]]:
    """The shares, those that are unclear named by what they are together with others, and the groups that say so.

    Groups are all components, else those of one direction and those of one axis.
    """
    judged = [
        share for share in shares if share.part == ALL and share.material and np.isfinite([share.low, share.sd]).all()
    ]
    whole = _pooled(judged)
    groups = [whole] if whole is not None else _parts(judged)
    # Two groups never name a component differently: it lies near one case only.
    named = {name: group.kind for group in groups for name in group.named}
    told = tuple(replace(s, kind=named.get(s.component, s.kind)) if s.part == ALL else s for s in shares)
    return told, tuple(groups)


def _parts(judged: Sequence[Share]) -> list[PooledShare]:
    keys = [share.component[1] for share in judged], [share.component[2:] for share in judged]
    groups = [[s for s, own in zip(judged, key, strict=True) if own == k] for key in keys for k in dict.fromkeys(key)]
    return [pooled for pooled in map(_pooled, groups) if pooled is not None]


def _pooled(group: Sequence[Share]) -> PooledShare | None:
    """The share of a group; None where it decides nothing that its components do not say themselves."""
    unclear = [share for share in group if share.kind == "unclear"]
    if len(group) < 2 or not unclear:
        return None
    value, half = _mean(group)
    kind = _named(value, value - half, value + half)
    mixed = {share.kind for share in group} & (set(DECIDED) - {kind})
    strange = any(abs(share.value - value) > FURTHEST * np.hypot(share.sd, MARGIN) for share in group)
    if kind not in DECIDED or mixed or strange:
        return None
    centre = next(centre for centre, name in SPECIAL if name == kind)
    near = tuple(share.component for share in unclear if _nearest(share.value) == centre)
    return PooledShare(tuple(s.component for s in group), value, value - half, value + half, kind, near)


def _mean(group: Sequence[Share]) -> tuple[float, float]:
    """Weighted mean of the shares, and half of its 95 % interval."""
    values = np.array([share.value for share in group])
    weight = 1.0 / (np.array([share.sd for share in group]) ** 2 + MARGIN**2)
    value = float(weight @ values / weight.sum())
    scatter = float(weight @ (values - value) ** 2) / (len(group) - 1)
    sd = float(np.sqrt(max(scatter, 1.0) / weight.sum()))
    quantile = float(special.stdtrit(sum(share.freedom for share in group), 0.5 + COVERAGE / 2))
    # What the law is wrong by in the same way in all components does not average out.
    return value, float(np.hypot(quantile * sd, special.ndtri(0.5 + COVERAGE / 2) * MARGIN))


def _named(value: float, low: float, high: float) -> ShareKind:
    # Surely negative is a wrong sign, whatever its size: a weak law makes -1 look like -1.6.
    return "reversed" if high < -MARGIN else named_share(value, low, high)


def _nearest(value: float) -> float:
    return min((centre for centre, _ in SPECIAL), key=lambda centre: abs(value - centre))

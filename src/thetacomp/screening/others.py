"""What the other sensors of a machine say about one of them, learnt from other campaigns."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.screening.grid import Course

WEIGHT_K = 0.15  # what a weight of one may cost: about the errors of readings and of their calibration


@dataclass(frozen=True)
class Teachers:
    """Slow courses of other campaigns with the same sensors, as sums of products (2p, 2p) a campaign."""

    courses: tuple[Course, ...]
    products: Floats
    rows: Floats

    def weights(self, j: int, excluded: Collection[int] = (), without: Collection[int] = ()) -> Floats:
        """Weights (2p,) that predict the rise of sensor j from the others but `excluded`, learnt from all campaigns but
        those numbered in `without`."""
        p = len(self.courses[0].read)
        taken = [c for c in range(len(self.courses)) if c not in without and self.courses[c].read[j]]
        out = np.zeros(2 * p)
        if not taken:
            return out
        read = np.all([self.courses[c].read for c in taken], axis=0)
        used = np.array([k for k in np.flatnonzero(read) if k != j and k not in excluded], int)
        if not len(used):
            return out
        used = np.concatenate([used, used + p])
        total = self.products[taken].sum(axis=0)
        penalty = WEIGHT_K**2 * self.rows[taken].sum() * np.eye(len(used))
        out[used] = np.linalg.solve(total[np.ix_(used, used)] + penalty, total[used, j])
        return out

    def usual_K(self, j: int, excluded: Collection[int] = ()) -> float:
        """The largest root mean square (K) of what a campaign left out of the others misses sensor j by.

        One campaign alone says little of the next: a quarter of what the sensor moves there, at least.
        """
        missed = self._missed_K(j, excluded)
        rms = [float(np.sqrt(np.mean(off_K**2))) for _, off_K in missed]
        if len(missed) == 1:
            return max(2.0 * rms[0], 0.25 * float(np.abs(missed[0][0].rise_K[:, j]).max()))
        return max(rms, default=np.inf)

    def rebuilt_u_K(self, j: int, excluded: Collection[int], elapsed_s: Floats) -> Floats:
        """Standard deviation of a value of sensor j rebuilt `elapsed_s` (n,) after its last reading."""
        missed = self._missed_K(j, excluded)
        if not missed:
            return np.full(len(elapsed_s), np.inf)
        longest = max(len(off_K) for _, off_K in missed) - 1
        steps = sorted({int(k) for k in np.geomspace(1, max(longest, 1), 12)})
        step_s = float(np.median([c.t_s[1] - c.t_s[0] for c, _ in missed]))
        u_K = [
            float(np.sqrt(np.mean(np.concatenate([off_K[k:] - off_K[:-k] for _, off_K in missed]) ** 2))) for k in steps
        ]
        known = np.maximum.accumulate(u_K) * (2.0 if len(missed) == 1 else 1.0)
        return np.asarray(np.interp(elapsed_s, step_s * np.array(steps), known))

    def moves_K(self, j: int) -> float:
        """How far sensor j moves in the campaigns: root mean square of its rise."""
        squares = [np.mean(c.rise_K[:, j] ** 2) for c in self.courses if c.read[j]]
        return float(np.sqrt(np.mean(squares))) if squares else 0.0

    def _missed_K(self, j: int, excluded: Collection[int]) -> list[tuple[Course, Floats]]:
        """What each campaign, left out of the others, misses sensor j by."""
        own = [c for c in range(len(self.courses)) if self.courses[c].read[j]]
        out = []
        for c in own:
            weights = self.weights(j, excluded, (c,) if len(own) > 1 else ())
            out.append((self.courses[c], self.courses[c].rise_K[:, j] - self.courses[c].inputs_K @ weights))
        return out


def teachers(courses: Sequence[Course]) -> Teachers:
    """What these campaigns teach."""
    products = np.array([c.inputs_K.T @ c.inputs_K for c in courses])
    return Teachers(tuple(courses), products, np.array([float(len(c.t_s)) for c in courses]))

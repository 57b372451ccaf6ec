"""What a column of readings shows of the instrument behind it: its resolution. Numpy only."""

from __future__ import annotations

import numpy as np

from thetacomp.arrays import Floats

FEWEST_CHANGES = 6  # fewer changes have a common divisor by chance
NANO = 1000.0  # readings count in thousandths of their unit


def resolution(value: Floats) -> float:
    """Division of the instrument in the unit of the readings (n,): all changes are whole multiples of it.

    0 where readings are finer than a thousandth of the unit, or change too seldom to tell. Missing ones are skipped.
    """
    digits = np.rint(NANO * value[np.isfinite(value)])
    changes = np.abs(np.diff(digits)).astype(np.int64)
    changes = changes[changes > 0]
    return float(np.gcd.reduce(changes)) / NANO if len(changes) >= FEWEST_CHANGES else 0.0

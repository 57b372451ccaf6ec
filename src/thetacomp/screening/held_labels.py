"""Displacements that stand still while the machine stands: the probe was not read, and the label is no measurement."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thetacomp.arrays import Floats
from thetacomp.errors import AnalysisError

SHORTEST_S = 300.0
FEWEST_EQUAL = 5
EQUAL_UM = 1e-9


def find_held_labels(
    label_um: Floats, t_s: Floats, duty: Floats, *, shortest_s: float = SHORTEST_S, resolution_um: float = 0.0
) -> NDArray[np.bool_]:
    """True (n, labels) where a displacement is frozen while the machine stands.

    `label_um` is (n,) or (n, labels), `t_s` (n,), `duty` (n,) the spindle speed or feed, 0 where the machine stands. A
    run counts from its second sample on, since the first one was measured, if it holds at least five samples within
    half of `resolution_um` of its first, lasts `shortest_s`, and the machine stands at all of them; a run that spreads
    into motion is marked where the machine stands. Missing labels are not marked. With a coarse probe give its
    resolution only where the noise moves the reading by more than one digit; otherwise a quiet hour would be marked.
    """
    labels = label_um[:, None] if label_um.ndim == 1 else label_um
    if len(labels) != len(t_s) or len(duty) != len(t_s):
        raise AnalysisError(
            f"labels, times and duty must be of one length: {len(labels)}, {len(t_s)} and {len(duty)} were given"
        )
    standing = np.asarray(duty) == 0
    held = np.zeros(labels.shape, bool)
    for j in range(labels.shape[1]):
        for begin, end in _runs(labels[:, j], max(resolution_um / 2.0, EQUAL_UM)):
            still = standing[begin:end]
            if not still.any():
                continue
            first = begin + int(np.argmax(still))
            last = end - 1 - int(np.argmax(still[::-1]))
            if still.sum() >= FEWEST_EQUAL and t_s[last] - t_s[first] >= shortest_s:
                marked = np.flatnonzero(still) + begin
                held[marked[marked > begin], j] = True
    return held[:, 0] if label_um.ndim == 1 else held


def _runs(x: Floats, tolerance: float) -> list[tuple[int, int]]:
    """Runs [begin, end) in which every value stays within the tolerance of the first; missing values end a run."""
    runs, begin = [], 0
    for i in range(1, len(x) + 1):
        if i == len(x) or not abs(x[i] - x[begin]) <= tolerance:
            if i - begin > 1:
                runs.append((begin, i))
            begin = i
    return runs

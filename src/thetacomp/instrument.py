"""What a column of readings shows of the instrument behind it: its resolution, where it hung, where it jumped."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thetacomp.arrays import Bools, Floats, Ints

FEWEST_CHANGES = 6  # fewer changes have a common divisor by chance
MICRO = 1e6  # readings count in millionths of their unit: 0.0625 °C is a division too
EQUAL = 1e-9

SHORTEST_S = 300.0
FEWEST_EQUAL = 5
MUCH_LONGER, LONGER = 10.0, 3.0  # than the runs that fill half of the record; the less where the reading jumps after it
CHANCE = 1e-3  # expected number of such runs in a record, were the readings to repeat as they do when alive
FEWEST_ALIVE = 20
COARSE = 3.0  # divisions: an instrument whose usual step is shorter shows its resolution, not its scatter
TURNS_BACK = 0.25  # scatter turns back at two steps of three, motion hardly ever
CATCHES_UP = 4.0

KEPT = 3
JUMP_SCATTER = 8.0
LEAST_JUMP = 20.0  # µm or µrad


def resolution(value: Floats) -> float:
    """Division of the instrument in the unit of the readings (n,): all changes are whole multiples of it.

    0 where readings are finer than a millionth of the unit, or change too seldom to tell. Missing ones are skipped.
    """
    digits = np.rint(MICRO * value[np.isfinite(value)])
    changes = np.abs(np.diff(digits)).astype(np.int64)
    changes = changes[changes > 0]
    return float(np.gcd.reduce(changes)) / MICRO if len(changes) >= FEWEST_CHANGES else 0.0


def frozen(t_s: Floats, value: Floats) -> Bools:
    """Readings (n,) that an instrument repeated instead of measuring, from the second of each run on.

    A run of equal readings is frozen if it lasts five minutes and longer than the instrument's runs otherwise. Of an
    instrument that scatters it must last much longer, and longer than chance makes of readings that repeat as often as
    its others do. One that shows only its resolution, or a table without scatter, may really stand still: there the
    reading behind the run must jump, as what happened meanwhile is caught up. A missing reading ends a run.
    """
    out = np.zeros(len(value), dtype=bool)
    begins, ends = _equal_runs(value)
    step_s = float(np.median(np.diff(t_s))) if len(t_s) > 1 else 0.0
    lasting_s = t_s[ends - 1] - t_s[begins]
    usual_s = _usual_s(lasting_s + step_s)
    long = (ends - begins >= FEWEST_EQUAL) & (lasting_s >= max(SHORTEST_S, LONGER * usual_s))
    if not long.any():
        return out
    runs = list(zip(begins[long], ends[long], lasting_s[long] / max(usual_s, EQUAL), strict=True))
    alive = np.ones(len(value), dtype=bool)
    for begin, end, _ in runs:
        alive[begin + 1 : end] = False
    scatters, known = _scatters(value[alive]), np.isfinite(np.diff(value)) & alive[1:]
    for begin, end, times in runs:
        if scatters:
            hung = times >= MUCH_LONGER and unlikely(end - begin, repeats(value), known)
        else:
            hung = _catches_up(value, int(end), value[alive])
        out[begin + 1 : end] = hung
    return out


def repeats(value: Floats) -> Bools:
    """Where a reading equals the one before, (n - 1,)."""
    return np.abs(np.diff(value)) <= EQUAL


def unlikely(length: int, repeated: Bools, known: Bools) -> bool:
    """True if chance makes no run of `length` equal readings where those `repeated` of the pairs `known` are equal."""
    pairs = int(known.sum())
    share = (int((repeated & known).sum()) + 1) / (pairs + 2)
    return pairs >= FEWEST_ALIVE and len(known) * share ** (length - 1) <= CHANCE


def _equal_runs(value: Floats) -> tuple[Ints, Ints]:
    """Begin and end of every run of equal readings, single ones too."""
    new = np.concatenate([[True], ~repeats(value)]) if len(value) else np.zeros(0, dtype=bool)
    begins = np.flatnonzero(new)
    ends = np.append(begins[1:], len(value)) if len(begins) else begins
    known = np.isfinite(value[begins])
    return begins[known], ends[known]


def _usual_s(lasting_s: Floats) -> float:
    """Length of run that fills half of the record: those up to it take half of its time."""
    order = np.sort(lasting_s)
    filled = np.cumsum(order)
    return float(order[np.searchsorted(filled, filled[-1] / 2.0)]) if len(order) else 0.0


def _scatters(alive: Floats) -> bool:
    """True if steps between readings turn back often and are larger than the division."""
    steps = np.diff(alive[np.isfinite(alive)])
    steps = steps[np.abs(steps) > EQUAL]
    if len(steps) < FEWEST_ALIVE:
        return False
    turning = float(np.mean(steps[1:] * steps[:-1] < 0.0))
    return turning > TURNS_BACK and float(np.median(np.abs(steps))) >= COARSE * resolution(alive)


def _catches_up(value: Floats, end: int, alive: Floats) -> bool:
    """True if the reading at `end` lies further from the run before it than steps do, there and elsewhere."""
    behind = value[end : end + 2]
    if len(behind) < 2 or not np.isfinite(behind).all():
        return False
    steps = np.abs(np.diff(alive[np.isfinite(alive)]))
    steps = steps[steps > EQUAL]
    usual = float(np.median(steps)) if len(steps) else 0.0
    least = max(COARSE * resolution(alive), CATCHES_UP * usual, CATCHES_UP * abs(float(behind[1] - behind[0])), EQUAL)
    return abs(float(behind[0] - value[end - 1])) > least


def step_scatter(runs: Sequence[Floats]) -> float:
    """Robust standard deviation of the step from one reading to the next, over several runs of readings."""
    steps = np.concatenate([np.zeros(0), *(np.diff(run[np.isfinite(run)]) for run in runs)])
    return 1.4826 * float(np.median(np.abs(steps))) if len(steps) else 0.0


def jump_that_stays(value: Floats, scatter: float) -> tuple[int, float] | None:
    """Where the readings of one run (n,) jump and stay, and by how much; None where they do not.

    `value` is what is left of the readings after all that runs have in common, `scatter` that of a step in the same
    unit. Three readings on either side must agree with the jump, so a single stray reading is none.
    """
    known = np.flatnonzero(np.isfinite(value))
    kept = value[known]
    if len(kept) < 2 * KEPT:
        return None
    steps = np.diff(kept)[KEPT - 1 : len(kept) - KEPT]
    i = int(np.argmax(np.abs(steps))) + KEPT
    size = float(np.median(kept[i : i + KEPT]) - np.median(kept[i - KEPT : i]))
    step = float(kept[i] - kept[i - 1])
    large = min(abs(size), abs(step)) > max(JUMP_SCATTER * scatter, LEAST_JUMP)
    return (int(known[i]), size) if large and abs(size - step) < 0.5 * abs(step) else None

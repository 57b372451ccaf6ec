"""Steps that stay: changes within a sample or two that no time constant nearby can give."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.model.temperatures import Temperatures
from thetacomp.screening.grid import BLOCK_S, block_means

LONG_SIDE = 10
SIDE = 5  # blocks of the straight line on each side of a step
ISOLATED = 3.0  # times the changes around it: a first-order response sampled faster than its time constant has not
BENT = 3.0  # times the change of slope over one side
NOISE = 10.0  # robust standard deviations
SMALLEST_K = 1.5
SMALLEST_EXCHANGE_K = 0.3
SCATTER_BLOCKS = 30
SCATTER_K = 0.5  # a smaller scatter averages out
RESTLESS = 3.0  # times the largest scatter that is usual elsewhere
OWN = 1.7  # times the sharpest change that the sensor, or one of its kind, ever had elsewhere
TOGETHER = 0.25  # another sensor that steps by this share at the same time: the machine did it
EXCHANGED = 3.0  # times nearer to the level of the other sensor than to its own
STAY_S = 3600.0
RELAX_S = (300.0, 600.0, 1200.0, 2400.0)


@dataclass(frozen=True)
class Sharp:
    """How sharply each sensor of a table changes in each block: `step_K` (n, p) the step between straight lines through
    both sides, 0 where it is not isolated; `noise_K` (p,) its standard deviation; blocks `x` (n, p) at `t_s` (n,).
    """

    t_s: Floats
    x: Floats
    step_K: Floats
    noise_K: Floats

    @property
    def step_s(self) -> float:
        """Length of a block."""
        return float(self.t_s[1] - self.t_s[0]) if len(self.t_s) > 1 else BLOCK_S

    @property
    def sharpest_K(self) -> Floats:
        """The largest isolated step of each sensor (p,)."""
        return np.asarray(np.max(np.abs(self.step_K), axis=0, initial=0.0))


def sharp(table: Temperatures) -> Sharp:
    """Isolated steps of a table without implausible readings."""
    step_s = max(BLOCK_S, table.interval_s)
    x = block_means(table.t_s, table.value_degC, step_s)
    t_s = table.t_s[0] + step_s * (np.arange(len(x)) + 0.5)
    n, p = x.shape
    step_K, noise_K = np.zeros((n, p)), np.zeros(p)
    if n > 2 * SIDE:
        window = np.lib.stride_tricks.sliding_window_view(x, 2 * SIDE + 1, axis=0)
        step_K[SIDE : n - SIDE], lines_K = isolated(window)
        read = np.isfinite(lines_K).any(axis=0)
        noise_K[read] = np.nanmedian(np.abs(lines_K[:, read]), axis=0) / 0.6745
    return Sharp(t_s, x, step_K, noise_K)


def isolated(window: Floats) -> tuple[Floats, Floats]:
    """The step in the middle of windows (..., 2 SIDE + 1) of blocks, 0 where it is not isolated; and the step between
    the straight lines through both sides, whatever is around it.
    """
    at = np.arange(SIDE) - (SIDE - 1) / 2.0
    # A straight line through SIDE points, carried on by one block: weights of the points on its left.
    line = 1.0 / SIDE + at * (SIDE + 1) / 2.0 / np.sum(at**2)
    lines = window[..., SIDE + 1 :] @ line[::-1] - window[..., :SIDE] @ line
    across = window[..., SIDE + 1] - window[..., SIDE - 1]
    # A kink carries a line beyond what was read: the step is the smaller of the two, where they agree in sign.
    found = np.where(lines * across > 0.0, np.sign(across) * np.minimum(np.abs(lines), np.abs(across)), 0.0)
    change = np.abs(np.diff(window, axis=-1))
    around = np.maximum(change[..., : SIDE - 1].max(axis=-1), change[..., SIDE + 1 :].max(axis=-1))
    # A response that is not over yet goes on in the next blocks; a step leaves the slope as it was.
    bent = np.abs(window[..., -1] - window[..., SIDE + 1] - window[..., SIDE - 1] + window[..., 0])
    alone = (np.abs(found) > ISOLATED * around) & (np.abs(found) > BENT * bent)
    return np.nan_to_num(np.where(alone, found, 0.0)), lines


def scatter_K(x: Floats) -> Floats:
    """How restless blocks x (n, p) are: the median size of their second differences over SCATTER_BLOCKS, (m, p)."""
    bend = np.abs(np.diff(x, n=2, axis=0))
    if len(bend) < SCATTER_BLOCKS:
        return np.zeros((0, x.shape[1]))
    window = np.lib.stride_tricks.sliding_window_view(np.nan_to_num(bend), SCATTER_BLOCKS, axis=0)
    return np.asarray(np.median(window, axis=-1))


@dataclass(frozen=True)
class Step:
    """A step of sensor j at `t_s`, with the other sensors that step at the same time."""

    j: int
    t_s: float
    size_K: float
    limit_K: float
    others: tuple[int, ...]
    stays: bool

    @property
    def is_fault(self) -> bool:
        """Whether no machine does this: one sensor alone, and for good."""
        return self.stays and not self.others


def usual_scatter_K(others: Sequence[Sharp]) -> Floats:
    """The largest scatter (p,) of each sensor in the usual other campaign: the lower median over the campaigns."""
    largest = np.sort([np.max(scatter_K(s.x), axis=0, initial=0.0) for s in others], axis=0)
    return np.asarray(largest[(len(others) - 1) // 2])


def history_K(others: Sequence[Sharp], kin: Sequence[Sequence[int]]) -> Floats:
    """The sharpest change (p,) that each sensor, or one of its kind, had in the other campaigns.

    The second largest of the campaigns: the same fault in another one is no habit.
    """
    usual = np.sort([s.sharpest_K for s in others], axis=0)[-2:][0]
    return np.array([max(usual[k] for k in group) for group in kin])


def steps(own: Sharp, usual_K: Floats, fast: Sequence[bool], whole_K: float) -> list[Step]:
    """Steps of a table that no heat can give. `usual_K` (p,) is what the sensors do elsewhere; a sensor in air or fluid
    (`fast`) may follow a door or a pump: there only a step beyond `whole_K`, all that the machine ever spans, counts.
    """
    limit = np.maximum.reduce([np.full(len(usual_K), SMALLEST_K), NOISE * own.noise_K, OWN * usual_K])
    limit = np.asarray(np.where(fast, np.maximum(limit, whole_K), limit))
    found = []
    for j, at in _peaks(own, limit):
        size_K = float(own.step_K[at, j])
        habit = np.sort(np.sign(size_K) * np.delete(own.step_K[:, j], np.arange(max(at - SIDE, 0), at + SIDE + 1)))
        if not len(habit) or OWN * habit[-1] <= abs(size_K):  # else it does so again and again
            others, stays = _together(own, at, j), _stays(own, j, at)
            found.append(Step(j, float(own.t_s[at]), _size_K(own, j, at), float(limit[j]), others, stays))
    return found


def exchanges(own: Sharp) -> list[tuple[Step, int, float]]:
    """Moments at which two channels change places, and nothing else steps: with the other sensor and how clearly.

    Two opposite steps that bring each sensor to the level of the other need not be larger than what machines do.
    """
    found: list[tuple[Step, int, float]] = []
    for j, at in _peaks(own, clear_K(own.noise_K)):
        step = Step(j, float(own.t_s[at]), float(own.step_K[at, j]), EXCHANGED, _together(own, at, j), stays=True)
        other = exchange(own.x, at, step)
        if other is not None and not any(k == j and abs(s.t_s - step.t_s) < SIDE * own.step_s for s, k, _ in found):
            found.append((step, *other))
    return found


def clear_K(noise_K: Floats) -> Floats:
    """Steps (p,) beyond any noise."""
    return np.maximum(SMALLEST_EXCHANGE_K, NOISE * noise_K)


def _peaks(own: Sharp, limit: Floats) -> list[tuple[int, int]]:
    """Sensors and blocks of the largest steps beyond the limit, one for each time that a sensor steps."""
    out = []
    for j in np.flatnonzero((np.abs(own.step_K) > limit).any(axis=0)).tolist():
        rows = np.flatnonzero(np.abs(own.step_K[:, j]) > limit[j])
        for run in np.split(rows, np.flatnonzero(np.diff(rows) > SIDE) + 1):
            out.append((j, int(run[np.argmax(np.abs(own.step_K[run, j]))])))
    return out


def _together(own: Sharp, at: int, j: int) -> tuple[int, ...]:
    """Other sensors that step at the same time, by a share of the step and beyond their noise."""
    near = np.abs(own.step_K[max(at - 2, 0) : at + 3]).max(axis=0)
    with_it = near > np.maximum(TOGETHER * abs(float(own.step_K[at, j])), NOISE * own.noise_K)
    with_it[j] = False
    return tuple(np.flatnonzero(with_it).tolist())


def _size_K(own: Sharp, j: int, at: int) -> float:
    """The step between straight lines through the longer stretches before and after it."""
    level = []
    for rows in (slice(max(at - LONG_SIDE, 0), at), slice(at + 1, at + 1 + LONG_SIDE)):
        good = np.isfinite(own.x[rows, j])
        t_s = own.t_s[rows][good] - own.t_s[at]
        level.append(float(np.polynomial.Polynomial.fit(t_s, own.x[rows, j][good], 1)(0.0)))
    return level[1] - level[0]


def first_sample_s(t_s: Floats, column: Floats, step: Step, step_s: float) -> float:
    """The first sample after a step: behind the sharpest change, in its direction, in the blocks around it."""
    rows = np.flatnonzero(np.isfinite(column) & (np.abs(t_s - step.t_s) < 1.5 * step_s + np.median(np.diff(t_s))))
    if len(rows) < 2:
        return step.t_s
    change = np.diff(column[rows]) * np.sign(step.size_K)
    return float(t_s[rows[int(np.argmax(change)) + 1]])


def exchange(x: Floats, at: int, step: Step) -> tuple[int, float] | None:
    """The sensor whose channel is exchanged with that of the step from block `at` of x (n, p) on: each takes the level
    of the other. With it, how many times nearer the levels are to those of the other. None where there is none.
    """
    if len(step.others) != 1:
        return None
    (k,) = step.others
    before, after = (np.nanmean(x[rows], axis=0) for rows in (slice(at - SIDE, at), slice(at + 1, at + SIDE + 1)))
    misfit_K = max(abs(float(after[step.j] - before[k])), abs(float(after[k] - before[step.j])))
    times = abs(float(before[k] - before[step.j])) / max(misfit_K, 1e-3)
    return (k, times) if times > EXCHANGED else None


def _stays(own: Sharp, j: int, at: int) -> bool:
    """Whether a step explains the hour around it better than a departure that relaxes, as air does after a door."""
    half = round(STAY_S / (own.t_s[1] - own.t_s[0]))
    rows = np.arange(max(at - half, 0), min(at + half + 1, len(own.x)))
    rows = rows[(rows != at) & np.isfinite(own.x[rows, j])]
    t_s = own.t_s[rows] - own.t_s[at]
    later = np.maximum(t_s, 0.0)
    kink = np.column_stack([np.ones(len(t_s)), t_s, later])

    def left_over(shape: Floats) -> float:
        design = np.column_stack([kink, shape])
        fitted = design @ np.linalg.lstsq(design, own.x[rows, j], rcond=None)[0]
        return float(np.sum((own.x[rows, j] - fitted) ** 2))

    step = left_over(np.where(t_s > 0.0, 1.0, 0.0))
    relaxed = min(left_over(np.where(t_s > 0.0, np.exp(-later / tau), 0.0)) for tau in RELAX_S)
    return step <= 1.4 * relaxed

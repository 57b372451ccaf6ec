"""Replay of wanted register values through the limits of a control and its writer: what is clipped, what comes late.

Each limit is a pure function on a series of one register; `replay` applies them one by one and all together. All
values are in the register's own unit; µm at the axis appear where a register is multiplied by its arm. numpy only.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats

TOGETHER = "all together"
Limit = Callable[[Floats, Floats], Floats]


@dataclass(frozen=True)
class Stage:
    """One limit: `name` is the cause; `apply(t_s, value)` gives the value that leaves it, both (n,)."""

    name: str
    apply: Limit


@dataclass(frozen=True)
class Register:
    """A wanted register over time, (n,) each, and the stages on its way to the axis, first to last.

    `um_per_unit` turns one unit of the register into µm at the axis, at the worst position of its range.
    """

    axis: str
    name: str
    wanted: Floats
    um_per_unit: float
    stages: tuple[Stage, ...]


@dataclass(frozen=True)
class Loss:
    """What one cause takes from one register, in µm at the worst position: |wanted - got|.

    `largest_at_s` is the first moment at which the largest loss is reached; `share_of_time` is that with more than
    `NOTICED_UM` of difference.
    """

    axis: str
    register: str
    cause: str
    largest_um: float
    p95_um: float
    largest_at_s: float
    share_of_time: float


NOTICED_UM = 1.0
SAME = 1e-9  # two losses that differ by less than this share are the same


def sample_and_hold(t_s: Floats, value: Floats, period_s: float) -> Floats:
    """A writer that updates every `period_s`: the value of the last update, (n,). Behind a ramp by up to a period."""
    if period_s <= 0:
        return value
    updates_s = t_s[0] + period_s * np.floor((t_s - t_s[0]) / period_s + 1e-9)
    return np.asarray(value[np.searchsorted(t_s, updates_s - 1e-6)])


def rate_limit(t_s: Floats, value: Floats, rate_per_s: float) -> Floats:
    """A ramp to every new value with at most `rate_per_s`, starting at the first value, (n,)."""
    out = np.array(value, dtype=np.float64)
    step = rate_per_s * np.diff(t_s)
    if (np.abs(np.diff(value)) <= step).all():
        return out
    level = out[0]
    for i in range(1, len(out)):
        level += min(max(value[i] - level, -step[i - 1]), step[i - 1])
        out[i] = level
    return out


def moving_average(t_s: Floats, value: Floats, cycles: int, cycle_s: float) -> Floats:
    """A filter over `cycles` cycles, (n,): mean of the value at the last n cycles, behind a ramp by (n - 1) / 2 cycles.

    ISG and TwinCAT spread a change evenly over `temp_comp_n_cycles`; before the start the first value holds.
    """
    total = np.zeros(len(value))
    for k in range(cycles):
        total += np.interp(t_s - k * cycle_s, t_s, value)
    return total / cycles


def clip(t_s: Floats, value: Floats, limit: float) -> Floats:
    """A clamp at ± `limit`: largest value that an entry, a register or a sum takes, (n,)."""
    return np.clip(value, -limit, limit)


def quantise(t_s: Floats, value: Floats, step: float) -> Floats:
    """The nearest multiple of `step`, (n,)."""
    return np.asarray(np.round(value / step) * step)


def hold_gaps(value: Floats) -> Floats:
    """A missing value keeps the last one (the writer freezes); before the first one it is zero, (n,)."""
    known = np.isfinite(value)
    last = np.maximum.accumulate(np.where(known, np.arange(len(value)), -1))
    return np.where(last >= 0, value[np.maximum(last, 0)], 0.0)


def outcome(t_s: Floats, register: Register, stages: Sequence[Stage] | None = None) -> Floats:
    """The register as it arrives behind the given stages (default: all its own), (n,)."""
    value = hold_gaps(register.wanted)
    for stage in register.stages if stages is None else stages:
        value = stage.apply(t_s, value)
    return value


def replay(t_s: Floats, registers: Sequence[Register]) -> tuple[Loss, ...]:
    """Losses of every register: each stage alone, then all together. `t_s` (n,) ascends evenly."""
    losses = []
    for register in registers:
        for stage in register.stages:
            losses.append(_loss(t_s, register, stage.name, outcome(t_s, register, [stage])))
        losses.append(_loss(t_s, register, TOGETHER, outcome(t_s, register)))
    return tuple(losses)


def _loss(t_s: Floats, register: Register, cause: str, got: Floats) -> Loss:
    lost_um = np.abs(got - hold_gaps(register.wanted)) * register.um_per_unit
    # Cycle after cycle loses the same: rounding must not choose the moment.
    worst = int(np.argmax(lost_um >= (1.0 - SAME) * lost_um.max()))
    return Loss(
        axis=register.axis,
        register=register.name,
        cause=cause,
        largest_um=float(lost_um.max()),
        p95_um=float(np.quantile(lost_um, 0.95)),
        largest_at_s=float(t_s[worst]),
        share_of_time=float(np.mean(lost_um > NOTICED_UM)),
    )

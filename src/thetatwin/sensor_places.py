"""The spine of `thetacomp place`: states at work -> field -> places of each strategy -> error on other states."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats, Ints
from thetacomp.errors import AnalysisError
from thetatwin import snapshots
from thetatwin.conditions import Conditions
from thetatwin.mounting import Candidates, Mounting, candidates
from thetatwin.placement import (
    Field,
    Goal,
    Spacing,
    best_subset,
    by_sensitivity,
    exchange,
    expected_squares_um2,
    field_of_modes,
    greedy,
    value,
)
from thetatwin.virtual_machine import VirtualMachine

MODES = 30
CHOOSE_DAYS, JUDGE_DAYS = (0, 181), (181, 184)  # first day of the year and number of days
_RANDOM_SETS = 50
_CHECK_CANDIDATES, _CHECK_SIZES = 24, (1, 2, 3, 4)

STRATEGIES: Mapping[str, str] = {
    "displacement": "observability: least uncertainty of the tool",
    "exchange": "observability: the same, then exchanged as a set",
    "modes": "observability: most information on the thermal modes",
    "sensitivity": "maximum sensitivity",
    "linearity": "nearest linearity",
}


@dataclass(frozen=True)
class Curve:
    """Expected error of the tool with the first 0, 1, … k sensors, in µm: X, Y, Z and all together, (k + 1, 4).

    `judged_um` on the states that were not used for choosing, `promised_um` on those that were.
    """

    judged_um: Floats
    promised_um: Floats


@dataclass(frozen=True)
class Choice:
    """Places of one strategy in the order in which they were taken: indices of the candidates (k,)."""

    strategy: str
    chosen: Ints
    curve: Curve


@dataclass(frozen=True)
class GreedyCheck:
    """Greedy against exact choice on a small random set of candidates.

    `share` of the best value that greedy reaches; `error_ratio` its error of the tool over the smallest possible one
    (1 for "information", which promises no error).
    """

    goal: Goal
    size: int
    candidates: int
    share: float
    error_ratio: float


@dataclass(frozen=True)
class Placement:
    """Everything that `thetacomp place` reports.

    `existing_ids` are the sensors of the description, the most useful first, with their `existing` curve; `random_um`
    (k + 1, 4) is the median over random sets; `nearest_id` and `nearest_mm` name the existing sensor nearest to each
    candidate. `states` counts those used for choosing and for judging; `modes_um` is what the field's modes leave out
    of the tool's displacement (RMS). `warm_rise_K` (states,) is the machine at the end of the published run's warm-up.
    """

    candidates: Candidates
    choices: tuple[Choice, ...]
    existing_ids: tuple[str, ...]
    existing: Curve
    random_um: Floats
    nearest_id: tuple[str, ...]
    nearest_mm: Floats
    checks: tuple[GreedyCheck, ...]
    noise_K: float
    states: tuple[int, int]
    modes_um: float
    warm_rise_K: Floats

    def choice(self, strategy: str) -> Choice:
        """The choice of one strategy."""
        return next(c for c in self.choices if c.strategy == strategy)


def place_sensors(
    machine: VirtualMachine, conditions: Conditions, mounting: Mounting, count: int, seed: int
) -> Placement:
    """Choose `count` places by each strategy and judge them. The same seed gives the same result.

    Raises AnalysisError where fewer places are free than sensors are asked for.
    """
    if count < 1:
        raise AnalysisError(f"{count} sensors cannot be placed. Fix: ask for one or more.")
    free = candidates(machine, mounting)
    rows = machine.reduced.shapes[free.state]
    outputs = snapshots.tool_outputs_um(machine, snapshots.positions_mm(machine), conditions.work.tool_length_mm)
    outputs = outputs.reshape(-1, outputs.shape[-1])
    first, others, cycles = (np.random.default_rng([seed, 3, k]) for k in range(3))
    seen = snapshots.working_states(machine, conditions, first, *CHOOSE_DAYS)
    later = snapshots.working_states(machine, conditions, others, *JUDGE_DAYS)
    loops = snapshots.warm_and_cool_states(machine, conditions, cycles)
    noise_K = snapshots.sensor_noise_K(conditions.pt100)
    covariance, moment = _moment(seen, seen.mean(axis=0)), _moment(later, seen.mean(axis=0))

    def errors_um(sensor_rows: Floats, states: Floats) -> Floats:
        parts = [sensor_rows[:k] for k in range(len(sensor_rows) + 1)]
        return np.array([_by_direction(expected_squares_um2(p, outputs, covariance, noise_K, states)) for p in parts])

    def curve(sensor_rows: Floats) -> Curve:
        return Curve(errors_um(sensor_rows, moment), errors_um(sensor_rows, covariance))

    spacing = Spacing(free.at_mm, mounting.apart_mm)
    field = field_of_modes(rows, outputs, covariance, MODES)
    looped = field_of_modes(rows, outputs, _moment(loops, loops.mean(axis=0)), MODES)
    by_tool = greedy(field, noise_K, count, "displacement", spacing)
    chosen = {
        "displacement": by_tool,
        "exchange": exchange(field, noise_K, by_tool, spacing),
        "modes": greedy(field, noise_K, count, "information", spacing),
        "sensitivity": by_sensitivity(snapshots.responses_K_per_kW(machine, free.state), count, spacing),
        "linearity": greedy(looped, noise_K, count, "displacement", spacing),
    }
    existing_rows = machine.reduced.rows[machine.sensor_rows]
    order = greedy(
        field_of_modes(existing_rows, outputs, covariance, MODES), noise_K, len(existing_rows), "displacement"
    )
    names, distance = _nearest(machine, free)
    left_out = np.trace(outputs @ covariance @ outputs.T) - np.sum(field.outputs_um**2)
    return Placement(
        free,
        tuple(Choice(name, chosen[name], curve(rows[chosen[name]])) for name in STRATEGIES),
        tuple(machine.description.sensors[k].id for k in order),
        curve(existing_rows[order]),
        _random_sets(np.random.default_rng([seed, 3, 3]), rows, count, lambda some: errors_um(some, moment)),
        names,
        distance,
        _checks(np.random.default_rng([seed, 3, 4]), field, noise_K),
        noise_K,
        (len(seen), len(later)),
        float(np.sqrt(max(left_out, 0.0) / len(outputs))),
        machine.reduced.shapes @ loops[snapshots.WARM_H * snapshots.LOOPS_PER_HOUR],
    )


def existing_margin_um(placement: Placement) -> tuple[int, float, float]:
    """Number of sensors n, and the error in µm that is left with n chosen places and with n existing sensors."""
    n = min(len(placement.existing_ids), len(placement.choice("displacement").chosen))
    chosen = placement.choice("displacement").curve.judged_um[n, 3]
    return n, float(chosen), float(placement.existing.judged_um[n, 3])


def _moment(states: Floats, about: Floats) -> Floats:
    away = states - about
    return np.asarray(away.T @ away / len(states))


def _by_direction(squares_um2: Floats) -> Floats:
    """Root of the mean over positions for X, Y, Z, and of their sum: (4,)."""
    mean = squares_um2.reshape(-1, 3).mean(axis=0)
    return np.asarray(np.sqrt(np.append(mean, mean.sum())))


def _random_sets(rng: np.random.Generator, rows: Floats, count: int, judge: Callable[[Floats], Floats]) -> Floats:
    take = min(count, len(rows))
    drawn = [judge(rows[rng.choice(len(rows), take, replace=False)]) for _ in range(_RANDOM_SETS)]
    return np.asarray(np.median(drawn, axis=0))


def _nearest(machine: VirtualMachine, free: Candidates) -> tuple[tuple[str, ...], Floats]:
    sensors = machine.description.sensors
    apart = np.linalg.norm(free.at_mm[:, None] - np.array([s.at_mm for s in sensors])[None], axis=2)
    return tuple(sensors[k].id for k in apart.argmin(axis=1)), apart.min(axis=1)


def _checks(rng: np.random.Generator, field: Field, noise_K: float) -> tuple[GreedyCheck, ...]:
    """Greedy choice against every subset of a few candidates."""
    n = min(_CHECK_CANDIDATES, len(field.rows_K))
    few = Field(field.rows_K[np.sort(rng.choice(len(field.rows_K), n, replace=False))], field.outputs_um)
    total = float(np.sum(few.outputs_um**2))
    out = []
    goals: tuple[Goal, ...] = ("displacement", "information")
    for goal in goals:
        for size in (s for s in _CHECK_SIZES if s <= n):
            _, best = best_subset(few, noise_K, size, goal)
            reached = value(few, noise_K, greedy(few, noise_K, size, goal)[None], goal)[0]
            ratio = np.sqrt((total - reached) / (total - best)) if goal == "displacement" else 1.0
            out.append(GreedyCheck(goal, size, n, float(reached / best), float(ratio)))
    return tuple(out)

"""States of the virtual machine at random work, and what sensors and tool make of a state: the data for placement."""

from __future__ import annotations

from itertools import product

import numpy as np

from thetacomp.arrays import Floats, Ints
from thetatwin import duty
from thetatwin.conditions import Conditions, Pt100
from thetatwin.hall import hall_inputs, yearly_degC
from thetatwin.operation import STEP_S, Work, rest_state, simulate
from thetatwin.thermal import AIR_INPUTS
from thetatwin.virtual_machine import VirtualMachine

HOUR_MIN = 60
SETTLE_DAYS = 3  # the guess at the first state has faded by then
WARM_H, COOL_H = 8, 16
LOOPS_PER_HOUR = 6
RESPONSE_H = 8.0


def working_states(
    machine: VirtualMachine, conditions: Conditions, rng: np.random.Generator, first_day: int, days: int
) -> Floats:
    """Modal states (hours, R), one an hour, over `days` of random shifts in the preset's hall; day 0 is New Year.

    The chiller runs on each day with the preset's probability.
    """
    names = [a.name for a in machine.description.axes]
    work = duty.weeks(rng, SETTLE_DAYS + days, names, conditions.work, int(rng.integers(0, 7)))
    chilled = rng.random(SETTLE_DAYS + days) < conditions.work.chiller
    work = duty.with_chiller(work, np.repeat(chilled.astype(float), duty.MINUTES_A_DAY))
    t_s = STEP_S * np.arange(float(len(work.on)))
    begin_day = first_day - SETTLE_DAYS
    reference = machine.description.reference_degC
    air, floor = hall_inputs(conditions.hall, rng, t_s, begin_day, work.on, reference)
    start_air = air[: duty.MINUTES_A_DAY].mean(axis=0)
    start_air[0] = yearly_degC(conditions.hall, np.array([begin_day]))[0] - reference
    history = simulate(machine, work, air, floor, rest_state(machine, start_air, float(floor[0])), keep=HOUR_MIN)
    return history.states[24 * SETTLE_DAYS :]


def warm_and_cool_states(
    machine: VirtualMachine, conditions: Conditions, rng: np.random.Generator, days: int = 4
) -> Floats:
    """Changes of the modal state (samples, R) since a cold start, each 10 minutes: work for 8 h, rest for 16 h.

    The first day is the published run, the others are random work; the hall stays at the reference temperature, so
    that nothing but the machine's own heat makes the loop between temperature and displacement.
    """
    names = [a.name for a in machine.description.axes]
    parts = []
    for day in range(days):
        warm = WARM_H * HOUR_MIN
        first = duty.paper_run(warm, names) if day == 0 else duty.random_shift(rng, warm, names, conditions.work)
        work: Work = duty.join([first, duty.idle(COOL_H * HOUR_MIN, names)])
        n = len(work.on)
        start = np.zeros(len(machine.reduced.rate_per_s))
        still = np.zeros((n, len(AIR_INPUTS)))
        history = simulate(machine, work, still, np.zeros(n), start, keep=HOUR_MIN // LOOPS_PER_HOUR)
        parts.append(history.states)
    return np.concatenate(parts)


def positions_mm(machine: VirtualMachine) -> dict[str, Floats]:
    """The positions at which the tool is judged: both ends and the middle of every travel, all combinations."""
    axes = machine.description.axes
    stops = [(a.travel_mm[0], 0.5 * sum(a.travel_mm), a.travel_mm[1]) for a in axes]
    grid = np.array(list(product(*stops)))
    return {a.name: grid[:, k] for k, a in enumerate(axes)}


def tool_outputs_um(machine: VirtualMachine, at_mm: dict[str, Floats], tool_length_mm: float) -> Floats:
    """Displacement of the tool as rows over the modal state, (positions, 3, R): X, Y, Z in µm at each position."""
    weights = machine.tool.weights(at_mm, tool_length_mm)[:, :3]
    return np.asarray(np.einsum("pij,jr->pir", weights, machine.reduced.rows[machine.tool_rows]) * 1e6)


def responses_K_per_kW(machine: VirtualMachine, states: Ints) -> Floats:
    """Rise (n, sources) at states of the full model after 8 h of 1 kW from each heat source alone."""
    model = machine.reduced
    columns = [model.inputs.index(source.name) for source in machine.description.sources]
    rate = model.rate_per_s
    modes = (-np.expm1(-rate * RESPONSE_H * 3600.0) / rate)[:, None] * model.source[:, columns]
    return np.asarray(1e3 * model.shapes[states] @ modes)


def sensor_noise_K(pt100: Pt100) -> float:
    """Standard deviation of one reading: noise, rounding (resolution / √12) and the offset of the thermometer."""
    return float(np.sqrt(pt100.noise_K**2 + pt100.resolution_K**2 / 12.0 + pt100.offset_sd_K**2))

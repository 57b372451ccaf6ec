"""A measuring campaign on the virtual machine: cold block, warm-up with sweeps, cool-down, and the truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date, timedelta

import numpy as np
from numpy.typing import NDArray

from thetacomp.arrays import Floats, Ints
from thetatwin import duty
from thetatwin.conditions import Conditions
from thetatwin.conditions import Work as WorkSettings
from thetatwin.description import TwinAxis
from thetatwin.geometry import MachineGeometry, draw_geometry
from thetatwin.hall import hall_inputs, yearly_degC
from thetatwin.instruments import (
    Fault,
    SensorTruth,
    draw_faults,
    fit_frame,
    frame_design,
    mount_sensors,
    read_sensors,
    set_up_tracker,
    track,
)
from thetatwin.operation import STEP_S, History, Work, rest_state, simulate
from thetatwin.virtual_machine import VirtualMachine

NEW_YEAR = date(2026, 1, 1)
START_HOUR = 7
DRIFT_POINT = -1
DAYS_BEFORE = 3  # the machine's past that still shows in its temperatures

# A compensation under test: (reading times (m,), readings (m, sensors), times of the points (n,), positions of all
# axes (n,) each) -> correction in µm (n, 3). It must not look at readings later than the point.
Correction = Callable[[Floats, Floats, Floats, Mapping[str, Floats]], Floats]


@dataclass(frozen=True)
class CampaignPlan:
    """One campaign before it is run. `day` counts from New Year; `kind` is "paper" or "random"."""

    number: int
    name: str
    day: int
    kind: str
    chiller: str


@dataclass(frozen=True)
class Twin:
    """One virtual machine with its own geometry and sensors under one preset; `seed` makes all of it repeatable."""

    machine: VirtualMachine
    conditions: Conditions
    geometry: MachineGeometry
    sensors: tuple[SensorTruth, ...]
    seed: int


def make_twin(machine: VirtualMachine, conditions: Conditions, seed: int) -> Twin:
    """Draw geometry and sensors of one machine. The thermal parameters are those of the description, not drawn."""
    rng = np.random.default_rng([seed, 0])
    geometry = draw_geometry(rng, machine.description.machine_axes(), conditions.geometry)
    sensors = mount_sensors(rng, [s.id for s in machine.description.sensors], conditions.pt100)
    return Twin(machine, conditions, geometry, sensors, seed)


@dataclass(frozen=True)
class SweepTruth:
    """All tool points of a campaign in order of time, n points. Errors are (n, 6): µm along, µrad about X, Y, Z.

    `thermal` counts from the machine at its uniform reference temperature; `geometry` is what position and approach
    alone make. `axis` is the index of the moving axis, -1 for points of the drift log.
    """

    t_s: Floats
    axis: Ints
    sweep: Ints
    direction: Ints
    positions_mm: Mapping[str, Floats]
    tool_m: Floats
    thermal: Floats
    geometry: Floats


@dataclass(frozen=True)
class Record:
    """What was measured in a campaign, and the truth. Temperatures (n, sensors), tool errors (points, 3).

    Times count from the start of the campaign. The loggers ran `lead_s` before it: readings and `work` begin there, the
    readings at negative times; `work_t_s` are the moments at which the minutes of `work` begin.
    """

    plan: CampaignPlan
    reference_s: float
    temperature_t_s: Floats
    temperature_degC: Floats
    measured_um: Floats
    work: Work
    faults: tuple[Fault, ...]
    truth: SweepTruth
    history: History
    begin_s: float
    lead_s: float = 0.0

    @property
    def work_t_s(self) -> Floats:
        """When each minute of `work` begins, (minutes,)."""
        return STEP_S * np.arange(float(len(self.work.on))) - self.lead_s


def plan_campaigns(twin: Twin, count: int) -> tuple[CampaignPlan, ...]:
    """The first campaign is the paper's run, the others are random work; days are spaced as the preset says."""
    plans, conditions = [], twin.conditions
    for k in range(count):
        rng = np.random.default_rng([twin.seed, 1, k])
        day = conditions.work.first_day + round(k * conditions.work.spacing_days)
        chilled = rng.random() < conditions.work.chiller
        chiller = (
            ("on" if chilled else "off")
            if not conditions.work.chiller_change
            else ("on, later off" if chilled else "off, later on")
        )
        name = (NEW_YEAR + timedelta(days=day)).isoformat()
        plans.append(CampaignPlan(k, name, day, "paper" if k == 0 else "random", chiller))
    return tuple(plans)


def run_campaign(twin: Twin, plan: CampaignPlan, correction: Correction | None = None) -> Record:
    """Run one campaign and measure it. A correction is added to the commanded position, so to the error as well.

    Each campaign has its own random stream, made from the twin's seed and the campaign's number, so the same
    campaign comes out with or without a correction, alone or among others.
    """
    machine, conditions, sensors = twin.machine, twin.conditions, twin.sensors
    rng = np.random.default_rng([twin.seed, 2, plan.number])
    timetable, work = _timetable(machine, conditions, plan, rng)
    history, begin_s, lived = _live(machine, conditions, plan, work, rng)
    faults = draw_faults(rng, [s.id for s in sensors], conditions.pt100, len(work.on) * STEP_S)
    t_s, reading = read_sensors(rng, history, sensors, faults, conditions.pt100, begin_s)
    lead_min = round(conditions.work.lead_h * 60)
    if lead_min:
        before_s, before = _read_before(twin, plan, history, begin_s, lead_min * STEP_S)
        t_s, reading = np.concatenate([before_s, t_s]), np.vstack([before, reading])
        work = duty.part(lived, round(begin_s / STEP_S) - lead_min, len(lived.on))
    truth = true_points(twin, history, begin_s, timetable)
    error = truth.thermal[:, :3] + truth.geometry[:, :3]
    if correction is not None:
        error = error + correction(t_s, reading, truth.t_s, truth.positions_mm)
    measured = measure_points(rng, conditions, truth, error, timetable.cold)
    reference_s = float(np.ceil(truth.t_s[timetable.cold].max()))
    return Record(plan, reference_s, t_s, reading, measured, work, faults, truth, history, begin_s, lead_min * STEP_S)


def _read_before(
    twin: Twin, plan: CampaignPlan, history: History, begin_s: float, lead_s: float
) -> tuple[Floats, Floats]:
    """Readings at negative times, of loggers that ran `lead_s` before the campaign, when no sensor was broken yet.

    They have a random stream of their own: with or without them the campaign comes out the same.
    """
    rng = np.random.default_rng([twin.seed, 5, plan.number])
    pt100, earlier = twin.conditions.pt100, history.t_s <= begin_s
    past = replace(
        history,
        t_s=history.t_s[earlier],
        sensors_degC=history.sensors_degC[earlier],
        air_degC=history.air_degC[earlier],
    )
    count = int(lead_s // pt100.sample_s)  # on the clock of the campaign's own samples
    start_s = begin_s - count * pt100.sample_s
    _, reading = read_sensors(rng, past, twin.sensors, (), pt100, start_s)
    return -pt100.sample_s * np.arange(float(count), 0.0, -1.0), reading[:count]


def measure_points(
    rng: np.random.Generator, conditions: Conditions, truth: SweepTruth, error_um: Floats, cold: NDArray[np.bool_]
) -> Floats:
    """What the tracker makes of the true errors (n, 3) in one set-up, in the frame of the machine, (n, 3)."""
    day = set_up_tracker(rng, conditions.tracker, truth.tool_m.mean(axis=0))
    measured = track(rng, conditions.tracker, day, truth.tool_m, error_um, truth.sweep)
    # The frame comes from the cold block and stays: refitting it later would absorb the thermal error.
    frame = fit_frame(truth.tool_m[cold], measured[cold])
    return np.asarray(measured - (frame_design(truth.tool_m) @ frame).reshape(-1, 3))


Point = tuple[float, int, int, int, float]
"""One point of a timetable: time in s, moving axis (DRIFT_POINT for the drift log), sweep, approach, position in mm."""


@dataclass(frozen=True)
class Timetable:
    """Points of all sweeps: times, moving axis (-1 drift), sweep number, approach, positions, cold block."""

    t_s: Floats
    axis: Ints
    sweep: Ints
    direction: Ints
    positions_mm: dict[str, Floats]
    cold: NDArray[np.bool_]


def _timetable(
    machine: VirtualMachine, conditions: Conditions, plan: CampaignPlan, rng: np.random.Generator
) -> tuple[Timetable, Work]:
    """When every point is taken, and the minutes of work between the rounds of sweeps."""
    settings, axes = conditions.work, machine.description.axes
    names = [a.name for a in axes]
    rounds = [("cold", 0)] * settings.cold_rounds
    blocks = round(settings.warm_h * 60 / settings.between_sweeps_min)
    rounds += [("warm", round(settings.warm_h * 60 / blocks))] * blocks
    cools = round(settings.cool_h * 60 / settings.between_sweeps_min)
    rounds += [("cool", round(settings.between_sweeps_min))] * cools
    points: list[Point] = []
    parts: list[Work] = []
    now, sweep, cold_points = 0.0, 0, 0
    for phase, minutes in rounds:
        if minutes:
            parts.append(_work_block(plan, phase, minutes, names, settings, rng))
            now += minutes * STEP_S
        begin = now
        own = sweep_round(axes, settings, begin, sweep)
        points += own
        now, sweep = own[-1][0], own[-1][2] + 1
        now = np.ceil(now / STEP_S) * STEP_S
        parts.append(duty.idle(round((now - begin) / STEP_S), names, on=1.0))
        if phase == "cold":
            cold_points = len(points)
    work = duty.join(parts)
    result = as_timetable(axes, points, np.arange(len(points)) < cold_points)
    return result, duty.with_chiller(work, _chiller(plan, len(work.on), rng))


def sweep_round(axes: Sequence[TwinAxis], settings: WorkSettings, begin_s: float, sweep: int) -> list[Point]:
    """One round from `begin_s` on: a sweep of every axis there and back, after each the middle of all travels.

    `sweep` is the number of its first sweep. The other axes stand in the middle.
    """
    points, now = [], begin_s
    for a, axis in enumerate(axes):
        targets = np.linspace(*axis.travel_mm, settings.points)
        travel_s = (targets[1] - targets[0]) / (settings.sweep_feed_m_min * 1000 / 60)
        now += 45.0  # from the middle to the start of the travel
        for direction, order in ((1, targets), (-1, targets[::-1])):
            for p in order:
                now += travel_s + settings.dwell_s
                points.append((now, a, sweep, direction, float(p)))
            now += 10.0  # overrun, so that every target is approached from one side
        now += 45.0
        points.append((now, DRIFT_POINT, sweep + 1, 1, 0.0))
        sweep += 2
    return points


def as_timetable(axes: Sequence[TwinAxis], points: Sequence[Point], cold: NDArray[np.bool_]) -> Timetable:
    """The points as arrays; an axis that does not move stands in the middle of its travel."""
    table = np.array(points)
    moving = table[:, 1].astype(np.int64)
    positions = {}
    for a, axis in enumerate(axes):
        middle = 0.5 * (axis.travel_mm[0] + axis.travel_mm[1])
        positions[axis.name] = np.where(moving == a, table[:, 4], middle)
    return Timetable(table[:, 0], moving, table[:, 2].astype(np.int64), table[:, 3].astype(np.int64), positions, cold)


def _work_block(
    plan: CampaignPlan, phase: str, minutes: int, names: list[str], settings: WorkSettings, rng: np.random.Generator
) -> Work:
    if phase == "cool":
        return duty.idle(minutes, names, on=1.0)
    if plan.kind == "paper":
        return duty.paper_run(minutes, names)
    return duty.random_shift(rng, minutes, names, settings)


def _chiller(plan: CampaignPlan, n: int, rng: np.random.Generator) -> Floats:
    change = round(n * rng.uniform(0.3, 0.6))
    first, *later = plan.chiller.split(", later ")
    out = np.full(n, 1.0 if first == "on" else 0.0)
    if later:
        out[change:] = 1.0 if later[0] == "on" else 0.0
    return out


def _live(
    machine: VirtualMachine, conditions: Conditions, plan: CampaignPlan, work: Work, rng: np.random.Generator
) -> tuple[History, float, Work]:
    """Some days before, the night, and the campaign; when the campaign starts in the history; all the work."""
    names = [a.name for a in machine.description.axes]
    before = duty.weeks(rng, DAYS_BEFORE, names, conditions.work, first_weekday=int(rng.integers(0, 7)))
    night = duty.idle(START_HOUR * 60, names)
    whole = duty.join([before, night, work])
    t_s = STEP_S * np.arange(float(len(whole.on)))
    reference = machine.description.reference_degC
    air, floor = hall_inputs(conditions.hall, rng, t_s, plan.day - DAYS_BEFORE, whole.on, reference)
    start_air = air[:1440].mean(axis=0)
    start_air[0] = yearly_degC(conditions.hall, np.array([plan.day - DAYS_BEFORE]))[0] - reference
    history = simulate(machine, whole, air, floor, rest_state(machine, start_air, float(floor[0])))
    return history, (len(before.on) + len(night.on)) * STEP_S, whole


def true_points(twin: Twin, history: History, begin_s: float, table: Timetable) -> SweepTruth:
    """What is true at the points of a timetable that begins at `begin_s` of the history."""
    machine, length = twin.machine, twin.conditions.work.tool_length_mm
    poses = history.poses(machine, begin_s + table.t_s)
    thermal = machine.tool_error_um(poses, table.positions_mm, length)
    approach = {}
    for a, axis in enumerate(machine.description.axes):
        # An axis that rests was last brought to its middle from below.
        approach[axis.name] = np.where(table.axis == a, table.direction, 1).astype(float)
    cold = twin.geometry.error_um(machine.tool, table.positions_mm, approach, length)
    tool_m, _, _ = machine.tool.levers_m(table.positions_mm, length)
    return SweepTruth(table.t_s, table.axis, table.sweep, table.direction, table.positions_mm, tool_m, thermal, cold)

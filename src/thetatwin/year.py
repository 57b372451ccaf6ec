"""A year of a virtual machine: some days of measured training, then months of work, all in one unbroken history."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import timedelta

import numpy as np

from thetacomp.arrays import Floats
from thetatwin import duty
from thetatwin.campaigns import (
    DAYS_BEFORE,
    NEW_YEAR,
    CampaignPlan,
    Point,
    Record,
    Twin,
    as_timetable,
    measure_points,
    sweep_round,
    true_points,
)
from thetatwin.conditions import Conditions
from thetatwin.hall import DAY_S, hall_inputs, yearly_degC
from thetatwin.instruments import Fault, draw_faults, read_sensors
from thetatwin.operation import STEP_S, History, Work, rest_state, simulate

MONTH_DAYS = 30
MOST_TRAINING_DAYS = 10
LEAD_DAYS = 2  # readings before a campaign or a month, so that lags start with the heat that is in the machine
TRUTH_MIN = 10  # the truth of the year is kept this often
COLD_HOUR = 3  # campaigns begin at night, when the machine has stood for some hours


@dataclass(frozen=True)
class Schedule:
    """How the machine is measured before it goes to work for months.

    Training has campaigns of `campaign_days` days each, together at most MOST_TRAINING_DAYS, in an unbroken row from a
    Monday on. Each begins with `cold_rounds` rounds of sweeps at COLD_HOUR and goes on with one round every
    `between_rounds_min`, day and night, while the machine works as always.
    """

    campaign_days: tuple[int, ...] = (2, 2, 2, 2, 2)
    cold_rounds: int = 4
    between_rounds_min: int = 120
    months: int = 12

    @property
    def training_days(self) -> int:
        """Days of training in all."""
        return sum(self.campaign_days)


@dataclass(frozen=True)
class Readings:
    """Readings (n, sensors) in °C at `t_s` (n,) with the faults that were in them; times count from the schedule's
    first midnight."""

    t_s: Floats
    value_degC: Floats
    faults: tuple[Fault, ...]


@dataclass(frozen=True)
class Year:
    """What happened and what was measured. Times count from the midnight before the first campaign.

    `training` are the measured campaigns with `before` each the readings of the days before it (negative times).
    `months` has the readings of each month with LEAD_DAYS before it, `history` the truth from the last training
    midnight on, `work` what the machine did since the first midnight, minute by minute.
    """

    schedule: Schedule
    training: tuple[Record, ...]
    before: tuple[Readings, ...]
    begins_s: tuple[float, ...]
    months: tuple[Readings, ...]
    history: History
    training_history: History
    work: Work


def live_a_year(twin: Twin, schedule: Schedule) -> Year:
    """Run training and months. Everything random comes from the twin's seed."""
    machine, conditions = twin.machine, twin.conditions
    rng = np.random.default_rng([twin.seed, 3])
    names = [a.name for a in machine.description.axes]
    days = DAYS_BEFORE + schedule.training_days + MONTH_DAYS * schedule.months
    work = duty.weeks(rng, days, names, conditions.work, first_weekday=(7 - DAYS_BEFORE) % 7)
    points, work = _with_rounds(twin, schedule, work)
    work = duty.with_chiller(work, _chiller(conditions, rng, days))
    t_s = STEP_S * np.arange(float(len(work.on)))
    reference = machine.description.reference_degC
    air, floor = hall_inputs(conditions.hall, rng, t_s, conditions.work.first_day - DAYS_BEFORE, work.on, reference)
    at_rest = air[:1440].mean(axis=0)
    at_rest[0] = yearly_degC(conditions.hall, np.array([conditions.work.first_day - DAYS_BEFORE]))[0] - reference
    start = rest_state(machine, at_rest, float(floor[0]))
    cut = (DAYS_BEFORE + schedule.training_days) * duty.MINUTES_A_DAY
    first = simulate(machine, _part(work, 0, cut), air[:cut], floor[:cut], start)
    then = simulate(machine, _part(work, cut, len(work.on)), air[cut:], floor[cut:], first.end, keep=TRUTH_MIN)
    first = _shifted(first, -DAYS_BEFORE * DAY_S)
    then = _shifted(then, schedule.training_days * DAY_S)
    whole = _joined(first, then)
    begins = _begins_s(schedule)
    training, before = _training(twin, schedule, rng, first, whole, points, work)
    months = []
    for k in range(schedule.months):
        begin_s = (schedule.training_days + k * MONTH_DAYS) * DAY_S
        months.append(_read(twin, rng, whole, begin_s, begin_s + MONTH_DAYS * DAY_S))
    own = _part(work, DAYS_BEFORE * duty.MINUTES_A_DAY, len(work.on))
    return Year(schedule, training, before, begins, tuple(months), then, first, own)


def _begins_s(schedule: Schedule) -> tuple[float, ...]:
    """When each campaign begins."""
    first = np.concatenate([[0], np.cumsum(schedule.campaign_days)[:-1]])
    return tuple(float(day) * DAY_S + COLD_HOUR * 3600.0 for day in first)


def _with_rounds(twin: Twin, schedule: Schedule, work: Work) -> tuple[list[tuple[list[Point], int]], Work]:
    """The points of every campaign with the number of cold ones, times from its begin, and the work they interrupt."""
    axes, settings = twin.machine.description.axes, twin.conditions.work
    names = [a.name for a in axes]
    begins = _begins_s(schedule)
    ends = [*begins[1:], schedule.training_days * DAY_S]
    campaigns = []
    for begin_s, end_s in zip(begins, ends, strict=True):
        points: list[Point] = []
        now, rounds, cold = 0.0, 0, 0
        while now < end_s - begin_s - 1800.0:
            own = sweep_round(axes, settings, now, points[-1][2] + 1 if points else 0)
            points += own
            rounds += 1
            stop = float(np.ceil(own[-1][0] / STEP_S)) * STEP_S
            work = _interrupted(work, DAYS_BEFORE * DAY_S + begin_s + now, DAYS_BEFORE * DAY_S + begin_s + stop, names)
            if rounds == schedule.cold_rounds:
                cold = len(points)
            now = stop if rounds < schedule.cold_rounds else stop + 60.0 * schedule.between_rounds_min
        campaigns.append((points, cold))
    return campaigns, work


def _interrupted(work: Work, begin_s: float, end_s: float, names: list[str]) -> Work:
    """The machine is on and still while it is measured."""
    a, b = round(begin_s / STEP_S), round(end_s / STEP_S)
    return duty.join([_part(work, 0, a), duty.idle(b - a, names, on=1.0), _part(work, b, len(work.on))])


def _chiller(conditions: Conditions, rng: np.random.Generator, days: int) -> Floats:
    """Minute by minute, drawn anew for every day; with a change of cooling it is switched over once a day."""
    out = []
    for _ in range(days):
        day = np.full(duty.MINUTES_A_DAY, float(rng.random() < conditions.work.chiller))
        if conditions.work.chiller_change:
            change = int(rng.uniform(0.3, 0.6) * duty.MINUTES_A_DAY)
            day[change:] = 1.0 - day[0]
        out.append(day)
    return np.concatenate(out)


def _training(
    twin: Twin,
    schedule: Schedule,
    rng: np.random.Generator,
    first: History,
    whole: History,
    campaigns: Sequence[tuple[list[Point], int]],
    work: Work,
) -> tuple[tuple[Record, ...], tuple[Readings, ...]]:
    begins = _begins_s(schedule)
    ends = [*begins[1:], schedule.training_days * DAY_S]
    records, before = [], []
    for number, (begin_s, end_s, (points, cold_points)) in enumerate(zip(begins, ends, campaigns, strict=True)):
        cold = np.arange(len(points)) < cold_points
        truth = true_points(twin, first, begin_s, as_timetable(twin.machine.description.axes, points, cold))
        error = truth.thermal[:, :3] + truth.geometry[:, :3]
        measured = measure_points(rng, twin.conditions, truth, error, cold)
        readings = _read(twin, rng, whole, begin_s, end_s)
        day = twin.conditions.work.first_day + int(begin_s // DAY_S)
        name = (NEW_YEAR + timedelta(days=day)).isoformat()
        own = readings.t_s >= begin_s
        a, b = (round(s / STEP_S) + DAYS_BEFORE * duty.MINUTES_A_DAY for s in (begin_s, end_s))
        records.append(
            Record(
                plan=CampaignPlan(number, name, day, "usual", "as usual"),
                reference_s=float(np.ceil(truth.t_s[cold].max())),
                temperature_t_s=readings.t_s[own] - begin_s,
                temperature_degC=readings.value_degC[own],
                measured_um=measured,
                work=_part(work, a, b),
                faults=readings.faults,
                truth=truth,
                history=first,
                begin_s=begin_s,
            )
        )
        before.append(Readings(readings.t_s[~own] - begin_s, readings.value_degC[~own], readings.faults))
    return tuple(records), tuple(before)


def _read(twin: Twin, rng: np.random.Generator, history: History, begin_s: float, end_s: float) -> Readings:
    """Readings from LEAD_DAYS before `begin_s` to `end_s`; faults are drawn for the time between the two."""
    start_s = max(begin_s - LEAD_DAYS * DAY_S, float(history.t_s[0]))
    rows = (history.t_s >= start_s) & (history.t_s <= end_s)
    part = replace(
        history, t_s=history.t_s[rows], sensors_degC=history.sensors_degC[rows], air_degC=history.air_degC[rows]
    )
    drawn = draw_faults(rng, [s.id for s in twin.sensors], twin.conditions.pt100, end_s - begin_s)
    faults = tuple(replace(fault, t_s=fault.t_s + begin_s - start_s) for fault in drawn)
    t_s, value = read_sensors(rng, part, twin.sensors, faults, twin.conditions.pt100, start_s)
    return Readings(t_s + start_s, value, drawn)


def _part(work: Work, a: int, b: int) -> Work:
    return Work(work.on[a:b], work.rpm[a:b], {k: v[a:b] for k, v in work.feed_m_min.items()}, work.chiller[a:b])


def _shifted(history: History, by_s: float) -> History:
    return replace(history, t_s=history.t_s + by_s, kept_s=history.kept_s + by_s)


def _joined(first: History, then: History) -> History:
    """Temperatures of both; the states are those of the second."""
    return replace(
        then,
        t_s=np.concatenate([first.t_s[:-1], then.t_s]),
        sensors_degC=np.vstack([first.sensors_degC[:-1], then.sensors_degC]),
        air_degC=np.vstack([first.air_degC[:-1], then.air_degC]),
    )

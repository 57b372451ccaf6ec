"""The trial of a year: a model trained in some days runs for months, frozen and with one five-minute probe a day.

Training and prediction are those of every user: measured campaigns, the procedures of `analyze`, `predict`. The model
sees the training days, the readings and the probes; the truth of the virtual machine judges it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from thetacomp.arrays import CARTESIAN, Floats, Ints
from thetacomp.campaign import Campaign, LeadIn, MachineFolder
from thetacomp.fitting.key_point_law import clock
from thetacomp.model.document import ModelDocument
from thetacomp.model.fallback import Carried, carry_over
from thetacomp.model.prediction import Prediction, predict
from thetacomp.model.temperatures import Temperatures
from thetacomp.reading import read_folder
from thetatwin.campaigns import Twin
from thetatwin.hall import DAY_S
from thetatwin.operation import STEP_S
from thetatwin.trial.probing import DAILY, Course, adapt
from thetatwin.trial.readings import (
    ScreenedMonth,
    ScreenedYear,
    as_read,
    screen_year,
    screened_training,
    screening_model,
    used_sensors,
)
from thetatwin.trial.training import Positions, Trained, at_minute, clock_samples, spindle_duty, train
from thetatwin.writer import write_machine_folder
from thetatwin.year import MONTH_DAYS, Readings, Schedule, Year, live_a_year

NOTHING, FROZEN, ADAPTIVE = "nothing", "frozen default", "adaptive default"
ONE_SENSOR, CLOCK, PROBES_ALONE = "one sensor (paper)", "clock", "probes alone"

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Place:
    """Where the tool is judged: all axes in the middle, or `axis` at one end of its travel."""

    label: str
    axis: str
    positions_mm: Mapping[str, float]

    @property
    def position_mm(self) -> float:
        """Position of the axis, zero in the middle, where the drift is asked for."""
        return self.positions_mm[self.axis] if self.axis else 0.0


@dataclass(frozen=True)
class Trial:
    """What is judged: errors of the tool in µm, (n, places, 3) at `t_s` (n,), by column; `nothing` is the true error.

    The error counts from the middle of the first cold block, as it does for the model. `band_um` are half widths of
    the stored model's bands, NaN where there are none; `in_domain` (n, places) its flag. `probes` tells how often the
    adaptation took, limited or gated a probe; `screened` are the readings that all models were given.
    """

    preset: str
    seed: int
    schedule: Schedule
    places: tuple[Place, ...]
    tool_length_mm: float
    t_s: Floats
    first_day: int
    residual_um: Mapping[str, Floats]
    band_um: Floats
    in_domain: Floats
    probes: Mapping[str, int]
    trained: Trained
    screened: ScreenedYear


def stated_places(twin: Twin) -> tuple[Place, ...]:
    """The middle of all travels, and each axis at both of its ends with the others in the middle."""
    axes = twin.machine.description.axes
    middle = {a.name: 0.5 * (a.travel_mm[0] + a.travel_mm[1]) for a in axes}
    ends = [
        Place(f"{a.name} {end:g}", a.name, middle | {a.name: end})
        for a in axes
        for end in (a.travel_mm[0], a.travel_mm[1])
    ]
    return (Place("middle", "", middle), *ends)


def run_trial(
    twin: Twin,
    schedule: Schedule,
    folder: Path,
    course: Course = DAILY,
    progress: Progress = lambda message: None,
    screening: bool = True,
) -> Trial:
    """Measure the training days into a machine folder, analyse them, and run the months.

    Without `screening` all readings are used as they are, in training and in the months. Raises AnalysisError where
    `folder` holds something or the training cannot carry an analysis.
    """
    progress("living the year")
    year = live_a_year(twin, schedule)
    write_machine_folder(folder, twin, year.training)
    measured = _with_days_before(read_folder(folder), year)
    if screening:
        progress("screening the training campaigns")
    healthy = screened_training(measured) if screening else measured
    progress("fitting the models")
    trained = train(healthy)
    begins_s = [_month_s(schedule, number) for number in range(schedule.months)]
    if screening:
        progress(f"screening {schedule.months} months of readings")
        readings = screen_year(screening_model(measured), year.months, begins_s)
    else:
        readings = as_read([sensor.id for sensor in twin.sensors], year.months)
    progress(f"running {schedule.months} months")
    places = stated_places(twin)
    t_s, true_um = _truth(twin, year, places)
    ready = Ready(healthy, trained.model)
    frozen, band, inside = _run(ready.without, year, readings, places, t_s)
    # The paper's method has no model without its sensor: it goes on with the rebuilt value, as long as there is one.
    paper, _, _ = _run(lambda lost: trained.paper_model, year, readings, places, t_s)
    timed = _by_the_clock(trained, year, places, t_s)
    learnt, log = adapt(twin, course, places, t_s, true_um, frozen, band)
    alone, _ = adapt(twin, course, places, t_s, true_um, np.zeros_like(true_um), np.full_like(band, np.inf))
    residual = {
        NOTHING: true_um,
        FROZEN: true_um - frozen,
        ADAPTIVE: true_um - frozen - learnt,
        ONE_SENSOR: true_um - paper,
        CLOCK: true_um - timed,
        PROBES_ALONE: true_um - alone,
    }
    return Trial(
        preset=twin.conditions.name,
        seed=twin.seed,
        schedule=schedule,
        places=places,
        tool_length_mm=twin.conditions.work.tool_length_mm,
        t_s=t_s,
        first_day=twin.conditions.work.first_day,
        residual_um=residual,
        band_um=band,
        in_domain=inside,
        probes=log,
        trained=trained,
        screened=readings,
    )


def _month_s(schedule: Schedule, number: int) -> float:
    return (schedule.training_days + number * MONTH_DAYS) * DAY_S


def _with_days_before(folder: MachineFolder, year: Year) -> MachineFolder:
    """The loggers ran before each campaign too: the filters start with the heat that is in the machine."""
    campaigns = [
        replace(campaign, before=_lead_in(campaign, readings, begin_s, year))
        for campaign, readings, begin_s in zip(folder.campaigns, year.before, year.begins_s, strict=True)
    ]
    return replace(folder, campaigns=tuple(campaigns))


def _lead_in(campaign: Campaign, readings: Readings, begin_s: float, year: Year) -> LeadIn:
    table = Temperatures(readings.t_s, campaign.temperatures.sensor_ids, readings.value_degC)
    return LeadIn(table, spindle_duty(year.work, begin_s + readings.t_s, readings.t_s))


def _truth(twin: Twin, year: Year, places: Sequence[Place]) -> tuple[Floats, Floats]:
    """Times (n,) and true errors (n, places, 3) since the middle of the first cold block."""
    length = twin.conditions.work.tool_length_mm
    zero_s = np.array([year.begins_s[0] + 0.5 * year.training[0].reference_s])
    t_s = year.history.kept_s[1:]
    poses, zero = year.history.poses(twin.machine, t_s), year.training_history.poses(twin.machine, zero_s)
    out = np.empty((len(t_s), len(places), 3))
    for k, place in enumerate(places):
        at = {name: np.full(len(t_s), value) for name, value in place.positions_mm.items()}
        one = {name: np.array([value]) for name, value in place.positions_mm.items()}
        cold = twin.machine.tool_error_um(zero, one, length)[:, :3]
        out[:, k] = twin.machine.tool_error_um(poses, at, length)[:, :3] - cold
    return t_s, out


class Ready:
    """The default model, and for sensors that are lost the model that the same procedure makes without them.

    `analyze` keeps such a fallback ready for each single sensor; here each one is made when it is first needed.
    """

    def __init__(self, folder: MachineFolder, model: ModelDocument) -> None:
        self._folder = folder
        self._models = {frozenset[str](): model}

    def without(self, lost: frozenset[str]) -> ModelDocument:
        """The model that does not need the sensors `lost`, fitted on the same campaigns."""
        if lost not in self._models:
            self._models[lost] = train(self._folder.without_sensors(lost)).model
        return self._models[lost]


def _run(
    model: Callable[[frozenset[str]], ModelDocument],
    year: Year,
    readings: ScreenedYear,
    places: Sequence[Place],
    t_s: Floats,
) -> tuple[Floats, Floats, Floats]:
    """Prediction and half width of its band (n, places, 3), flag of validity (n, places), month by month.

    `model` names the model that serves where some sensors are lost. Where it changes, the output goes on from where it
    was: the difference of the two models decays as `fallback.carry_over` does it.
    """
    out = _Output(
        np.zeros((len(t_s), len(places), 3)),
        np.full((len(t_s), len(places), 3), np.nan),
        np.zeros((len(t_s), len(places))),
    )
    running: ModelDocument | None = None
    carried: Carried | None = None
    for number, month in enumerate(readings.months):
        begin_s = _month_s(year.schedule, number)
        rows = np.flatnonzero((t_s > begin_s) & (t_s <= begin_s + MONTH_DAYS * DAY_S))
        parts = _lost_parts(month, t_s[rows])
        for lost in dict.fromkeys(lost for _, lost in parts):
            own = np.concatenate([rows[part] for part, some in parts if some == lost])
            _predict(model(lost), month, lost, year, places, t_s, own, out)
        for part, lost in parts:
            own, serving = rows[part], model(lost)
            if running is not None and serving is not running:
                carried = carry_over(t_s[own[0]], out.error[own[0] - 1].ravel(), out.error[own[0]].ravel())
            running = serving
            if carried is not None:
                out.error[own] += np.array([carried.at(s) for s in t_s[own]]).reshape(len(own), len(places), 3)
    return out.error, out.band, out.inside


@dataclass(frozen=True)
class _Output:
    """Prediction and half width of its band (n, places, 3) and flag of validity (n, places), while they are filled."""

    error: Floats
    band: Floats
    inside: Floats


def _lost_parts(month: ScreenedMonth, t_s: Floats) -> list[tuple[Ints, frozenset[str]]]:
    """The moments (n,) of a month in stretches of the same lost sensors."""
    out = month.out[np.clip(np.searchsorted(month.temperatures.t_s, t_s, side="right") - 1, 0, None)]
    begins = np.flatnonzero((out[1:] != out[:-1]).any(axis=1)) + 1
    ids = np.array(month.temperatures.sensor_ids)
    return [(part, frozenset(ids[out[part[0]]].tolist())) for part in np.split(np.arange(len(t_s)), begins)]


def _predict(
    model: ModelDocument,
    month: ScreenedMonth,
    lost: frozenset[str],
    year: Year,
    places: Sequence[Place],
    t_s: Floats,
    rows: Ints,
    out: _Output,
) -> None:
    """Fill in what a model says of the moments `rows`, without the sensors that it can do without."""
    known = set(model.in_use)
    table = month.temperatures.without(lost - used_sensors(model))
    table = replace(table, value_degC=table.at(table.t_s))
    asked = [k for k, place in enumerate(places) if place.axis in known]
    axis = tuple(places[k].axis for k in asked for _ in rows)
    position = np.repeat([places[k].position_mm for k in asked], len(rows))
    wanted = Positions(np.tile(t_s[rows], len(asked)), axis, position)
    got = predict(model, table, wanted, "model", duty=spindle_duty(year.work, table.t_s, table.t_s))
    _fill(got, rows, asked, out)
    # A component that a model does not have is not compensated.
    out.error[rows] = np.nan_to_num(out.error[rows])


def _fill(got: Prediction, rows: Ints, asked: Sequence[int], out: _Output) -> None:
    shape = (len(asked), len(rows), 3)
    half_um = (0.5 * (got.upper_um - got.lower_um)).reshape(shape)
    for i, k in enumerate(asked):
        out.error[rows, k] = got.error_um.reshape(shape)[i]
        out.band[rows, k] = half_um[i]
        out.inside[rows, k] = got.in_domain.reshape(shape[:2])[i]


def _by_the_clock(trained: Trained, year: Year, places: Sequence[Place], t_s: Floats) -> Floats:
    """Regression on the hours since the day's work began, no thermometer; (n, places, 3)."""
    hours = _hours_at_work(year)
    out = np.zeros((len(t_s), len(places), 3))
    for states in trained.states:
        begins = np.array(year.begins_s)[states.campaign]
        model = clock(replace(states, elapsed_h=at_minute(hours, begins + states.t_s)))
        for k, place in enumerate(places):
            if place.axis != states.axis:
                continue
            lever_m = 0.0 if states.is_drift else (place.position_mm - states.p0_mm) / 1000.0
            for component in states.components:
                value, _ = model.predict(component, states, clock_samples(states, at_minute(hours, t_s), lever_m))
                out[:, k, CARTESIAN.index(component[1])] = value
    return out


def _hours_at_work(year: Year) -> Floats:
    """For every minute since the first midnight the hours since the spindle first turned that day, zero before."""
    minutes = round(DAY_S / STEP_S)
    turning = (year.work.rpm > 0).reshape(-1, minutes)
    begun = np.maximum.accumulate(turning, axis=1)
    return np.asarray(np.cumsum(begun, axis=1).ravel() * STEP_S / 3600.0)

"""The trial of a year: a model trained in some days runs for months, frozen and with one five-minute probe a day.

Training and prediction are those of every user: measured campaigns, `prepare` and `train` as in `analyze`, the
prediction at positions of all axes. The model sees the training days, the readings and the probes; the truth of the
virtual machine judges it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from thetacomp.arrays import Floats, Ints
from thetacomp.campaign import Campaign, LeadIn, MachineFolder
from thetacomp.fitting.training import Trained, train
from thetacomp.model.document import ModelDocument
from thetacomp.model.fallback import BumplessTransfer, start_transfer
from thetacomp.model.temperatures import Temperatures
from thetacomp.model.volumetric import predict_volume
from thetacomp.preparation import Prepared, prepare
from thetacomp.reading import read_folder
from thetatwin.campaigns import Twin
from thetatwin.hall import DAY_S
from thetatwin.operation import STEP_S, at_minute, spindle_duty
from thetatwin.trial.clock import clock_error_um
from thetatwin.trial.probing import DAILY, Course, adapt
from thetatwin.trial.screened_year import (
    ScreenedMonth,
    ScreenedYear,
    as_read,
    screen_year,
    screening_model,
    used_sensors,
)
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


@dataclass(frozen=True)
class Trial:
    """What is judged: errors of the tool in µm, (n, places, 3) at `t_s` (n,), by column; `nothing` is the true error.

    The error counts from the middle of the first cold block, as it does for the model. `band_um` are half widths of
    the stored model's bands, NaN where there are none; `in_domain` (n, places) its flag. `probes` says how often the
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
    prepared = prepare(measured, faults="repair" if screening else "ignore", mix=True, progress=progress)
    trained = train(prepared, lost=(), progress=progress)
    begins_s = [_month_s(schedule, number) for number in range(schedule.months)]
    if screening:
        progress(f"screening {schedule.months} months of readings")
        readings = screen_year(screening_model(measured), year.months, begins_s)
    else:
        readings = as_read([sensor.id for sensor in twin.sensors], year.months)
    progress(f"running {schedule.months} months")
    places = stated_places(twin)
    t_s, true_um = _truth(twin, year, places)
    ready = Ready(prepared, trained.model)
    frozen, band, inside = _run(ready.without, year, readings, places, t_s)
    # The paper's method has no model without its sensor: it goes on with the rebuilt value, as long as there is one.
    paper, _, _ = _run(lambda lost: trained.paper_model, year, readings, places, t_s)
    timed = _by_the_clock(prepared, year, places, t_s)
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

    def __init__(self, prepared: Prepared, model: ModelDocument) -> None:
        self._prepared = prepared
        self._models = {frozenset[str](): model}

    def without(self, lost: frozenset[str]) -> ModelDocument:
        """The model that does not need the sensors `lost`, fitted on the same campaigns."""
        if lost not in self._models:
            self._models[lost] = train(self._prepared.without_sensors(lost), lost=()).model
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
    was: the difference of the two models decays as `fallback.start_transfer` does it.
    """
    out = _Output(
        np.zeros((len(t_s), len(places), 3)),
        np.full((len(t_s), len(places), 3), np.nan),
        np.zeros((len(t_s), len(places))),
    )
    running: ModelDocument | None = None
    carried: BumplessTransfer | None = None
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
                carried = start_transfer(t_s[own[0]], out.error[own[0] - 1].ravel(), out.error[own[0]].ravel())
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
    table = month.temperatures.without(lost - used_sensors(model)).bridged()
    there = {
        name: np.repeat([place.positions_mm[name] for place in places], len(rows))
        for name in places[0].positions_mm
        if name in known
    }
    duty = spindle_duty(year.work, table.t_s, table.t_s)
    got = predict_volume(model, table, np.tile(t_s[rows], len(places)), there, reference="model", duty=duty)
    half_um = 0.5 * (got.upper_um - got.lower_um)
    # A component that a model does not have is not compensated.
    error_um = np.nan_to_num(got.error_um)
    for k in range(len(places)):
        own = slice(k * len(rows), (k + 1) * len(rows))
        out.error[rows, k], out.band[rows, k], out.inside[rows, k] = error_um[own], half_um[own], got.in_domain[own]


def _by_the_clock(prepared: Prepared, year: Year, places: Sequence[Place], t_s: Floats) -> Floats:
    """Regression on the hours since the day's work began, no thermometer; (n, places, 3)."""
    hours, begins_s = _hours_at_work(year), np.array(year.begins_s)
    trained_on = [
        replace(states, elapsed_h=at_minute(hours, begins_s[states.campaign] + states.t_s))
        for states in prepared.training
    ]
    at = [{name: np.full(len(t_s), value) for name, value in place.positions_mm.items()} for place in places]
    return np.stack([clock_error_um(trained_on, at_minute(hours, t_s), there) for there in at], axis=1)


def _hours_at_work(year: Year) -> Floats:
    """For every minute since the first midnight the hours since the spindle first turned that day, zero before."""
    minutes = round(DAY_S / STEP_S)
    turning = (year.work.rpm > 0).reshape(-1, minutes)
    begun = np.maximum.accumulate(turning, axis=1)
    return np.asarray(np.cumsum(begun, axis=1).ravel() * STEP_S / 3600.0)

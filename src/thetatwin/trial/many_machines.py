"""Verification of many virtual machines: measure, analyse, run with compensation, and compare column deviations.

As in the paper: the column's deviation is the largest deviation of the tool from its cold reference over the column's
travel, in X and in Z, over all sweeps after the cold block. It is given as the tracker measures it and as it truly is.
Calibration and compensation go the way of a user: files, screening, joint form, stored model, positions of all axes.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from thetacomp.arrays import CARTESIAN, Floats, Ints
from thetacomp.axis_states import DRIFT
from thetacomp.campaign import MachineFolder
from thetacomp.fitting.training import train
from thetacomp.machine import Axis
from thetacomp.model.document import ModelDocument
from thetacomp.preparation import Prepared, prepare
from thetacomp.reading import read_folder
from thetacomp.screening import fit_screening
from thetatwin.campaigns import Correction, Record, Twin, make_twin, plan_campaigns, run_campaign
from thetatwin.conditions import Conditions
from thetatwin.trial.clock import clock_error_um
from thetatwin.trial.online import OnlineReadings, online_error_um, online_readings
from thetatwin.virtual_machine import VirtualMachine
from thetatwin.writer import write_machine_folder

DEFAULT, ONE_SENSOR, CLOCK = "default", "one_sensor", "clock"
COLUMN = "Y"
DIRECTIONS = ("X", "Z")
_SMALLEST_GROSS_UM = 1.0
_REWEIGHTED = 20


@dataclass(frozen=True)
class VerificationPlan:
    """How the campaigns are measured and used; everything else stays as the preset has it.

    `calibrations` campaigns train; one more, of other work on another day, verifies. Each point is the mean of
    `readings` readings of the usual dwell. A round has `points` targets an axis; the station stands at `station_mm`.
    The cold block has `cold_rounds` rounds, and the loggers run `lead_h` before it. Without `screening` the readings
    are taken as they are. Sensors at other places are those of the machine that is built with them.
    """

    calibrations: int = 8
    points: int = 13
    readings: int = 1
    station_mm: tuple[float, float, float] | None = None
    cold_rounds: int = 2
    lead_h: float = 0.0
    screening: bool = True


@dataclass(frozen=True)
class Deviation:
    """Column deviation of one machine, direction and method in µm, before and after, measured and true."""

    seed: int
    direction: str
    method: str
    measured_before_um: float
    measured_after_um: float
    true_before_um: float
    true_after_um: float

    @property
    def measured_percent(self) -> float:
        """Reduction as measured."""
        return 100.0 * (1.0 - self.measured_after_um / self.measured_before_um)

    @property
    def true_percent(self) -> float:
        """Reduction of the true deviation."""
        return 100.0 * (1.0 - self.true_after_um / self.true_before_um)


def with_plan(conditions: Conditions, plan: VerificationPlan) -> Conditions:
    """The same hall, work, sensors and tracker, measured by a plan: more readings take longer and scatter less."""
    work, tracker = conditions.work, conditions.tracker
    # The scatter from point to point falls with the readings; what a sweep or a day has in common does not.
    white = tracker.white_share / plan.readings
    kept = 1.0 - tracker.white_share + white
    scale = float(np.sqrt(kept))
    return conditions.model_copy(
        update={
            "work": work.model_copy(
                update={
                    "points": plan.points,
                    "dwell_s": work.dwell_s * plan.readings,
                    "cold_rounds": plan.cold_rounds,
                    "lead_h": plan.lead_h,
                }
            ),
            "tracker": tracker.model_copy(
                update={
                    "u_um": tracker.u_um * scale,
                    "u_um_per_m": tracker.u_um_per_m * scale,
                    "white_share": white / kept,
                    "sweep_share": tracker.sweep_share / kept,
                    "at_mm": plan.station_mm or tracker.at_mm,
                }
            ),
        }
    )


def verify_machine(
    machine: VirtualMachine, conditions: Conditions, plan: VerificationPlan, seed: int
) -> list[Deviation]:
    """Calibrate one machine, verify it in a campaign that the analysis has not seen, and compare.

    The same campaign is run without and with each compensation: heat, hall and instruments are the same in all runs.
    """
    twin = make_twin(machine, with_plan(conditions, plan), seed)
    plans = plan_campaigns(twin, plan.calibrations + 1)
    records = [run_campaign(twin, p) for p in plans]
    folder, off = _measured(twin, records), records[-1]
    out = []
    for method, correction in corrections(folder, off, plan.screening).items():
        on = run_campaign(twin, plans[-1], correction)
        moved = correction(off.temperature_t_s, off.temperature_degC, off.truth.t_s, off.truth.positions_mm)
        true = off.truth.thermal[:, :3]
        for direction in DIRECTIONS:
            d = CARTESIAN.index(direction)
            figures = (off.measured_um[:, d], on.measured_um[:, d], true[:, d], true[:, d] + moved[:, d])
            out.append(Deviation(seed, direction, method, *(column_deviation_um(twin, off, e) for e in figures)))
    return out


def column_deviation_um(twin: Twin, record: Record, error_um: Floats) -> float:
    """Largest deviation from the cold reference over the column's travel and all sweeps after the cold block.

    `error_um` (n,) at the points of the record. Both approaches of a sweep are averaged at each position. Points far
    from the smooth curve of their sweep are gross errors of the instrument and are left out.
    """
    truth = record.truth
    axis = [a.name for a in twin.machine.description.axes].index(COLUMN)
    own = (truth.axis == axis) & np.isfinite(error_um)
    position, sweep, error = truth.positions_mm[COLUMN][own], truth.sweep[own], error_um[own]
    # The smooth curve is judged without the geometry, which is the same in all sweeps.
    good = _no_gross_errors(position, truth.direction[own], sweep, error)
    position, sweep, error = position[good], sweep[good], error[good]
    cold = truth.t_s[own][good] <= record.reference_s
    largest = 0.0
    for p in np.unique(position):
        here = position == p
        reference = error[here & cold].mean()
        for number in np.unique(sweep[here & ~cold]):
            largest = max(largest, abs(float(error[here & (sweep == number)].mean() - reference)))
    return largest


def _no_gross_errors(position: Floats, direction: Ints, sweep: Ints, error: Floats) -> NDArray[np.bool_]:
    """Points (n,) within 4.5 robust standard deviations of a parabola through their sweep."""
    rest = error.copy()
    for p, sign in {(p, s) for p, s in zip(position, direction, strict=True)}:
        here = (position == p) & (direction == sign)
        rest[here] -= np.median(rest[here])
    good = np.ones(len(error), dtype=np.bool_)
    for number in np.unique(sweep):
        rows = np.flatnonzero(sweep == number)
        off_um = np.abs(rest[rows] - _parabola(position[rows], rest[rows]))
        good[rows] = off_um <= 4.5 * 1.4826 * np.median(off_um) + _SMALLEST_GROSS_UM
    return good


def _parabola(position: Floats, value: Floats) -> Floats:
    """The parabola of least absolute deviations at its points (n,), by reweighted least squares.

    Two gross errors at one position would draw that of least squares so far that neither stands out.
    """
    at = (position - position.mean()) / np.ptp(position)
    design = np.vander(at, 3)
    weight = np.ones(len(value))
    fitted = value
    for _ in range(_REWEIGHTED):
        fitted = design @ np.linalg.lstsq(design * weight[:, None], value * weight, rcond=None)[0]
        weight = 1.0 / np.sqrt(np.maximum(np.abs(value - fitted), 0.1))
    return np.asarray(fitted)


def _measured(twin: Twin, records: Sequence[Record]) -> MachineFolder:
    """The campaigns as a user reads them, from files."""
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "machine"
        write_machine_folder(path, twin, records)
        return read_folder(path)


def corrections(folder: MachineFolder, off: Record, screening: bool = True) -> Mapping[str, Correction]:
    """What each method adds to the commanded position at the points of the column's sweeps.

    All campaigns of the folder train but the one of `off`, whose readings are screened by what the others taught.
    """
    names = [c.name for c in folder.campaigns if c.name != off.plan.name]
    healthy = fit_screening([folder.campaign(name).temperatures for name in names]) if screening else None
    live = online_readings(folder.campaign(off.plan.name), healthy)
    prepared = prepare(folder, names, faults="repair" if screening else "ignore", mix=True)
    # A fallback is fitted where its sensor is lost: one for each sensor takes longer than all the rest.
    trained = train(prepared, (COLUMN, DRIFT), live.ever_lost)
    return {
        DEFAULT: _by_model(trained.model, live, off),
        ONE_SENSOR: _by_model(trained.paper_model, live, off),
        CLOCK: _by_clock(prepared, off),
    }


def _by_model(model: ModelDocument, live: OnlineReadings, off: Record) -> Correction:
    # The readings of a run do not depend on the correction, so they are screened once, before.
    def correction(t_s: Floats, reading: Floats, at_s: Floats, positions_mm: Mapping[str, Floats]) -> Floats:
        rows = _column_rows(model.axes, positions_mm)
        there = {name: position[rows] for name, position in positions_mm.items()}
        out = np.zeros((len(at_s), 3))
        out[rows] = -online_error_um(model, live, at_s[rows], there, off.reference_s)
        return out

    return correction


def _by_clock(prepared: Prepared, off: Record) -> Correction:
    # Hours count from the middle of the cold sweeps, as in the states that the clock was fitted on.
    zero_s = off.truth.t_s[(off.truth.t_s <= off.reference_s) & (off.truth.axis >= 0)].mean()
    states = [one for one in prepared.training if one.axis in (COLUMN, DRIFT)]

    def correction(t_s: Floats, reading: Floats, at_s: Floats, positions_mm: Mapping[str, Floats]) -> Floats:
        rows = _column_rows(prepared.folder.machine.axes, positions_mm)
        out = np.zeros((len(at_s), 3))
        out[rows] = -clock_error_um(states, (at_s[rows] - zero_s) / 3600.0, {COLUMN: positions_mm[COLUMN][rows]})
        return out

    return correction


def _column_rows(axes: Sequence[Axis], positions_mm: Mapping[str, Floats]) -> Ints:
    """Points at which all axes but the column's stand in the middle."""
    middle = [positions_mm[a.name] == 0.5 * sum(a.travel_mm) for a in axes if a.name != COLUMN]
    return np.flatnonzero(np.all(middle, axis=0))


@dataclass(frozen=True)
class Summary:
    """One method and direction over many machines.

    The reductions are (10th percentile, median) in percent, the deviations medians (before, after) in µm.
    """

    method: str
    direction: str
    machines: int
    measured_percent: tuple[float, float]
    true_percent: tuple[float, float]
    measured_um: tuple[float, float]
    true_um: tuple[float, float]


def summaries(rows: Sequence[Deviation]) -> list[Summary]:
    """Every method and direction over the machines of `rows`, in the order of the rows."""
    out = []
    for method, direction in dict.fromkeys((row.method, row.direction) for row in rows):
        own = [row for row in rows if (row.method, row.direction) == (method, direction)]
        measured_um = [(row.measured_before_um, row.measured_after_um) for row in own]
        true_um = [(row.true_before_um, row.true_after_um) for row in own]
        out.append(
            Summary(
                method=method,
                direction=direction,
                machines=len(own),
                measured_percent=_tenth_and_median([row.measured_percent for row in own]),
                true_percent=_tenth_and_median([row.true_percent for row in own]),
                measured_um=_medians(measured_um),
                true_um=_medians(true_um),
            )
        )
    return out


def _tenth_and_median(values: Sequence[float]) -> tuple[float, float]:
    return float(np.quantile(values, 0.1)), float(np.median(values))


def _medians(pairs: Sequence[tuple[float, float]]) -> tuple[float, float]:
    before, after = np.median(np.array(pairs), axis=0)
    return float(before), float(after)

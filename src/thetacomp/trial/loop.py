"""Verification of many virtual machines: measure, analyse, run with compensation, and compare column deviations.

As in the paper: the column's deviation is the largest deviation of the tool from its cold reference over the column's
travel, in X and in Z, over all sweeps after the cold block. It is told as the tracker measures it and as it truly is.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from thetacomp.campaign import CARTESIAN, Floats, Ints, MachineFolder, Temperatures
from thetacomp.models.axis_model import clock
from thetacomp.models.document import ModelDocument
from thetacomp.prediction import predict
from thetacomp.reading import read_folder
from thetacomp.trial.training import Positions, Trained, clock_samples, spindle_duty, train
from thetacomp.twin.campaigns import Correction, Record, Twin, make_twin, plan_campaigns, run_campaign
from thetacomp.twin.conditions import Conditions
from thetacomp.twin.virtual import VirtualMachine
from thetacomp.twin.writer import write_machine_folder

DEFAULT, ONE_SENSOR, CLOCK = "default", "one_sensor", "clock"
COLUMN = "Y"
DIRECTIONS = ("X", "Z")
_SMALLEST_GROSS_UM = 1.0


@dataclass(frozen=True)
class MeasuringPlan:
    """How the campaigns are measured; everything else stays as the preset has it.

    `calibrations` campaigns train; one more, of other work on another day, verifies. Each point is the mean of
    `readings` readings of the usual dwell. A round has `points` targets an axis; the station stands at `station_mm`.
    """

    calibrations: int = 8
    points: int = 13
    readings: int = 1
    station_mm: tuple[float, float, float] | None = None


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


def with_plan(conditions: Conditions, plan: MeasuringPlan) -> Conditions:
    """The same hall, work, sensors and tracker, measured by a plan: more readings take longer and scatter less."""
    work, tracker = conditions.work, conditions.tracker
    # The scatter from point to point falls with the readings; what a sweep or a day has in common does not.
    white = tracker.white_share / plan.readings
    kept = 1.0 - tracker.white_share + white
    scale = float(np.sqrt(kept))
    return conditions.model_copy(
        update={
            "work": work.model_copy(update={"points": plan.points, "dwell_s": work.dwell_s * plan.readings}),
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


def verify_machine(machine: VirtualMachine, conditions: Conditions, plan: MeasuringPlan, seed: int) -> list[Deviation]:
    """Calibrate one machine, verify it in a campaign that the analysis has not seen, and compare.

    The same campaign is run without and with each compensation: heat, hall and instruments are the same in all runs.
    """
    twin = make_twin(machine, with_plan(conditions, plan), seed)
    plans = plan_campaigns(twin, plan.calibrations + 1)
    calibration = _measured(twin, [run_campaign(twin, p) for p in plans[:-1]])
    trained = train(calibration, (COLUMN,))
    off = run_campaign(twin, plans[-1])
    out = []
    for method, correction in _corrections(twin, trained, off).items():
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
    for _ in range(3):
        for number in np.unique(sweep):
            rows = np.flatnonzero(sweep == number)
            kept = rows[good[rows]]
            curve = Polynomial.fit(position[kept], rest[kept], 2)
            off_um = np.abs(rest[rows] - curve(position[rows]))
            good[rows] = off_um <= 4.5 * 1.4826 * np.median(off_um) + _SMALLEST_GROSS_UM
    return good


def _measured(twin: Twin, records: Sequence[Record]) -> MachineFolder:
    """The campaigns as a user reads them, from files."""
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "machine"
        write_machine_folder(path, twin, records)
        folder = read_folder(path)
    # Cooling that is switched during every campaign is one mode of work, whichever way it is switched first.
    one_mode = [replace(c, settings=c.settings.model_copy(update={"mode": "as measured"})) for c in folder.campaigns]
    return replace(folder, campaigns=tuple(one_mode))


def _corrections(twin: Twin, trained: Trained, off: Record) -> Mapping[str, Correction]:
    """What each method adds to the commanded position at the points of the column's sweeps."""
    (states,) = trained.states
    timed = clock(states)
    duty = spindle_duty(off.work, off.temperature_t_s, off.temperature_t_s)
    ids = tuple(s.id for s in twin.sensors)
    components = [(name, CARTESIAN.index(name[1])) for name in states.components]

    def by_model(model: ModelDocument) -> Correction:
        def correction(t_s: Floats, reading: Floats, at_s: Floats, positions_mm: Mapping[str, Floats]) -> Floats:
            rows = _column_rows(twin, positions_mm)
            table = Temperatures(t_s, ids, reading)
            table = replace(table, value_degC=table.at(t_s))
            wanted = Positions(at_s[rows], (COLUMN,) * len(rows), positions_mm[COLUMN][rows])
            out = np.zeros((len(at_s), 3))
            out[rows] = -np.nan_to_num(predict(model, table, wanted, off.reference_s, duty=duty).error_um)
            return out

        return correction

    def by_clock(t_s: Floats, reading: Floats, at_s: Floats, positions_mm: Mapping[str, Floats]) -> Floats:
        rows = _column_rows(twin, positions_mm)
        lever_m = (positions_mm[COLUMN][rows] - states.p0_mm) / 1000.0
        samples = clock_samples(states, (at_s[rows] - off.reference_s) / 3600.0, lever_m)
        out = np.zeros((len(at_s), 3))
        for name, d in components:
            out[rows, d] = -timed.predict(name, states, samples)[0]
        return out

    return {DEFAULT: by_model(trained.model), ONE_SENSOR: by_model(trained.paper_model), CLOCK: by_clock}


def _column_rows(twin: Twin, positions_mm: Mapping[str, Floats]) -> Ints:
    """Points at which all axes but the column's stand in the middle."""
    middle = [
        positions_mm[a.name] == 0.5 * (a.travel_mm[0] + a.travel_mm[1])
        for a in twin.machine.description.axes
        if a.name != COLUMN
    ]
    return np.flatnonzero(np.all(middle, axis=0))


def tenth_percentiles(rows: Sequence[Deviation]) -> list[tuple[str, str, float, float]]:
    """Method, direction, and the 10th percentiles of the measured and of the true reduction over the machines."""
    keys = dict.fromkeys((row.method, row.direction) for row in rows)
    out = []
    for method, direction in keys:
        own = [row for row in rows if (row.method, row.direction) == (method, direction)]
        measured = float(np.quantile([row.measured_percent for row in own], 0.1))
        out.append((method, direction, measured, float(np.quantile([row.true_percent for row in own], 0.1))))
    return out

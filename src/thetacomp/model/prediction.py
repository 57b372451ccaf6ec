"""Prediction of the thermal error from a stored model, temperatures and positions. Numpy only."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from thetacomp.arrays import CARTESIAN, Bools, Floats
from thetacomp.errors import AnalysisError
from thetacomp.model.border import Limit
from thetacomp.model.document import Accuracy, AxisLaw, ModelDocument
from thetacomp.model.fallback import degraded
from thetacomp.model.filters import InputLayout, recorded_inputs
from thetacomp.model.law import Law, LawValues, joined
from thetacomp.model.temperatures import Duty, Temperatures
from thetacomp.model.wanted_length import follows_workpiece, length_error_um
from thetacomp.table_file import Cell, Number, fixed, write_table

# Rows that are worked on at once: hundreds of inputs for each must stay in the processor's cache.
BLOCK = 1024

Reference = Literal["first_row", "model"] | float


class PositionTable(Protocol):
    """Where the error is wanted, n rows; an empty `axis` asks for the drift at a fixed position."""

    @property
    def t_s(self) -> Floats:
        """Times in s, shape (n,)."""

    @property
    def axis(self) -> Sequence[str]:
        """Name of the moving axis of each row, or ""."""

    @property
    def position_mm(self) -> Floats:
        """Position of that axis, shape (n,); without meaning for drift."""


@dataclass(frozen=True)
class Breach:
    """A limit of the training that some rows break; a row without a value breaks none.

    `kind` is temperature (°C), rise (K) or position (mm), `name` the sensor or the axis. `values` are the least and
    the largest value of all rows asked for, `trained` those of the training; `rows` counts the rows outside.
    """

    kind: str
    name: str
    rows: int
    values: tuple[float, float]
    trained: tuple[float, float]


@dataclass(frozen=True)
class Prediction:
    """The predicted error `E = actual - commanded` with its 95 % bounds, n rows.

    `error_um`, `lower_um` and `upper_um` are (n, 3) along machine X, Y, Z; NaN where the model has no such component,
    where a temperature is missing, or (bounds only) where the fit had no degree of freedom. `in_domain` is (n,);
    `missing` (n,) marks rows without a temperature; `breaches` says why rows lie outside. `replaced` names the
    components that came from a fallback because a sensor is missing in the table, with its accuracy.
    """

    t_s: Floats
    axis: tuple[str, ...]
    position_mm: Floats
    error_um: Floats
    lower_um: Floats
    upper_um: Floats
    in_domain: Bools
    missing: Bools
    breaches: tuple[Breach, ...]
    replaced: dict[str, Accuracy | None] = field(default_factory=dict)


def data_row(i: int) -> str:
    """How messages name row i of the positions where nothing is known of their file."""
    return f"positions, data row {i + 1}"


def predict(
    model: ModelDocument,
    temperatures: Temperatures,
    positions: PositionTable,
    reference: Reference = "first_row",
    place: Callable[[int], str] = data_row,
    duty: Duty | None = None,
) -> Prediction:
    """Predict the error at every row of `positions`.

    `reference` is the moment of zero: the first row of the temperatures, a time in s on their clock (both drop the
    constant of the fit, so that the error is exactly zero there), or the reference stored in the model (constant
    kept). Temperatures are linear between samples; a gap stays a gap, and the last sample holds for one sampling
    interval. An error that no sensor predicts stays at its constant. Where the model has heat history for an axis it
    is used: its filters start at rest on the first row of the temperatures, and `duty` gives the spindle speed where
    the model needs it. `place` names row i of the positions in messages. Raises AnalysisError where the model cannot
    answer.
    """
    _check_axes(model, positions, place)
    asked = tuple(dict.fromkeys(positions.axis))
    model, replaced = answering(model, temperatures, asked)
    check_times(temperatures, positions.t_s, place)
    table, recording = _Table(positions), Recording(temperatures, duty, reference)
    for name in asked:
        table.fill(name, recording.values(model.in_use[name], positions.t_s[table.rows(name)]))
    if follows_workpiece(model):
        _follow_workpiece(model, temperatures, table)
    return table.prediction(replaced)


def workpiece_degC(model: ModelDocument, temperatures: Temperatures, t_s: Floats) -> Floats:
    """Temperature of the workpiece at moments (n,). Raises AnalysisError where its sensor has no column."""
    return temperatures.select((model.length.workpiece_sensor or "",)).unbridged_at(t_s)[:, 0]


def workpiece_limit(model: ModelDocument, value_degC: Floats) -> Limit:
    """The limit of the temperatures (n,) at which the workpiece is followed."""
    low, high = model.length.workpiece_degC
    inside = (value_degC >= low) & (value_degC <= high)
    return Limit("temperature", model.length.workpiece_sensor or "", value_degC, (low, high), inside)


def _follow_workpiece(model: ModelDocument, temperatures: Temperatures, table: _Table) -> None:
    """Add what following the workpiece does along each axis; outside its trusted temperatures the flag is set."""
    for axis in model.axes:
        rows = table.rows(axis.name)
        if not len(rows):
            continue
        value = workpiece_degC(model, temperatures, table.positions.t_s[rows])
        k = CARTESIAN.index(axis.cartesian)
        table.error_um[rows, k] += length_error_um(model, axis, value, table.positions.position_mm[rows])
        table.missing[rows] |= ~np.isfinite(value)
        table.limit(rows, [workpiece_limit(model, value)])


def answering(
    model: ModelDocument, temperatures: Temperatures, asked: Collection[str]
) -> tuple[ModelDocument, dict[str, Accuracy | None]]:
    """The model for the sensors that the table has; as it is where no fallback covers what the axes `asked` miss."""
    missing = {s for name in asked for s in model.in_use[name].layout.sensors} - set(temperatures.sensor_ids)
    if not missing:
        return model, {}
    rest = degraded(model, missing)
    if not set(asked) <= set(rest.model.in_use):
        return model, {}
    names = {component for name in asked for component in rest.model.in_use[name].components}
    return rest.model, {name: accuracy for name, accuracy in rest.replaced.items() if name in names}


def law_values(
    model: ModelDocument,
    axis: str,
    temperatures: Temperatures,
    t_s: Floats,
    reference: Reference,
    place: Callable[[int], str] = data_row,
    duty: Duty | None = None,
) -> LawValues:
    """What the law that answers for an axis says at moments (n,); arguments and errors as in `predict`."""
    check_times(temperatures, t_s, place)
    rest, _ = answering(model, temperatures, (axis,))
    return Recording(temperatures, duty, reference).values(rest.in_use[axis], t_s)


class Recording:
    """One recording as the laws see it: laws of the same layout share filters and samples.

    `reference` is as in `predict`. Raises AnalysisError for a missing sensor, speed or reference.
    """

    def __init__(self, temperatures: Temperatures, duty: Duty | None, reference: Reference) -> None:
        self.temperatures, self.duty, self.reference = temperatures.evenly_sampled(), duty, reference
        self._inputs: dict[InputLayout, Temperatures] = {}

    def values(self, axis: AxisLaw, t_s: Floats) -> LawValues:
        """The law of an axis at moments (n,) on the clock of the temperatures; filters start at rest on the first."""
        inputs, sensors = self._inputs_of(axis.layout), len(axis.layout.sensors)
        law = Law.of_model(axis)
        if self.reference != "model":
            at_s = _reference_s(self.temperatures, self.reference)
            zero = inputs.unbridged_at(np.array([at_s]))[0]
            _refuse_missing_reference([s for s, v in zip(axis.layout.sensors, zero, strict=False) if v != v], at_s)
            law = Law(axis, zero, keeps_constant=False)
        parts = []
        for start in range(0, max(len(t_s), 1), BLOCK):
            now = inputs.unbridged_at(t_s[start : start + BLOCK])
            parts.append(law.at(axis.layout.since(now, law.zero), now[:, :sensors]))
        return joined(parts)

    def _inputs_of(self, layout: InputLayout) -> Temperatures:
        if layout not in self._inputs:
            duty = self.duty if layout.speed_powers else None
            _check_duty_clock(self.temperatures, duty)
            clock_s, inputs = recorded_inputs(layout, self.temperatures, duty)
            self._inputs[layout] = Temperatures(clock_s, tuple(map(str, range(inputs.shape[1]))), inputs)
        return self._inputs[layout]


class _Table:
    """The rows of a prediction while they are being filled in, axis by axis."""

    def __init__(self, positions: PositionTable) -> None:
        n = len(positions.t_s)
        self.positions = positions
        self._axis = np.array(positions.axis, dtype=str)
        self.error_um, self.half_um = np.full((n, 3), np.nan), np.full((n, 3), np.nan)
        self.domain, self.missing = np.ones(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
        self.seen: list[tuple[NDArray[np.intp], Limit]] = []

    def rows(self, axis: str) -> NDArray[np.intp]:
        """Rows of one axis, "" for drift."""
        return np.flatnonzero(self._axis == axis)

    def fill(self, axis: str, values: LawValues) -> None:
        """Enter what the law of an axis says at its rows."""
        rows = self.rows(axis)
        position_mm = self.positions.position_mm[rows]
        u_m = values.law.u_m(position_mm)
        self.error_um[rows], self.half_um[rows] = values.errors_um(u_m), values.half_widths_um(u_m)
        self.missing[rows] |= values.missing
        self.limit(rows, values.limits(position_mm))

    def limit(self, rows: NDArray[np.intp], limits_: Sequence[Limit]) -> None:
        """Take the rows out of the domain that break one of these limits."""
        for one in limits_:
            self.domain[rows] &= one.inside
            self.seen.append((rows, one))

    def prediction(self, replaced: dict[str, Accuracy | None]) -> Prediction:
        """The finished table: a row without an input has no values."""
        lower_um, upper_um = self.error_um - self.half_um, self.error_um + self.half_um
        for values in (self.error_um, lower_um, upper_um):
            values[self.missing] = np.nan
        return Prediction(
            t_s=self.positions.t_s,
            axis=tuple(self.positions.axis),
            position_mm=self.positions.position_mm,
            error_um=self.error_um,
            lower_um=lower_um,
            upper_um=upper_um,
            in_domain=self.domain,
            missing=self.missing,
            breaches=breaches_of(self.seen),
            replaced=replaced,
        )


def write_prediction(prediction: Prediction, path: Path) -> None:
    """Write the prediction as CSV or .xlsx, by the ending of `path`; an empty cell is a value that is not known."""
    header = ["t_s", "axis", "position_mm", *(f"d{d}_um" for d in CARTESIAN)]
    header += [f"d{d}_{side}_um" for d in CARTESIAN for side in ("lo", "hi")]
    rows: Iterator[list[Cell]] = (
        [
            exact(prediction.t_s[i]),
            prediction.axis[i],
            exact(prediction.position_mm[i]),
            *(fixed(value, 4) for value in prediction.error_um[i]),
            *(fixed(side[i, k], 4) for k in range(3) for side in (prediction.lower_um, prediction.upper_um)),
            int(prediction.in_domain[i]),
        ]
        for i in range(len(prediction.t_s))
    )
    write_table(path, [*header, "in_domain"], rows)


def breaches_of(seen: Sequence[tuple[NDArray[np.intp], Limit]]) -> tuple[Breach, ...]:
    """One entry a broken limit, from limits at rows: axes may share a sensor, and a row counts once."""
    grouped: dict[tuple[str, str, tuple[float, float]], list[tuple[NDArray[np.intp], Limit]]] = {}
    for rows, limit in seen:
        grouped.setdefault((limit.kind, limit.name, limit.trained), []).append((rows, limit))
    out = []
    for (kind, name, trained), parts in grouped.items():
        outside = [rows[~one.inside & np.isfinite(one.value)] for rows, one in parts]
        count = len(outside[0]) if len(parts) == 1 else len(np.unique(np.concatenate(outside)))
        if count:
            values = np.concatenate([one.value for _, one in parts])
            out.append(Breach(kind, name, count, (float(np.nanmin(values)), float(np.nanmax(values))), trained))
    return tuple(out)


def _check_axes(model: ModelDocument, positions: PositionTable, place: Callable[[int], str]) -> None:
    known = model.in_use
    axis = np.array(positions.axis, dtype=str)
    unknown = ~np.isin(axis, list(known)) if known else np.ones(len(axis), dtype=np.bool_)
    bad = np.flatnonzero(unknown | ((axis != "") & ~np.isfinite(positions.position_mm)))
    if not len(bad):
        return
    i = int(bad[0])
    name = str(axis[i])
    if not unknown[i]:
        raise AnalysisError(f"{place(i)}: axis {name} without a position_mm. Fix: fill in the position.")
    asked = f"axis {name!r}" if name else "drift at a fixed position (axis empty)"
    drift = "drift too (axis empty)" if "" in known else "no drift"
    raise AnalysisError(
        f"{place(i)}: the model has no component for {asked}."
        f" It knows the axes {', '.join(sorted(filter(None, known))) or 'none'}, and {drift}. Fix: name one of these."
    )


def check_times(temperatures: Temperatures, t_s: Floats, place: Callable[[int], str]) -> None:
    """Raise AnalysisError where moments (n,) lie before the temperatures, or all of them after."""
    if not len(temperatures.t_s):
        raise AnalysisError("temperatures: the table has no rows. Fix: give the samples of the time wanted.")
    first_s, last_s = temperatures.t_s[0], temperatures.t_s[-1]
    early = np.flatnonzero(t_s < first_s)
    if len(early):
        raise AnalysisError(
            f"{place(int(early[0]))}: t_s = {exact(t_s[early[0]])} lies before the first"
            f" temperature sample at t_s = {exact(first_s)} ({len(early)} such rows)."
            " Fix: bring both tables to the same clock, or start the temperatures earlier."
        )
    if len(t_s) and (t_s > last_s + temperatures.interval_s).all():
        raise AnalysisError(
            f"positions: all rows lie after the last temperature sample at t_s = {exact(last_s)}."
            " Fix: bring both tables to the same clock, or let the temperatures go on longer."
        )


def _check_duty_clock(temperatures: Temperatures, duty: Duty | None) -> None:
    """A duty table of another clock would look like one speed that never changes."""
    if duty is None or not len(duty.t_s) or not len(temperatures.t_s):
        return
    if duty.t_s[-1] < temperatures.t_s[0] or duty.t_s[0] > temperatures.t_s[-1]:
        raise AnalysisError(
            f"duty: its rows run from t_s = {exact(duty.t_s[0])} to {exact(duty.t_s[-1])}, the temperatures from"
            f" {exact(temperatures.t_s[0])} to {exact(temperatures.t_s[-1])}: they never meet."
            " Fix: bring both tables to the same clock."
        )


def _reference_s(temperatures: Temperatures, reference: Reference) -> float:
    """The moment of zero on the clock of the temperatures."""
    at_s = float(temperatures.t_s[0]) if reference == "first_row" else float(reference)
    if not temperatures.t_s[0] <= at_s <= temperatures.t_s[-1]:
        raise AnalysisError(
            f"reference {exact(at_s) or at_s} s lies outside the temperatures,"
            f" which run from {exact(temperatures.t_s[0])} to {exact(temperatures.t_s[-1])} s."
            " Fix: choose a time inside, or `--reference model`."
        )
    return at_s


def _refuse_missing_reference(lacking: Sequence[str], at_s: float) -> None:
    if lacking:
        raise AnalysisError(
            f"temperatures: {', '.join(lacking)} has no value at the reference, t_s = {exact(at_s)}."
            " Fix: choose another moment with `--reference TIME`, or `--reference model`."
        )


def exact(value: float) -> Number | str:
    """A number with all its digits, as a cell or in a message; empty where there is no finite value."""
    return Number(np.format_float_positional(value, trim="-")) if np.isfinite(value) else ""

"""Prediction of the thermal error from a stored model, temperatures and positions. Numpy only."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from thetacomp.arrays import CARTESIAN, Bools, Floats
from thetacomp.errors import AnalysisError
from thetacomp.model.document import Accuracy, Component, HistoryAxis, ModelDocument
from thetacomp.model.domain import Limit, history_limits, limits
from thetacomp.model.fallback import degraded
from thetacomp.model.filters import recorded_inputs
from thetacomp.model.history_law import HistoryLaw, HistoryMoments, check_history
from thetacomp.model.law import Law, laws
from thetacomp.model.temperatures import Duty, Temperatures
from thetacomp.model.wanted_length import follows_workpiece, length_error_um
from thetacomp.table_file import Cell, Number, fixed, write_table

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
    `missing` (n,) marks rows without a temperature; `breaches` tells why rows lie outside. `replaced` names the
    components that came from a fallback because the table lacks a sensor, with the accuracy of it.
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
    model, replaced = _without_missing(model, temperatures, positions)
    wanted = {name: c for name, c in model.components.items() if _asked_for(c, positions)}
    _check_axes(model, positions, wanted, place)
    _check_times(temperatures, positions, place)
    table = _Table(positions)
    static = {name: c for name, c in wanted.items() if (c.axis or "") not in model.history}
    _predict_static(model.model_copy(update={"components": static}), temperatures, reference, table)
    for name in dict.fromkeys(positions.axis):
        if name in model.history:
            check_history(name, model.history[name])
            _predict_history(model.history[name], temperatures, duty, reference, table)
    if follows_workpiece(model):
        _follow_workpiece(model, temperatures, table)
    return table.prediction(replaced)


def workpiece_degC(model: ModelDocument, temperatures: Temperatures, t_s: Floats) -> Floats:
    """Temperature of the workpiece at moments (n,). Raises AnalysisError where its sensor has no column."""
    return temperatures.select((model.length.workpiece_sensor or "",)).unbridged_at(t_s)[:, 0]


def _follow_workpiece(model: ModelDocument, temperatures: Temperatures, table: _Table) -> None:
    """Add what following the workpiece does along each axis; outside its believed temperatures the flag goes on."""
    for axis in model.axes:
        rows = table.rows(axis.name)
        if not len(rows):
            continue
        value = workpiece_degC(model, temperatures, table.positions.t_s[rows])
        k = CARTESIAN.index(axis.cartesian)
        table.error_um[rows, k] += length_error_um(model, axis, value, table.positions.position_mm[rows])
        table.missing[rows] |= ~np.isfinite(value)
        low, high = model.length.workpiece_degC
        inside = (value >= low) & (value <= high)
        sensor = model.length.workpiece_sensor or ""
        table.limit(rows, [Limit("temperature", sensor, value, (low, high), inside)])


def _without_missing(
    model: ModelDocument, temperatures: Temperatures, positions: PositionTable
) -> tuple[ModelDocument, dict[str, Accuracy | None]]:
    """The model for the sensors that the table has; as it is where no fallback covers what is missing."""
    asked = set(positions.axis)
    needed = {s for c in model.components.values() if (c.axis or "") in asked - set(model.history) for s in c.inputs}
    needed |= {s for key, axis in model.history.items() if key in asked for s in axis.layout.sensors}
    missing = needed - set(temperatures.sensor_ids)
    if not missing:
        return model, {}
    rest = degraded(model, missing)
    if any((model.components[name].axis or "") in asked for name in rest.ended):
        return model, {}
    names = {name for name, c in model.components.items() if (c.axis or "") in asked}
    return rest.model, {name: accuracy for name, accuracy in rest.replaced.items() if name in names}


class _Table:
    """The rows of a prediction while they are being filled in, axis by axis."""

    def __init__(self, positions: PositionTable) -> None:
        n = len(positions.t_s)
        self.positions = positions
        self.axis = np.array(positions.axis, dtype=str)
        self.error_um, self.half_um = np.full((n, 3), np.nan), np.full((n, 3), np.nan)
        self.domain, self.missing = np.ones(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
        self.seen: list[tuple[NDArray[np.intp], Limit]] = []

    def rows(self, axis: str | None) -> NDArray[np.intp]:
        """Rows of one axis, None for drift."""
        return np.flatnonzero(self.axis == (axis or ""))

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
            breaches=_breaches(self.seen),
            replaced=replaced,
        )


def _predict_static(model: ModelDocument, temperatures: Temperatures, reference: Reference, table: _Table) -> None:
    inputs = tuple(dict.fromkeys(sensor for component in model.components.values() for sensor in component.inputs))
    read = temperatures.select(inputs)
    bound = laws(model, _reference_degC(read, reference))
    degC = dict(zip(inputs, read.unbridged_at(table.positions.t_s).T, strict=True))
    for law in bound.values():
        rows = table.rows(law.component.axis)
        position_mm = table.positions.position_mm[rows]
        theta = np.array([degC[sensor][rows] for sensor in law.inputs]).reshape(len(law.inputs), len(rows)).T
        k = CARTESIAN.index(law.component.direction)
        table.error_um[rows, k], table.half_um[rows, k] = _row_values(law, theta, position_mm)
        table.missing[rows] |= ~np.isfinite(theta).all(axis=1)
        table.limit(rows, limits(law, model.training, theta, position_mm))


def _predict_history(
    axis: HistoryAxis, temperatures: Temperatures, duty: Duty | None, reference: Reference, table: _Table
) -> None:
    rows = table.rows(axis.axis)
    t_s, position_mm = table.positions.t_s[rows], table.positions.position_mm[rows]
    law = history_law(axis, temperatures, duty, reference, t_s)
    lever_m = np.zeros(len(rows)) if axis.p0_mm is None else (position_mm - axis.p0_mm) / 1000.0
    for name, component in axis.components.items():
        k = CARTESIAN.index(component.direction)
        table.error_um[rows, k] = law.error_um(name, lever_m)
        table.half_um[rows, k] = law.half_width_um(name)
    table.missing[rows] |= ~np.isfinite(law.moments.moved).all(axis=1)
    table.limit(rows, history_limits(law, position_mm))


def history_law(
    axis: HistoryAxis, temperatures: Temperatures, duty: Duty | None, reference: Reference, t_s: Floats
) -> HistoryLaw:
    """The law of an axis on heat history at the moments `t_s`, which lie on the clock of the temperatures.

    The filters start at rest on the first row. Raises AnalysisError for a missing sensor, speed or reference.
    """
    if not axis.layout.speed_powers:
        duty = None
    _check_duty_clock(temperatures, duty)
    clock_s, inputs = recorded_inputs(axis.layout, temperatures, duty)
    recorded = Temperatures(clock_s, tuple(str(j) for j in range(inputs.shape[1])), inputs)
    if reference == "model":
        zero = np.array(axis.reference.inputs)
    else:
        at_s = _reference_s(temperatures, reference)
        zero = recorded.unbridged_at(np.array([at_s]))[0]
        lacking = [s for s, value in zip(axis.layout.sensors, zero, strict=False) if not np.isfinite(value)]
        _refuse_missing_reference(lacking, at_s)
    values = recorded.unbridged_at(t_s)
    return HistoryLaw(axis, HistoryMoments(values - zero, values[:, : len(axis.layout.sensors)]))


def write_prediction(prediction: Prediction, path: Path) -> None:
    """Write the prediction as CSV or .xlsx, by the ending of `path`; an empty cell is a value that cannot be told."""
    header = ["t_s", "axis", "position_mm", *(f"d{d}_um" for d in CARTESIAN)]
    header += [f"d{d}_{side}_um" for d in CARTESIAN for side in ("lo", "hi")]
    rows: Iterator[list[Cell]] = (
        [
            _plain(prediction.t_s[i]),
            prediction.axis[i],
            _plain(prediction.position_mm[i]),
            *(fixed(value, 4) for value in prediction.error_um[i]),
            *(fixed(side[i, k], 4) for k in range(3) for side in (prediction.lower_um, prediction.upper_um)),
            int(prediction.in_domain[i]),
        ]
        for i in range(len(prediction.t_s))
    )
    write_table(path, [*header, "in_domain"], rows)


def _breaches(seen: Sequence[tuple[NDArray[np.intp], Limit]]) -> tuple[Breach, ...]:
    """One entry a broken limit: errors of one axis share their inputs, and a row counts once."""
    grouped: dict[tuple[str, str, tuple[float, float]], list[tuple[NDArray[np.intp], Limit]]] = {}
    for rows, limit in seen:
        grouped.setdefault((limit.kind, limit.name, limit.trained), []).append((rows, limit))
    out = []
    for (kind, name, trained), parts in grouped.items():
        outside: set[int] = set()
        for rows, limit in parts:
            outside |= set(rows[~limit.inside & np.isfinite(limit.value)].tolist())
        if outside:
            values = np.concatenate([limit.value for _, limit in parts])
            out.append(Breach(kind, name, len(outside), (float(np.nanmin(values)), float(np.nanmax(values))), trained))
    return tuple(out)


def _row_values(law: Law, theta_degC: Floats, position_mm: Floats) -> tuple[Floats, Floats]:
    rises_K = law.rises_K(theta_degC)
    half_um = law.half_width_um(rises_K, position_mm)
    return law.error_um(rises_K, position_mm), np.where(np.isfinite(half_um), half_um, np.nan)


def _asked_for(component: Component, positions: PositionTable) -> bool:
    return (component.axis or "") in set(positions.axis)


def _check_axes(
    model: ModelDocument, positions: PositionTable, wanted: dict[str, Component], place: Callable[[int], str]
) -> None:
    known = sorted({component.axis for component in model.components.values() if component.axis})
    answered = {component.axis or "" for component in wanted.values()}
    for i, name in enumerate(positions.axis):
        if name not in answered:
            asked = f"axis {name!r}" if name else "drift at a fixed position (axis empty)"
            drift = "drift too (axis empty)" if any(not c.axis for c in model.components.values()) else "no drift"
            raise AnalysisError(
                f"{place(i)}: the model has no component for {asked}."
                f" It knows the axes {', '.join(known) or 'none'}, and {drift}. Fix: name one of these."
            )
        if name and not np.isfinite(positions.position_mm[i]):
            raise AnalysisError(f"{place(i)}: axis {name} without a position_mm. Fix: fill in the position.")


def _check_times(temperatures: Temperatures, positions: PositionTable, place: Callable[[int], str]) -> None:
    if not len(temperatures.t_s):
        raise AnalysisError("temperatures: the table has no rows. Fix: give the samples of the time wanted.")
    first_s, last_s = temperatures.t_s[0], temperatures.t_s[-1]
    early = np.flatnonzero(positions.t_s < first_s)
    if len(early):
        raise AnalysisError(
            f"{place(int(early[0]))}: t_s = {_plain(positions.t_s[early[0]])} lies before the first"
            f" temperature sample at t_s = {_plain(first_s)} ({len(early)} such rows)."
            " Fix: bring both tables to the same clock, or start the temperatures earlier."
        )
    if len(positions.t_s) and (positions.t_s > last_s + temperatures.interval_s).all():
        raise AnalysisError(
            f"positions: all rows lie after the last temperature sample at t_s = {_plain(last_s)}."
            " Fix: bring both tables to the same clock, or let the temperatures go on longer."
        )


def _check_duty_clock(temperatures: Temperatures, duty: Duty | None) -> None:
    """A duty table of another clock would look like one speed that never changes."""
    if duty is None or not len(duty.t_s) or not len(temperatures.t_s):
        return
    if duty.t_s[-1] < temperatures.t_s[0] or duty.t_s[0] > temperatures.t_s[-1]:
        raise AnalysisError(
            f"duty: its rows run from t_s = {_plain(duty.t_s[0])} to {_plain(duty.t_s[-1])}, the temperatures from"
            f" {_plain(temperatures.t_s[0])} to {_plain(temperatures.t_s[-1])}: they never meet."
            " Fix: bring both tables to the same clock."
        )


def _reference_degC(inputs: Temperatures, reference: Reference) -> dict[str, float] | None:
    """Temperatures of the inputs at the moment of zero; None for the reference stored in the model."""
    if reference == "model":
        return None
    at_s = _reference_s(inputs, reference)
    value = dict(zip(inputs.sensor_ids, inputs.unbridged_at(np.array([at_s]))[0].tolist(), strict=True))
    _refuse_missing_reference([sensor for sensor, degC in value.items() if not np.isfinite(degC)], at_s)
    return value


def _reference_s(temperatures: Temperatures, reference: Reference) -> float:
    """The moment of zero on the clock of the temperatures."""
    at_s = float(temperatures.t_s[0]) if reference == "first_row" else float(reference)
    if not temperatures.t_s[0] <= at_s <= temperatures.t_s[-1]:
        raise AnalysisError(
            f"reference {_plain(at_s)} s lies outside the temperatures, which run from {_plain(temperatures.t_s[0])}"
            f" to {_plain(temperatures.t_s[-1])} s. Fix: choose a time inside, or `--reference model`."
        )
    return at_s


def _refuse_missing_reference(lacking: Sequence[str], at_s: float) -> None:
    if lacking:
        raise AnalysisError(
            f"temperatures: {', '.join(lacking)} has no value at the reference, t_s = {_plain(at_s)}."
            " Fix: choose another moment with `--reference TIME`, or `--reference model`."
        )


def _plain(value: float) -> Number | str:
    return Number(np.format_float_positional(value, trim="-")) if np.isfinite(value) else ""

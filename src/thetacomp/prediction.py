"""Prediction of the thermal error from a stored model, temperatures and positions. Numpy only."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from thetacomp.campaign import CARTESIAN, Floats, Temperatures
from thetacomp.compensation.domain import Limit, limits
from thetacomp.compensation.law import Law, laws
from thetacomp.errors import AnalysisError
from thetacomp.models.document import Component, ModelDocument

Reference = Literal["first_row", "model"] | float
Bools = NDArray[np.bool_]


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
    `missing` (n,) marks rows without a temperature; `breaches` tells why rows lie outside.
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


def data_row(i: int) -> str:
    """How messages name row i of the positions where nothing is known of their file."""
    return f"positions, data row {i + 1}"


def predict(
    model: ModelDocument,
    temperatures: Temperatures,
    positions: PositionTable,
    reference: Reference = "first_row",
    place: Callable[[int], str] = data_row,
) -> Prediction:
    """Predict the error at every row of `positions`.

    `reference` is the moment of zero: the first row of the temperatures, a time in s on their clock (both drop the
    constant of the fit, so that the error is exactly zero there), or the reference stored in the model (constant
    kept). Temperatures are linear between samples; a gap stays a gap, and the last sample holds for one sampling
    interval. An error that no sensor predicts stays at its constant. `place` names row i of the positions in
    messages. Raises AnalysisError where the model cannot answer.
    """
    wanted = {name: c for name, c in model.components.items() if _asked_for(c, positions)}
    _check_axes(model, positions, wanted, place)
    cut = model.model_copy(update={"components": wanted})
    inputs = tuple(dict.fromkeys(sensor for component in wanted.values() for sensor in component.inputs))
    columns = _columns(temperatures, inputs)
    _check_times(temperatures, positions, place)
    bound = laws(cut, _reference_degC(temperatures, inputs, columns, reference))
    degC = dict(zip(inputs, sampled(temperatures, positions.t_s)[:, columns].T, strict=True))

    n = len(positions.t_s)
    axis = np.array(positions.axis, dtype=str)
    error_um, lower_um, upper_um = (np.full((n, 3), np.nan) for _ in range(3))
    domain, missing = np.ones(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
    seen: list[tuple[NDArray[np.intp], Limit]] = []
    for law in bound.values():
        rows = np.flatnonzero(axis == (law.component.axis or ""))
        theta = np.array([degC[sensor][rows] for sensor in law.inputs]).reshape(len(law.inputs), len(rows)).T
        k = CARTESIAN.index(law.component.direction)
        error_um[rows, k], half_um = _row_values(law, theta, positions.position_mm[rows])
        lower_um[rows, k], upper_um[rows, k] = error_um[rows, k] - half_um, error_um[rows, k] + half_um
        missing[rows] |= ~np.isfinite(theta).all(axis=1)
        for limit in limits(law, model.training, theta, positions.position_mm[rows]):
            domain[rows] &= limit.inside
            seen.append((rows, limit))
    for values in (error_um, lower_um, upper_um):
        values[missing] = np.nan
    return Prediction(
        t_s=positions.t_s,
        axis=tuple(positions.axis),
        position_mm=positions.position_mm,
        error_um=error_um,
        lower_um=lower_um,
        upper_um=upper_um,
        in_domain=domain,
        missing=missing,
        breaches=_breaches(seen),
    )


def sampled(temperatures: Temperatures, t_s: Floats) -> Floats:
    """Temperatures at other times, shape (len(t_s), sensors): linear between two samples that both exist, else NaN.

    After the last sample it holds for one sampling interval (the median one), no longer: a logger that stopped must
    not look like a machine that stays warm.
    """
    clock = temperatures.t_s
    after = np.clip(np.searchsorted(clock, t_s, side="left"), 0, len(clock) - 1)
    before = np.where((clock[after] > t_s) & (after > 0), after - 1, after)
    step_s = np.where(after > before, clock[after] - clock[before], 1.0)
    share = np.where(after > before, (t_s - clock[before]) / step_s, 0.0)[:, None]
    value = temperatures.value_degC[before] * (1.0 - share) + temperatures.value_degC[after] * share
    value[(t_s < clock[0]) | (t_s > clock[-1] + _interval_s(temperatures))] = np.nan
    return value


def write_prediction(prediction: Prediction, path: Path) -> None:
    """Write the prediction as CSV (UTF-8, decimal point); an empty cell is a value that cannot be told."""
    header = ["t_s", "axis", "position_mm", *(f"d{d}_um" for d in CARTESIAN)]
    header += [f"d{d}_{side}_um" for d in CARTESIAN for side in ("lo", "hi")]
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*header, "in_domain"])
        for i in range(len(prediction.t_s)):
            bounds = [side[i, k] for k in range(3) for side in (prediction.lower_um, prediction.upper_um)]
            writer.writerow(
                [
                    _plain(prediction.t_s[i]),
                    prediction.axis[i],
                    _plain(prediction.position_mm[i]),
                    *(_micrometres(value) for value in (*prediction.error_um[i], *bounds)),
                    int(prediction.in_domain[i]),
                ]
            )


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


def _columns(temperatures: Temperatures, inputs: tuple[str, ...]) -> list[int]:
    lacking = [sensor for sensor in inputs if sensor not in temperatures.sensor_ids]
    if lacking:
        raise AnalysisError(
            f"temperatures: no column {', '.join(lacking)}, which the model needs as an input;"
            f" found {', '.join(temperatures.sensor_ids)}. Fix: add the column, or give it the name used in training."
        )
    return [temperatures.sensor_ids.index(sensor) for sensor in inputs]


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
    if len(positions.t_s) and (positions.t_s > last_s + _interval_s(temperatures)).all():
        raise AnalysisError(
            f"positions: all rows lie after the last temperature sample at t_s = {_plain(last_s)}."
            " Fix: bring both tables to the same clock, or let the temperatures go on longer."
        )


def _interval_s(temperatures: Temperatures) -> float:
    return float(np.median(np.diff(temperatures.t_s))) if len(temperatures.t_s) > 1 else 0.0


def _reference_degC(
    temperatures: Temperatures, inputs: tuple[str, ...], columns: list[int], reference: Reference
) -> dict[str, float] | None:
    """Temperatures of the inputs at the moment of zero; None for the reference stored in the model."""
    if reference == "model":
        return None
    at_s = float(temperatures.t_s[0]) if reference == "first_row" else float(reference)
    if not temperatures.t_s[0] <= at_s <= temperatures.t_s[-1]:
        raise AnalysisError(
            f"reference {_plain(at_s)} s lies outside the temperatures, which run from {_plain(temperatures.t_s[0])}"
            f" to {_plain(temperatures.t_s[-1])} s. Fix: choose a time inside, or `--reference model`."
        )
    value = sampled(temperatures, np.array([at_s]))[0, columns]
    lacking = [sensor for sensor, degC in zip(inputs, value, strict=True) if not np.isfinite(degC)]
    if lacking:
        raise AnalysisError(
            f"temperatures: {', '.join(lacking)} has no value at the reference, t_s = {_plain(at_s)}."
            " Fix: choose another moment with `--reference TIME`, or `--reference model`."
        )
    return dict(zip(inputs, value.tolist(), strict=True))


def _plain(value: float) -> str:
    return np.format_float_positional(value, trim="-") if np.isfinite(value) else ""


def _micrometres(value: float) -> str:
    return f"{value:.4f}" if np.isfinite(value) else ""

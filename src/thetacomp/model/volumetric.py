"""Volumetric prediction: the thermal error at any position of all axes, from a stored model in the joint form.

All values come from `prediction.predict`, whatever family a component is of; `volume` puts them together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from thetacomp.arrays import CARTESIAN, Bools, Floats
from thetacomp.errors import AnalysisError
from thetacomp.machine import WantedLength
from thetacomp.model.axis_chain import ChainAxis, chain_of
from thetacomp.model.document import Accuracy, ModelDocument
from thetacomp.model.prediction import Breach, Prediction, Reference, data_row, predict, workpiece_degC
from thetacomp.model.temperatures import Duty, Temperatures
from thetacomp.model.volume import Part, ThermalParts, spindle_lean, volume_error
from thetacomp.model.wanted_length import follows_workpiece, length_error_um
from thetacomp.table_file import Cell, Number, fixed, write_table

ANGLES = ("A", "B", "C")


@dataclass(frozen=True)
class VolumePrediction:
    """The predicted error of the tool `E = actual - commanded` at n positions of all axes, with 95 % bounds.

    `error_um`, `lower_um`, `upper_um` are (n, 3) along machine X, Y, Z; NaN where a component was not measured, a
    temperature is missing, or (bounds only) a fit had no degree of freedom. `absent` names what was not measured.
    `replaced` is as in Prediction; `lean` says what a change of the tool length was taken to do.
    """

    t_s: Floats
    positions_mm: Mapping[str, Floats]
    tool_length_mm: Floats
    error_um: Floats
    lower_um: Floats
    upper_um: Floats
    in_domain: Bools
    missing: Bools
    breaches: tuple[Breach, ...]
    absent: tuple[str, ...]
    lean: str
    replaced: Mapping[str, Accuracy | None]


@dataclass(frozen=True)
class _Rows:
    """Rows as `predict` asks for them: one axis, or drift."""

    t_s: Floats
    axis: tuple[str, ...]
    position_mm: Floats


def predict_volume(
    model: ModelDocument,
    temperatures: Temperatures,
    t_s: Floats,
    positions_mm: Mapping[str, Floats],
    tool_length_mm: Floats | None = None,
    reference: Reference = "first_row",
    place: Callable[[int], str] = data_row,
    duty: Duty | None = None,
) -> VolumePrediction:
    """Predict the error of the tool at n moments and positions of all axes of the model.

    `tool_length_mm` (n,) is by default that of the model's measurements. `reference` and `duty` as in `predict`. Raises
    AnalysisError for a model in separate form, for missing positions, and for a tool length without known effect.
    """
    chain = _chain(model, positions_mm, place)
    length_mm = np.full(len(t_s), model.tool_length_mm) if tool_length_mm is None else tool_length_mm
    longer_mm = length_mm - model.tool_length_mm
    _check_length(model, chain, longer_mm, place)

    # The workpiece is followed once, at the end: the slopes are asked for a metre from P0.
    plain = model.model_copy(update={"length": WantedLength()})

    def ask(document: ModelDocument, axis: str, position_mm: Floats) -> Prediction:
        rows = _Rows(t_s, (axis,) * len(t_s), position_mm)
        return predict(document, temperatures, rows, reference, place, duty)

    seen = [ask(plain, "", np.full(len(t_s), np.nan)), *(ask(plain, a.name, positions_mm[a.name]) for a in chain)]
    metre = {a.name: np.full(len(t_s), a.p0_mm + 1000.0) for a in chain}
    slopes, bends = {}, {}
    for a in chain:
        # A metre to either side of P0: the odd part is the slope, the even part the bend.
        ahead, behind = (ask(plain, a.name, np.full(len(t_s), a.p0_mm + d_mm)) for d_mm in (1000.0, -1000.0))
        slopes[a.name] = Part(0.5 * (ahead.error_um - behind.error_um), _part(ahead).half_width)
        bends[a.name] = 0.5 * (ahead.error_um + behind.error_um)
    turning, angle, angle_slopes = _angle_document(plain), None, {}
    if turning.components:
        angle = _part(ask(turning, "", np.full(len(t_s), np.nan)))
        angle_slopes = {a.name: _part(ask(turning, a.name, metre[a.name])) for a in chain}
    there_um = {a.name: _part(one).half_width for a, one in zip(chain, seen[1:], strict=True)}
    reading_um = {a.name: _reading_um(plain, a.name) for a in chain}
    parts = ThermalParts(_part(seen[0]), slopes, angle, angle_slopes, there_um, reading_um, bends)
    error_um, half_um = volume_error(chain, parts, positions_mm, longer_mm)
    missing = np.any([one.missing for one in seen], axis=0)
    if follows_workpiece(model):
        degC = workpiece_degC(model, temperatures, t_s)
        missing |= ~np.isfinite(degC)
        for axis in (axis for axis in model.axes if axis.name in positions_mm):
            error_um[:, CARTESIAN.index(axis.cartesian)] += length_error_um(model, axis, degC, positions_mm[axis.name])
    half_um[~np.isfinite(error_um)] = np.nan
    return VolumePrediction(
        t_s=t_s,
        positions_mm={a.name: positions_mm[a.name] for a in chain},
        tool_length_mm=length_mm,
        error_um=error_um,
        lower_um=error_um - half_um,
        upper_um=error_um + half_um,
        in_domain=np.all([one.in_domain for one in seen], axis=0),
        missing=missing,
        breaches=_merged([breach for one in seen for breach in one.breaches]),
        absent=tuple(f"E{d}{a.name}" for a in chain for d in CARTESIAN if f"E{d}{a.name}" not in model.components),
        lean=_lean_text(model, chain) if np.any(longer_mm) else "",
        replaced={name: accuracy for one in seen for name, accuracy in one.replaced.items()},
    )


def write_volume(prediction: VolumePrediction, path: Path) -> None:
    """Write the prediction as CSV or .xlsx, by the ending of `path`; an empty cell is a value that cannot be told."""
    axes = list(prediction.positions_mm)
    header = ["t_s", *(f"{name}_mm" for name in axes), "tool_length_mm", *(f"d{d}_um" for d in CARTESIAN)]
    header += [f"d{d}_{side}_um" for d in CARTESIAN for side in ("lo", "hi")]
    rows: Iterator[list[Cell]] = (
        [
            *(_plain(v) for v in (prediction.t_s[i], *(prediction.positions_mm[name][i] for name in axes))),
            _plain(prediction.tool_length_mm[i]),
            *(fixed(value, 4) for value in prediction.error_um[i]),
            *(fixed(side[i, k], 4) for k in range(3) for side in (prediction.lower_um, prediction.upper_um)),
            int(prediction.in_domain[i]),
        ]
        for i in range(len(prediction.t_s))
    )
    write_table(path, [*header, "in_domain"], rows)


def _chain(
    model: ModelDocument, positions_mm: Mapping[str, Floats], place: Callable[[int], str]
) -> tuple[ChainAxis, ...]:
    """The measured axes in the order of the chain. Raises AnalysisError where the model or a position is missing."""
    if model.form != "joint":
        raise AnalysisError(
            "this model holds every axis on its own (separate form): each of its intercepts holds the drift, and adding"
            " them would count the drift once for each axis. Fix: measure with the positions of the other axes"
            " (at_<axis>_mm columns in sweeps.csv) and run `thetacomp analyze` again; or give t_s, axis, position_mm."
        )
    measured = {c.axis: c.p0_mm for c in model.components.values() if c.axis is not None}
    axes = [axis for axis in model.axes if axis.name in measured]
    names = [axis.name for axis in axes]
    lacking, spare = [n for n in names if n not in positions_mm], [n for n in positions_mm if n not in names]
    if lacking or spare:
        found = [f"no column {name}_mm" for name in lacking] + [f"{name}_mm is no axis of the model" for name in spare]
        raise AnalysisError(
            f"positions: {', '.join(found)}; the model knows {', '.join(names)}. Fix: give t_s and one column for each."
        )
    for name in names:
        empty = np.flatnonzero(~np.isfinite(positions_mm[name]))
        if len(empty):
            raise AnalysisError(f"{place(int(empty[0]))}: {name}_mm is empty. Fix: fill in the position of every axis.")
    # P0 as stored: the slopes were fitted about it.
    p0_mm = {name: value for name, value in measured.items() if value is not None}
    return tuple(replace(link, p0_mm=p0_mm[link.name]) for link in chain_of(axes))


def _check_length(
    model: ModelDocument, chain: tuple[ChainAxis, ...], longer_mm: Floats, place: Callable[[int], str]
) -> None:
    empty = np.flatnonzero(~np.isfinite(longer_mm))
    if len(empty):
        raise AnalysisError(f"{place(int(empty[0]))}: tool_length_mm is empty. Fix: fill it in, or drop the column.")
    if np.any(longer_mm) and not model.rotations and spindle_lean(chain) is None:
        raise AnalysisError(
            f"tool_length_mm differs from {model.tool_length_mm:g} mm, the length in the measurements, but the model"
            f" has no angles, and its last axis {chain[-1].name} does not run along the spindle (Z): what a longer tool"
            " does is not known. Fix: measure rA_urad, rB_urad, rC_urad, or leave tool_length_mm out."
        )


def _lean_text(model: ModelDocument, chain: tuple[ChainAxis, ...]) -> str:
    if model.rotations:
        return "the measured angles act on the change of the tool length"
    return f"a longer tool is taken to lean with the guide of {chain[-1].name} (no angles were measured)"


def _part(prediction: Prediction) -> Part:
    return Part(prediction.error_um, 0.5 * (prediction.upper_um - prediction.lower_um))


def _reading_um(model: ModelDocument, axis: str) -> Floats:
    """Half width (3,) of the scatter of one reading that the band of an axis holds; zero for a law on key points."""
    out = np.zeros(3)
    for component in model.history[axis].components.values() if axis in model.history else ():
        out[CARTESIAN.index(component.direction)] = component.band.quantile * component.noise_sd_um
    return out


def _angle_document(model: ModelDocument) -> ModelDocument:
    """The angles as a model of their own, named by the axis they turn about, so that one law serves both."""
    named = {
        f"{name[0]}{CARTESIAN[ANGLES.index(name[1])]}{name[2:]}": component
        for name, component in model.rotations.items()
    }
    return model.model_copy(update={"components": named, "rotations": {}, "history": {}})


def _merged(breaches: list[Breach]) -> tuple[Breach, ...]:
    """One entry a limit: several axes may use the same sensor."""
    out: dict[tuple[str, str, tuple[float, float]], Breach] = {}
    for breach in breaches:
        key = (breach.kind, breach.name, breach.trained)
        known = out.get(key)
        if known is None or breach.rows > known.rows:
            out[key] = breach
    return tuple(out.values())


def _plain(value: float) -> Number | str:
    return Number(np.format_float_positional(value, trim="-")) if np.isfinite(value) else ""

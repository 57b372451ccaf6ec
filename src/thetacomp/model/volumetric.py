"""Volumetric prediction: the thermal error at any position of all axes, from a stored model in the joint form."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from thetacomp.arrays import CARTESIAN, Bools, Floats
from thetacomp.errors import AnalysisError
from thetacomp.model.axis_chain import ChainAxis, chain_of
from thetacomp.model.document import Accuracy, AxisLaw, ModelDocument, components_of
from thetacomp.model.law import LawValues
from thetacomp.model.prediction import (
    Breach,
    Recording,
    Reference,
    answering,
    breaches_of,
    check_times,
    data_row,
    exact,
    workpiece_degC,
    workpiece_limit,
)
from thetacomp.model.temperatures import Duty, Temperatures
from thetacomp.model.volume import Part, ThermalParts, spindle_lean, volume_error, volume_slope
from thetacomp.model.wanted_length import follows_workpiece, length_error_um
from thetacomp.table_file import Cell, fixed, write_table


@dataclass(frozen=True)
class VolumePrediction:
    """The predicted error of the tool `E = actual - commanded` at n positions of all axes, with 95 % bounds.

    `error_um`, `lower_um`, `upper_um` are (n, 3) along machine X, Y, Z; NaN where a component was not measured, a
    temperature is missing, or (bounds only) a fit had no degree of freedom. `absent` names what was not measured,
    `lost_angles` the angles whose sensors the table lacks: what they do over the arms is not in the values, so no row
    counts as inside the training.
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
    lost_angles: tuple[str, ...]
    lean: str
    replaced: Mapping[str, Accuracy | None]


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
    length_mm = np.full(len(t_s), model.tool_length_mm) if tool_length_mm is None else tool_length_mm
    longer_mm = length_mm - model.tool_length_mm
    volume = _Volume(model, temperatures, t_s, positions_mm, reference, place, duty)
    chain, seen = volume.chain, volume.seen
    _check_length(model, volume, longer_mm, place)
    error_um, half_um = volume_error(chain, volume.parts(), positions_mm, longer_mm)
    missing = np.any([one.missing for one in (*seen.values(), *volume.turned.values())], axis=0)
    limits = [limit for name, one in seen.items() for limit in one.limits(positions_mm.get(name, t_s))]
    if follows_workpiece(model):
        degC = workpiece_degC(model, temperatures, t_s)
        missing |= ~np.isfinite(degC)
        limits.append(workpiece_limit(model, degC))
        for axis in (axis for axis in model.axes if axis.name in positions_mm):
            error_um[:, CARTESIAN.index(axis.cartesian)] += length_error_um(model, axis, degC, positions_mm[axis.name])
    half_um[~np.isfinite(error_um)] = np.nan
    lost_angles = set(components_of(model.rotations)) - {name for one in volume.turned.values() for name in one.terms}
    return VolumePrediction(
        t_s=t_s,
        positions_mm={a.name: positions_mm[a.name] for a in chain},
        tool_length_mm=length_mm,
        error_um=error_um,
        lower_um=error_um - half_um,
        upper_um=error_um + half_um,
        in_domain=np.all([np.full(len(t_s), not lost_angles), *(limit.inside for limit in limits)], axis=0),
        missing=missing,
        breaches=breaches_of([(np.arange(len(t_s)), limit) for limit in limits]),
        absent=_absent(chain, seen),
        lost_angles=tuple(sorted(lost_angles)),
        lean=_lean_text(volume) if np.any(longer_mm) else "",
        replaced=volume.replaced,
    )


def volume_along(
    model: ModelDocument,
    temperatures: Temperatures,
    t_s: Floats,
    positions_mm: Mapping[str, Floats],
    axis: str,
    reference: Reference = "first_row",
    place: Callable[[int], str] = data_row,
    duty: Duty | None = None,
) -> tuple[Floats, Floats, Floats]:
    """The error of the tool along one axis about where it stands: its value, slope and bend, each (n, 3).

    In µm, µm/m and µm/m²; arguments and errors as in `predict_volume`, with the tool of the measurements.
    """
    volume = _Volume(model, temperatures, t_s, positions_mm, reference, place, duty)
    parts = volume.parts()
    error_um, _ = volume_error(volume.chain, parts, positions_mm, np.zeros(len(t_s)))
    return error_um, volume_slope(volume.chain, parts, positions_mm, axis), parts.bends_um_per_m2[axis]


class _Volume:
    """The laws of drift, axes and angles at n moments; angles whose sensors are missing in the table are left out."""

    def __init__(
        self,
        model: ModelDocument,
        temperatures: Temperatures,
        t_s: Floats,
        positions_mm: Mapping[str, Floats],
        reference: Reference,
        place: Callable[[int], str],
        duty: Duty | None,
    ) -> None:
        self.chain = _chain(model, positions_mm, place)
        self.positions_mm = positions_mm
        check_times(temperatures, t_s, place)
        recording, self.replaced = Recording(temperatures, duty, reference), dict[str, Accuracy | None]()
        self.seen: dict[str, LawValues] = {}
        for name in ("", *(axis.name for axis in self.chain)):
            rest, changed = answering(model, temperatures, (name,))
            self.seen[name] = recording.values(rest.in_use[name], t_s)
            self.replaced |= changed
        known = set(temperatures.sensor_ids)
        self.turned = {
            name: recording.values(law, t_s)
            for name, law in model.rotations.items()
            if set(law.layout.sensors) <= known
        }

    def parts(self) -> ThermalParts:
        """What the laws say, as the terms of the joint form."""
        drift, own = self.seen[""], {axis.name: self.seen[axis.name] for axis in self.chain}
        return ThermalParts(
            drift=_at(drift, 0.0),
            slopes={name: Part(one.term(1), one.half_widths_um(1.0)) for name, one in own.items()},
            angle=_at(self.turned[""], 0.0) if "" in self.turned else None,
            angle_slopes={name: _at(one, 1.0) for name, one in self.turned.items() if name},
            there_um={name: one.half_widths_um(one.law.u_m(self.positions_mm[name])) for name, one in own.items()},
            reading_um={name: _reading_um(one.law.axis) for name, one in own.items()},
            bends_um_per_m2={name: one.term(2) for name, one in own.items()},
        )


def write_volume(prediction: VolumePrediction, path: Path) -> None:
    """Write the prediction as CSV or .xlsx, by the ending of `path`; an empty cell is a value that is not known."""
    axes = list(prediction.positions_mm)
    header = ["t_s", *(f"{name}_mm" for name in axes), "tool_length_mm", *(f"d{d}_um" for d in CARTESIAN)]
    header += [f"d{d}_{side}_um" for d in CARTESIAN for side in ("lo", "hi")]
    rows: Iterator[list[Cell]] = (
        [
            *(exact(v) for v in (prediction.t_s[i], *(prediction.positions_mm[name][i] for name in axes))),
            exact(prediction.tool_length_mm[i]),
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
            "this model treats every axis alone (separate form): each of its intercepts contains the drift, and adding"
            " them would count the drift once for each axis. Fix: measure with the positions of the other axes"
            " (at_<axis>_mm columns in sweeps.csv) and run `thetacomp analyze` again; or give t_s, axis, position_mm."
        )
    if "" not in model.in_use:
        raise AnalysisError(
            "the model has no drift (DX, DY, DZ), without which the error in the volume is unknown."
            " Fix: measure at a fixed position too, and run `thetacomp analyze` again."
        )
    measured = {name: law.p0_mm for name, law in model.in_use.items() if name}
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


def _check_length(model: ModelDocument, volume: _Volume, longer_mm: Floats, place: Callable[[int], str]) -> None:
    empty = np.flatnonzero(~np.isfinite(longer_mm))
    if len(empty):
        raise AnalysisError(f"{place(int(empty[0]))}: tool_length_mm is empty. Fix: fill it in, or drop the column.")
    if np.any(longer_mm) and "" not in volume.turned and spindle_lean(volume.chain) is None:
        raise AnalysisError(
            f"tool_length_mm differs from {model.tool_length_mm:g} mm, the length in the measurements, but the model"
            f" has no angles, and its last axis {volume.chain[-1].name} does not run along the spindle (Z): the"
            " effect of a longer tool is unknown. Fix: measure rA_urad, rB_urad, rC_urad, or leave tool_length_mm out."
        )


def _lean_text(volume: _Volume) -> str:
    if "" in volume.turned:
        return "the measured angles act on the change of the tool length"
    return f"a longer tool is assumed to tilt with the guide of {volume.chain[-1].name} (no angles were measured)"


def _at(values: LawValues, u_m: float) -> Part:
    return Part(values.errors_um(u_m), values.half_widths_um(u_m))


def _absent(chain: tuple[ChainAxis, ...], seen: Mapping[str, LawValues]) -> tuple[str, ...]:
    names = [(axis.name, f"E{d}{axis.name}") for axis in chain for d in CARTESIAN]
    return tuple(component for axis, component in names if component not in seen[axis].terms)


def _reading_um(law: AxisLaw) -> Floats:
    """Half width (3,) of the scatter of one reading that the bands of an axis hold."""
    out = np.zeros(3)
    for component in law.components.values():
        out[CARTESIAN.index(component.direction)] = (component.band.quantile or 0.0) * component.band.noise_sd_um
    return out

"""SINUMERIK 840D sl / ONE: which register carries which part of the thermal error, with sign and unit.

Temperature compensation of an axis is `ΔK = K0(T) + tanβ(T) (P - P0)`; sag compensation (CEC) adds to an output axis
the table of a base axis times a weight that takes effect at once (SINUMERIK Extended Functions, K3 Compensations,
03/2013). Here the slope of an axis' own error goes to its tanβ, the slope of a cross error to the weight of a straight
table, and the drift of one direction to one single K0: every intercept holds it, so it must not be added twice.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from thetacomp.arrays import CARTESIAN, Floats
from thetacomp.controllers.base import RegisterLaw, register_law
from thetacomp.errors import AnalysisError, InputError, Problem
from thetacomp.machine import Axis, Strict
from thetacomp.model.document import ModelDocument
from thetacomp.model.law import Box, ComponentLaw, box_degC, component_laws, inputs_of
from thetacomp.model.wanted_length import (
    REFERENCE_DEGC,
    expansion_um_per_m_per_K,
    follows_workpiece,
    zero_mm,
)

TABLE_POINTS = 11  # ten steps: the step stays an exact decimal number, so MAX - MIN is a whole number of steps
GRID_STATES = 10
Sign = Literal[1, -1]
Cartesian = Literal["X", "Y", "Z"]
AXIS_NAME = r"^[A-Za-z_][A-Za-z0-9_]*$"
AxisName = Annotated[str, Field(pattern=AXIS_NAME)]


class ReplaySettings(Strict):
    """`[replay]` of `export.toml`: what the replay of measured campaigns assumes of writer and control.

    `update_s`: how often the writer brings new values; `entry_step_um`: what it rounds to, at the worst position;
    `largest_entry_um`: the largest value that an operator's or PLC's entry takes, at the worst position (default:
    none); `filter_cycles`, `filter_cycle_s`: a mean over the last n cycles on the way, as ISG and TwinCAT have it
    (default: none); `md32000_mm_per_min`: fastest velocity of the axes, from which MD32760 and MD32730 count.
    """

    update_s: Annotated[float, Field(ge=0.0)] = 60.0
    entry_step_um: Annotated[float, Field(ge=0.0)] = 0.1
    largest_entry_um: Annotated[float, Field(gt=0.0)] | None = None
    filter_cycles: Annotated[int, Field(ge=1, le=1000)] = 1
    filter_cycle_s: Annotated[float, Field(gt=0.0)] = 0.004
    md32000_mm_per_min: Annotated[float, Field(gt=0.0)] = 10000.0


class SinumerikSettings(Strict):
    """`export.toml` for SINUMERIK. Every default that leaves a question open is stated in the sheet.

    `sign_temperature`, `sign_cec`: +1 writes the error with its own sign; the sign test decides.
    `axis_name`: axis of the model -> channel axis of the control (default `X` -> `X1`); `axis_number`: its number n
    in `AXn` (default: place in the model). `output_axis`: direction -> axis that corrects all errors of that
    direction (default: the axis that moved, else the first axis along the direction). `drift_source`: direction ->
    the one component whose intercept becomes K0. `reference_degC`: temperatures at the moment of zero; the constant
    of the fit is then dropped (default: the reference stored in the model, constant kept). `reserve`: factor on
    the largest values of the training range, for table slopes and clamps. `rate_limit_um_per_s`: how fast the writer
    may move an axis. `md32720_cec_max_sum_mm`: default sized from the tables. `replay`: see ReplaySettings.
    """

    sign_temperature: Sign = 1
    sign_cec: Sign = 1
    axis_name: dict[str, AxisName] = Field(default_factory=dict)
    axis_number: dict[str, Annotated[int, Field(ge=1, le=31)]] = Field(default_factory=dict)
    output_axis: dict[Cartesian, str] = Field(default_factory=dict)
    drift_source: dict[Cartesian, str] = Field(default_factory=dict)
    reference_degC: dict[str, float] | None = None
    reserve: Annotated[float, Field(ge=1.0, le=10.0)] = 1.25
    first_cec_table: Annotated[int, Field(ge=0)] = 0
    rate_limit_um_per_s: Annotated[float, Field(gt=0.0)] = 1.0
    md32760_comp_add_velo_factor: Annotated[float, Field(gt=0.0, le=0.1)] = 0.01
    md32720_cec_max_sum_mm: Annotated[float, Field(gt=0.0)] | None = None
    md32730_cec_max_velo_factor: Annotated[float, Field(gt=0.0, le=1.0)] = 0.01
    replay: ReplaySettings = Field(default_factory=ReplaySettings)


@dataclass(frozen=True)
class AxisRegisters:
    """Temperature compensation of one axis. K0 in mm, tanβ in mm/mm, P0 in mm; None where nothing is written.

    The clamps are the largest values inside the training range, with the 95 % bound and the reserve.
    """

    axis: Axis
    channel_axis: str
    drift_source: str | None
    slope_source: str | None
    register_k0_mm: RegisterLaw
    register_tan_beta: RegisterLaw
    register_p0_mm: float
    clamp_k0_mm: float
    clamp_tan_beta: float
    p_min_mm: float
    p_max_mm: float

    @property
    def compensation_type(self) -> int:
        """MD32750: bit 0 position-independent, bit 1 position-dependent."""
        return (1 if self.k0_source else 0) + (2 if self.tan_beta_source else 0)

    @property
    def k0_source(self) -> str:
        """What K0 carries, in a word or two; empty where nothing is written."""
        return self.drift_source or ("workpiece" if self.register_k0_mm.used else "")

    @property
    def tan_beta_source(self) -> str:
        """What tanβ carries, in a word or two; empty where nothing is written."""
        return self.slope_source or ("workpiece" if self.register_tan_beta.used else "")

    @property
    def longest_arm_mm(self) -> float:
        """Largest distance from P0 inside the measured range, at least 1 mm."""
        return max(abs(self.p_max_mm - self.register_p0_mm), abs(self.p_min_mm - self.register_p0_mm), 1.0)


@dataclass(frozen=True)
class SagTable:
    """One straight CEC table: `register_mm` at `TABLE_POINTS` positions of the base axis, times `weight` (-1 to 1)."""

    index: int
    source: str
    base: AxisRegisters
    output: AxisRegisters
    base_number: int
    output_number: int
    p0_mm: float
    p_min_mm: float
    p_max_mm: float
    slope_ref_um_per_m: float
    register_mm: tuple[float, ...]
    weight: RegisterLaw

    @property
    def step_mm(self) -> float:
        """Distance of two points of the table."""
        return round((self.p_max_mm - self.p_min_mm) / (TABLE_POINTS - 1), 4)

    @property
    def largest_mm(self) -> float:
        """Largest value of the table, without its sign."""
        return max(abs(value) for value in self.register_mm)


@dataclass(frozen=True)
class LeftOut:
    """An intercept that is not exported because the drift of its direction comes from `counted`.

    Both values are those of the warmest state of the grid: their difference is what the choice costs or saves.
    `bound_um` is the 95 % bound of this difference, the root of the sum of the squares of both half widths; infinite
    where a fit has no degree of freedom.
    """

    component: str
    counted: str
    direction: str
    intercept_um: float
    counted_um: float
    bound_um: float

    @property
    def difference_um(self) -> float:
        """The intercept left out less the one in use."""
        return self.intercept_um - self.counted_um

    @property
    def differs(self) -> bool:
        """True where the two differ by more than chance explains."""
        return abs(self.difference_um) > self.bound_um


@dataclass(frozen=True)
class NotExported:
    """An error along a direction that no axis corrects; `largest_um` is its size at the warmest state."""

    component: str
    direction: str
    largest_um: float


@dataclass(frozen=True)
class RegisterPlan:
    """Everything that is written: registers, tables, and the grid of states (`grid_degC`: sensor -> (n,)).

    `unpredicted` names the errors that no sensor predicts: they are not compensated.
    """

    model: ModelDocument
    settings: SinumerikSettings
    axes: tuple[AxisRegisters, ...]
    tables: tuple[SagTable, ...]
    left_out: tuple[LeftOut, ...]
    not_exported: tuple[NotExported, ...]
    unpredicted: tuple[str, ...]
    max_sum_mm: dict[str, float]
    grid_degC: dict[str, Floats]

    @property
    def sign_unproven(self) -> bool:
        """True where the model's own sign convention is not stated by its source."""
        return self.model.sign == "unproven"


def plan_registers(
    model: ModelDocument, settings: SinumerikSettings, settings_file: str = "export.toml"
) -> RegisterPlan:
    """Decide which register carries what.

    Raises InputError where the settings do not fit the model, AnalysisError where nothing can be exported.
    """
    _check_settings(model, settings, settings_file)
    every = component_laws(model.control, settings.reference_degC)
    bound = {name: law for name, law in every.items() if law.component.predicted}
    box = box_degC(bound)
    grid = {sensor: np.linspace(*box[sensor], GRID_STATES) for sensor in inputs_of(bound)}
    if follows_workpiece(model):
        sensor, (low, high) = model.length.workpiece_sensor or "", model.length.workpiece_degC
        known = box.get(sensor, (low, high))
        grid[sensor] = np.linspace(min(low, known[0]), max(high, known[1]), GRID_STATES)
    outputs = {d: _output_axis(model, bound, settings, d) for d in CARTESIAN}
    sources = {d: _drift_source(model, bound, settings, d, outputs[d]) for d in CARTESIAN if outputs[d]}

    axes = tuple(_axis_registers(axis, model, settings, bound, box, outputs, sources) for axis in model.axes)
    by_name = {registers.axis.name: registers for registers in axes}
    tables: list[SagTable] = []
    for name, law in bound.items():
        output = outputs[law.component.direction]
        if law.axis and output and not _is_own(law, model, settings):
            index = settings.first_cec_table + len(tables)
            pair = (by_name[law.axis], by_name[output])
            tables.append(_sag_table(index, name, law, model, settings, pair, box))
    needed = {t.output.axis.name: 0.0 for t in tables}
    for table in tables:
        needed[table.output.axis.name] += max(abs(value) for value in table.register_mm)
    sums = {name: math.ceil(110 * value) / 100 for name, value in needed.items()}
    _check_sum(settings, sums, settings_file)
    counted = {d: bound[source] for d, source in sources.items() if source}
    pairs = [(law, counted[d]) for law in bound.values() if (d := law.component.direction) in counted]
    # In the joint form no intercept holds the drift but that of the drift itself: nothing is left out.
    pairs = pairs if model.form == "separate" else []
    left_out = [_left_out(law, other, grid) for law, other in pairs if law is not other]
    orphans = [law for law in bound.values() if not outputs[law.component.direction]]
    if len(orphans) == len(bound):
        raise AnalysisError(_nothing(every, orphans))
    return RegisterPlan(
        model=model,
        settings=settings,
        axes=tuple(registers for registers in axes if registers.compensation_type),
        tables=tuple(tables),
        left_out=tuple(left_out),
        not_exported=tuple(_not_exported(law, grid) for law in orphans),
        unpredicted=tuple(name for name in every if name not in bound),
        max_sum_mm={name: settings.md32720_cec_max_sum_mm or value for name, value in sums.items()},
        grid_degC=grid,
    )


def _output_axis(
    model: ModelDocument, bound: Mapping[str, ComponentLaw], settings: SinumerikSettings, direction: str
) -> str | None:
    """The axis that corrects a direction: as set, else the first one with an error of its own, else the first one."""
    if direction in settings.output_axis:
        return settings.output_axis[direction]
    along = [axis.name for axis in model.axes if axis.cartesian == direction]
    measured = [name for name in along if f"E{direction}{name}" in bound]
    return next(iter(measured + along), None)


def _drift_source(
    model: ModelDocument,
    bound: Mapping[str, ComponentLaw],
    settings: SinumerikSettings,
    direction: str,
    output: str | None,
) -> str | None:
    """The one component whose intercept becomes K0: as set, else an axis along the direction, Y sweep, any other.

    In the joint form it is the drift alone: every other intercept is zero.
    """
    if model.form == "joint":
        return f"D{direction}" if f"D{direction}" in bound else None
    if direction in settings.drift_source:
        return settings.drift_source[direction]
    candidates = [name for name, law in bound.items() if law.component.direction == direction]
    along = [axis.name for axis in model.axes if axis.cartesian == direction]
    column = [axis.name for axis in model.axes if axis.cartesian == "Y"]
    order = [f"E{direction}{name}" for name in (output, *along, *column)]
    return next((name for name in (*order, *candidates) if name in candidates), None)


def _is_own(law: ComponentLaw, model: ModelDocument, settings: SinumerikSettings) -> bool:
    """True where the moving axis itself corrects this error, through its tanβ."""
    moving = next((axis for axis in model.axes if axis.name == law.axis), None)
    if moving is None or moving.cartesian != law.component.direction:
        return False
    return settings.output_axis.get(moving.cartesian, moving.name) == moving.name


def _axis_registers(
    axis: Axis,
    model: ModelDocument,
    settings: SinumerikSettings,
    bound: Mapping[str, ComponentLaw],
    box: Box,
    outputs: dict[str, str | None],
    sources: dict[str, str | None],
) -> AxisRegisters:
    # The model's error runs along the Cartesian direction, the register along the axis: its sign comes in here.
    sign = settings.sign_temperature * axis.sign
    drift = sources.get(axis.cartesian) if outputs[axis.cartesian] == axis.name else None
    own = [n for n, law in bound.items() if law.axis == axis.name and _is_own(law, model, settings)]
    slope = next(iter(own), None)
    k0, tan_beta = RegisterLaw(0.0), RegisterLaw(0.0)
    clamp_k0_mm = clamp_tan_beta = p0_mm = 0.0
    if drift:
        k0 = register_law(bound[drift], 0, sign * 1e-3)
        clamp_k0_mm = settings.reserve * 1e-3 * bound[drift].largest(0, box)
    if slope:
        tan_beta = register_law(bound[slope], 1, sign * 1e-6)
        clamp_tan_beta = settings.reserve * 1e-6 * bound[slope].largest(1, box)
        p0_mm = bound[slope].travel_mm[0]
    if follows_workpiece(model) and outputs[axis.cartesian] == axis.name:
        p0_mm = p0_mm if slope else zero_mm(model, axis)
        # Register = sign × axis.sign × E, and E that follows the workpiece is -axis.sign × …: the axis' sign cancels.
        per_K = -settings.sign_temperature * 1e-6 * expansion_um_per_m_per_K(model.length)
        span_K = max(abs(degC - REFERENCE_DEGC) for degC in model.length.workpiece_degC)
        tan_beta = _with_workpiece(tan_beta, model, per_K)
        clamp_tan_beta += abs(per_K) * span_K
        if p0_mm != zero_mm(model, axis):
            k0 = _with_workpiece(k0, model, per_K * (p0_mm - zero_mm(model, axis)))
            clamp_k0_mm += abs(per_K * (p0_mm - zero_mm(model, axis))) * span_K
    moving = [law for law in bound.values() if law.axis == axis.name]
    p_min_mm, p_max_mm = moving[0].travel_mm[1:] if moving else axis.travel_mm
    return AxisRegisters(
        axis=axis,
        channel_axis=settings.axis_name.get(axis.name, f"{axis.name}1"),
        drift_source=drift,
        slope_source=slope,
        register_k0_mm=k0,
        register_tan_beta=tan_beta,
        register_p0_mm=p0_mm,
        clamp_k0_mm=clamp_k0_mm,
        clamp_tan_beta=clamp_tan_beta,
        p_min_mm=p_min_mm,
        p_max_mm=p_max_mm,
    )


def _with_workpiece(register: RegisterLaw, model: ModelDocument, per_K: float) -> RegisterLaw:
    """The law of a register that also follows the workpiece; its reference is 20 °C, whatever the others' is."""
    sensor = model.length.workpiece_sensor or ""
    return RegisterLaw(
        constant=register.constant,
        sensors=(*register.sensors, sensor),
        factors=(*register.factors, per_K),
        reference_degC=(*register.reference_degC, REFERENCE_DEGC),
    )


def _sag_table(
    index: int,
    name: str,
    law: ComponentLaw,
    model: ModelDocument,
    settings: SinumerikSettings,
    pair: tuple[AxisRegisters, AxisRegisters],
    box: Box,
) -> SagTable:
    (base, output), (p0_mm, *ends_mm) = pair, law.travel_mm
    # Whole µm/m, so that the number in the table is the number on the sheet.
    reference = float(max(1, math.ceil(settings.reserve * law.largest(1, box))))
    p_min_mm, p_max_mm = (round(end, 3) for end in ends_mm)
    step_mm = round((p_max_mm - p_min_mm) / (TABLE_POINTS - 1), 4)
    position_mm = p_min_mm + step_mm * np.arange(TABLE_POINTS)
    register_mm = settings.sign_cec * output.axis.sign * reference * 1e-6 * (position_mm - p0_mm)
    numbers = {axis.name: settings.axis_number.get(axis.name, i + 1) for i, axis in enumerate(model.axes)}
    return SagTable(
        index=index,
        source=name,
        base=base,
        output=output,
        base_number=numbers[base.axis.name],
        output_number=numbers[output.axis.name],
        p0_mm=p0_mm,
        p_min_mm=p_min_mm,
        p_max_mm=p_max_mm,
        slope_ref_um_per_m=reference,
        register_mm=tuple(register_mm.tolist()),
        weight=register_law(law, 1, 1.0 / reference),
    )


def _warmest_K(law: ComponentLaw, grid: dict[str, Floats]) -> Floats:
    return law.rises_K(np.array([[grid[sensor][-1] for sensor in law.inputs]]))


def _left_out(law: ComponentLaw, counted: ComponentLaw, grid: dict[str, Floats]) -> LeftOut:
    def warmest_um(one: ComponentLaw) -> tuple[float, float]:
        rises_K, at_p0 = _warmest_K(one, grid), np.array([one.law.axis.p0_mm or 0.0])
        return float(one.error_um(rises_K, at_p0)[0]), float(one.half_width_um(rises_K, at_p0)[0])

    (intercept_um, half_um), (counted_um, counted_half_um) = warmest_um(law), warmest_um(counted)
    bound_um = math.hypot(half_um, counted_half_um)
    return LeftOut(law.name, counted.name, law.component.direction, intercept_um, counted_um, bound_um)


def _not_exported(law: ComponentLaw, grid: dict[str, Floats]) -> NotExported:
    ends_mm = np.array([law.law.axis.p_min_mm or 0.0, law.law.axis.p_max_mm or 0.0])
    error_um = law.error_um(np.repeat(_warmest_K(law, grid), 2, axis=0), ends_mm)
    return NotExported(law.name, law.component.direction, float(np.abs(error_um).max()))


def _nothing(every: Mapping[str, ComponentLaw], orphans: list[ComponentLaw]) -> str:
    lost = ", ".join(name for name, law in every.items() if not law.component.predicted)
    no_axis = ", ".join(f"{law.name} (no axis along {law.component.direction})" for law in orphans)
    reasons = [f"no sensor predicts {lost}"] * bool(lost) + [f"no axis corrects {no_axis}"] * bool(no_axis)
    return (
        f"nothing can be exported: {'; '.join(reasons) or 'the model has no component'}. Fix: measure with sensors"
        " that follow these errors, describe the axes in machine.toml, and run `thetacomp analyze` again."
    )


def _check_settings(model: ModelDocument, settings: SinumerikSettings, file: str) -> None:
    axes, components = {axis.name: axis for axis in model.axes}, model.components
    found: list[tuple[str, str]] = []
    for key in ("axis_name", "axis_number"):
        for name in getattr(settings, key):
            if name not in axes:
                found.append((f"{key}.{name}: the model has no axis {name}.", f"its axes are {', '.join(axes)}."))
    for direction, name in settings.output_axis.items():
        if name not in axes or axes[name].cartesian != direction:
            along = [axis.name for axis in model.axes if axis.cartesian == direction]
            found.append(
                (f"output_axis.{direction} = {name!r}: not an axis along {direction}.", f"choose from {along}.")
            )
    for direction, name in settings.drift_source.items():
        if name not in components or components[name].direction != direction:
            known = [n for n, component in components.items() if component.direction == direction]
            found.append(
                (f"drift_source.{direction} = {name!r}: not an error in {direction}.", f"choose from {known}.")
            )
        elif model.form == "joint" and name[0] == "E":
            found.append(
                (
                    f"drift_source.{direction} = {name!r}: the model is in the joint form, its drift is D{direction}.",
                    "leave the setting out.",
                )
            )
        elif not components[name].predicted:
            found.append((f"drift_source.{direction} = {name!r}: no sensor predicts it.", "choose another error."))
    if settings.reference_degC is not None:
        inputs = {sensor for law in model.control.values() for sensor in law.layout.sensors}
        lacking, spare = sorted(inputs - set(settings.reference_degC)), sorted(set(settings.reference_degC) - inputs)
        if lacking or spare:
            text = f"reference_degC: missing {lacking or 'nothing'}, not an input of the model: {spare or 'nothing'}."
            found.append((text, f"give the temperature of each of {sorted(inputs)}."))
    for axis in model.axes:
        if axis.name not in settings.axis_name and not re.match(AXIS_NAME, f"{axis.name}1"):
            found.append(
                (
                    f"axis_name: the control cannot have an axis {axis.name}1 (Latin letters, digits and _ only).",
                    f'name its channel axis in export.toml: [axis_name] "{axis.name}" = "Y1".',
                )
            )
    for key, values in (
        ("axis_number", [str(settings.axis_number.get(a.name, i + 1)) for i, a in enumerate(model.axes)]),
        ("axis_name", [settings.axis_name.get(a.name, f"{a.name}1") for a in model.axes]),
    ):
        twice = sorted({value for value in values if values.count(value) > 1})
        if twice:
            found.append((f"{key}: {', '.join(twice)} stands for two axes.", f"set [{key}] for every axis."))
    _raise(found, file)


def _check_sum(settings: SinumerikSettings, needed_mm: dict[str, float], file: str) -> None:
    limit = settings.md32720_cec_max_sum_mm
    _raise(
        [
            (
                f"md32720_cec_max_sum_mm = {limit} mm, but the tables for axis {name} reach {value} mm;"
                " the control would clamp the sum.",
                f"set at least {value}, or leave the setting out.",
            )
            for name, value in needed_mm.items()
            if limit is not None and limit < value
        ],
        file,
    )


def _raise(found: list[tuple[str, str]], file: str) -> None:
    if found:
        raise InputError([Problem("error", "export-settings", file, message, fix) for message, fix in found])

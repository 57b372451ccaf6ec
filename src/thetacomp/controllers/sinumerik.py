"""SINUMERIK 840D sl / ONE: which register carries which part of the thermal error, with sign and unit.

Temperature compensation of an axis is `ΔK = K0(T) + tanβ(T) (P - P0)`; sag compensation (CEC) adds to an output axis
the table of a base axis times a weight that takes effect at once (SINUMERIK Extended Functions, K3 Compensations,
03/2013). Here the slope of an axis' own error goes to its tanβ, the slope of a cross error to the weight of a straight
table, and the drift of one direction to one single K0: every intercept holds it, so it must not be added twice.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import CARTESIAN, Floats
from thetacomp.controllers.base import RegisterLaw, register_law
from thetacomp.controllers.sinumerik_settings import (
    SinumerikSettings,
    check_settings,
    check_sum,
)
from thetacomp.errors import AnalysisError
from thetacomp.machine import Axis
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
    check_settings(model, settings, settings_file)
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
    check_sum(settings, sums, settings_file)
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

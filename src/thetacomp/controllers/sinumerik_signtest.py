"""The +10 µm sign test: for every register the value to enter and the movement that an indicator must show."""

from __future__ import annotations

from dataclasses import dataclass

from thetacomp.controllers.sinumerik import AxisRegisters, RegisterPlan, SagTable
from thetacomp.controllers.sinumerik_files import number

TEST_MM = 0.010


@dataclass(frozen=True)
class SignTest:
    """One test: at `where`, `enter` is written to the setting datum `datum`.

    The tool must then move by `movement_um` along `direction` (`+X` …) relative to the workpiece.
    """

    register: str
    where: str
    datum: str
    enter: str
    direction: str
    movement_um: float
    setting: str
    opposite: int


def sign_tests(plan: RegisterPlan) -> tuple[SignTest, ...]:
    """Tests of all registers, in the order of the sheet."""
    tests: list[SignTest] = []
    for axis in plan.axes:
        if axis.k0_source:
            enter = f"$SA_TEMP_COMP_ABS_VALUE[{axis.channel_axis}] = {TEST_MM:.3f}"
            tests.append(_axis_test(plan, axis, "K0", "anywhere", ("SD43900", enter), TEST_MM))
        if axis.tan_beta_source:
            position_mm = _far_end(axis.register_p0_mm, axis.p_min_mm, axis.p_max_mm)
            tan_beta = round(TEST_MM / (position_mm - axis.register_p0_mm), 9)
            enter = f"$SA_TEMP_COMP_SLOPE[{axis.channel_axis}] = {tan_beta:.9f}"
            datum = f"SD43910, with SD43920 P0 = {number(axis.register_p0_mm)}"
            where, arm_mm = f"{axis.channel_axis} at {number(position_mm)} mm", position_mm - axis.register_p0_mm
            tests.append(_axis_test(plan, axis, "tanβ", where, (datum, enter), tan_beta * arm_mm))
    return (*tests, *(_table_test(plan, table) for table in plan.tables))


def _axis_test(
    plan: RegisterPlan, axis: AxisRegisters, register: str, where: str, enter: tuple[str, str], value_mm: float
) -> SignTest:
    # With the right sign setting a positive register means that the axis stands too far along its positive direction.
    sign = plan.settings.sign_temperature
    return SignTest(
        register=f"{register} of {axis.channel_axis}",
        where=where,
        datum=enter[0],
        enter=enter[1],
        direction=_toward(axis.axis.cartesian, -sign * axis.axis.sign * value_mm),
        movement_um=abs(value_mm) * 1e3,
        setting="sign_temperature",
        opposite=-sign,
    )


def _table_test(plan: RegisterPlan, table: SagTable) -> SignTest:
    sign = plan.settings.sign_cec
    position_mm = _far_end(table.p0_mm, table.p_min_mm, table.p_max_mm)
    full_mm = table.register_mm[0] if position_mm == table.p_min_mm else table.register_mm[-1]
    weight = max(-1.0, min(1.0, round(TEST_MM / full_mm, 6)))
    value_mm = weight * full_mm
    return SignTest(
        register=f"table {table.index} ({table.source})",
        where=f"{table.base.channel_axis} at {number(position_mm)} mm",
        datum="SD41310",
        enter=f"$SN_CEC_TABLE_WEIGHT[{table.index}] = {weight:.6f}",
        direction=_toward(table.output.axis.cartesian, -sign * table.output.axis.sign * value_mm),
        movement_um=abs(value_mm) * 1e3,
        setting="sign_cec",
        opposite=-sign,
    )


def _far_end(p0_mm: float, p_min_mm: float, p_max_mm: float) -> float:
    return p_max_mm if p_max_mm - p0_mm >= p0_mm - p_min_mm else p_min_mm


def _toward(cartesian: str, movement_mm: float) -> str:
    return ("+" if movement_mm > 0 else "−") + cartesian

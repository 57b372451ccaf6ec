"""The commissioning sheet of a SINUMERIK: one printable page with what to enter where, and how to prove it."""

from __future__ import annotations

from collections.abc import Iterable
from math import isfinite

from thetacomp.controllers.base import RegisterLaw
from thetacomp.controllers.sinumerik import TABLE_POINTS, RegisterPlan
from thetacomp.controllers.sinumerik_files import law_in_digits, number, reference_lines, sensor_names
from thetacomp.controllers.sinumerik_remarks import differing, failed_checks, not_compensated, worst_drift
from thetacomp.controllers.sinumerik_signtest import sign_tests
from thetacomp.model.wanted_length import follows_workpiece
from thetacomp.report.page_writer import page

SHEET_FILE = "commissioning_sheet.html"
Rows = list[list[str]]

_KNOWN = (
    ("documented", "ΔK = K0(T) + tanβ(T)·(P − P0), P the actual position (machine coordinates)", "K3, 03/2013, p. 225"),
    ("documented", "MD32750 bit 0 switches K0 on, bit 1 tanβ; takes effect after POWER ON", "K3, p. 228"),
    ("documented", "MD32760 spreads larger steps over several cycles, without an alarm", "K3; list of machine data"),
    (
        "documented",
        "A CEC table takes the setpoint of the base axis; outside its range the end values hold",
        "K3, p. 248",
    ),
    ("documented", "CEC tables load only while MD32710 of the output axis is 0", "K3, commissioning"),
    ("documented", "SD41310 multiplies the table and takes effect at once", "parameter manual"),
    (
        "documented",
        "A lost reference switches CEC off; a new reference switches it on again by itself",
        "K3, p. 277",
    ),
    (
        "inferred",
        "K0 and tanβ are those of the error line: they are entered with the sign of the error (sign_temperature = 1)",
        "K3, p. 225: tanβ is the gradient of the approximated error line",
    ),
    (
        "probable",
        "A positive CEC value moves the output axis in the negative direction (sign_cec = 1)",
        "stated for encoder compensation; the same sentence is cut off for CEC in the copy that was read",
    ),
    ("unproven", "A negative weight in SD41310 works like a positive one", "no stated limit: the sign test shows it"),
    ("unproven", "SD43900 to SD43920 may be written for years without wear of the memory", "ask the builder"),
    (
        "unproven",
        "Temperature compensation waits for a referenced axis",
        "not stated for this function: reference the axes first",
    ),
    ("unproven", "The control's own defaults of MD32720 (1 mm) and MD32730 (0.1)", "read them before you write"),
)
_OF_TABLES = ("CEC", "SD41310", "MD32720")


def commissioning_sheet(plan: RegisterPlan) -> str:
    """The sheet as HTML text: what to enter where, in steps, the sign test, what is proven, and where it is valid."""
    channel = {table.output.axis.name: table.output.channel_axis for table in plan.tables}
    moments = [line.partition(";")[0] for line in reference_lines(plan) if "campaign" in line]
    return page(
        "thetacomp.report/commissioning_sheet.html.j2",
        plan=plan,
        model=plan.model,
        settings=plan.settings,
        failed=failed_checks(plan) if plan.model.failed_export_checks else "",
        axis_rows=_axis_rows(plan),
        table_rows=_table_rows(plan),
        worst_drift=worst_drift(plan),
        not_compensated=not_compensated(plan),
        sizes=", ".join(f"MD18342[{table.index}]" for table in plan.tables),
        table_points=TABLE_POINTS,
        enables=", ".join(dict.fromkeys(table.output.channel_axis for table in plan.tables)),
        outputs=", ".join(f"{channel[axis]} = {value:g} mm" for axis, value in plan.max_sum_mm.items()),
        sign_tests=sign_tests(plan),
        moments="R" + "; ".join(moments)[1:] + ".",
        renamed=[f"{sensor} = {name}" for sensor, name in sensor_names(plan).items() if sensor != name],
        laws=_laws(plan),
        clamps=_clamps(plan),
        counted=[
            f"{a.axis.cartesian}: {a.drift_source}, into K0 of {a.channel_axis}" for a in plan.axes if a.drift_source
        ],
        drift_rows=_drift_rows(plan),
        known=[row for row in _KNOWN if plan.tables or not any(word in row[1] for word in _OF_TABLES)],
        errors=_errors(plan),
        sensors=_sensors(plan),
        follows_workpiece=follows_workpiece(plan.model),
    )


def _carried(what: str, source: str | None, law: RegisterLaw, nothing: str, plan: RegisterPlan) -> str:
    """What a register carries, the workpiece's expansion with it."""
    parts = [f"{what} {source}"] if source else []
    sensor = plan.model.length.workpiece_sensor
    if follows_workpiece(plan.model) and sensor in law.sensors:
        parts.append(f"expansion of the workpiece ({sensor})")
    return ", ".join(parts) or nothing


def _axis_rows(plan: RegisterPlan) -> Rows:
    return [
        [
            f"{axis.channel_axis} (axis {axis.axis.name}, {axis.axis.direction})",
            str(axis.compensation_type),
            _carried("intercept of", axis.drift_source, axis.register_k0_mm, "0: drift is counted elsewhere", plan),
            _carried("slope of", axis.slope_source, axis.register_tan_beta, "0: no error of its own", plan),
            number(axis.register_p0_mm) if axis.tan_beta_source else "–",
        ]
        for axis in plan.axes
    ]


def _table_rows(plan: RegisterPlan) -> Rows:
    return [
        [
            str(table.index),
            table.source,
            f"{table.base.channel_axis} (AX{table.base_number})",
            f"{table.output.channel_axis} (AX{table.output_number})",
            f"{number(table.p_min_mm)} … {number(table.p_max_mm)}, step {number(table.step_mm)}",
            f"{table.slope_ref_um_per_m:g}",
            f"{table.largest_mm:.4f}",
        ]
        for table in plan.tables
    ]


def _laws(plan: RegisterPlan) -> list[tuple[str, str]]:
    rows = []
    for axis in plan.axes:
        for label, wanted, law, um_per_unit in (
            (f"K0 of {axis.channel_axis}, mm", axis.k0_source, axis.register_k0_mm, 1e3),
            (f"tanβ of {axis.channel_axis}, mm/mm", axis.tan_beta_source, axis.register_tan_beta,
             1e3 * axis.longest_arm_mm),
        ):  # fmt: skip
            if wanted:
                rows.append((label, _formula(law, um_per_unit)))
    for table in plan.tables:
        rows.append((f"weight of table {table.index}, SD41310", _formula(table.weight, 1e3 * table.largest_mm)))
    return rows


def _formula(law: RegisterLaw, um_per_unit: float) -> str:
    constant, terms = law_in_digits(law, um_per_unit)
    text = constant.replace("-", "−")
    for sign, factor, sensor, reference in terms:
        text += f" {sign.replace('-', '−')} {factor}·({sensor} − {reference.replace('-', '−')})"
    return text


def _clamps(plan: RegisterPlan) -> Rows:
    rate_mm_per_s = plan.settings.rate_limit_um_per_s * 1e-3
    rows = []
    for axis in plan.axes:
        if axis.k0_source:
            rows.append([f"K0 of {axis.channel_axis}", f"± {axis.clamp_k0_mm:.4f} mm", f"{rate_mm_per_s:.3g} mm/s"])
        if axis.tan_beta_source:
            clamp, rate = f"± {axis.clamp_tan_beta:.3e} mm/mm", f"{rate_mm_per_s / axis.longest_arm_mm:.3g} /s"
            rows.append([f"tanβ of {axis.channel_axis}", clamp, rate])
    for table in plan.tables:
        rows.append([f"weight of table {table.index}", "± 1", f"{rate_mm_per_s / table.largest_mm:.3g} /s"])
    return rows


def _drift_rows(plan: RegisterPlan) -> Rows:
    apart = differing(plan)
    return [
        [
            o.component,
            f"{o.intercept_um:+.1f}",
            o.counted,
            f"{o.counted_um:+.1f}",
            f"± {o.bound_um:.1f}" if isfinite(o.bound_um) else "–",
            "DIFFERS" if o in apart else "within the bound" if isfinite(o.bound_um) else "cannot be stated",
        ]
        for o in plan.left_out
    ]


def _errors(plan: RegisterPlan) -> Rows:
    return [
        [
            name,
            ", ".join(law.layout.sensors) if c.predicted else "none: not compensated",
            "fixed" if law.p_min_mm is None else f"{law.p_min_mm:g} … {law.p_max_mm:g}",
            str(c.states),
            *(_one_decimal(c.held_out_um) if c.held_out_um else ("–", "–", "–")),
            *_one_decimal(c.residual_um[:2]),
        ]
        for law in plan.model.control.values()
        for name, c in law.components.items()
    ]


def _sensors(plan: RegisterPlan) -> Rows:
    model, trained = plan.model, plan.model.trained
    return [
        [
            s,
            *_one_decimal(trained.temperature_degC.get(s, model.length.workpiece_degC)),
            *(_one_decimal(trained.rise_K[s]) if s in trained.rise_K else ("–", "–")),
        ]
        for s in plan.grid_degC
    ]


def _one_decimal(values: Iterable[float]) -> list[str]:
    return [f"{value:.1f}" for value in values]

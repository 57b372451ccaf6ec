"""The texts that a SINUMERIK reads or that a writer of its registers needs. NC files are plain ASCII."""

from __future__ import annotations

import textwrap

import numpy as np

from thetacomp import __version__
from thetacomp.controllers.ascii_text import ascii_names, ascii_text
from thetacomp.controllers.base import RegisterLaw
from thetacomp.controllers.sinumerik import GRID_STATES, TABLE_POINTS, RegisterPlan, SagTable
from thetacomp.controllers.sinumerik_remarks import failed_checks
from thetacomp.table_file import Number, csv_text

TABLE_COLUMNS = 6
LONGEST_LINE = 500  # a block of an NC program must stay below 512 characters, comments too
REFERENCE_ROUNDING_UM = 0.05
UNPROVEN = (
    "SIGN UNPROVEN: the source of this model does not state its sign convention or axis directions.",
    "Do not switch the compensation on before the measurement itself and the +10 um sign test have proven both.",
)


def number(value: float) -> str:
    """The number to 15 significant digits as decimal text, without an exponent (NC blocks have none)."""
    text = np.format_float_positional(float(f"{value:.15g}"), trim="0")
    return "0.0" if text == "-0.0" else text


def rounded(value: float, digits: int) -> str:
    """A decimal text with at most `digits` places, never "-0.0"."""
    return number(round(value, digits) + 0.0)


def temperature_program(plan: RegisterPlan) -> str:
    """`sinumerik_temperature_compensation.spf`: machine data, start values at zero, and the law of every register."""
    lines = ["%_N_THETACOMP_TEMP_SPF", ";$PATH=/_N_SPF_DIR", *_head(plan)]
    lines += [
        "; It switches the functions on with all values at zero: nothing is compensated until values are written.",
        ";",
    ]
    lines += ["; --- 1 machine data (MD32750: bit 0 = K0, bit 1 = tanbeta; effective after POWER ON)"]
    for axis in plan.axes:
        name, factor = axis.channel_axis, number(plan.settings.md32760_comp_add_velo_factor)
        lines.append(f"$MA_TEMP_COMP_TYPE[{name}]={axis.compensation_type} ; MD32750")
        lines.append(f"$MA_COMP_ADD_VELO_FACTOR[{name}]={factor} ; MD32760")
    for output, limit_mm in plan.max_sum_mm.items():
        name = next(t.output.channel_axis for t in plan.tables if t.output.axis.name == output)
        lines.append(f"$MA_CEC_MAX_SUM[{name}]={number(limit_mm)} ; MD32720, mm")
        lines.append(f"$MA_CEC_MAX_VELO[{name}]={number(plan.settings.md32730_cec_max_velo_factor)} ; MD32730")
    lines += [";", "; --- 2 start values"]
    for axis in plan.axes:
        name = axis.channel_axis
        lines.append(f"$SA_TEMP_COMP_ABS_VALUE[{name}]=0.0 ; SD43900, K0, mm")
        lines.append(f"$SA_TEMP_COMP_SLOPE[{name}]=0.0 ; SD43910, tanbeta, mm/mm")
        lines.append(f"$SA_TEMP_COMP_REF_POSITION[{name}]={number(axis.register_p0_mm)} ; SD43920, P0, mm in MCS")
    lines += [f"$SN_CEC_TABLE_WEIGHT[{table.index}]=0.0 ; SD41310, {table.source}" for table in plan.tables]
    lines += [";", "; --- 3 the law of every register: constant + sum of factor * (temperature - reference), degC"]
    lines += [f"; {line}" for line in reference_lines(plan)]
    names = sensor_names(plan)
    for label, law, um_per_unit in _laws(plan):
        constant, terms = law_in_digits(law, um_per_unit)
        text = "".join(f" {sign} {factor} * ({names[s]} - {reference})" for sign, factor, s, reference in terms)
        lines.append(f"; {label} = {constant}{text}")
    lines += [";", f"; --- 4 values at {GRID_STATES} states over the training range (all inputs rise together)"]
    columns = register_columns(plan)
    for first in range(0, len(columns), TABLE_COLUMNS):
        lines += [f"; {row}" for row in _table(plan, columns[first : first + TABLE_COLUMNS])]
    return _ascii([*lines, "M17"])


def sag_tables(plan: RegisterPlan) -> str:
    """`sinumerik_cec.ini`: one straight table a cross error; SD41310 carries the slope."""
    lines = ["%_N_NC_CEC_INI", ";$PATH=/_N_NC_ACT/_N_CEC_DIR", *_head(plan)]
    lines += [
        f"; Before loading: MD18342 $MN_MM_CEC_MAX_POINTS[t] >= {TABLE_POINTS} for"
        f" t = {', '.join(str(t.index) for t in plan.tables)} (reformats static memory: archive first;",
        "; the 828D has 8 fixed tables), MD32710 $MA_CEC_ENABLE of the output axes = 0.",
        "; After loading: POWER ON, MD32710 = 1, SD41310 weight = 0, SD41300 $SN_CEC_TABLE_ENABLE[t] = 1.",
        "; Tables of the same number that are already in the control are overwritten.",
        "CHANDATA(1)",
    ]
    for table in plan.tables:
        lines += _sag_block(table)
    return _ascii([*lines, "M17"])


def values_csv(plan: RegisterPlan) -> str:
    """`sinumerik_values.csv`: temperatures of the inputs and what every register wants there."""
    columns = register_columns(plan)
    values = [law.at(plan.grid_degC) for _, law, _ in columns]
    rows = [
        [
            *(Number(rounded(float(degC[i]), 6)) for degC in plan.grid_degC.values()),
            *(Number(rounded(float(v[i]), digits)) for v, (_, _, digits) in zip(values, columns, strict=True)),
        ]
        for i in range(GRID_STATES)
    ]
    return csv_text([*(f"{sensor}_degC" for sensor in plan.grid_degC), *(name for name, _, _ in columns)], rows)


def register_columns(plan: RegisterPlan) -> list[tuple[str, RegisterLaw, int]]:
    """Column name, law and decimal places of every register that changes with temperature."""
    out: list[tuple[str, RegisterLaw, int]] = []
    for axis in plan.axes:
        if axis.k0_source:
            out.append((f"K0_{axis.channel_axis}_mm", axis.register_k0_mm, 7))
        if axis.tan_beta_source:
            out.append((f"tanbeta_{axis.channel_axis}", axis.register_tan_beta, 12))
    out += [(f"weight_table_{table.index}", table.weight, 9) for table in plan.tables]
    return out


def law_in_digits(law: RegisterLaw, um_per_unit: float) -> tuple[str, list[tuple[str, str, str, str]]]:
    """A law to seven digits: its constant, and sign, factor, sensor and reference of every term.

    A reference has two decimals, or as many as keep what the rounding does below 0.05 µm; `um_per_unit` is what one
    unit of the register does at most.
    """
    allowed = REFERENCE_ROUNDING_UM / max(1, len(law.sensors))
    terms = []
    for sensor, factor, reference in zip(law.sensors, law.factors, law.reference_degC, strict=True):
        decimals = 2
        while decimals < 15 and abs(factor * (round(reference, decimals) - reference)) * um_per_unit >= allowed:
            decimals += 1
        terms.append(("-" if factor < 0 else "+", _seven(abs(factor)), sensor, f"{reference:.{decimals}f}"))
    return _seven(law.constant), terms


def sensor_names(plan: RegisterPlan) -> dict[str, str]:
    """The inputs as ASCII files name them."""
    return ascii_names(plan.grid_degC, "sensor")


def reference_lines(plan: RegisterPlan) -> list[str]:
    """Whose temperatures the law counts from: one line, or one for each moment where there are several."""
    anew = "capture anew at each datum set, see sheet"
    if plan.settings.reference_degC is not None:
        return [f"reference: reference_degC of the export settings; {anew}"]
    sources = [s for a in plan.axes for s in (a.drift_source, a.slope_source) if s] + [t.source for t in plan.tables]
    moments: dict[str, list[str]] = {}
    for name in dict.fromkeys(sources):
        reference = next(law.reference for law in plan.model.control.values() if name in law.components)
        moments.setdefault(f"campaign {reference.campaign} at {reference.t_s:.10g} s", []).append(name)
    if len(moments) == 1:
        return [f"reference: {next(iter(moments))}; {anew}"]
    return [*(f"reference of {', '.join(names)}: {moment}" for moment, names in moments.items()), f"reference: {anew}"]


def _seven(value: float) -> str:
    return number(float(f"{value:.7g}"))


def _laws(plan: RegisterPlan) -> list[tuple[str, RegisterLaw, float]]:
    """Label, law, and what one unit of the register does at most, in µm."""
    out: list[tuple[str, RegisterLaw, float]] = []
    for axis in plan.axes:
        name, arm_um = axis.channel_axis, 1e3 * axis.longest_arm_mm
        if axis.k0_source:
            out.append((f"K0[{name}] mm ({axis.k0_source})", axis.register_k0_mm, 1e3))
        if axis.tan_beta_source:
            out.append((f"tanbeta[{name}] mm/mm ({axis.tan_beta_source})", axis.register_tan_beta, arm_um))
    out += [(f"weight[{t.index}] ({t.source})", t.weight, 1e3 * t.largest_mm) for t in plan.tables]
    return out


def _head(plan: RegisterPlan) -> list[str]:
    model = plan.model
    lines = [f"; thermal compensation for SINUMERIK, written by thetacomp {__version__}"]
    if plan.sign_unproven:
        lines += [f"; !!! {line} !!!" for line in UNPROVEN]
    if model.failed_export_checks:
        lines.append(f"; !!! NOT FIT FOR USE: {failed_checks(plan)} !!!")
        lines += [f"; !!! - {sentence}" for sentence in model.failed_export_checks]
    machine, campaigns = (ascii_text(text).strip() for text in (model.machine, ", ".join(model.training.campaigns)))
    cec = f", sign_cec = {plan.settings.sign_cec:+d}; both wait" if plan.tables else "; it waits"
    lines += [
        f"; {f'machine {machine}; ' if machine else ''}model of {model.created}, trained on {campaigns}",
        "; Values follow the error E = actual - commanded with sign_temperature ="
        f" {plan.settings.sign_temperature:+d}{cec} for the sign test.",
    ]
    return lines


def _table(plan: RegisterPlan, columns: list[tuple[str, RegisterLaw, int]]) -> list[str]:
    names = [f"{sensor}_degC" for sensor in sensor_names(plan).values()]
    cells = [[f"{degC[i]:.3f}" for degC in plan.grid_degC.values()] for i in range(GRID_STATES)]
    for name, law, digits in columns:
        names.append(name)
        for row, value in zip(cells, law.at(plan.grid_degC), strict=True):
            row.append(f"{value:.{digits}f}")
    widths = [max(len(name), *(len(row[k]) for row in cells)) for k, name in enumerate(names)]
    return [" ".join(text.rjust(width) for text, width in zip(row, widths, strict=True)) for row in (names, *cells)]


def _sag_block(table: SagTable) -> list[str]:
    t, source = table.index, table.source
    values = [f"$AN_CEC[{t},{n}]={rounded(value, 9)}" for n, value in enumerate(table.register_mm)]
    return [
        f"; {source}: base {table.base.channel_axis}, output {table.output.channel_axis},"
        f" {number(table.slope_ref_um_per_m)} um/m at weight 1, zero at {number(table.p0_mm)} mm",
        *values,
        f"$AN_CEC_INPUT_AXIS[{t}]=(AX{table.base_number})",
        f"$AN_CEC_OUTPUT_AXIS[{t}]=(AX{table.output_number})",
        f"$AN_CEC_STEP[{t}]={number(table.step_mm)}",
        f"$AN_CEC_MIN[{t}]={number(table.p_min_mm)}",
        f"$AN_CEC_MAX[{t}]={number(table.p_max_mm)}",
        f"$AN_CEC_DIRECTION[{t}]=0",
        f"$AN_CEC_MULT_BY_TABLE[{t}]=0",
        f"$AN_CEC_IS_MODULO[{t}]=0",
    ]


def _ascii(lines: list[str]) -> str:
    # A control may refuse or mangle letters beyond ASCII even in a comment; a machine name can hold them.
    out: list[str] = []
    for line in (ascii_text(" ".join(line.splitlines())) for line in lines):
        out += textwrap.wrap(line, LONGEST_LINE, subsequent_indent=";   ") if len(line) > LONGEST_LINE else [line]
    return "".join(f"{line}\n" for line in out)

"""The commissioning sheet: one printable HTML page that needs nothing else."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from math import isfinite

from thetacomp import __version__
from thetacomp.controllers.base import RegisterLaw
from thetacomp.controllers.sinumerik import TABLE_POINTS, Plan
from thetacomp.controllers.sinumerik_files import law_in_digits, number, reference_lines, sensor_names
from thetacomp.controllers.sinumerik_remarks import differing, failed_checks, not_compensated, worst_drift
from thetacomp.controllers.sinumerik_signtest import sign_tests
from thetacomp.model.wanted_length import follows_workpiece

_STYLE = """
@page { size: A4; margin: 14mm 12mm; }
body { font: 14px/1.45 "Segoe UI", "Helvetica Neue", Arial, "Liberation Sans", sans-serif; color: #1a1a1a;
  max-width: 1000px; margin: 24px auto; padding: 0 16px; }
h1 { font-size: 24px; margin: 0 0 4px; }
p { orphans: 3; widows: 3; }
h2 { font-size: 17px; margin: 28px 0 8px; border-bottom: 2px solid #24527a;
  padding-bottom: 3px; break-after: avoid; }
.sub { color: #555; margin: 0 0 12px; } p { margin: 6px 0 8px; }
table { border-collapse: collapse; width: 100%; margin: 8px 0; font-size: 13px; }
th, td { border: 1px solid #b9c2ca; padding: 4px 7px; text-align: left; vertical-align: top; }
th { background: #eaf0f5; } td.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
tr { break-inside: avoid; } thead, tbody tr:first-child { break-after: avoid; }
ol, ul { margin: 6px 0; padding-left: 24px; } li { margin: 4px 0; }
code { font: 12px/1.4 Consolas, "DejaVu Sans Mono", monospace; }
.keep { white-space: nowrap; }
.banner { background: #b00020; color: #fff; padding: 12px 16px; font-weight: 600; margin: 12px 0;
  print-color-adjust: exact; -webkit-print-color-adjust: exact; }
.banner ul { margin: 4px 0 0; font-weight: 400; }
.warn { border: 2px solid #b00020; padding: 8px 12px; margin: 10px 0; break-inside: avoid; }
.blank { display: inline-block; min-width: 48px; }
@media print { body { margin: 0; padding: 0; max-width: none; font-size: 12px; } table { font-size: 11px; }
  code { font-size: 9.5px; } }
"""
_BANNER = (
    "SIGN UNPROVEN. The source of this model does not state its sign convention or its axis directions. "
    "Use these files to prepare and to test, not to compensate: first prove on the machine that a measured error of "
    "+10 µm means actual − commanded = +10 µm along the stated direction, then pass every sign test below."
)
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


def commissioning_sheet(plan: Plan) -> str:
    """The sheet as HTML text: what to enter where, in steps, the sign test, what is proven, and where it is valid."""
    model = plan.model
    parts = [
        f"<h1>Commissioning sheet: thermal compensation of {escape(model.machine)}</h1>",
        f'<p class="sub">SINUMERIK 840D sl / ONE · thetacomp {__version__} · model of {escape(model.created)}'
        f" · trained on {escape(', '.join(model.training.campaigns))}</p>",
        f'<div class="banner">{_BANNER}</div>' if plan.sign_unproven else "",
        _failed(plan),
        "<p>The error is E = actual − commanded at the tool point, along X, Y, Z. A register of the control is"
        " not an error: it belongs to an axis and has the sign of the control. The direction of every axis below is the"
        " movement of the tool relative to the workpiece.</p>",
        _what_goes_where(plan),
        _steps(plan),
        _sign_test(plan),
        _laws(plan),
        _writer(plan),
        _drift(plan),
        _known(plan),
        _limits(plan),
        '<p style="margin-top:28px">Date ______________ Name ______________________'
        " Signature ______________________</p>",
    ]
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>Commissioning sheet {escape(model.machine)}</title><style>{_STYLE}</style></head><body>\n"
        + "\n".join(part for part in parts if part)
        + "\n</body></html>\n"
    )


def _failed(plan: Plan) -> str:
    if not plan.model.failed_export_checks:
        return ""
    items = "".join(f"<li>{escape(sentence)}</li>" for sentence in plan.model.failed_export_checks)
    return f'<div class="banner">NOT FIT FOR USE: {failed_checks(plan)}.<ul>{items}</ul></div>'


def _carried(what: str, source: str | None, law: RegisterLaw, nothing: str, plan: Plan) -> str:
    """What a register carries, the workpiece's expansion with it."""
    parts = [f"{what} {source}"] if source else []
    sensor = plan.model.length.workpiece_sensor
    if follows_workpiece(plan.model) and sensor in law.sensors:
        parts.append(f"expansion of the workpiece ({sensor})")
    return ", ".join(parts) or nothing


def _what_goes_where(plan: Plan) -> str:
    axis_rows = [
        [
            f"{axis.channel_axis} (axis {axis.axis.name}, {axis.axis.direction})",
            str(axis.compensation_type),
            _carried("intercept of", axis.drift_source, axis.register_k0_mm, "0: drift is counted elsewhere", plan),
            _carried("slope of", axis.slope_source, axis.register_tan_beta, "0: no error of its own", plan),
            number(axis.register_p0_mm) if axis.tan_beta_source else "–",
        ]
        for axis in plan.axes
    ]
    table_rows = [
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
    text = "<h2>1 What goes where</h2>" + _table(["Axis", "MD32750", "K0 carries", "tanβ carries", "P0, mm"], axis_rows)
    if table_rows:
        head = ["CEC table", "Error", "Base", "Output", "Range, mm", "µm/m at weight 1", "Largest value, mm"]
        text += _table(head, table_rows, numeric=(5, 6))
    else:
        text += "<p>No cross error is exported: temperature compensation alone is used.</p>"
    if worst_drift(plan):
        text += f'<div class="warn"><b>The drift does not agree.</b> {escape(worst_drift(plan))}</div>'
    sentences = not_compensated(plan)
    if sentences:
        items = "".join(f"<li>{escape(sentence)}</li>" for sentence in sentences)
        text += f"<p><b>Not compensated:</b></p><ul>{items}</ul>"
    return text


def _step_zero(plan: Plan) -> str:
    """Proof of the sign of the measured errors, where the model lacks it; a line for the result of every axis."""
    if not plan.sign_unproven:
        return ""
    rows = [
        [
            f"{escape(axis.name)} (direction {axis.direction})",
            f"move {escape(axis.name)} by +0.010 mm",
            f"d{axis.cartesian}_um",
            f"{10.0 * axis.sign:+.1f}".replace("-", "−"),
            '<span class="blank">&nbsp;</span>',
        ]
        for axis in plan.model.axes
    ]
    head = ["Axis", "With the compensation off", "Column of the table", "Must change by, µm", "Recorded, µm"]
    return (
        "<p><b>Step 0: prove the sign of the measured errors.</b> Set up the measuring instrument as in the campaign"
        " and record one error. Then move the axis on by 0.010 mm, but keep the old commanded position in the record:"
        " the tool now stands 10 µm too far. Record again, through the same evaluation that made the tables.</p>"
        + _table(head, rows, numeric=(3,), escaped=True)
        + "<p>Result: all signs right ☐ &nbsp; wrong in ______________ &nbsp; Date ______________ Name"
        " ______________</p>"
        "<p>Where a sign is wrong, turn it in that column of the tables. When every axis is right, write"
        f' <code>sign = "stated"</code> into campaign.toml of {escape(", ".join(plan.model.training.campaigns))} and'
        " run the analysis and this export again: the warning is then gone. Do not go on to step 1 before.</p>"
    )


def _steps(plan: Plan) -> str:
    settings = plan.settings
    steps = [
        "Archive the control (NC, PLC). Check that the options temperature compensation"
        + (" and sag compensation are" if plan.tables else " is")
        + " set. Read the values that are replaced and write them down.",
        "Check the channel axis names, the axis numbers AXn and the direction of every axis in part 1 against the"
        " machine. Numbers follow the order in the model unless export.toml says otherwise.",
    ]
    if plan.tables:
        numbers = ", ".join(f"MD18342[{table.index}]" for table in plan.tables)
        channel = {table.output.axis.name: table.output.channel_axis for table in plan.tables}
        outputs = ", ".join(f"{channel[axis]} = {value:g} mm" for axis, value in plan.max_sum_mm.items())
        enables = ", ".join(dict.fromkeys(table.output.channel_axis for table in plan.tables))
        steps += [
            f"Set {numbers} = {TABLE_POINTS} or more. This reformats the static memory: reload the archive."
            " (828D: 8 tables of 200 points are fixed, skip this step.) Tables of the same number that exist already"
            " are overwritten: move ours with first_cec_table.",
            f"Set MD32710 $MA_CEC_ENABLE = 0 for {enables}; tables load only then.",
            "Load sinumerik_cec.ini, then POWER ON.",
            f"Set the sum limit MD32720 $MA_CEC_MAX_SUM ({outputs}; sized from these tables, add what other tables"
            f" need) and MD32730 $MA_CEC_MAX_VELO = {settings.md32730_cec_max_velo_factor:g} (of MD32000).",
        ]
    steps += [
        "Load sinumerik_temperature_compensation.spf and run it once with the axes at standstill: it writes MD32750,"
        f" MD32760 = {settings.md32760_comp_add_velo_factor:g}"
        + (", MD32720, MD32730" if plan.tables else "")
        + " and sets every value to zero. POWER ON. Reference all axes."
    ]
    if plan.tables:
        steps.append(
            "Set SD41310 $SN_CEC_TABLE_WEIGHT = 0 and SD41300 $SN_CEC_TABLE_ENABLE = 1 for tables "
            + ", ".join(str(table.index) for table in plan.tables)
            + ", and MD32710 = 1 for the output axes."
        )
    steps += [
        "Do the sign test of part 3. Do not go on before every row has passed.",
        "Let the writer (PLC, or a program on a PC) put the values of part 4 into the registers, within the limits of"
        " part 5.",
    ]
    return (
        "<h2>2 Steps</h2>" + _step_zero(plan) + "<ol>" + "".join(f"<li>{escape(step)}</li>" for step in steps) + "</ol>"
    )


def _sign_test(plan: Plan) -> str:
    rows = [
        [
            f'<span class="keep">{escape(test.register)}</span>',
            escape(test.where),
            f'{escape(test.datum)}<br><code class="keep">{escape(test.enter)}</code>',
            f'<span class="keep">{test.movement_um:.1f} µm to <b>{escape(test.direction)}</b></span>',
            '<span class="blank">&nbsp;</span>',
            f'<code class="keep">{test.setting} = {test.opposite}</code>',
        ]
        for test in sign_tests(plan)
    ]
    head = ["Register", "Position", "Enter", "Tool must move", "Shown, µm", "If opposite"]
    return (
        "<h2>3 Sign test with +10 µm</h2><p>All values at zero, axes referenced. Put an indicator between tool and"
        " workpiece along the named direction and set it to zero. Enter the value, wait until it stands, read, and set"
        " the value back to zero. The position display normally does not move. If the indicator moves the other way,"
        " write the last column into export.toml, export again and repeat all tests. If it does not move, the function"
        " is not active.</p>" + _table(head, rows, escaped=True)
    )


def _laws(plan: Plan) -> str:
    rows = []
    for axis in plan.axes:
        arm_um = 1e3 * axis.longest_arm_mm
        for label, wanted, law, um_per_unit in (
            (f"K0 of {axis.channel_axis}, mm", axis.k0_source, axis.register_k0_mm, 1e3),
            (f"tanβ of {axis.channel_axis}, mm/mm", axis.tan_beta_source, axis.register_tan_beta, arm_um),
        ):
            if wanted:
                rows.append([escape(label), f"<code>{escape(_formula(law, um_per_unit))}</code>"])
    for table in plan.tables:
        formula = _formula(table.weight, 1e3 * table.largest_mm)
        rows.append([f"weight of table {table.index}, SD41310", f"<code>{escape(formula)}</code>"])
    if plan.settings.reference_degC is None:
        text = (
            f"{_moments(plan)} The reference temperatures are those stored in the model, and the constant of the fit"
            " is kept: at these temperatures the registers are the constants, not zero. <b>Capture the reference anew"
            " at each datum set:</b> read all inputs at the moment when the datum of the workpiece is set, name them as"
            " reference_degC in export.toml and export again, or let the writer use them in place of the values below."
            " The constant is then dropped, and the registers are zero there."
        )
    else:
        text = (
            "The registers are zero at the temperatures of reference_degC; the constant of the fit is dropped. Capture"
            " them anew at each datum set."
        )
    renamed = [f"{sensor} = {name}" for sensor, name in sensor_names(plan).items() if sensor != name]
    if renamed:
        text += f" Names in the ASCII files: {escape(', '.join(renamed))}."
    return (
        f"<h2>4 The law of every register</h2><p>{text} The same laws are in the .spf file; values at ten states, with"
        " more digits, in sinumerik_values.csv.</p>" + _table(["Register", "Value (θ in °C)"], rows, escaped=True)
    )


def _moments(plan: Plan) -> str:
    """The moments of the stored reference, as sentences."""
    lines = [line.partition(";")[0] for line in reference_lines(plan) if "campaign" in line]
    return escape("R" + "; ".join(lines)[1:]) + "."


def _formula(law: RegisterLaw, um_per_unit: float) -> str:
    constant, terms = law_in_digits(law, um_per_unit)
    text = constant.replace("-", "−")
    for sign, factor, sensor, reference in terms:
        text += f" {sign.replace('-', '−')} {factor}·({sensor} − {reference.replace('-', '−')})"
    return text


def _writer(plan: Plan) -> str:
    rate = plan.settings.rate_limit_um_per_s
    rows = []
    for axis in plan.axes:
        if axis.k0_source:
            rows.append([f"K0 of {axis.channel_axis}", f"± {axis.clamp_k0_mm:.4f} mm", f"{rate * 1e-3:.3g} mm/s"])
        if axis.tan_beta_source:
            slope_rate = rate * 1e-3 / axis.longest_arm_mm
            rows.append([f"tanβ of {axis.channel_axis}", f"± {axis.clamp_tan_beta:.3e} mm/mm", f"{slope_rate:.3g} /s"])
    for table in plan.tables:
        weight_rate = rate * 1e-3 / table.largest_mm
        rows.append([f"weight of table {table.index}", "± 1", f"{weight_rate:.3g} /s"])
    return (
        "<h2>5 Limits for whatever writes the registers</h2>"
        + _table(["Register", "Clamp", "Fastest change"], rows, numeric=(1, 2))
        + "<p>The rate is such that no point of an axis moves faster than"
        f" {rate:g} µm/s. A temperature that is too old, missing or outside the training range: freeze the values,"
        " never jump to zero. Write only while the axis is referenced, read back what was written, and give a heartbeat"
        " that the PLC watches. The clamps are the largest values of the training range with their 95 % bound, times"
        f" {plan.settings.reserve:g}.</p>"
    )


def _drift(plan: Plan) -> str:
    counted = [
        f"{a.axis.cartesian}: {a.drift_source}, into K0 of {a.channel_axis}" for a in plan.axes if a.drift_source
    ]
    if plan.model.form == "joint":
        return (
            "<h2>6 The drift counts once</h2><p>The model holds the drift apart from the axes (joint form):"
            f" {escape('; '.join(counted) or 'no sensor predicts it')}. The slopes act about the P0 of their axis.</p>"
        )
    text = (
        "<h2>6 The drift counts once</h2><p>The intercepts of sweeps along different axes all hold the drift of the"
        f" tool at that moment. One of them is used in each direction: {escape('; '.join(counted))}. Change this with"
        " [drift_source] in export.toml.</p>"
    )
    if plan.left_out:
        apart = differing(plan)
        rows = [
            [
                o.component,
                f"{o.intercept_um:+.1f}",
                o.counted,
                f"{o.counted_um:+.1f}",
                f"± {o.bound_um:.1f}" if isfinite(o.bound_um) else "–",
                "DIFFERS" if o in apart else "within the bound" if isfinite(o.bound_um) else "cannot be told",
            ]
            for o in plan.left_out
        ]
        warmest = "at the warmest state, µm"
        head = ["Intercept left out", warmest, "counted instead", warmest, "95 % bound of the difference, µm", ""]
        text += _table(head, rows, numeric=(1, 3, 4))
        text += (
            "<p>Where the two differ by much, the sweeps do not see the same drift: find out why before you trust"
            " either (another campaign, another position of the other axes, another sign).</p>"
        )
    return text


def _known(plan: Plan) -> str:
    rows = [list(row) for row in _KNOWN if plan.tables or not any(word in row[1] for word in _OF_TABLES)]
    return (
        "<h2>7 What is proven and what is not</h2>"
        + _table(["Status", "Statement", "Source or remark"], rows)
        + "<p>Some of these come from older editions of the manuals. Verify them on the software of your control.</p>"
    )


def _limits(plan: Plan) -> str:
    model = plan.model
    ranges, rises = model.trained.temperature_degC, model.trained.rise_K
    rows = [
        [
            name,
            ", ".join(law.layout.sensors) if c.predicted else "none: not compensated",
            "fixed" if law.p_min_mm is None else f"{law.p_min_mm:g} … {law.p_max_mm:g}",
            str(c.states),
            *(_one_decimal(c.held_out_um) if c.held_out_um else ("–", "–", "–")),
            f"{c.residual_um[0]:.1f}",
            f"{c.residual_um[1]:.1f}",
        ]
        for law in model.control.values()
        for name, c in law.components.items()
    ]
    sensors = [
        [
            s,
            *_one_decimal(ranges.get(s, model.length.workpiece_degC)),
            *(_one_decimal(rises[s]) if s in rises else ("–", "–")),
        ]
        for s in plan.grid_degC
    ]
    notes = [
        "Positions are machine coordinates (MCS) of the axis that moved. Beyond the measured range tanβ goes on in a"
        " straight line" + (", while a CEC table holds its end value." if plan.tables else "."),
        "Every sweep was made with the other axes where they stood then. Rotations of the axes over longer arms, and"
        " the tool length, are not compensated.",
        _workpiece(plan),
        "If the control compensated temperature or sag while the machine was measured, switch that on again exactly"
        " as it was, or measure anew without it.",
        f"Operating mode of the training: {model.training.mode or 'not stated'}; instrument:"
        f" {model.training.instrument or 'not stated'}.",
        *model.notes,
    ]
    figures = ("Held-out RMS, µm", "Held-out p95, µm", "Held-out max, µm", "In-sample RMS, µm", "In-sample max, µm")
    head = ["Error", "Inputs", "Positions, mm", "States", *figures]
    return (
        "<h2>8 Where this is valid</h2><p>Held-out: what remains on data that the same procedure had not seen; expect"
        " at least this on the machine. In-sample: what remains on the training states themselves; it is always too"
        " good. A dash means that nothing could be held out.</p>"
        + _table(head, rows, numeric=(3, 4, 5, 6, 7, 8))
        + _table(["Sensor", "from, °C", "to, °C", "least rise, K", "largest rise, K"], sensors, numeric=(1, 2, 3, 4))
        + "<ul>"
        + "".join(f"<li>{escape(note)}</li>" for note in notes)
        + "</ul>"
    )


def _workpiece(plan: Plan) -> str:
    length = plan.model.length
    if not follows_workpiece(plan.model):
        return (
            "Lengths are true: a part that is cut warm is too short at 20 °C, by 345 µm on 3 m of steel at +10 K."
            ' [length] wanted = "workpiece" in machine.toml follows the workpiece instead.'
        )
    return (
        f"Lengths follow the workpiece ({length.workpiece_expansion_per_K:.4g} 1/K, sensor {length.workpiece_sensor}):"
        " parts are right once they are at 20 °C. A measurement of the machine itself then shows this expansion as an"
        " error: verify with the workpiece sensor at 20 °C, or with true lengths."
    )


def _one_decimal(values: Iterable[float]) -> list[str]:
    return [f"{value:.1f}" for value in values]


def _table(
    head: Sequence[str], rows: Iterable[Sequence[str]], numeric: tuple[int, ...] = (), escaped: bool = False
) -> str:
    def cell(k: int, text: str) -> str:
        return f'<td class="n">{text}</td>' if k in numeric else f"<td>{text}</td>"

    lines = ["".join(cell(k, text if escaped else escape(text)) for k, text in enumerate(row)) for row in rows]
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    top = "".join(f"<th>{escape(text)}</th>" for text in head)
    return f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"

"""Sizes that stand in sheet, files and replay, each from a closed form: clamps, rates, digits, tables, sums, names."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from html import unescape

import numpy as np
import pytest
from small_models import Part, component, document, term, three_axes

from thetacomp.controllers.ascii_text import ascii_names
from thetacomp.controllers.base import RegisterLaw
from thetacomp.controllers.replay import (
    Register,
    Stage,
    clip,
    moving_average,
    outcome,
    quantise,
    rate_limit,
    replay,
    sample_and_hold,
)
from thetacomp.controllers.sinumerik import RegisterPlan, plan_registers
from thetacomp.controllers.sinumerik_files import (
    law_in_digits,
    number,
    rounded,
    sag_tables,
    temperature_program,
    values_csv,
)
from thetacomp.controllers.sinumerik_remarks import left_to_history, not_compensated, remarks
from thetacomp.controllers.sinumerik_replay import (
    CLAMP,
    ENTRY,
    FILTER,
    ROUNDING,
    STEP,
    SUM,
    SUM_STEP,
    CampaignReplay,
    replay_campaign,
)
from thetacomp.controllers.sinumerik_settings import ReplaySettings, SinumerikSettings
from thetacomp.controllers.sinumerik_signtest import sign_tests
from thetacomp.errors import InputError
from thetacomp.machine import WantedLength
from thetacomp.model.document import ModelDocument
from thetacomp.report.commissioning import commissioning_sheet

T = {"t": 20.0}


PARTS = {
    "EXX": component("EXX", term(0.0, 10.0), term(0.0, 20.0), T, p=(200.0, 0.0, 1000.0)),
    "EXY": component("EXY", term(0.0, 4.0), term(0.0, -30.0), T, p=(0.0, -500.0, 2000.0)),
    "EXZ": component("EXZ", term(0.0, 4.0), term(0.0, 8.0), T, p=(100.0, 0.0, 500.0)),
}


def mill(parts: Mapping[str, Part] = PARTS, axes: str = "XYZ", **more: object) -> ModelDocument:
    """X corrects itself and the lean of Y and of Z towards X; 10 K. No scatter, so sizes are products.

    Slopes per K: EXX 20 µm/m about 200 mm over 0 to 1000, EXY -30 about 0 over -500 to 2000, EXZ 8 about 100 over 0 to
    500. The drift is that of EXX, 10 µm/K.
    """
    return document({axis: f"+{axis}" for axis in axes}, parts, {"t": (-2.0, 10.0)}, **more)  # type: ignore[arg-type]


def plan(**settings: object) -> RegisterPlan:
    return plan_registers(mill(), SinumerikSettings.model_validate(settings))


# --- the plan ---------------------------------------------------------------------------------------------------------


def test_clamps_are_the_largest_values_of_the_training_range_times_the_reserve() -> None:
    """10 K are more than 2 K the other way: K0 1.5 × 0.1 mm, tanβ 1.5 × 200 µm/m; arms count from P0."""
    (x,) = plan(reserve=1.5).axes
    assert (x.clamp_k0_mm, x.clamp_tan_beta) == (pytest.approx(0.15), pytest.approx(3e-4))
    assert (x.register_p0_mm, x.p_min_mm, x.p_max_mm, x.longest_arm_mm) == (200.0, 0.0, 1000.0, 800.0)
    assert x.compensation_type == 3


def test_tables_carry_whole_slopes_with_reserve_over_the_measured_range() -> None:
    """1.25 × 300 = 375 µm/m; 1.25 × 80 = 100. At weight 1 they reach 0.375 × 2 m and 0.1 × 0.4 m."""
    made = plan(first_cec_table=4)
    y, z = made.tables
    assert [(t.index, t.source, t.slope_ref_um_per_m) for t in (y, z)] == [(4, "EXY", 375.0), (5, "EXZ", 100.0)]
    assert [(t.p0_mm, t.p_min_mm, t.p_max_mm, t.step_mm) for t in (y, z)] == [
        (0.0, -500.0, 2000.0, 250.0), (100.0, 0.0, 500.0, 50.0)
    ]  # fmt: skip
    np.testing.assert_allclose(y.register_mm, 375e-6 * (-500.0 + 250.0 * np.arange(11)))
    np.testing.assert_allclose(z.register_mm, 100e-6 * (-100.0 + 50.0 * np.arange(11)))
    assert (y.largest_mm, z.largest_mm) == (pytest.approx(0.75), pytest.approx(0.04))
    assert [(t.base_number, t.output_number) for t in (y, z)] == [(2, 1), (3, 1)]
    # The weight turns the table's slope into the law's: -30 / 375 and 8 / 100 a kelvin.
    assert [t.weight.factors for t in (y, z)] == [(pytest.approx(-0.08),), (pytest.approx(0.08),)]
    # 0.79 mm in all, a tenth on top, rounded up to 0.01 mm.
    assert made.max_sum_mm == {"X": pytest.approx(0.87)}
    assert plan(md32720_cec_max_sum_mm=2.0).max_sum_mm == {"X": 2.0}


def test_the_grid_of_states_spans_the_training_range() -> None:
    grid = plan().grid_degC
    assert list(grid) == ["t"]
    np.testing.assert_allclose(grid["t"], np.linspace(18.0, 30.0, 10))


@pytest.mark.parametrize(
    ("sensor", "range_degC", "expected"),
    [
        ("part", (15.0, 28.0), {"t": (18.0, 30.0), "part": (15.0, 28.0)}),
        ("t", (15.0, 28.0), {"t": (15.0, 30.0)}),
        ("t", (19.0, 40.0), {"t": (18.0, 40.0)}),
        ("t", (19.0, 21.0), {"t": (18.0, 30.0)}),
    ],
)
def test_the_grid_covers_the_workpiece_too(
    sensor: str, range_degC: tuple[float, float], expected: dict[str, tuple[float, float]]
) -> None:
    """A sensor of the workpiece that is an input as well has the wider of both ranges, at either end."""
    length = WantedLength(
        wanted="workpiece", workpiece_expansion_per_K=11.5e-6, workpiece_sensor=sensor, workpiece_degC=range_degC
    )
    grid = plan_registers(mill().model_copy(update={"length": length}), SinumerikSettings()).grid_degC
    assert {name: (values[0], values[-1]) for name, values in grid.items()} == expected
    assert all(len(values) == 10 for values in grid.values())


def test_a_register_that_follows_the_workpiece_is_clamped_by_both_and_zero_at_its_own_place() -> None:
    """11.5 µm/m a kelvin, 20 °C up to 30 °C: 115 µm/m beside 1.25 × 200; zero at 700 mm is 0.5 m from P0."""
    length = WantedLength(
        wanted="workpiece", workpiece_expansion_per_K=11.5e-6, workpiece_sensor="part", workpiece_degC=(15.0, 30.0),
        zero_mm={"X": 700.0},
    )  # fmt: skip
    made = plan_registers(mill().model_copy(update={"length": length}), SinumerikSettings())
    x, y, z = made.axes
    assert x.clamp_tan_beta == pytest.approx(250e-6 + 115e-6)
    assert x.clamp_k0_mm == pytest.approx(0.125 + 115e-6 * 500.0)
    assert x.register_p0_mm == 200.0
    assert x.register_tan_beta.factors == (pytest.approx(20e-6), pytest.approx(-11.5e-6))
    assert x.register_k0_mm.factors[1] == pytest.approx(11.5e-6 * 500.0)
    # Y and Z have no error of their own: they follow the workpiece about P0 of what they do to X.
    assert [(a.axis.name, a.register_p0_mm, a.k0_source, a.tan_beta_source) for a in (y, z)] == [
        ("Y", 0.0, "", "workpiece"), ("Z", 100.0, "", "workpiece")
    ]  # fmt: skip
    assert y.clamp_tan_beta == pytest.approx(115e-6)


def test_without_an_axis_along_the_direction_the_drift_is_that_of_the_column() -> None:
    """X has no error of its own: what the sweep along Y saw counts, whatever comes first in machine and model."""
    parts = {name: PARTS[name] for name in ("EXZ", "EXY")}
    (x, *_) = plan_registers(mill(parts, "XZY"), SinumerikSettings()).axes
    assert (x.axis.name, x.drift_source, x.slope_source) == ("X", "EXY", None)


def test_the_drift_of_a_joint_model_is_not_chosen() -> None:
    """It is the one of its own component; an axis named for it is refused, its own name is as good as none."""
    joint = mill(PARTS | {"DX": component("DX", term(0.0, 7.0), None, T)}, form="joint")
    with pytest.raises(InputError, match=r"drift_source\.X = 'EXX': the model is in the joint form, its drift is DX"):
        plan_registers(joint, SinumerikSettings(drift_source={"X": "EXX"}))
    for settings in (SinumerikSettings(), SinumerikSettings(drift_source={"X": "DX"})):
        plan = plan_registers(joint, settings)
        assert (plan.axes[0].drift_source, plan.left_out) == ("DX", ())


def test_numbers_of_axes_count_from_one_unless_set() -> None:
    assert {t.base_number for t in plan().tables} == {2, 3}
    assert [t.base_number for t in plan(axis_number={"Y": 7}).tables] == [7, 3]
    assert plan(axis_number={"X": 4}).tables[0].output_number == 4
    for twice in ({"X": 2}, {"Y": 1}, {"Z": 2}):
        with pytest.raises(Exception, match="stands for two axes"):
            plan(axis_number=twice)
    with pytest.raises(Exception, match="axis_name: Q stands for two axes"):
        plan(axis_name={"X": "Q", "Z": "Q"})


# --- sheet ------------------------------------------------------------------------------------------------------------


def part(sheet: str, begin: str, end: str) -> list[list[str]]:
    """Cells of the table rows between two headings."""
    text = sheet[sheet.index(begin) : sheet.index(end)]
    rows = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in text.split("<tr>")]
    return [[unescape(re.sub(r"<[^>]+>", "", cell)) for cell in row] for row in rows if row]


def test_the_sheet_limits_every_register_to_a_micrometre_a_second_at_its_farthest_point() -> None:
    """At 2 µm/s: tanβ over 800 mm of arm, the tables over 0.75 and 0.04 mm."""
    rows = part(commissioning_sheet(plan(rate_limit_um_per_s=2.0)), "5 Limits", "6 The drift")
    assert rows == [
        ["K0 of X1", "± 0.1250 mm", "0.002 mm/s"],
        ["tanβ of X1", "± 2.500e-04 mm/mm", f"{2e-3 / 800:.3g} /s"],
        ["weight of table 0", "± 1", f"{2e-3 / 0.75:.3g} /s"],
        ["weight of table 1", "± 1", f"{2e-3 / 0.04:.3g} /s"],
    ]


def test_the_sheet_says_what_each_register_and_table_carries() -> None:
    sheet = commissioning_sheet(plan())
    axes_and_tables = part(sheet, "1 What goes where", "2 Steps")
    assert axes_and_tables == [
        ["X1 (axis X, +X)", "3", "intercept of EXX", "slope of EXX", "200.0"],
        ["0", "EXY", "Y1 (AX2)", "X1 (AX1)", "-500.0 … 2000.0, step 250.0", "375", "0.7500"],
        ["1", "EXZ", "Z1 (AX3)", "X1 (AX1)", "0.0 … 500.0, step 50.0", "100", "0.0400"],
    ]
    assert "MD18342[0], MD18342[1] = 11 or more" in sheet
    assert "(X1 = 0.87 mm; sized" in sheet


def test_the_sheet_names_the_workpiece_where_a_register_follows_it() -> None:
    length = WantedLength(
        wanted="workpiece", workpiece_expansion_per_K=11.5e-6, workpiece_sensor="part", workpiece_degC=(15.0, 30.0)
    )
    sheet = commissioning_sheet(plan_registers(mill().model_copy(update={"length": length}), SinumerikSettings()))
    rows = part(sheet, "1 What goes where", "2 Steps")[:2]
    assert [row[2:4] for row in rows] == [
        ["intercept of EXX", "slope of EXX, expansion of the workpiece (part)"],
        ["0: drift is counted elsewhere", "expansion of the workpiece (part)"],
    ]


def inexact(reference_degC: float) -> ModelDocument:
    """A mill whose reference has many digits."""
    made = mill()
    laws = {
        axis: law.model_copy(update={"reference": law.reference.model_copy(update={"inputs": (reference_degC,)})})
        for axis, law in made.control.items()
    }
    return made.model_copy(update={"control": laws})


@pytest.mark.parametrize(
    ("reference", "k0", "tan_beta", "lean_of_y"),
    [
        (20.1246, "20.12", "20.125", "20.125"),
        (20.1229, "20.12", "20.12", "20.123"),
        (20.1208, "20.12", "20.12", "20.12"),
        (20.1252, "20.13", "20.125", "20.125"),
    ],
)
def test_sheet_and_program_write_each_law_with_the_digits_that_its_farthest_point_needs(
    reference: float, k0: str, tan_beta: str, lean_of_y: str
) -> None:
    """Below 0.05 µm. K0 moves 10 µm/K, tanβ 20 µm/m over 0.8 m: 16 µm/K, the lean of Y 30 µm/m over 2 m: 60
    µm/K; of Z it is 8 µm/m over 0.4 m.

    So 4.6 mK are 0.046 and 0.074 µm; 2.9 mK 0.029, 0.046 and 0.17; 0.8 mK 0.048 in the lean.
    """
    made = plan_registers(inexact(reference), SinumerikSettings())
    short = f"{reference:.2f}"
    expected = {
        "K0 of X1, mm": f"0.0 + 0.01·(t − {k0})",
        "tanβ of X1, mm/mm": f"0.0 + 0.00002·(t − {tan_beta})",
        "weight of table 0, SD41310": f"0.0 − 0.08·(t − {lean_of_y})",
        "weight of table 1, SD41310": f"0.0 + 0.08·(t − {short})",
    }
    assert {row[0]: row[1] for row in part(commissioning_sheet(made), "4 The law", "5 Limits")} == expected
    labels = ("K0[X1] mm (EXX)", "tanbeta[X1] mm/mm (EXX)", "weight[0] (EXY)", "weight[1] (EXZ)")
    lines = temperature_program(made).splitlines()
    for label, law in zip(labels, expected.values(), strict=True):
        assert f"; {label} = {law.replace('·', ' * ').replace('−', '-')}" in lines


def test_several_sensors_share_what_rounding_may_do() -> None:
    """0.05 µm for one sensor, 0.025 µm for each of two: 3 mK at 10 µm/K are 0.03 µm."""
    one = RegisterLaw(0.0, ("a",), (0.01,), (20.123,))
    two = RegisterLaw(0.0, ("a", "b"), (0.01, -0.001), (20.123, 20.123))
    assert law_in_digits(one, 1e3)[1] == [("+", "0.01", "a", "20.12")]
    assert law_in_digits(two, 1e3)[1] == [("+", "0.01", "a", "20.123"), ("-", "0.001", "b", "20.12")]
    assert law_in_digits(RegisterLaw(-1.23456789), 1e3) == ("-1.234568", [])
    assert RegisterLaw(2.0).at({}).tolist() == [2.0]  # a constant needs no temperature


def test_numbers_are_decimals_without_an_exponent_or_a_negative_zero() -> None:
    assert [number(v) for v in (1e-7, 12345678.0, -0.0, 0.1 + 0.2)] == ["0.0000001", "12345678.0", "0.0", "0.3"]
    assert [rounded(v, 3) for v in (-0.0004, 1.23456, -1.5)] == ["0.0", "1.235", "-1.5"]


def test_machine_data_and_tables_of_the_files() -> None:
    settings = {"md32760_comp_add_velo_factor": 0.02, "md32730_cec_max_velo_factor": 0.3}
    lines = temperature_program(plan(**settings)).splitlines()
    for line in (
        "$MA_TEMP_COMP_TYPE[X1]=3 ; MD32750",
        "$MA_COMP_ADD_VELO_FACTOR[X1]=0.02 ; MD32760",
        "$MA_CEC_MAX_SUM[X1]=0.87 ; MD32720, mm",
        "$MA_CEC_MAX_VELO[X1]=0.3 ; MD32730",
        "$SA_TEMP_COMP_REF_POSITION[X1]=200.0 ; SD43920, P0, mm in MCS",
        "$SN_CEC_TABLE_WEIGHT[1]=0.0 ; SD41310, EXZ",
    ):
        assert line in lines
    table = sag_tables(plan()).splitlines()
    for line in (
        "; EXZ: base Z1, output X1, 100.0 um/m at weight 1, zero at 100.0 mm",
        "$AN_CEC[1,0]=-0.01", "$AN_CEC[1,2]=0.0", "$AN_CEC[1,10]=0.04",
        "$AN_CEC_STEP[1]=50.0", "$AN_CEC_MIN[1]=0.0", "$AN_CEC_MAX[1]=500.0",
    ):  # fmt: skip
        assert line in table


def test_values_at_the_states_are_those_of_the_law_in_table_and_program() -> None:
    made = plan()
    rows = list(csv.reader(values_csv(made).splitlines()))
    assert rows[0] == ["t_degC", "K0_X1_mm", "tanbeta_X1", "weight_table_0", "weight_table_1"]
    assert len(rows) == 11
    assert rows[1] == ["18.0", "-0.02", "-0.00004", "0.16", "-0.16"]
    assert rows[10] == ["30.0", "0.1", "0.0002", "-0.8", "0.8"]
    lines = temperature_program(made).splitlines()
    begin = next(i for i, line in enumerate(lines) if "--- 4" in line)
    assert lines[begin + 1].split()[1:] == rows[0]
    assert [float(cell) for cell in lines[begin + 11].split()[1:]] == [30.0, 0.1, 0.0002, -0.8, 0.8]


def test_values_have_the_places_that_a_thousandth_of_a_micrometre_needs() -> None:
    """K0 in mm to 1e-7, tanβ to 1e-12, a weight to 1e-9; 10 K times factors of many digits."""
    odd = term(0.0, 10.123456789), term(0.0, 20.123456789)
    parts = {
        "EXX": component("EXX", *odd, T, p=(200.0, 0.0, 1000.0)),
        "EXY": component("EXY", *odd, T, p=(0.0, -500.0, 2000.0)),
    }
    changed = plan_registers(mill(parts), SinumerikSettings())
    last = list(csv.reader(values_csv(changed).splitlines()))[-1]
    reference = np.ceil(1.25 * 201.23456789)
    assert last[1:] == ["0.1012346", "0.000201234568", f"{201.23456789 / reference:.9f}"]
    lines = temperature_program(changed).splitlines()
    begin = next(i for i, line in enumerate(lines) if "--- 4" in line)
    assert lines[begin + 11].split()[2:] == last[1:]


def test_a_program_has_no_line_beyond_what_a_control_reads() -> None:
    """Seven registers and more go into several tables of six columns."""
    lines = temperature_program(plan_registers(three_axes(), SinumerikSettings())).splitlines()
    begin = next(i for i, line in enumerate(lines) if "--- 4" in line)
    heads = [line.split()[1:] for line in lines[begin:] if "_degC" in line]
    registers = [[name for name in head if not name.endswith("_degC")] for head in heads]
    assert [len(one) for one in registers] == [6, 6]
    assert len({name for one in registers for name in one}) == 12


# --- sign test --------------------------------------------------------------------------------------------------------


def test_sign_tests_are_made_at_the_end_that_is_farther_from_p0() -> None:
    """tanβ: 10 µm over 800 mm. EXY reaches 0.75 mm at 2000 mm; EXZ 0.04 mm at 500 mm."""
    k0, tan_beta, y, z = sign_tests(plan())
    assert (k0.where, k0.direction, k0.movement_um) == ("anywhere", "−X", 10.0)
    assert tan_beta.where == "X1 at 1000.0 mm"
    assert tan_beta.enter == "$SA_TEMP_COMP_SLOPE[X1] = 0.000012500"
    assert (y.where, y.enter) == ("Y1 at 2000.0 mm", "$SN_CEC_TABLE_WEIGHT[0] = 0.013333")
    assert (z.where, z.enter) == ("Z1 at 500.0 mm", "$SN_CEC_TABLE_WEIGHT[1] = 0.250000")
    assert [test.movement_um for test in (tan_beta, y, z)] == pytest.approx([10.0, 9.99975, 10.0])
    other = mill()
    laws = dict(other.control)
    for axis in ("X", "Z"):
        laws[axis] = laws[axis].model_copy(update={"p0_mm": 900.0, "p_max_mm": 1000.0, "p_min_mm": -20.0})
    _, tan_beta, _, z = sign_tests(plan_registers(other.model_copy(update={"control": laws}), SinumerikSettings()))
    assert (tan_beta.where, z.where) == ("X1 at -20.0 mm", "Z1 at -20.0 mm")
    # 100 µm/m over -920 mm is -0.092 mm: the weight is negative, the tool moves against +10 µm of error all the same.
    assert z.enter == "$SN_CEC_TABLE_WEIGHT[1] = -0.108696"
    assert z.direction == "−X"


def test_the_farther_end_counts_from_p0_not_from_the_scale() -> None:
    """From 600 mm it is 150 mm to the upper end at 750 and 100 to the lower one at 500; halfway the upper one."""
    for p0_mm, end_mm in ((600.0, 750.0), (650.0, 500.0), (625.0, 750.0)):
        changed = mill(PARTS | {"EXZ": PARTS["EXZ"] | {"p0_mm": p0_mm, "p_min_mm": 500.0, "p_max_mm": 750.0}})
        assert sign_tests(plan_registers(changed, SinumerikSettings()))[-1].where == f"Z1 at {end_mm} mm"


def test_a_flat_table_gives_what_it_can() -> None:
    """1 µm/m over 0.4 m is 0.4 µm at weight 1: no weight above 1 is asked for."""
    made = plan()
    flat = replace(made.tables[1], register_mm=tuple(v / 100.0 for v in made.tables[1].register_mm))
    weak = sign_tests(replace(made, tables=(flat,)))[-1]
    assert weak.enter.endswith("= 1.000000")
    assert weak.movement_um == pytest.approx(0.4)


# --- remarks ----------------------------------------------------------------------------------------------------------


def test_what_heat_history_would_do_better_is_told_component_by_component() -> None:
    class Fitted:
        def __init__(self, rms_um: float | None) -> None:
            self.held_out_um = None if rms_um is None else (rms_um, 0.0, 0.0)

    class OfAxis:
        def __init__(self, **components: Fitted) -> None:
            self.components = components

    made = plan()
    laws = {
        axis: law.model_copy(
            update={
                "components": {
                    name: part.model_copy(update={"held_out_um": (10.0, 20.0, 30.0)})
                    for name, part in law.components.items()
                }
            }
        )
        for axis, law in made.model.control.items()
    }
    model = made.model.model_copy(update={"control": laws})

    def told(**history: OfAxis) -> str:
        changed = model.model_copy(update={"prediction": history})
        return " ".join(left_to_history(replace(made, model=changed)))

    assert told() == ""
    assert told(X=OfAxis(EXX=Fitted(6.0)), Y=OfAxis(EXY=Fitted(12.0)), Z=OfAxis(EXZ=Fitted(None))).endswith(
        "Held out it leaves (RMS): EXX 10.0 instead of 6.0 µm."
    )
    assert "Held out" not in told(X=OfAxis(EXX=Fitted(10.0)))
    assert "Held out" not in told(X=OfAxis())
    both = told(X=OfAxis(EXX=Fitted(6.0)), Y=OfAxis(EXY=Fitted(9.94)))
    assert both.endswith("EXX 10.0 instead of 6.0 µm, EXY 10.0 instead of 9.9 µm.")


def test_a_good_plan_has_nothing_to_be_said_but_drift_that_is_not_alike() -> None:
    """Intercepts of 40 µm are left out where 100 µm are counted: they differ, for nothing scatters."""
    (one,) = remarks(plan())
    assert one.startswith("DRIFT DOES NOT AGREE: K0[X1] carries the intercept of EXX, +100 µm")
    assert "1 more such pairs" in one
    (alone,) = remarks(plan_registers(mill({name: PARTS[name] for name in ("EXX", "EXY")}), SinumerikSettings()))
    assert alone.endswith("[drift_source] in export.toml makes the choice.")
    assert not_compensated(plan()) == ()


# --- names ------------------------------------------------------------------------------------------------------------


def test_names_keep_their_spelling_where_they_can_and_stay_apart() -> None:
    """Plain names first; then what can be spelled in full; else the place. A name that is taken is not taken again."""
    given = ["ä", "ae", "ß", "sensor_5", "x镗", "θ", "Θ"]
    assert ascii_names(given, "sensor") == {
        "ä": "sensor_1", "ae": "ae", "ß": "ss", "sensor_5": "sensor_5", "x镗": "sensor_5_", "θ": "theta", "Θ": "Theta"
    }  # fmt: skip
    assert ascii_names(["é", "è"], "s") == {"é": "e", "è": "s_2"}


# --- limits of the replay ---------------------------------------------------------------------------------------------


def test_a_ramp_that_one_step_exceeds_is_limited_though_all_others_keep_below() -> None:
    t_s = np.array([0.0, 1.0, 2.0, 3.0, 5.0])
    value = np.array([0.0, 0.1, 5.0, 5.1, 5.1])
    np.testing.assert_allclose(rate_limit(t_s, value, 1.0), [0.0, 0.1, 1.1, 2.1, 4.1])
    np.testing.assert_allclose(rate_limit(t_s, -value, 1.0), [0.0, -0.1, -1.1, -2.1, -4.1])
    np.testing.assert_array_equal(rate_limit(t_s, value, 4.9), value)
    assert rate_limit(t_s, value, 4.9) is not value


def test_a_writer_counts_its_updates_from_the_first_sample() -> None:
    t_s = np.array([7.0, 12.0, 17.0, 22.0, 27.0])
    np.testing.assert_allclose(sample_and_hold(t_s, np.arange(5.0), 10.0), [0.0, 0.0, 2.0, 2.0, 4.0])
    np.testing.assert_allclose(sample_and_hold(t_s, np.arange(5.0), 5.0), np.arange(5.0))


def test_a_mean_over_cycles_begins_with_the_first_value() -> None:
    t_s = np.arange(5.0)
    value = np.array([3.0, 0.0, 6.0, 9.0, 0.0])
    np.testing.assert_allclose(moving_average(t_s, value, 3, 1.0), [3.0, 2.0, 3.0, 5.0, 5.0])
    np.testing.assert_allclose(moving_average(t_s, value, 1, 1.0), value)


def test_rounding_goes_to_the_nearest_step() -> None:
    np.testing.assert_allclose(quantise(np.zeros(4), np.array([0.24, 0.26, -0.26, 1.0]), 0.5), [0.0, 0.5, -0.5, 1.0])


def test_losses_are_counted_in_micrometres_against_the_frozen_value() -> None:
    """Wanted 0, 2, (missing), 4 mm at 10 µm a unit, clipped at 1.8: losses 0, 2, 2, 22 µm; 1 µm is not noticed."""
    t_s = np.array([0.0, 10.0, 20.0, 30.0])
    one = Register("X1", "K0", np.array([0.0, 2.0, np.nan, 4.0]), 10.0, (Stage("c", partial(clip, limit=1.8)),))
    alone, together = replay(t_s, [one])
    assert (alone.axis, alone.register, alone.cause, together.cause) == ("X1", "K0", "c", "all together")
    assert (alone.largest_um, alone.largest_at_s) == (pytest.approx(22.0), 30.0)
    assert alone.p95_um == pytest.approx(np.quantile([0.0, 2.0, 2.0, 22.0], 0.95))
    assert alone.share_of_time == 0.75
    edge = replace(one, wanted=np.array([0.0, 1.875, 2.0, 2.0]), um_per_unit=8.0)
    edge = replace(edge, stages=(Stage("c", partial(clip, limit=1.875)),))
    assert replay(t_s, [edge])[0].share_of_time == 0.0  # just 1 µm
    assert outcome(t_s, one, []).tolist() == [0.0, 2.0, 2.0, 4.0]


# --- a whole campaign -------------------------------------------------------------------------------------------------

QUIET = {"update_s": 0.0, "entry_step_um": 0.0}
T_S = np.arange(0.0, 3601.0)


def campaign(own: dict[str, object] | None = None, **settings: object) -> CampaignReplay:
    """10 K in an hour, from 21.5 °C on."""
    given = SinumerikSettings.model_validate({"replay": ReplaySettings.model_validate(own or QUIET), **settings})
    return replay_campaign(mill(), given, "A", T_S, {"t": 21.5 + T_S / 360.0})


def lost(one: CampaignReplay, register: str, cause: str) -> float:
    (found,) = (x.largest_um for x in one.losses if (x.register, x.cause) == (register, cause))
    return found


EXY, EXZ = "weight of table 0 (EXY)", "weight of table 1 (EXZ)"


def test_wanted_values_stand_in_micrometres_at_the_worst_position() -> None:
    """100 µm of drift; 200 µm/m over 0.8 m; -300 µm/m over 2 m; 80 µm/m over 0.4 m; both tables together."""
    one = campaign()
    assert one.registers == ("K0 of X1", "tanβ of X1", f"{EXY} of X1", f"{EXZ} of X1", "sum of the tables of X1")
    np.testing.assert_allclose(one.wanted_um[:, -1], [100.0, 160.0, -600.0, 32.0, 632.0])
    np.testing.assert_allclose(one.wanted_um[:, 1800], [50.0, 80.0, -300.0, 16.0, 316.0])
    np.testing.assert_allclose(one.got_um, one.wanted_um, atol=1e-6)
    assert all(x.largest_um < 1e-6 for x in one.losses)
    assert (one.campaign, one.t_s is T_S) == ("A", True)


def test_entries_and_rounding_are_those_of_the_worst_position() -> None:
    one = campaign({**QUIET, "largest_entry_um": 120.0, "entry_step_um": 4.0})
    assert lost(one, "K0", ENTRY) == 0.0
    assert lost(one, "tanβ", ENTRY) == pytest.approx(40.0)
    assert lost(one, EXY, ENTRY) == pytest.approx(480.0)
    assert lost(one, EXZ, ENTRY) == 0.0
    for register in ("K0", "tanβ", EXY, EXZ):
        assert 1.8 < lost(one, register, ROUNDING) <= 2.0 + 1e-9
    plain = {x.cause for x in campaign().losses}
    assert not plain & {ENTRY, ROUNDING, FILTER}
    assert FILTER in {x.cause for x in campaign({**QUIET, "filter_cycles": 2}).losses}


def test_clamps_are_those_of_the_training_range_not_of_the_campaign() -> None:
    """Twice the heat: 1.25 × 100 µm of K0 are allowed of 200; weights reach 1.6 of 1."""
    settings = SinumerikSettings(replay=ReplaySettings.model_validate(QUIET))
    hot = replay_campaign(mill(), settings, "A", T_S, {"t": 21.5 + T_S / 180.0})
    assert lost(hot, "K0", CLAMP) == pytest.approx(75.0)
    assert lost(hot, "tanβ", CLAMP) == pytest.approx(320.0 - 200.0)
    assert lost(hot, EXY, CLAMP) == pytest.approx(0.6 * 750.0)
    assert lost(hot, EXZ, CLAMP) == pytest.approx(0.6 * 40.0)
    # 1200 and 64 µm are asked of a sum of 870.
    assert lost(hot, "sum of the tables", SUM) == pytest.approx(1264.0 - 870.0)


def test_what_the_control_gives_a_second_is_a_share_of_its_fastest_velocity() -> None:
    """MD32000 of 6 mm/min is 100 µm/s: a factor of 1e-4 gives 0.01 µm/s, 36 µm in the hour."""
    own = {**QUIET, "md32000_mm_per_min": 6.0}
    slow = campaign(own, md32760_comp_add_velo_factor=1e-4, md32730_cec_max_velo_factor=1e-3, rate_limit_um_per_s=9.0)
    assert lost(slow, "K0", STEP) == pytest.approx(100.0 - 36.0)
    assert lost(slow, "tanβ", STEP) == pytest.approx(160.0 - 36.0)
    assert lost(slow, EXY, SUM_STEP) == pytest.approx(600.0 - 360.0)
    assert lost(slow, EXZ, SUM_STEP) == pytest.approx(0.0, abs=1e-9)
    checks = {check.register: check for check in slow.motion}
    assert list(checks) == ["tanβ of X1", f"{EXY} of X1", f"{EXZ} of X1"]
    # The axis at 100 µm/s = 1e-4 m/s: slopes of 200, 300 and 80 µm/m.
    for name, slope, factor in (
        ("tanβ of X1", 200.0, 1e-4),
        (f"{EXY} of X1", 300.0, 1e-3),
        (f"{EXZ} of X1", 80.0, 1e-3),
    ):
        assert checks[name].needed_um_per_s == pytest.approx(slope * 1e-4)
        assert checks[name].allowed_um_per_s == pytest.approx(100.0 * factor)
    assert [check.holds for check in slow.motion] == [False, True, True]


def test_a_register_that_carries_nothing_is_not_replayed() -> None:
    drift_alone = document({"X": "+X"}, {"DX": component("DX", term(0.0, 4.0), None, T)}, {"t": (0.0, 5.0)})
    one = replay_campaign(drift_alone, SinumerikSettings(), "A", T_S, {"t": 20.0 + T_S / 3600.0})
    assert one.registers == ("K0 of X1",)
    assert one.motion == ()


def test_a_temperature_that_is_lost_on_the_way_freezes_the_registers() -> None:
    degC = 21.5 + T_S / 360.0
    degC[1800:] = np.nan
    settings = SinumerikSettings(replay=ReplaySettings.model_validate(QUIET))
    one = replay_campaign(mill(), settings, "A", T_S, {"t": degC})
    np.testing.assert_allclose(one.got_um[:, -1], one.wanted_um[:, 1799], atol=1e-6)
    assert one.motion[0].needed_um_per_s == pytest.approx(200.0 * 1799 / 3600 / 6.0)

"""Export to SINUMERIK: the files are read back by a little reader of their own and replayed against the model."""

from __future__ import annotations

import csv
import itertools
import json
import re
from collections import defaultdict
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from small_models import PLACES, component, document, nothing_predicts, term, three_axes
from typer.testing import CliRunner

from thetacomp.cli.main import app
from thetacomp.controllers.ascii_text import ascii_names, ascii_text
from thetacomp.controllers.sinumerik import plan_registers
from thetacomp.controllers.sinumerik_remarks import differing
from thetacomp.controllers.sinumerik_settings import SinumerikSettings
from thetacomp.errors import InputError
from thetacomp.model.document import ModelDocument
from thetacomp.model.law import component_laws

FILES = (
    "sinumerik_temperature_compensation.spf",
    "sinumerik_cec.ini",
    "sinumerik_values.csv",
    "commissioning_sheet.html",
)


@dataclass
class Control:
    """What a control would hold after loading the files: built from their text alone."""

    laws: dict[str, list[tuple[float, str, float]]] = field(default_factory=dict)
    p0_mm: dict[str, float] = field(default_factory=dict)
    machine_data: dict[str, str] = field(default_factory=dict)
    tables: dict[int, dict[str, object]] = field(default_factory=lambda: defaultdict(dict))

    def value(self, register: str, degC: dict[str, float]) -> float:
        """A register from the law in the comments of the .spf file."""
        return sum(f * (degC[s] - r) if s else f for f, s, r in self.laws.get(register, []))

    def compensation_mm(self, axis: str, degC: dict[str, float], position_mm: dict[str, float]) -> float:
        """K0 + tanβ (P - P0) of a channel axis plus its weighted CEC tables."""
        return self.own_mm(axis, degC, position_mm) + self.cross_mm(axis, degC, position_mm)

    def own_mm(self, axis: str, degC: dict[str, float], position_mm: dict[str, float]) -> float:
        arm_mm = position_mm[axis] - self.p0_mm.get(axis, 0.0)
        return self.value(f"K0[{axis}]", degC) + self.value(f"tanbeta[{axis}]", degC) * arm_mm

    def cross_mm(self, axis: str, degC: dict[str, float], position_mm: dict[str, float]) -> float:
        total = 0.0
        for t, table in self.tables.items():
            if table["OUTPUT_AXIS"] == axis:
                start, end, step = (float(str(table[key])) for key in ("MIN", "MAX", "STEP"))
                points = [v for _, v in sorted(table["points"].items())]  # type: ignore[attr-defined]
                assert start + step * (len(points) - 1) == pytest.approx(end, abs=1e-9)
                p = start + step * np.arange(len(points))
                total += self.value(f"weight[{t}]", degC) * np.interp(position_mm[str(table["INPUT_AXIS"])], p, points)
        return total


def load(folder: Path, numbers: dict[int, str]) -> Control:
    """Read the .spf and .ini as a control and an engineer would; `numbers` is AXn -> channel axis."""
    control = Control()
    for line in (folder / FILES[0]).read_text(encoding="ascii").splitlines():
        if match := re.match(r"; (K0\[\w+\]|tanbeta\[\w+\]|weight\[\d+\]) [^=]*= (-?[\d.]+)(.*)$", line):
            register, constant, rest = match.groups()
            terms = re.findall(r" ([+-]) ([\d.]+) \* \((\S+) - (-?[\d.]+)\)", rest)
            assert "".join(f" {s} {f} * ({name} - {r})" for s, f, name, r in terms) == rest, line
            assert register not in control.laws
            control.laws[register] = [(float(constant), "", 0.0)]
            control.laws[register] += [(float(s + f), name, float(r)) for s, f, name, r in terms]
        elif match := re.match(r"\$SA_TEMP_COMP_REF_POSITION\[(\w+)\]=(\S+)", line):
            control.p0_mm[match[1]] = float(match[2])
        elif match := re.match(r"(\$\w+\[\w+\])=(\S+)", line):
            control.machine_data[match[1]] = match[2]
    if (folder / FILES[1]).exists():
        for line in (folder / FILES[1]).read_text(encoding="ascii").splitlines():
            if match := re.match(r"\$AN_CEC\[(\d+),(\d+)\]=(-?[\d.]+)$", line):
                control.tables[int(match[1])].setdefault("points", {})[int(match[2])] = float(match[3])  # type: ignore[index]
            elif match := re.match(r"\$AN_CEC_(\w+)\[(\d+)\]=(.*)$", line):
                axis = re.match(r"\(AX(\d+)\)", match[3])
                control.tables[int(match[2])][match[1]] = numbers[int(axis[1])] if axis else match[3]
    return control


def export(tmp_path: Path, model: ModelDocument, toml: str = "", expect: int = 0) -> Path:
    model.save(tmp_path / "model.json")
    (tmp_path / "export.toml").write_text(toml, encoding="utf-8")
    arguments = ["export", str(tmp_path / "model.json"), "--target", "sinumerik", "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(app, [*arguments, "--settings", str(tmp_path / "export.toml")])
    assert result.exit_code == expect, result.output
    return tmp_path / "out"


def console(tmp_path: Path) -> tuple[int, str]:
    """The end and the words of the export of the model that `export` has saved."""
    arguments = ["export", str(tmp_path / "model.json"), "--target", "sinumerik", "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(app, arguments)
    return result.exit_code, result.output


def states(model: ModelDocument) -> list[dict[str, float]]:
    """All corners of the training range and its middle: inputs out of step with each other."""
    ranges = {s: span for law in model.control.values() for s, span in law.border.temperature_degC.items()}
    corners = [dict(zip(ranges, corner, strict=True)) for corner in itertools.product(*ranges.values())]
    return [*corners, {sensor: sum(limits) / 2 for sensor, limits in ranges.items()}]


def errors_um(
    model: ModelDocument, degC: dict[str, float], p: dict[str, float], **reference: dict[str, float]
) -> dict[str, float]:
    """`intercept + slope` parts of every component, each by hand from the document."""
    out = {}
    for name, law in component_laws(model.control, reference.get("reference_degC")).items():
        rises = law.rises_K(np.array([[degC[s] for s in law.inputs]]))
        out[name] = float(law.error_um(rises, np.array([p[law.axis]]))[0])
    return out


@pytest.mark.parametrize("temperature_sign", [1, -1])
@pytest.mark.parametrize("cec_sign", [1, -1])
@pytest.mark.parametrize("directions", [("+X", "+Y", "+Z"), ("-X", "+Y", "-Z")])
def test_replay_takes_away_the_error_of_the_model(
    tmp_path: Path, temperature_sign: int, cec_sign: int, directions: tuple[str, str, str]
) -> None:
    """K0 + tanβ (P - P0) + Σ w table, as an error along X, Y, Z, is the model's: drift once, all slopes."""
    model = three_axes(directions=directions)
    folder = export(tmp_path, model, f"sign_temperature = {temperature_sign}\nsign_cec = {cec_sign}\n")
    control = load(folder, {1: "X1", 2: "Y1", 3: "W1"})
    rng = np.random.default_rng(5)
    worst_um = 0.0
    for degC in states(model):
        for corner in range(4):
            p = {}
            for axis in "XYW":
                one = model.control[axis]
                low, high = one.p_min_mm, one.p_max_mm
                assert low is not None
                assert high is not None
                p[axis] = float(rng.uniform(low, high)) if corner else low
            by_name = errors_um(model, degC, p)
            at_p0 = errors_um(model, degC, {axis: law.p0_mm or 0.0 for axis, law in model.control.items()})
            for direction, axis in zip("XYZ", "XYW", strict=True):
                # One intercept (the axis along the direction), the slope part of all three axes.
                wanted = at_p0[f"E{direction}{axis}"]
                wanted += sum(by_name[f"E{direction}{a}"] - at_p0[f"E{direction}{a}"] for a in "XYW")
                axis_sign = 1 if directions["XYW".index(axis)][0] == "+" else -1
                positions = {f"{a}1": value for a, value in p.items()}
                own_mm = temperature_sign * control.own_mm(f"{axis}1", degC, positions)
                cross_mm = cec_sign * control.cross_mm(f"{axis}1", degC, positions)
                replayed = 1e3 * axis_sign * (own_mm + cross_mm)
                worst_um = max(worst_um, abs(replayed - wanted))
    assert worst_um < 0.05


def test_one_axis_moving_sees_exactly_its_own_error(tmp_path: Path) -> None:
    """With the other axes at P0 the replay is the model's own `EZW` at every position of W: a negative axis."""
    model = three_axes()
    control = load(export(tmp_path, model), {1: "X1", 2: "Y1", 3: "W1"})
    rest = {"X1": 1234.567, "Y1": 0.0}
    for degC in states(model):
        for w in (10.0, 481.3, 993.7):
            wanted = errors_um(model, degC, {"X": 0.0, "Y": 0.0, "W": w})["EZW"]
            assert -1e3 * control.compensation_mm("W1", degC, {**rest, "W1": w}) == pytest.approx(wanted, abs=0.05)


def test_values_file_agrees_with_the_laws_and_the_weights_stay_below_one(tmp_path: Path) -> None:
    model = three_axes()
    folder = export(tmp_path, model)
    control = load(folder, {1: "X1", 2: "Y1", 3: "W1"})
    with (folder / FILES[2]).open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 10
    names = {f"K0_{a}1_mm": f"K0[{a}1]" for a in "XYW"} | {f"tanbeta_{a}1": f"tanbeta[{a}1]" for a in "XYW"}
    names |= {f"weight_table_{t}": f"weight[{t}]" for t in range(6)}
    assert set(rows[0]) == set(names) | {"tx_degC", "ty_degC", "oil_degC", "tw_degC"}
    for row in rows:
        degC = {sensor: float(row[f"{sensor}_degC"]) for sensor in ("tx", "ty", "oil", "tw")}
        for column, register in names.items():
            # Over 6 m of travel and 0.4 mm of table each of these is below 0.001 µm.
            allowed = 1e-7 if column[0] == "K" else 1e-10 if column[0] == "t" else 1e-6
            assert float(row[column]) == pytest.approx(control.value(register, degC), abs=allowed)
    for degC in states(model):
        assert all(abs(control.value(f"weight[{t}]", degC)) < 1 / 1.25 + 1e-9 for t in range(6))


def test_drift_counts_once_and_the_choice_is_a_setting(tmp_path: Path) -> None:
    model = three_axes()
    folder = export(tmp_path, model, '[drift_source]\nX = "EXY"\n')
    text = (folder / FILES[0]).read_text(encoding="ascii")
    k0 = re.findall(r"; K0\[(\w+)\] mm \((\w+)\) =", text)
    assert k0 == [("X1", "EXY"), ("Y1", "EYY"), ("W1", "EZW")]
    control = load(folder, {1: "X1", 2: "Y1", 3: "W1"})
    degC = {"tx": 25.0, "ty": 24.0, "oil": 23.0, "tw": 26.0}
    p0 = {"X1": 1234.567, "Y1": 0.0, "W1": 481.3}
    wanted = errors_um(model, degC, {"X": 0.0, "Y": 0.0, "W": 0.0})["EXY"]  # at P0 of Y
    assert 1e3 * control.compensation_mm("X1", degC, p0) == pytest.approx(wanted, abs=0.05)
    sheet = (folder / FILES[3]).read_text(encoding="utf-8")
    left_out = sheet[sheet.index("6 The drift counts once") : sheet.index("What is proven")]
    assert re.findall(r"<tr><td>(E\w\w)</td>", left_out) == ["EXX", "EYX", "EZX", "EZY", "EXW", "EYW"]


def secondary() -> ModelDocument:
    """W lies along +Z beside Z; both have an error of their own along Z, and X tilts towards Z."""
    t = {"t": 20.0}
    parts = {
        "EZX": component("EZX", term(0.0, 2.0), term(0.0, 5.0), t),
        "EZZ": component("EZZ", term(0.0, 7.0), term(0.0, 3.0), t, p=(100.0, 0.0, 800.0)),
        "EZW": component("EZW", term(0.0, 9.0), term(0.0, 4.0), t, p=(200.0, 0.0, 600.0)),
    }
    return document({"X": "+X", "Z": "+Z", "W": "+Z"}, parts, {"t": (0.0, 10.0)})


def test_secondary_axis_corrects_its_own_slope_and_drift_goes_to_one_axis(tmp_path: Path) -> None:
    control = load(export(tmp_path, secondary()), {1: "X1", 2: "Z1", 3: "W1"})
    assert control.machine_data["$MA_TEMP_COMP_TYPE[Z1]"] == "3"
    assert control.machine_data["$MA_TEMP_COMP_TYPE[W1]"] == "2"
    p = {"X1": 900.0, "Z1": 700.0, "W1": 550.0}
    # +10 K: 70 µm of drift once, 30 µm/m x 0.6 m on Z, 40 µm/m x 0.35 m on W, 50 µm/m x 0.9 m from X on Z.
    assert 1e3 * control.compensation_mm("Z1", {"t": 30.0}, p) == pytest.approx(70 + 18 + 45, abs=0.01)
    assert 1e3 * control.compensation_mm("W1", {"t": 30.0}, p) == pytest.approx(14, abs=0.01)


def test_all_errors_of_a_direction_can_go_to_one_axis(tmp_path: Path) -> None:
    control = load(export(tmp_path, secondary(), '[output_axis]\nZ = "W"\n'), {1: "X1", 2: "Z1", 3: "W1"})
    p = {"X1": 900.0, "Z1": 700.0, "W1": 550.0}
    assert 1e3 * control.compensation_mm("W1", {"t": 30.0}, p) == pytest.approx(90 + 18 + 14 + 45, abs=0.01)
    assert control.compensation_mm("Z1", {"t": 30.0}, p) == 0.0


def test_reference_of_the_day_makes_all_registers_zero_there(tmp_path: Path) -> None:
    model = three_axes()
    day = {"tx": 21.0, "ty": 20.5, "oil": 22.0, "tw": 20.25}
    toml = "[reference_degC]\n" + "".join(f"{s} = {v}\n" for s, v in day.items())
    control = load(export(tmp_path, model, toml), {1: "X1", 2: "Y1", 3: "W1"})
    assert all(control.value(register, day) == 0.0 for register in control.laws)
    warm = {sensor: degC + 2.0 for sensor, degC in day.items()}
    p = {"X1": 1234.567, "Y1": 1000.0, "W1": 481.3}
    wanted = errors_um(model, warm, {"X": 0.0, "Y": 1000.0, "W": 0.0}, reference_degC=day)["EYY"]
    assert 1e3 * control.compensation_mm("Y1", warm, p) == pytest.approx(wanted, abs=0.05)


def test_table_slope_is_sized_from_the_largest_slope_with_reserve(tmp_path: Path) -> None:
    """One input, 8 K, 99 µrad at the end as on this class of machines, no scatter: 1.25 x 99 = 124 µm/m, not 100."""
    exy = component("EXY", term(0.0, 1.0), term(0.0, 12.375), {"t": 20.0}, p=(0.0, 0.0, 3000.0))
    model = document({"X": "+X", "Y": "+Y"}, {"EXY": exy}, {"t": (0.0, 8.0)})
    folder = export(tmp_path, model)
    text = (folder / FILES[1]).read_text(encoding="ascii")
    assert "124.0 um/m at weight 1" in text
    assert "$AN_CEC[0,10]=0.372\n" in text  # 124 µm/m x 3 m
    spf = (folder / FILES[0]).read_text(encoding="ascii")
    assert "$MA_CEC_MAX_SUM[X1]=0.41 ; MD32720" in spf  # 0.372 mm and a tenth, rounded up


def test_files_are_of_the_form_that_the_control_reads(tmp_path: Path) -> None:
    folder = export(tmp_path, three_axes(), 'first_cec_table = 3\n[axis_name]\nW = "Z2"\n[axis_number]\nW = 7\n')
    cec = (folder / FILES[1]).read_text(encoding="ascii").splitlines()
    assert cec[:2] == ["%_N_NC_CEC_INI", ";$PATH=/_N_NC_ACT/_N_CEC_DIR"]
    assert cec[-1] == "M17"
    assert "CHANDATA(1)" in cec
    assert "$AN_CEC_INPUT_AXIS[8]=(AX7)" in cec
    keys = {re.match(r"\$AN_CEC_(\w+)\[3\]=", line)[1] for line in cec if re.match(r"\$AN_CEC_(\w+)\[3\]=", line)}  # type: ignore[index]
    assert keys == {"INPUT_AXIS", "OUTPUT_AXIS", "STEP", "MIN", "MAX", "DIRECTION", "MULT_BY_TABLE", "IS_MODULO"}
    spf = (folder / FILES[0]).read_text(encoding="ascii").splitlines()
    assert spf[-1] == "M17"
    assert "$SA_TEMP_COMP_ABS_VALUE[Z2]=0.0 ; SD43900, K0, mm" in spf
    commands = [line for line in (*cec, *spf) if not line.startswith((";", "%"))]
    assert not [line for line in commands if re.search(r"=-?[\d.]*[eE][-+]?\d", line)]  # no exponents in NC blocks


def test_names_beyond_ascii_or_with_line_breaks_do_no_harm(tmp_path: Path) -> None:
    broken = three_axes().model_copy(update={"machine": "Maschine\nM30"})
    broken.save(tmp_path / "broken.json")
    refused = CliRunner().invoke(
        app, ["export", str(tmp_path / "broken.json"), "--target", "sinumerik", "--out", str(tmp_path / "never")]
    )
    assert refused.exit_code == 1
    assert "it holds the control character U+000A" in refused.output
    folder = export(tmp_path, three_axes().model_copy(update={"machine": "Maschine Ä <b>"}))
    for name in FILES[:2]:
        assert (folder / name).read_bytes().decode("ascii")
    assert "Ä &lt;b&gt;" in (folder / FILES[3]).read_text(encoding="utf-8")


def test_unproven_sign_is_told_everywhere_and_ends_with_3(tmp_path: Path) -> None:
    folder = export(tmp_path, three_axes("unproven"), expect=3)
    assert sorted(p.name for p in folder.iterdir()) == sorted(FILES)
    for name in FILES[:2]:
        assert "SIGN UNPROVEN" in "".join((folder / name).read_text(encoding="ascii").splitlines(keepends=True)[:6])
    assert '<div class="banner">SIGN UNPROVEN' in (folder / FILES[3]).read_text(encoding="utf-8")
    arguments = ["export", str(tmp_path / "model.json"), "--target", "sinumerik", "--out", str(folder), "--json"]
    answer = json.loads(CliRunner().invoke(app, arguments).stdout)
    assert answer["exit_code"] == 3
    assert "sign" in answer["reason"]


def test_stated_sign_has_no_banner(tmp_path: Path) -> None:
    folder = export(tmp_path, three_axes())
    assert not [name for name in FILES if "SIGN UNPROVEN" in (folder / name).read_text(encoding="utf-8")]


def sign_rows(folder: Path) -> list[tuple[str, ...]]:
    """Register, position, what to enter, µm, direction and the remedy of every row of the sign test."""
    sheet = (folder / FILES[3]).read_text(encoding="utf-8")
    part = sheet[sheet.index("Sign test with") : sheet.index("The law of every register")]
    out = []
    for row in re.findall(r"<tr>(<td.*?)</tr>", part):
        cells = [
            " ".join(re.sub(r"<[^>]+>", "", cell.replace("<br>", " ")).split())
            for cell in re.findall(r"<td[^>]*>(.*?)</td>", row)
        ]
        moved = re.fullmatch(r"([\d.]+) µm to ([+−][XYZ])", cells[3])
        assert moved
        out.append((*cells[:3], *moved.groups(), cells[5]))
    return out


def test_sign_test_for_every_register(tmp_path: Path) -> None:
    """W runs along -Z: a positive K0 of W moves W in its negative direction, which is +Z."""
    rows = {row[0]: row for row in sign_rows(export(tmp_path, three_axes()))}
    assert len(rows) == 3 + 3 + 6
    assert rows["K0 of X1"][2:] == (
        "SD43900 $SA_TEMP_COMP_ABS_VALUE[X1] = 0.010", "10.0", "−X", "sign_temperature = -1",
    )  # fmt: skip
    assert rows["K0 of W1"][3:] == ("10.0", "+Z", "sign_temperature = -1")
    assert rows["tanβ of W1"][1] == "W1 at 993.7 mm"
    # The table of E_Z over X goes to W: positive values stand for an error along -W's direction, table value < 0.
    assert rows["table 1 (EZX)"][3:] == ("10.0", "+Z", "sign_cec = -1")


@pytest.mark.parametrize("sign", [1, -1])
def test_sign_test_tells_the_movement_that_the_control_makes(tmp_path: Path, sign: int) -> None:
    """Right sign setting: a register that stands for an error of +10 µm moves the tool 10 µm the other way."""
    folder = export(tmp_path, three_axes(), f"sign_temperature = {sign}\nsign_cec = {sign}\n")
    axis_sign = {"X1": 1, "Y1": 1, "W1": -1}
    control = load(folder, {1: "X1", 2: "Y1", 3: "W1"})
    for register, where, enter, movement, towards, _ in sign_rows(folder):
        value = float(re.search(r"\] = (-?[\d.]+)$", enter)[1])  # type: ignore[index]
        if register.startswith("K0"):
            axis, register_mm = register[-2:], value
        elif register.startswith("tan"):
            axis = register[-2:]
            register_mm = value * (float(where.split()[2]) - control.p0_mm[axis])
        else:
            table = control.tables[int(register.split()[1])]
            axis, points = str(table["OUTPUT_AXIS"]), table["points"]
            at = 0 if float(where.split()[2]) == float(str(table["MIN"])) else 10
            register_mm = value * points[at]  # type: ignore[index]
        error_um = 1e3 * sign * axis_sign[axis] * register_mm
        assert abs(error_um) == pytest.approx(float(movement), abs=0.06)
        assert towards[0] == ("−" if error_um > 0 else "+")


class Closed(HTMLParser):
    """Counts tags and what a page asks from elsewhere."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.outside: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "br"):
            self.open.append(tag)
        self.outside += [value or "" for name, value in attrs if name in ("src", "href")]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_sheet_stands_alone_and_is_well_formed(tmp_path: Path) -> None:
    page = Closed()
    text = (export(tmp_path, three_axes("unproven"), expect=3) / FILES[3]).read_text(encoding="utf-8")
    page.feed(text)
    assert page.open == []
    assert page.outside == []
    assert "@import" not in text
    assert "url(" not in text


@pytest.mark.parametrize(
    ("toml", "words"),
    [
        ("sign_cec = 2", "sign_cec"),
        ("sign_cec = 2", "sign_cec = 2: expected 1 or -1."),
        ("sing_cec = 1", "unknown setting 'sing_cec', did you mean sign_cec?"),
        ("rate = 1", "unknown setting 'rate', did you mean rate_limit_um_per_s?"),
        ("qqq = 1", "unknown setting 'qqq'. Fix: known settings are sign_temperature"),
        ("reserve = 0.5", "reserve = 0.5: expected a value at least 1"),
        ("rate_limit_um_per_s = 'slow'", "rate_limit_um_per_s = 'slow': expected a number."),
        ("first_cec_table = 1.5", "first_cec_table = 1.5: expected a whole number."),
        ("axis_name = 3", "axis_name = 3: expected a table."),
        ("[axis_name]\nX = 1", "axis_name.X = 1: expected a text in quotes."),
        ("[drift_source]\nQ = 'EXX'", "drift_source.Q: this key is not known here, expected 'X', 'Y' or 'Z'."),
        ("= 3", "not readable as TOML"),
        ("[axis_name]\nV = 'V1'", "the model has no axis V"),
        ("[axis_name]\nX = 'X 1'", "axis_name.X"),
        ("[axis_number]\nX = 2", "axis_number: 2 stands for two axes"),
        ("[output_axis]\nX = 'Y'", "not an axis along X"),
        ("[drift_source]\nX = 'EYX'", "not an error in X"),
        (
            "[reference_degC]\ntx = 20.0\nty = 20.0\noil = 20.0\nfoo = 3",
            "missing ['tw'], not an input of the model: ['foo']",
        ),
        ("md32720_cec_max_sum_mm = 0.01", "the control would clamp the sum"),
    ],
)
def test_wrong_settings_are_told(tmp_path: Path, toml: str, words: str) -> None:
    three_axes().save(tmp_path / "model.json")
    (tmp_path / "export.toml").write_text(toml, encoding="utf-8")
    arguments = ["export", str(tmp_path / "model.json"), "--target", "sinumerik", "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(app, [*arguments, "--settings", str(tmp_path / "export.toml")])
    assert result.exit_code == 1
    assert words in result.output
    assert "export.toml" in result.output
    assert not re.search("Input should|not permitted|a valid ", result.output)
    assert not (tmp_path / "out").exists()


def test_missing_files_are_told(tmp_path: Path) -> None:
    arguments = ["export", str(tmp_path / "no.json"), "--target", "sinumerik", "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(app, arguments)
    assert (result.exit_code, "there is no such file" in result.output) == (1, True)
    three_axes().save(tmp_path / "no.json")
    result = CliRunner().invoke(app, [*arguments, "--settings", str(tmp_path / "no.toml")])
    assert (result.exit_code, "there is no such file" in result.output) == (1, True)


@pytest.mark.parametrize("target", ["heidenhain", "fanuc", "unheard-of"])
def test_other_targets_name_what_is_written(tmp_path: Path, target: str) -> None:
    three_axes().save(tmp_path / "model.json")
    arguments = ["export", str(tmp_path / "model.json"), "--target", target, "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert "this version writes sinumerik" in result.output


def test_direction_without_an_axis_is_said(tmp_path: Path) -> None:
    exy = component("EXY", term(0.0, 1.0), term(0.0, 2.0), {"t": 20.0})
    eyy = component("EYY", term(0.0, 1.0), term(0.0, 2.0), {"t": 20.0})
    folder = export(tmp_path, document({"Y": "+Y"}, {"EXY": exy, "EYY": eyy}, {"t": (0.0, 5.0)}))
    assert not (folder / FILES[1]).exists()
    sheet = (folder / FILES[3]).read_text(encoding="utf-8")
    # 5 K: 5 µm, and 10 µm/m x 1 m at the end of the travel.
    sentence = "not exported: EXY, up to 15 µm at the warmest state, because no axis moves along X."
    assert sentence in sheet
    assert sentence in console(tmp_path)[1]


def test_drift_component_alone_becomes_k0(tmp_path: Path) -> None:
    dx = component("DX", term(0.0, 4.0), None, {"t": 20.0})
    control = load(export(tmp_path, document({"X": "+X"}, {"DX": dx}, {"t": (0.0, 5.0)})), {1: "X1"})
    assert control.machine_data["$MA_TEMP_COMP_TYPE[X1]"] == "1"
    assert control.compensation_mm("X1", {"t": 25.0}, {"X1": 0.0}) == pytest.approx(0.020)


FAILED = ("axis X: campaigns: 1 (must be ≥ 2)", "axis Y: residual RMS 31 µm, clock 24 µm")


def test_failed_acceptance_checks_are_told_everywhere_and_end_with_3(tmp_path: Path) -> None:
    model = three_axes().model_copy(update={"failed_checks": FAILED})
    folder = export(tmp_path, model, expect=3)
    for name in FILES[:2]:
        head = "".join((folder / name).read_text(encoding="ascii").splitlines(keepends=True)[:8])
        assert "NOT FIT FOR USE: the model failed 2 acceptance checks" in head
        assert "campaigns: 1 (must be >= 2)" in head
        assert "residual RMS 31 um, clock 24 um" in head
    sheet = (folder / FILES[3]).read_text(encoding="utf-8")
    banner = sheet[sheet.index('<div class="banner">NOT FIT FOR USE') : sheet.index("1 What goes where")]
    code, words = console(tmp_path)
    assert code == 3
    assert "NOT FIT FOR USE: The model failed 2 acceptance checks." in words
    assert "nothing is compensated before" not in words
    for sentence in FAILED:
        assert sentence in banner
        assert sentence in words


def test_error_that_no_sensor_predicts_is_not_compensated(tmp_path: Path) -> None:
    """EXX has no input: the drift of X comes from the sweep along Y, X has no tanβ; the rest is as without EXX."""
    folder = export(tmp_path, three_axes(EXX=nothing_predicts("EXX", 7.0, p=PLACES["X"])))
    control = load(folder, {1: "X1", 2: "Y1", 3: "W1"})
    assert control.machine_data["$MA_TEMP_COMP_TYPE[X1]"] == "1"
    assert "tanbeta[X1]" not in control.laws
    assert [name for _, name, _ in control.laws["K0[X1]"]] == ["", "ty", "oil"]
    sentence = "no sensor predicts EXX: not compensated (up to 40 µm in the training states)."
    assert sentence in console(tmp_path)[1]
    assert sentence in (folder / FILES[3]).read_text(encoding="utf-8")


def test_nothing_to_export_is_one_clear_message(tmp_path: Path) -> None:
    parts = {name: nothing_predicts(name) for name in ("EXX", "EYX")}
    document({"X": "+X", "Y": "+Y"}, parts, {}).save(tmp_path / "model.json")
    code, words = console(tmp_path)
    assert code == 1
    assert "nothing can be exported: no sensor predicts EXX, EYX." in words
    exy = component("EXY", term(0.0, 1.0), term(0.0, 2.0), {"t": 20.0})
    document({"Y": "+Y"}, {"EXY": exy}, {"t": (0.0, 5.0)}).save(tmp_path / "model.json")
    assert "no axis corrects EXY (no axis along X)" in console(tmp_path)[1]
    assert not (tmp_path / "out").exists()


def test_drift_source_that_no_sensor_predicts_is_refused(tmp_path: Path) -> None:
    model = three_axes(EXY=nothing_predicts("EXY", p=PLACES["Y"]))
    export(tmp_path, model, "[drift_source]\nX = 'EXY'\n", expect=1)


def drifts(other_um_per_K: float, dof: int = 8, sd: float = 3.0) -> ModelDocument:
    """EXX drifts by +10 µm/K, EXY otherwise; 10 K are the warmest state."""
    t = {"t": 20.0}
    parts = {
        "EXX": component("EXX", term(0.0, 10.0, sd=4.0), term(0.0, 1.0), t, dof=8),
        "EXY": component("EXY", term(0.0, other_um_per_K, sd=sd), term(0.0, 1.0), t, dof=dof),
    }
    return document({"X": "+X", "Y": "+Y"}, parts, {"t": (0.0, 10.0)})


def test_drift_that_does_not_agree_is_named_with_both_values(tmp_path: Path) -> None:
    """t(0.975, 8) = 2.306: the bound of the difference is 2.306 √(4² + 3²) = 11.5 µm."""
    folder = export(tmp_path, drifts(-14.5))
    code, words = console(tmp_path)
    told = "K0[X1] carries the intercept of EXX, +100 µm at the warmest state,"
    told += " while EXY, from the sweep along Y, has −145 µm there"
    assert code == 0
    assert told in words
    assert "(95 % bound of the difference: ±12 µm)" in words
    assert "the tool stands 245 µm wrong" in words
    sheet = (folder / FILES[3]).read_text(encoding="utf-8")
    assert told in sheet[: sheet.index("2 Steps")]


def test_worst_pair_is_named_of_several(tmp_path: Path) -> None:
    """Model of nine errors: EXY at its warmest +143 µm against EXX -188 µm, EZY -220 µm against EZW +101 µm, …"""
    export(tmp_path, three_axes())
    found = differing(plan_registers(three_axes(), SinumerikSettings()))
    assert len(found) > 2
    assert found[0] == max(found, key=lambda one: abs(one.difference_um))
    words = console(tmp_path)[1]
    assert f"while {found[0].component}, from the sweep" in words
    assert f"{len(found) - 1} more such pairs are in part 6" in words


@pytest.mark.parametrize(("other", "differs"), [(11.1, False), (11.2, True), (8.9, False), (8.8, True)])
def test_drift_agrees_within_the_95_percent_bound(other: float, differs: bool) -> None:
    (left_out,) = plan_registers(drifts(other), SinumerikSettings()).left_out
    assert left_out.bound_um == pytest.approx(2.306 * 5, abs=0.01)
    assert left_out.differs is differs


def test_bound_without_a_degree_of_freedom_claims_nothing(tmp_path: Path) -> None:
    folder = export(tmp_path, drifts(-30.0, dof=0))
    assert "DRIFT" not in console(tmp_path)[1]
    assert "cannot be stated" in (folder / FILES[3]).read_text(encoding="utf-8")


def test_held_out_figures_stand_before_those_of_the_training(tmp_path: Path) -> None:
    model = three_axes()
    law = model.control["X"]
    exx = law.components["EXX"].model_copy(update={"held_out_um": (18.25, 31.04, 44.0), "residual_um": (3.3, 6.6)})
    judged = law.model_copy(update={"components": law.components | {"EXX": exx}})
    folder = export(tmp_path, model.model_copy(update={"control": {**model.control, "X": judged}}))
    sheet = (folder / FILES[3]).read_text(encoding="utf-8")
    valid = sheet[sheet.index("8 Where this is valid") :]
    heads = re.findall(r"<th>([^<]*)</th>", valid)[4:9]
    assert heads == [f"Held-out {k}, µm" for k in ("RMS", "p95", "max")] + [
        f"In-sample {k}, µm" for k in ("RMS", "max")
    ]
    rows = {row[0]: row[4:] for row in (re.findall(r"<td[^>]*>([^<]*)</td>", r) for r in valid.split("<tr>")) if row}
    assert rows["EXX"] == ["18.2", "31.0", "44.0", "3.3", "6.6"]
    assert rows["EYX"] == ["–", "–", "–", "1.0", "2.0"]


def test_law_is_one_line_a_register_in_seven_digits(tmp_path: Path) -> None:
    """A reference keeps two decimals only while that moves the register by less than 0.05 µm.

    21.9744 to 21.97 is 4.4 mK: at 27.7 µm/K 0.12 µm, too much, and 21.974 does 0.011 µm; at 3 µm/K it does 0.013 µm.
    """
    t = {"t": 21.9744}
    exx = component("EXX", term(3.6, -27.700012345), term(0.0, 1.0), t)
    eyy = component("EYY", term(3.6, 3.0), term(0.0, 1.0), t)
    folder = export(tmp_path, document({"X": "+X", "Y": "+Y"}, {"EXX": exx, "EYY": eyy}, {"t": (0.0, 5.0)}))
    lines = (folder / FILES[0]).read_text(encoding="ascii").splitlines()
    assert "; K0[X1] mm (EXX) = 0.0036 - 0.02770001 * (t - 21.974)" in lines
    assert "; K0[Y1] mm (EYY) = 0.0036 + 0.003 * (t - 21.97)" in lines
    assert "; reference: campaign A at 0 s; capture anew at each datum set, see sheet" in lines
    sheet = (folder / FILES[3]).read_text(encoding="utf-8")
    assert "<code>0.0036 − 0.02770001·(t − 21.974)</code>" in sheet


def test_long_laws_stay_below_the_block_limit_of_the_control(tmp_path: Path) -> None:
    sensors = {f"temperature_of_bearing_{i:02d}": 20.0 + i / 7 for i in range(16)}
    exx = component("EXX", term(1.0, *[1.23456789 + i for i in range(16)]), term(0.0, *[0.1] * 16), sensors, dof=3)
    folder = export(tmp_path, document({"X": "+X"}, {"EXX": exx}, dict.fromkeys(sensors, (0.0, 5.0))))
    lines = (folder / FILES[0]).read_text(encoding="ascii").splitlines()
    laws_and_more = lines[: next(i for i, line in enumerate(lines) if "--- 4" in line)]
    assert max(map(len, laws_and_more)) < 512
    assert sum("temperature_of_bearing_15" in line for line in laws_and_more) == 2


def test_machine_names_are_spelled_in_ascii_or_left_out(tmp_path: Path) -> None:
    model = three_axes()
    export(tmp_path, model.model_copy(update={"machine": "Fräse Größe 5"}))
    spf = (tmp_path / "out" / FILES[0]).read_text(encoding="ascii")
    assert "; machine Fraese Groesse 5; model of" in spf
    export(tmp_path, model.model_copy(update={"machine": "镗床"}))
    spf = (tmp_path / "out" / FILES[0]).read_text(encoding="ascii")
    assert "; model of 2026-03-02T10:00:00, trained on A" in spf
    assert "\\u" not in spf


def test_ascii_names_stay_apart() -> None:
    assert ascii_text("θ₁₅ ≥ 3 µm, 20 °C − Ø") == "theta15 >= 3 um, 20 degC - "
    names = ascii_names(["Öl", "Oel", "镗", "床", "θ_1"], "sensor")
    assert list(names.values()) == ["sensor_1", "Oel", "sensor_3", "sensor_4", "theta_1"]


def test_sheet_says_how_the_ascii_files_name_a_sensor(tmp_path: Path) -> None:
    exx = component("EXX", term(0.0, 1.0), term(0.0, 1.0), {"θ_öl": 20.0})
    folder = export(tmp_path, document({"X": "+X"}, {"EXX": exx}, {"θ_öl": (0.0, 5.0)}))
    assert "Names in the ASCII files: θ_öl = theta_oel." in (folder / FILES[3]).read_text(encoding="utf-8")
    assert "(theta_oel - 20.00)" in (folder / FILES[0]).read_text(encoding="ascii")


def test_unproven_sign_is_proven_first_in_a_step_of_its_own(tmp_path: Path) -> None:
    """W runs along -Z: 10 µm further along W are -10 µm of error in Z."""
    sheet = (export(tmp_path, three_axes("unproven"), expect=3) / FILES[3]).read_text(encoding="utf-8")
    step = sheet[sheet.index("Step 0: prove the sign") : sheet.index("<ol>")]
    assert '<code>sign = "stated"</code> into campaign.toml of A' in step
    assert "Result:" in step
    rows = [re.findall(r"<td[^>]*>([^<]*)", row) for row in step.split("<tr>")[2:]]
    assert [(row[0], row[2], row[3]) for row in rows] == [
        ("X (direction +X)", "dX_um", "+10.0"),
        ("Y (direction +Y)", "dY_um", "+10.0"),
        ("W (direction -Z)", "dZ_um", "−10.0"),
    ]
    assert "Step 0" not in (export(tmp_path, three_axes()) / FILES[3]).read_text(encoding="utf-8")


def test_without_a_cross_error_nothing_speaks_of_cec(tmp_path: Path) -> None:
    exx = component("EXX", term(0.0, 1.0), term(0.0, 1.0), {"t": 20.0})
    folder = export(tmp_path, document({"X": "+X"}, {"EXX": exx}, {"t": (0.0, 5.0)}))
    for file in folder.iterdir():
        assert not re.search(r"cec|sag comp|SD41310|\bweight of", file.read_text(encoding="utf-8"), re.IGNORECASE), file


def test_an_older_cec_file_is_pointed_out(tmp_path: Path) -> None:
    export(tmp_path, three_axes())
    exx = component("EXX", term(0.0, 1.0), term(0.0, 1.0), {"t": 20.0})
    export(tmp_path, document({"X": "+X"}, {"EXX": exx}, {"t": (0.0, 5.0)}))
    assert "An older sinumerik_cec.ini is still in" in console(tmp_path)[1]


def test_an_axis_name_that_no_control_can_have_is_asked_for() -> None:
    """A Chinese axis name would become a register without a name; the settings must say which channel axis it is."""
    slope = term(0.0, 5.0)
    model = document({"立柱": "+Y"}, {"EY立柱": component("EY立柱", slope, slope, {"t1": 20.0})}, {"t1": (0.0, 5.0)})
    with pytest.raises(InputError, match=r"cannot have an axis 立柱1 .*\[axis_name\]"):
        plan_registers(model, SinumerikSettings())
    plan = plan_registers(model, SinumerikSettings(axis_name={"立柱": "Y1"}))
    assert plan.axes[0].channel_axis == "Y1"

"""Prediction from a stored model: values, references, gaps, domain, the file, and what is refused."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from small_models import Part, component, document, nothing_predicts, term
from typer.testing import CliRunner

from thetacomp.arrays import Floats
from thetacomp.cli.main import app
from thetacomp.errors import AnalysisError
from thetacomp.model.document import ModelDocument, Term
from thetacomp.model.filters import InputLayout
from thetacomp.model.leverage import Leverage
from thetacomp.model.prediction import Reference, predict
from thetacomp.model.temperatures import Duty, Temperatures
from thetacomp.table_file import xlsx_bytes


@dataclass(frozen=True)
class Rows:
    t_s: Floats
    axis: tuple[str, ...]
    position_mm: Floats


def rows(*wanted: tuple[float, str, float]) -> Rows:
    t_s, axis, position_mm = zip(*wanted, strict=True)
    return Rows(np.array(t_s, float), tuple(axis), np.array(position_mm, float))


def model(leave_out: tuple[str, ...] = (), **other: Part) -> ModelDocument:
    """X sees `a`, Y sees `b`, the drift `DZ` sees both. References: a = 20, b = 18.

    Without the components `leave_out`; `other` components stand in their place.
    """
    a, b = {"a": 20.0}, {"b": 18.0}
    parts = {
        "EXX": component("EXX", term(5.0, 10.0, sd=2.0), term(1.0, 4.0, sd=1.0), a, p=(500.0, 0.0, 2000.0), dof=6),
        "EYX": component("EYX", term(0.5, -1.0), term(0.0, 0.25), a, p=(500.0, 0.0, 2000.0), dof=6),
        "EXY": component("EXY", term(2.0, 3.0), term(-1.0, 2.0), b, p=(0.0, 0.0, 3000.0), dof=6),
        "DZ": component("DZ", term(1.0, 2.0, -4.0), None, {**a, **b}, dof=6),
    }
    parts = {name: one for name, one in (parts | other).items() if name not in leave_out}
    return document({"X": "+X", "Y": "+Y"}, parts, {"a": (0.0, 10.0), "b": (0.0, 8.0)})


def temperatures() -> Temperatures:
    value = np.array([[21.0, 18.0, 1.0], [23.0, 19.0, 1.0], [27.0, 22.0, 1.0]])
    return Temperatures(np.array([100.0, 200.0, 300.0]), ("a", "b", "spare"), value)


def test_zero_in_the_first_row_and_by_hand_after_it() -> None:
    out = predict(model(), temperatures(), rows((100, "X", 1500), (200, "X", 1500), (250, "Y", 1000)))
    nan = float("nan")
    # a rises by 2 K: EXX = 20 + 8 * 1 m, EYX = -2 + 0.5 * 1 m; b at 250 s rises by 2.5 K: EXY = 7.5 + 5 * 1 m.
    expected = [[0.0, 0.0, nan], [28.0, -1.5, nan], [12.5, nan, nan]]
    np.testing.assert_allclose(out.error_um, expected, atol=1e-12)
    assert out.in_domain.all()
    assert not out.missing.any()


def test_reference_of_the_model_keeps_the_constant() -> None:
    out = predict(model(), temperatures(), rows((100, "X", 1500), (100, "Y", 1000)), "model")
    # a is 1 K above its stored reference: 5 + 10 + (1 + 4) * 1 m; b is at its own: 2 - 1 * 1 m.
    assert out.error_um[:, 0] == pytest.approx([20.0, 1.0])


def test_reference_at_a_time_is_interpolated() -> None:
    out = predict(model(), temperatures(), rows((150, "X", 1500), (300, "X", 500)), 150.0)
    assert out.error_um[:, 0] == pytest.approx([0.0, 50.0])  # a = 22 °C at 150 s, 27 °C at 300 s


def test_empty_axis_is_the_drift() -> None:
    out = predict(model(), temperatures(), rows((300, "", float("nan"))))
    np.testing.assert_allclose(out.error_um, [[float("nan"), float("nan"), 2 * 6.0 - 4 * 4.0]])
    assert out.in_domain.all()


@pytest.mark.parametrize(("reference", "states"), [("first_row", 2), ("model", 1)])
def test_bounds_by_hand(reference: Reference, states: int) -> None:
    """No covariance: residuals alone, 2 µm and 1 µm/m at 1 m, of one state or of the difference of two."""
    out = predict(model(), temperatures(), rows((200, "X", 1500)), reference)
    half = stats.t.ppf(0.975, 6) * np.sqrt(states * (2.0**2 + 1.0**2))
    assert out.upper_um[0, 0] - out.error_um[0, 0] == pytest.approx(half, rel=1e-3)
    assert out.error_um[0, 0] - out.lower_um[0, 0] == pytest.approx(half, rel=1e-3)


def test_a_gap_stays_a_gap_and_the_last_sample_holds_for_one_interval() -> None:
    value = np.array([[20.0], [21.0], [np.nan], [23.0]])
    table = Temperatures(np.array([0.0, 10.0, 20.0, 30.0]), ("a",), value)
    at = np.array([-1.0, 0.0, 5.0, 10.0, 12.0, 20.0, 29.0, 30.0, 40.0, 41.0])
    nan = float("nan")
    expected = [nan, 20.0, 20.5, 21.0, nan, nan, nan, 23.0, 23.0, nan]
    np.testing.assert_allclose(table.unbridged_at(at)[:, 0], expected)


def test_missing_temperature_empties_the_row_and_only_this_axis() -> None:
    table = temperatures()
    table.value_degC[1, 0] = np.nan
    out = predict(model(), table, rows((200, "X", 500), (200, "Y", 500), (300, "X", 500)))
    assert out.missing.tolist() == [True, False, False]
    assert out.in_domain.tolist() == [False, True, True]
    assert np.isnan(out.error_um[0]).all()
    assert np.isnan(out.lower_um[0]).all()


def test_row_is_empty_where_only_one_of_its_errors_lacks_a_temperature() -> None:
    eyx = component("EYX", term(0.5, -1.0), term(0.0, 0.25), {"b": 18.0}, p=(500.0, 0.0, 2000.0))
    table = temperatures()
    table.value_degC[1, 0] = np.nan
    out = predict(model(EYX=eyx), table, rows((200, "X", 500)))
    assert np.isnan(out.error_um).all()
    assert not out.in_domain[0]


def test_outside_the_training_range_is_said() -> None:
    table = Temperatures(np.array([0.0, 1.0, 2.0]), ("a", "b"), np.array([[20.0, 18], [30.4, 18], [30.6, 18]]))
    out = predict(model(), table, rows((1, "X", 500), (2, "X", 500), (1, "X", 2001.5), (2, "Y", 500)))
    assert out.in_domain.tolist() == [True, False, False, True]
    assert np.isfinite(out.error_um[:, 0]).all()


@pytest.mark.parametrize(
    ("wanted", "reference", "words"),
    [
        ((200, "Q", 1.0), "first_row", "data row 1: the model has no component for axis 'Q'. It knows the axes X, Y"),
        ((99, "X", 1.0), "first_row", "before the first temperature sample at t_s = 100"),
        ((401, "X", 1.0), "first_row", "all rows lie after the last temperature sample at t_s = 300"),
        ((200, "X", float("nan")), "first_row", "axis X without a position_mm"),
        ((200, "X", 1.0), 99.0, "reference 99 s lies outside the temperatures"),
        ((200, "X", 1.0), 301.0, "which run from 100 to 300 s"),
        ((200, "X", 1.0), float("nan"), "reference nan s lies outside the temperatures"),
        ((200, "X", 1.0), float("inf"), "reference inf s lies outside the temperatures"),
    ],
)
def test_what_cannot_be_answered_is_told(wanted: tuple[float, str, float], reference: Reference, words: str) -> None:
    with pytest.raises(AnalysisError) as caught:
        predict(model(), temperatures(), rows(wanted), reference)
    assert words in str(caught.value)
    assert "Fix:" in str(caught.value)


def follows_the_speed() -> ModelDocument:
    """EXX is 5 µm for each 1000 rpm of the spindle's speed, lagged by 600 s, and nothing else."""
    static = model().control["X"]
    term_um = Term(coefficients=(0.0, 0.0, 5.0, 0.0))
    exx = static.components["EXX"].model_copy(update={"terms": (term_um, Term(coefficients=(0.0,) * 4))})
    changed = {
        "layout": InputLayout(sensors=("a",), time_constants_s=(600.0,), speed_powers=(1,), base_degC=20.0),
        "reference": static.reference.model_copy(update={"inputs": (20.0, 0.0, 0.0, 0.0)}),
        "leverage": Leverage((0.0,) * 4, (1.0,) * 4, (), (), floor=1.0),
        "components": {"EXX": exx},
    }
    return model().model_copy(update={"prediction": {"X": static.model_copy(update=changed)}})


@pytest.mark.parametrize(
    ("first_s", "last_s", "wanted_um"),
    [
        (0.0, 100.0, 5.0),  # 1000 rpm before the first sample and ever since: at rest there
        (300.0, 400.0, 0.0),
        (0.0, 400.0, 0.0),
        (200.0, 200.0, 5.0 * (1.0 - np.exp(-100.0 / 600.0))),  # a step at 200 s, seen at 300 s
        (0.0, 99.0, None),
        (301.0, 400.0, None),
    ],
)
def test_a_duty_table_has_to_meet_the_temperatures_in_one_moment_at_least(
    first_s: float, last_s: float, wanted_um: float | None
) -> None:
    """The temperatures run from 100 to 300 s; the spindle stands until the last row of the duty, then 1000 rpm."""
    duty = Duty(np.array([first_s, last_s]), {"spindle_rpm": np.array([0.0, 1000.0])})
    wanted, law = rows((300, "X", 500)), follows_the_speed()
    if wanted_um is not None:
        found = predict(law, temperatures(), wanted, "model", duty=duty)
        assert found.error_um[0, 0] == pytest.approx(wanted_um, abs=1e-12)
        return
    words = f"from t_s = {first_s:g} to {last_s:g}, the temperatures from 100 to 300: they never meet"
    with pytest.raises(AnalysisError, match=words):
        predict(law, temperatures(), wanted, "model", duty=duty)


def test_rows_up_to_one_interval_after_the_last_sample_are_answered() -> None:
    """Samples every 100 s until 300 s: 400 s still counts, and one row that counts lets later ones stay empty."""
    assert predict(model(), temperatures(), rows((400, "X", 500))).error_um[0, 0] == pytest.approx(60.0)
    out = predict(model(), temperatures(), rows((100, "X", 500), (401, "X", 500)))
    assert out.missing.tolist() == [False, True]


def test_missing_input_column_is_told_only_where_it_is_needed() -> None:
    only_a = Temperatures(np.array([0.0, 1.0]), ("a",), np.array([[20.0], [21.0]]))
    assert predict(model(), only_a, rows((1, "X", 500))).error_um[0, 0] == pytest.approx(10.0)
    with pytest.raises(AnalysisError, match=r"no column b, which the model needs.*found a\."):
        predict(model(), only_a, rows((1, "Y", 500)))


def test_reference_without_a_temperature_is_told() -> None:
    table = temperatures()
    table.value_degC[0, 0] = np.nan
    with pytest.raises(AnalysisError, match="a has no value at the reference, t_s = 100"):
        predict(model(), table, rows((300, "X", 500)))
    assert predict(model(), table, rows((300, "X", 500)), "model").error_um[0, 0] == pytest.approx(75.0)


def test_no_drift_in_the_model_is_told() -> None:
    with pytest.raises(AnalysisError, match=r"drift at a fixed position \(axis empty\).* and no drift"):
        predict(model(("DZ",)), temperatures(), rows((200, "", 0.0)))


def call(
    tmp_path: Path,
    positions: str,
    *more: str,
    temperature: str = "",
    stored: ModelDocument | None = None,
    **changes: object,
) -> tuple[int, str]:
    (stored or model()).model_copy(update=changes).save(tmp_path / "model.json")
    text = temperature or "t_s,a,b\n100,21,18\n200,23,19\n300,27,22\n"
    (tmp_path / "T.csv").write_text(text, encoding="utf-8")
    (tmp_path / "P.csv").write_text(positions, encoding="utf-8")
    arguments = ["predict", str(tmp_path / "model.json"), "--temperatures", str(tmp_path / "T.csv")]
    out = [] if "--out" in more else ["--out", str(tmp_path / "F.csv")]
    arguments += ["--positions", str(tmp_path / "P.csv"), *out, *more]
    result = CliRunner().invoke(app, arguments)
    return result.exit_code, result.output


def written(tmp_path: Path) -> list[dict[str, str]]:
    with (tmp_path / "F.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_command_writes_the_columns_of_the_conventions(tmp_path: Path) -> None:
    code, output = call(tmp_path, "t_s,axis,position_mm\n100,X,1500\n200,X,1500\n300,,\n")
    assert code == 0, output
    lines = written(tmp_path)
    bounds = [f"d{d}_{side}_um" for d in "XYZ" for side in ("lo", "hi")]
    assert list(lines[0]) == ["t_s", "axis", "position_mm", "dX_um", "dY_um", "dZ_um", *bounds, "in_domain"]
    assert [float(line["dX_um"] or "nan") for line in lines[:2]] == [0.0, 28.0]
    assert (lines[1]["t_s"], lines[1]["axis"], lines[1]["position_mm"]) == ("200", "X", "1500")
    assert (lines[2]["axis"], lines[2]["dX_um"], lines[2]["dZ_um"]) == ("", "", "-4.0000")
    assert [line["in_domain"] for line in lines] == ["1", "1", "1"]
    assert float(lines[1]["dX_lo_um"]) < 28.0 < float(lines[1]["dX_hi_um"])


def test_command_counts_what_it_could_not_tell(tmp_path: Path) -> None:
    positions = "t_s,axis,position_mm\n200,X,1500\n300,X,2500\n300,Y,10\n"
    code, output = call(tmp_path, positions, "--json", temperature="t_s,a,b\n100,21,18\n200,,19\n300,27,22\n")
    assert code == 0
    answer = json.loads(output)
    assert (answer["rows"], answer["outside_domain"], answer["missing_temperature"]) == (3, 2, 1)
    assert answer["largest"]["dX_um"] == pytest.approx(60.0 + 24.0 * 2.0)
    assert written(tmp_path)[0]["dX_um"] == ""


@pytest.mark.parametrize(("reference", "wanted"), [("model", 60.5), ("200", 32.0), ("first_row", 48.0)])
def test_command_takes_every_reference(tmp_path: Path, reference: str, wanted: float) -> None:
    # a: 27 °C at 300 s, 23 °C at 200 s, 21 °C at 100 s, 20 °C in the model; p = P0 - 0.5 m.
    # model: 5 + 70 - (1 + 28) / 2 = 60.5; 200 s: 40 - 16 / 2 = 32; first row: 60 - 24 / 2 = 48.
    code, output = call(tmp_path, "t_s,axis,position_mm\n300,X,0\n", "--reference", reference)
    assert code == 0, output
    assert float(written(tmp_path)[0]["dX_um"]) == pytest.approx(wanted)


@pytest.mark.parametrize(("column", "unit_s"), [("t_s", 1.0), ("t_min", 60.0), ("t_h", 3600.0)])
def test_a_reference_is_in_seconds_whatever_the_tables_count_in(tmp_path: Path, column: str, unit_s: float) -> None:
    """a: 21, 23, 27 °C at 0, 1, 2 units; zero is set at 1.5 units, where it is 25 °C: 10 µm/K at P0."""
    table = f"{column},a,b\n0,21,18\n1,23,19\n2,27,22\n"
    positions = f"{column},axis,position_mm\n2,X,500\n"
    code, output = call(tmp_path, positions, "--reference", f"{1.5 * unit_s}", temperature=table)
    assert code == 0, output
    assert float(written(tmp_path)[0]["dX_um"]) == pytest.approx(20.0)
    assert f"the temperatures at t = {1.5 * unit_s:g} s;" in output


def test_a_column_without_a_value_is_not_said_to_be_absent_alone(tmp_path: Path) -> None:
    code, output = call(tmp_path, "t_s,axis,position_mm\n300,X,0\n", temperature="t_s,a,b\n100,,18\n300,,22\n")
    assert code == 1
    told = " ".join(output.split())
    assert (
        "no column a, which the model needs as an input, or no value in it; found b. Fix: add the column, fill" in told
    )


ONE = "t_s,axis,position_mm\n300,X,0\n"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("t_s,theta_1,theta_2,theta_3\n0,20,20,20\n", "its columns are t_s, theta_1, theta_2, …) and would be lost"),
        ("t_s,in_domain_too\n0,1\n", "its columns are t_s, in_domain_too)"),
        ("time,in_domain\n0,1\n", "its columns are time, in_domain)"),
        ("\x00\x01\x02", "(no table)"),
        ("a thesis\nwith lines\n", "its columns are a thesis)"),
    ],
)
def test_a_file_that_is_no_prediction_is_not_replaced(tmp_path: Path, content: str, words: str) -> None:
    (tmp_path / "F.csv").write_text(content, encoding="utf-8")
    code, output = call(tmp_path, ONE)
    assert code == 1
    assert words in " ".join(output.split())
    assert "Fix: name another file." in output
    assert (tmp_path / "F.csv").read_text(encoding="utf-8") == content


@pytest.mark.parametrize("ending", [".csv", ".xlsx"])
def test_an_older_prediction_is_replaced_however_it_was_saved_again(tmp_path: Path, ending: str) -> None:
    out = tmp_path / f"old{ending}"
    for _ in range(2):
        assert call(tmp_path, ONE, "--out", str(out))[0] == 0
    if ending == ".csv":
        for text in ("", out.read_text(encoding="utf-8").replace(",", ";"), "\ufeff" + out.read_text(encoding="utf-8")):
            out.write_text(text, encoding="utf-8")
            assert call(tmp_path, ONE, "--out", str(out))[0] == 0
    else:
        out.write_bytes(xlsx_bytes(["t_s", "theta"], [[0.0, 20.0]]))
        code, output = call(tmp_path, ONE, "--out", str(out))
        assert (code, "its columns are t_s, theta)" in " ".join(output.split())) == (1, True)
        out.write_bytes(b"no workbook")
        assert "(no table)" in " ".join(call(tmp_path, ONE, "--out", str(out))[1].split())


def test_an_output_that_is_a_folder_is_told_as_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "taken.csv").mkdir()
    monkeypatch.chdir(tmp_path)
    for out in ("", ".", "..", "taken.csv", "taken.csv/"):
        code, output = call(tmp_path, ONE, "--out", out)
        assert code == 1
        assert "it is a folder, expected a table, its name ending in .csv or .xlsx. Fix: name it" in " ".join(
            output.split()
        )


ISO = "time,a,b\n2026-03-02T08:00:00,21,18\n2026-03-02T09:00:00,23,19\n2026-03-02T10:00:00,27,22\n"


def test_command_takes_dates(tmp_path: Path) -> None:
    positions = "time,axis,position_mm\n2026-03-02T09:30:00,X,500\n"
    code, output = call(tmp_path, positions, "--reference", "2026-03-02T08:30", temperature=ISO)
    assert code == 0, output
    assert float(written(tmp_path)[0]["dX_um"]) == pytest.approx(30.0)  # a: 25 °C against 22 °C, 10 µm/K


def test_command_says_that_the_sign_is_unproven(tmp_path: Path) -> None:
    code, output = call(tmp_path, "t_s,axis,position_mm\n300,X,0\n", sign="unproven")
    assert code == 0
    assert "SIGN UNPROVEN" in output


@pytest.mark.parametrize(
    ("positions", "more", "words"),
    [
        ("t_s,X_mm,Y_mm\n200,1,2\n", (), "give t_s, axis, position_mm"),
        ("t_s,axis,position_mm\n200,Q,2\n", (), "no component for axis 'Q'"),
        ("time,axis,position_mm\n2026-03-02T09:00,X,2\n", (), "bring both tables to the same clock"),
        ("t_s,axis,position_mm\n200,X,2\n", ("--reference", "2026-03-02T08:30"), "counts seconds, not dates"),
        ("t_s,axis,position_mm\n200,X,2\n", ("--reference", "noon"), "expected first_row, model or a time"),
    ],
)
def test_command_refuses_in_one_clear_message(
    tmp_path: Path, positions: str, more: tuple[str, ...], words: str
) -> None:
    code, output = call(tmp_path, positions, *more)
    assert code == 1
    assert words in " ".join(output.split())
    assert not (tmp_path / "F.csv").exists()


ONE_ROW = "t_s,axis,position_mm\n300,X,500\n"


@pytest.mark.parametrize(
    ("reference", "words"),
    [
        ("first_row", "reference: first row of the temperatures, t = 100 s; the error is zero there"),
        ("model", "reference: the model's own, campaign A at 0 s; the constants of the fit are kept"),
        ("250", "reference: the temperatures at t = 250 s; the error is zero there"),
    ],
)
def test_command_says_which_reference_it_used(tmp_path: Path, reference: str, words: str) -> None:
    assert words in call(tmp_path, ONE_ROW, "--reference", reference)[1]


def test_command_says_a_reference_in_dates_as_a_date(tmp_path: Path) -> None:
    positions = "time,axis,position_mm\n2026-03-02T09:30:00,X,500\n"
    assert "first row of the temperatures, time = 2026-03-02T08:00:00;" in call(tmp_path, positions, temperature=ISO)[1]


def test_command_says_which_limit_was_broken_in_how_many_rows(tmp_path: Path) -> None:
    """Trained: a from 20 to 30 °C, so 31 °C and its rise of 11 K are out; EXX and EYX count a row once."""
    table = "t_s,a,b\n100,20,18\n200,31,19\n300,20,20\n"
    positions = "t_s,axis,position_mm\n200,X,500\n300,X,2500\n300,X,-40\n300,Y,10\n"
    code, output = call(tmp_path, positions, temperature=table)
    assert code == 0
    assert "3 rows outside what the model was trained on" in output
    assert "    a: 1 row outside; values 20 … 31, trained 20 … 30 °C" in output
    assert "    rise of a: 1 row outside; values 0 … 11, trained 0 … 10 K above the reference" in output
    assert "    position of X: 2 rows outside; values -40 … 2500, trained 0 … 2000 mm" in output
    assert "b: " not in output
    breaches = json.loads(call(tmp_path, positions, "--json", temperature=table)[1])["breaches"]
    assert [(b["kind"], b["name"], b["rows"]) for b in breaches] == [
        ("temperature", "a", 1),
        ("rise", "a", 1),
        ("position", "X", 2),
    ]


def test_a_gap_is_no_broken_limit(tmp_path: Path) -> None:
    output = call(
        tmp_path, "t_s,axis,position_mm\n200,X,500\n", temperature="t_s,a,b\n100,21,18\n200,,19\n300,27,22\n"
    )[1]
    assert "row outside;" not in output
    assert "1 row without a temperature" in output


def test_command_names_file_and_spreadsheet_row(tmp_path: Path) -> None:
    """The header is row 1 and row 3 is blank, so the second row of data is row 4."""
    code, output = call(tmp_path, "t_s,axis,position_mm\n200,X,2\n,,\n200,Q,2\n")
    assert code == 1
    assert "P.csv, row 4: the model has no component for axis 'Q'" in output


def test_failed_acceptance_checks_are_one_line_and_the_end_stays_good(tmp_path: Path) -> None:
    code, output = call(tmp_path, ONE_ROW, failed_checks=("one campaign only", "the clock does better"))
    assert code == 0
    assert "NOT FIT FOR USE: 2 acceptance checks failed: one campaign only; the clock does better\n" in output
    assert "NOT FIT FOR USE" not in call(tmp_path, ONE_ROW)[1]


@pytest.mark.parametrize(("reference", "wanted"), [("first_row", 0.0), ("model", 7.0)])
def test_error_that_no_sensor_predicts_stays_at_its_constant(tmp_path: Path, reference: str, wanted: float) -> None:
    exx = nothing_predicts("EXX", 7.0, p=(500.0, 0.0, 2000.0))
    code, output = call(tmp_path, ONE_ROW, "--reference", reference, stored=model(EXX=exx))
    assert code == 0, output
    assert "No sensor predicts EXX" in output
    (line,) = written(tmp_path)
    assert float(line["dX_um"]) == wanted
    assert float(line["dX_hi_um"]) > wanted
    assert float(line["dY_um"]) != 0.0  # a has risen by 6 K
    alone = model(("EYX", "EXY", "DZ"), EXX=exx)
    assert call(tmp_path, ONE_ROW, "--reference", reference, stored=alone)[0] == 0

"""`thetacomp iso230`: folder or lone table in, CSV and one page a test out; refusals in words."""

from __future__ import annotations

import csv
import json
import shutil
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from browser import open_in_browser
from machine_folders import csv_text, small_folder, valid_files, write_files
from typer.testing import CliRunner, Result

from thetacomp.cli.main import app
from thetacomp.errors import InputError
from thetacomp.reading import read_positioning
from thetacomp.reading.checks import LARGEST_ERROR_UM

EXAMPLE = Path(__file__).parents[2] / "examples" / "spindle"
DATA = "caiviac_fl_thermal/data.xlsx"
TARGETS_MM = (3, 252, 507, 748, 997)


def invoke(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["iso230", *map(str, arguments)])


def table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def value(rows: list[dict[str, str]], **wanted: str) -> float:
    (row,) = (r for r in rows if all(r[name] == text for name, text in wanted.items()))
    return float(row["value"])


def deviations(runs: int = 5) -> list[list[object]]:
    """Axis, target, run, approach, deviation: 10 µm/m, 3 µm of reversal, readings ±1 and 0 µm about their mean."""
    rows: list[list[object]] = [["axis", "target_mm", "run", "direction", "error_um"]]
    for run, noise in zip(range(1, runs + 1), (-1.0, 1.0, 0.0, 1.0, -1.0), strict=False):
        rows += [["X", p, run, "+", round(p / 100 + noise, 2)] for p in TARGETS_MM]
        rows += [["X", p, run, "-", round(p / 100 + noise - 3.0, 2)] for p in reversed(TARGETS_MM)]
    return rows


class Text(HTMLParser):
    """The words of a page."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.words: list[str] = []
        self.feed(page.read_text(encoding="utf-8"))

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


def test_a_lone_table_gives_the_figures_of_the_closed_form(tmp_path: Path) -> None:
    """s = 1 µm, slope over 994 mm: E = 12.94, M = 9.94, B = 3, R = 7, A = E + 4."""
    source = tmp_path / "x.csv"
    source.write_text(csv_text(deviations()), encoding="utf-8")
    done = invoke(source, "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert "A = 16.94 µm, R = 7 µm, E = 12.94 µm, M = 9.94 µm, B = 3 µm" in done.output
    rows = table(tmp_path / "out" / "iso230.csv")
    expected = {"A": 16.94, "A_up": 13.94, "R": 7.0, "E": 12.94, "E_down": 9.94, "M": 9.94, "B": 3.0, "B_mean": 3.0}
    for symbol, number in expected.items():
        assert value(rows, symbol=symbol, place="") == pytest.approx(number, abs=1e-4), symbol
    assert value(rows, symbol="s_up", place="507 mm") == pytest.approx(1.0)
    page = Text(tmp_path / "out" / "iso230-2_X.html").text
    assert "5 targets from 3 to 997 mm, 5 runs in each direction" in page
    assert "no correction to 20 °C" in page
    assert (tmp_path / "out" / "figures" / "iso230-2_X.png").stat().st_size > 10_000


def test_a_lone_table_with_millimetres_times_and_two_axes_is_read(tmp_path: Path) -> None:
    _, *rows = deviations()
    wide: list[list[object]] = [["axis", "target_mm", "run", "direction", "error_mm", "t_min"]]
    for axis in ("X", "Y"):
        wide += [[axis, p, run, d, e / 1000.0, i] for i, (_, p, run, d, e) in enumerate(rows)]  # type: ignore[operator]
    path = write_files(tmp_path, {"t.csv": csv_text(wide, ";", ",")}) / "t.csv"
    x, y = read_positioning(path)
    assert (x.axis, y.axis) == ("X", "Y")
    assert x.deviation_um == pytest.approx([float(row[4]) for row in rows])  # type: ignore[arg-type]
    assert y.t_s is not None
    assert y.t_s[-1] == 49 * 60.0


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda rows: rows[3].__setitem__(3, "up"), "row 4, column 'direction': found 'up', expected + or -"),
        (lambda rows: rows[3].__setitem__(3, None), "row 4, column 'direction': the cell is empty"),
        (lambda rows: rows[3].__setitem__(4, 748_007.5), "row 4, column 'error_um': found 748008 µm"),
        (lambda rows: rows[3].__setitem__(1, None), "row 4, column 'target_mm': the cell is empty"),
        (lambda rows: rows[0].__setitem__(1, "position_mm"), "column 'position_mm': found unknown columns"),
        (lambda rows: rows[0].__setitem__(2, "extra"), "there is no column 'run'"),
    ],
)
def test_bad_cells_of_a_lone_table_are_told_with_row_and_column(tmp_path: Path, spoil, message: str) -> None:
    rows = deviations()
    spoil(rows)
    path = write_files(tmp_path, {"x.csv": csv_text(rows)}) / "x.csv"
    with pytest.raises(InputError) as refusal:
        read_positioning(path)
    assert message in str(refusal.value)
    assert invoke(path, "--out", tmp_path / "out").exit_code == 1


def test_a_lone_table_that_cannot_be_read_at_all_is_named(tmp_path: Path) -> None:
    (tmp_path / "empty.csv").write_text("", encoding="utf-8")
    (tmp_path / "binary.csv").write_bytes(bytes(range(256)) * 8)
    for name, code in (("lost.csv", "missing-file"), ("empty.csv", None), ("binary.csv", None)):
        with pytest.raises(InputError) as refusal:
            read_positioning(tmp_path / name)
        (problem,) = refusal.value.problems
        assert problem.file == name
        assert code is None or problem.code == code
        assert problem.fix


def test_the_largest_plausible_deviation_is_one_still_taken(tmp_path: Path) -> None:
    for error_um, good in ((LARGEST_ERROR_UM, True), (-LARGEST_ERROR_UM, True), (-1.001 * LARGEST_ERROR_UM, False)):
        rows = deviations()
        rows[3][4] = error_um
        path = write_files(tmp_path, {"x.csv": csv_text(rows)}) / "x.csv"
        if good:
            assert read_positioning(path)[0].deviation_um[2] == error_um
        else:
            with pytest.raises(InputError, match="row 4, column 'error_um'"):
                read_positioning(path)


def test_four_runs_end_with_exit_code_1_and_write_nothing(tmp_path: Path) -> None:
    path = write_files(tmp_path, {"x.csv": csv_text(deviations(4))}) / "x.csv"
    done = invoke(path, "--out", tmp_path / "out")
    assert done.exit_code == 1
    assert "4 runs in each direction (1, 2, 3, 4), ISO 230-2 needs 5" in done.output
    assert not (tmp_path / "out").exists()


def five_runs_of_w() -> str:
    """Sweeps of the ram W, which moves along +Z here: the same deviations as above, with times."""
    rows: list[list[object]] = [["t_s", "axis", "position_mm", "dZ_um", "direction", "run"]]
    for i, (_, p, run, d, e) in enumerate(deviations()[1:]):
        rows.append([20 * i, "W", p, e, d, run])
    return csv_text(rows)


def test_sweeps_with_runs_and_directions_are_evaluated_along_the_axis(tmp_path: Path) -> None:
    files = valid_files(["day"])
    files["campaigns/day/sweeps.csv"] = five_runs_of_w()
    backward = files["machine.toml"].replace('direction = "+Z"', 'direction = "-Z"')
    turned = {**files, "machine.toml": backward}
    for name, content in (("a", files), ("b", turned)):
        folder = write_files(tmp_path / name, content)
        done = invoke(folder, "--out", tmp_path / f"out-{name}", "--json")
        assert done.exit_code == 0, done.output
        rows = table(tmp_path / f"out-{name}" / "iso230.csv")
        assert value(rows, axis="W", symbol="A", place="") == pytest.approx(16.94, abs=1e-4)
        sign = 1.0 if name == "a" else -1.0
        assert value(rows, axis="W", symbol="B_mean") == pytest.approx(sign * 3.0, abs=1e-4)
        # Leica: 15 µm; no growth with the distance is stated.
        (accuracy,) = (r for r in rows if (r["axis"], r["symbol"]) == ("W", "A"))
        assert float(accuracy["u"]) == pytest.approx(15.0 * np.sqrt(2.0), rel=1e-5)
        told = json.loads(done.stdout)
        assert any(test["title"] == "ISO 230-2, positioning of axis W" for test in told["tests"])
        assert any("there are no sweeps of axis X" in one["reason"] for one in told["not_evaluated"])


def test_a_folder_gives_a_page_for_each_test_and_says_what_it_lacks(tmp_path: Path) -> None:
    folder = small_folder(tmp_path / "mill")
    done = invoke(folder, "--out", tmp_path / "out", "--campaign", "2026-03-09")
    assert done.exit_code == 0, done.output
    assert "does not state the run of every point" in done.output
    assert "the machine rests for 10 min" in done.output
    pages = sorted(path.name for path in (tmp_path / "out").glob("*.html"))
    assert pages == [f"iso230-3_{kind}_2026-03-09.html" for kind in ("axis_W", "axis_X", "spindle")]
    page = Text(tmp_path / "out" / pages[2]).text
    # drift.csv: X grows by 1 µm in 2000 s; readings each 20 min, from 0 s (before the start at 600 s) to 14400 s.
    assert "X µm 1.8 7.2 7.2 ± 21.2" in page
    assert "Operating mode: no cooling." in page
    # theta_3 is ambient and rises by 0.3 K in 8 h: 20.13 °C at first, 20.28 °C after 4 h.
    assert "Ambient temperature: theta_3 20.1 to 20.3 °C (0.1 K)." in page
    assert "Axes moved meanwhile (up to 1000 mm/min)" in page
    assert "tilt A, B, C: drift.csv has no rA_urad, rB_urad, rC_urad" in page


def test_an_unknown_campaign_and_a_folder_without_any_test_are_bad_input(tmp_path: Path) -> None:
    folder = small_folder(tmp_path / "mill")
    done = invoke(folder, "--out", tmp_path / "out", "--campaign", "May")
    assert done.exit_code == 1
    assert "there is no campaign May; the folder has 2026-03-02, 2026-03-09" in done.output
    assert "there is no such folder" in invoke(tmp_path / "nowhere", "--out", tmp_path / "out").output
    files = valid_files(["day"])
    del files["campaigns/day/drift.csv"], files["campaigns/day/duty.csv"]
    files["campaigns/day/sweeps.csv"] = csv_text(
        [["t_s", "axis", "position_mm", "dX_um"], *[[i, "X", 250 * i, 1.5 * i] for i in range(4)]]
    )
    done = invoke(write_files(tmp_path / "poor", files), "--out", tmp_path / "out")
    assert done.exit_code == 1
    assert "no test can be evaluated" in done.output
    assert "visited fewer than 3 times" in done.output
    assert not (tmp_path / "out").exists()


@pytest.mark.needs("chromium")
def test_the_page_fits_its_window_and_asks_for_nothing(tmp_path: Path) -> None:
    source = write_files(tmp_path, {"x.csv": csv_text(deviations())}) / "x.csv"
    assert invoke(source, "--out", tmp_path / "out").exit_code == 0
    view = open_in_browser(tmp_path / "out" / "iso230-2_X.html", tmp_path)
    assert [url for url in view.requests if not url.startswith("file:")] == []
    assert view.console == ()
    assert np.all(view.pixels[:, -10:] > 0.99)


@pytest.mark.shared_data(DATA)
def test_the_spindle_recording_against_ranges_taken_from_its_table(tmp_path: Path, shared_data: Path) -> None:
    """Expected: largest less smallest of ch1, ch3, ch5 over 1 h and 4 h, by pandas straight from the workbook."""
    folder = tmp_path / "spindle"
    shutil.copytree(EXAMPLE, folder)
    recording = folder / "recording.toml"
    text = recording.read_text(encoding="utf-8")
    recording.write_text(text.replace('file = "data.xlsx"', f'file = "{shared_data.as_posix()}"'), encoding="utf-8")
    done = invoke(folder, "--out", tmp_path / "out", "--campaign", "2 2500 rpm", "--campaign", "4 5000 rpm")
    assert done.exit_code == 0, done.output
    assert "running at the first drift reading" in done.output
    rows = table(tmp_path / "out" / "iso230.csv")
    for name, expected in (
        ("2 2500 rpm", [(7.0009, 10.2019, 9.7745), (11.7257, 22.5159, -21.9605), (6.0958, 13.6279, 6.7310)]),
        ("4 5000 rpm", [(16.4128, 22.3599, 21.4005), (32.2120, 61.6534, -61.3964), (19.5519, 27.5710, 7.8618)]),
    ):
        for letter, figures in zip("XYZ", expected, strict=True):
            found = [value(rows, campaign=name, symbol=f"{letter}_{x}") for x in ("range_60min", "range", "change")]
            assert found == pytest.approx(figures, abs=2e-4)
    page = Text(tmp_path / "out" / "iso230-3_spindle_4-5000-rpm.html").text
    assert "Sign unproven" in page
    assert "Spindle speed: 5000 rpm." in page
    assert "No ambient temperature" in page
    assert "campaign.toml has no instrument_u_um" in page

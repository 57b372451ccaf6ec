"""`thetacomp demo` and what it leaves behind: the files, the figures it tells, the pages in a browser."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
from browser import open_in_browser
from typer.testing import CliRunner, Result

from thetacomp.cli.main import app
from thetacomp.model.load import load_model


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    out = tmp_path_factory.mktemp("demo") / "here"
    return CliRunner().invoke(app, ["demo", "--out", str(out)]), out


def test_every_file_that_it_names_is_there(run):
    result, out = run
    assert result.exit_code == 0, result.output
    named = set(re.findall(re.escape(str(out)) + r"/[\w./-]*\w", result.stdout))
    assert {path.removeprefix(str(out)) for path in named} >= {
        "/results/report.html",
        "/results/model.json",
        "/sinumerik/commissioning_sheet.html",
        "/tk6920",
        "/keypoints.txt",
        "/prediction.csv",
    }
    assert [path for path in named if not (out / path).exists()] == []


def test_it_tells_the_main_figures_beside_the_clock(run):
    result, _ = run
    # Leave one state out over Y 0 to 3000 mm: 90.5 and 88.0 % (clock 92.6 and 85.0 %), recomputed from the published
    # tables by another program, each within 0.5.
    told = re.findall(r"^  ([XZ]), each state in turn .* ([\d.]+) %   the clock alone +([\d.]+) %", result.stdout, re.M)
    assert [direction for direction, *_ in told] == ["X", "Z"]
    figures = [float(figure) for _, *pair in told for figure in pair]
    assert figures == pytest.approx([90.5, 92.6, 88.0, 85.0], abs=0.5)


def test_the_figures_in_the_readme_are_those_of_the_program(run):
    _, out = run

    def rows(file: str) -> dict[tuple[str, str], dict[str, str]]:
        with (out / "results" / file).open(newline="", encoding="utf-8") as table:
            return {(row["component"], row["model"]): row for row in csv.DictReader(table)}

    by_state, forward = rows("validation.csv"), rows("validation_forward.csv")
    readme = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    for direction in "XZ":
        column = f"column_{direction}"
        model = by_state[column, "default"]
        cells = [f"{float(model['max_before_um']):.0f} µm", f"{float(model['max_after_um']):.0f} µm"]
        for table in (by_state, forward):
            cells += [f"{float(table[column, name]['reduction_percent']):.1f} %" for name in ("default", "clock")]
        assert f"| {direction} | {' | '.join(cells)} |" in readme
    for component in ("EYW", "EYY"):
        row = by_state[component, "default"]
        assert f"({float(row['max_before_um']):.0f} -> {float(row['max_after_um']):.0f} µm)" in readme


def test_the_unproven_sign_is_in_what_it_says_and_in_the_files(run):
    result, out = run
    assert "does not state the sign" in result.stdout
    assert load_model(out / "results" / "model.json").sign == "unproven"


def test_the_prediction_starts_at_zero_and_grows_with_the_column(run):
    _, out = run
    with (out / "prediction.csv").open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["position_mm"] == "3000"]
    deviation_um = [abs(float(row["dX_um"])) for row in rows]
    assert deviation_um[0] == 0.0
    assert deviation_um[-1] == max(deviation_um) > 300.0


@pytest.mark.slow
def test_as_json_it_is_one_object_with_every_step(tmp_path):
    result: Result = CliRunner().invoke(app, ["demo", "--json", "--out", str(tmp_path)])
    steps = json.loads(result.stdout)["steps"]
    assert [step["command"][0] for step in steps] == ["check", "keypoints", "analyze", "predict", "export"]
    assert [step["exit_code"] for step in steps] == [0, 0, 3, 0, 3]


@pytest.mark.needs("chromium")
@pytest.mark.parametrize("page", ["results/report.html", "sinumerik/commissioning_sheet.html"])
def test_a_page_opens_without_a_network_and_is_not_blank(run, page, tmp_path):
    _, out = run
    view = open_in_browser(out / page, tmp_path)
    assert view.requests == ()
    assert view.console == ()
    written = np.any(np.abs(view.pixels - view.pixels[0, 0]) > 0.1, axis=2)
    assert 0.02 < written.mean() < 0.9
    # Nothing may be cut off at the right: the last columns of pixels are background.
    assert not written[:, -4:].any()


@pytest.mark.needs("chromium")
def test_the_browser_check_sees_a_request_and_a_failing_script(tmp_path):
    page = tmp_path / "page.html"
    page.write_text(
        '<!doctype html><img src="http://example.invalid/x.png"><script>throw new Error("broken")</script>', "utf-8"
    )
    view = open_in_browser(page, tmp_path, height=300)
    assert view.requests == ("http://example.invalid/x.png",)
    assert "broken" in view.console[0]

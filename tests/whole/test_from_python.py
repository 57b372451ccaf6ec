"""The public API as a notebook uses it: docs/from_python.ipynb and the page beside it are run as they stand."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from machine_folders import small_folder, small_machine
from small_models import three_axes
from typer.testing import CliRunner

import thetacomp
from thetacomp.api import Model, PredictedError
from thetacomp.cli.main import app
from thetacomp.errors import AnalysisError, InputError, ModelFileError
from thetacomp.examples import TK6920
from thetacomp.model.volumetric import VolumePrediction

DOCS = Path(__file__).parents[2] / "docs"
SOURCE = Path(__file__).parents[2] / "src"


def code_cells() -> list[str]:
    notebook = json.loads((DOCS / "from_python.ipynb").read_text(encoding="utf-8"))
    return ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]


def run_cell(code: str, names: dict[str, Any]) -> Any:
    """Run one cell as a notebook does: the value of its last expression is what is shown."""
    tree = ast.parse(code)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "cell", "exec"), names)
    return None if last is None else eval(compile(ast.Expression(last.value), "cell", "eval"), names)


@pytest.fixture(scope="module")
def notebook(tmp_path_factory):
    """The folder in which the notebook was run, what each cell showed, and its names."""
    folder, names = tmp_path_factory.mktemp("notebook"), {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        shown = [run_cell(code, names) for code in code_cells()]
    return folder, shown, names


def test_the_page_shows_the_code_of_the_notebook():
    page = (DOCS / "from_python.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    assert [block.rstrip("\n") for block in blocks] == code_cells()


def test_the_notebook_runs_and_every_cell_shows_something(notebook):
    folder, shown, _ = notebook
    assert shown[0] == ["W", "X", "Y"]
    assert all(value is not None for value in shown)
    assert (folder / "results" / "report.html").exists()
    assert (folder / "results" / "model.json").exists()
    assert all((folder / path).exists() for path in shown[-2])
    assert {path.name for path in shown[-2]} >= {"sinumerik_values.csv", "commissioning_sheet.html"}


def test_a_notebook_shows_verdict_and_picture(notebook):
    html = notebook[2]["analysis"]._repr_html_()
    assert "Not fit for use" in html
    line = r"column deviation X, held out: largest error 451\.6 → 42\.4 µm \(90\.6 % less; the clock alone leaves"
    assert re.search(line, html)
    assert html.count("<svg") == 1
    assert "Before and after" in html
    assert "http" not in html.replace("http://www.w3.org", "").replace("http://purl.org", "")


def test_every_repr_is_a_few_lines(notebook):
    names = notebook[2]
    for value in (names["analysis"].model, names["error"], notebook[1][-1]):
        assert len(repr(value)) < 400
        assert repr(value).count("\n") < 5
    assert repr(names["error"]).startswith("PredictedError: 8 rows, largest in µm: |dX| ")
    assert repr(notebook[1][-1]).startswith("Verification of TK6920: ")


def test_python_predicts_what_the_command_writes(notebook, tmp_path):
    import pandas as pd

    folder, _, names = notebook
    pd.DataFrame(names["positions"]).to_csv(tmp_path / "P.csv", index=False)
    arguments = ["predict", folder / "results" / "model.json", "--positions", tmp_path / "P.csv"]
    arguments += ["--temperatures", TK6920 / "campaigns" / "Y" / "temperatures.csv", "--out", tmp_path / "error.csv"]
    assert CliRunner().invoke(app, [str(a) for a in arguments]).exit_code == 0
    written, frame = pd.read_csv(tmp_path / "error.csv"), names["error"].to_frame()
    assert list(frame.columns) == list(written.columns)
    assert frame["axis"].tolist() == written["axis"].tolist()
    numbers = [name for name in frame.columns if name != "axis"]
    np.testing.assert_allclose(frame[numbers].astype(float), written[numbers], atol=6e-5)


def test_a_model_is_saved_and_loaded(tmp_path):
    model = Model(three_axes())
    model.save(tmp_path / "model.json")
    assert thetacomp.load_model(tmp_path / "model.json").document == model.document


def test_positions_of_all_axes_have_their_own_columns():
    t_s, zeros = np.array([0.0, 50.0]), np.zeros((2, 3))
    volume = VolumePrediction(
        t_s, {"X": t_s, "W": t_s}, t_s, zeros + 1.0, zeros, zeros + 2.0, t_s < 9.0, t_s > 99.0, (), (), (), "", {}
    )
    columns = PredictedError(volume).columns()
    assert list(columns)[:5] == ["t_s", "X_mm", "W_mm", "tool_length_mm", "dX_um"]
    assert [columns["dZ_hi_um"][0], columns["dZ_lo_um"][0]] == [2.0, 0.0]
    mixed = {"t_s": [0.0], "axis": ["X"], "position_mm": [0.0], "W_mm": [0.0]}
    with pytest.raises(InputError, match="an axis with position_mm stands beside W_mm"):
        Model(three_axes()).predict({"t_s": [0.0, 1.0], "tx": [20.0, 20.0]}, mixed)


def test_what_is_wrong_is_said_as_in_the_commands(notebook, tmp_path):
    with pytest.raises(InputError, match="there is no such folder"):
        thetacomp.analyze(tmp_path / "nowhere")
    with pytest.raises(ModelFileError, match="there is no such file"):
        thetacomp.load_model(tmp_path / "model.json")
    analysis = notebook[2]["analysis"]
    with pytest.raises(AnalysisError, match=r"no table 'validations'\. Fix: one of separation, "):
        analysis.table("validations")
    with pytest.raises(AnalysisError, match="this version writes sinumerik, not 'fanuc'"):
        thetacomp.export(analysis.model, "fanuc", tmp_path)
    with pytest.raises(AnalysisError, match="Q"):
        thetacomp.analyze(TK6920, train="Q")
    with pytest.raises(AttributeError, match="no attribute 'campaign_from_frames'"):
        _ = thetacomp.campaign_from_frames


def test_the_machine_may_be_a_file(tmp_path):
    small = small_folder(tmp_path)
    heat = {"t_s": np.arange(0.0, 600.0, 60.0), "theta_1": np.full(10, 20.0)}
    folder = thetacomp.read_frames(small / "machine.toml", {"a": {"temperatures": heat}})
    assert folder.machine == small_machine()


def test_importing_thetacomp_imports_nothing_else():
    code = (
        f"import sys; sys.path.insert(0, {str(SOURCE)!r}); import thetacomp\n"
        "print(*(name for name in sys.modules if name.split('.')[0] not in sys.stdlib_module_names))"
    )
    bare = [sys.executable, "-I", "-S", "-c", code]  # without the packages and what their .pth files import
    done = subprocess.run(bare, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["__main__", "thetacomp"]
    stub = (Path(thetacomp.__file__).with_suffix(".pyi")).read_text(encoding="utf-8")
    assert re.findall(r"as (\w+)$", stub, re.MULTILINE) == thetacomp.__all__
    assert all(callable(getattr(thetacomp, name)) for name in thetacomp.__all__)

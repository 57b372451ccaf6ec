"""What runs without the optional packages, and what each command says where it needs one."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest
from machine_folders import csv_text, small_folder
from packaging.requirements import Requirement
from verification_runs import Run, write_folder

from thetacomp.extras import _EXTRAS

ROOT = Path(__file__).parents[2]

# Runs commands, one after the other, where no optional package can be imported; prints how each ended.
WITHOUT_EXTRAS = """
import contextlib, io, json, sys

BLOCKED = {"skfem", "numba", "llvmlite", "pyarrow", "sklearn", "pandas", "threadpoolctl", "joblib"}

class Hook:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in BLOCKED:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name.split(".")[0])
        return None

sys.meta_path.insert(0, Hook())
from thetacomp.cli.main import app

ended = []
for arguments in json.loads(sys.argv[1]):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = app(arguments, standalone_mode=False)
    ended.append([arguments[0], code or 0, out.getvalue(), err.getvalue()])
print(json.dumps(ended))
"""


def run_without_extras(*commands: tuple[object, ...]) -> list[tuple[str, int, str, str]]:
    """Name, exit code, standard output and standard error of each command."""
    arguments = json.dumps([[str(part) for part in command] for command in commands])
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_EXTRAS, arguments],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return [tuple(entry) for entry in json.loads(done.stdout)]


def test_every_command_of_the_base_installation_runs_without_an_extra(tmp_path):
    example = files("thetacomp.examples") / "tk6920"
    machine = write_folder(tmp_path / "machine", [Run("off"), Run("good", compensation="on", share=0.9)])
    deviations = [
        ["X", p, run, side, 0.01 * p + run] for run in range(1, 6) for side in "+-" for p in (3, 252, 507, 748, 997)
    ]
    table = tmp_path / "deviations.csv"
    table.write_text(csv_text([["axis", "target_mm", "run", "direction", "error_um"], *deviations]), "utf-8")
    shutil.copytree(machine / "campaigns" / "off", machine / "campaigns" / "again")
    small = small_folder(tmp_path / "small")
    model = tmp_path / "demo" / "results" / "model.json"
    ended = run_without_extras(
        ("demo", "--out", tmp_path / "demo"),  # runs check, keypoints on tables, analyze, predict and export
        ("predict", model, "--temperatures", example / "campaigns" / "Y" / "temperatures.csv",
         "--positions", tmp_path / "demo" / "positions.csv", "--out", tmp_path / "error.csv"),
        ("export", model, "--target", "sinumerik", "--out", tmp_path / "export"),
        ("verify", machine, "--off", "off", "--on", "good", "--out", tmp_path / "verification"),
        ("plan", machine, "--out", tmp_path / "plan"),
        ("keypoints", machine, "--train", "off"),
        ("keypoints", machine, "--train", "off", "--train", "again", "--method", "exact", "--sensors", "2"),
        ("iso230", table, "--out", tmp_path / "iso230"),
        ("check", small),
    )  # fmt: skip
    for name in ("check", "keypoints", "analyze", "predict", "export"):
        assert f"$ thetacomp {name} " in ended[0][2]
    expected = [0, 0, 3, 0, 0, 0, 0, 0, 0]
    assert [code for _, code, *_ in ended] == expected, [entry for entry in ended if "error" in entry[3]]


@pytest.mark.parametrize(
    ("extra", "command"),
    [
        ("twin", ("twin", "--out", "{}/twin")),
        ("twin", ("place", "--out", "{}/places")),
        ("twin", ("trial", "--out", "{}/year")),
        ("families", ("analyze", "{}/machine", "--out", "{}/results", "--compare")),
        ("parquet", ("check", "{}/machine")),
    ],
    ids=lambda value: value if isinstance(value, str) else value[0],
)
def test_a_command_without_its_extra_names_it_in_one_line(tmp_path, extra, command):
    machine = small_folder(tmp_path / "machine")
    if extra == "parquet":
        for table in machine.rglob("temperatures.csv"):
            table.rename(table.with_suffix(".parquet"))
    before = sorted(tmp_path.iterdir())
    ((_, code, out, err),) = run_without_extras(tuple(part.format(tmp_path) for part in command))
    assert code == 1
    assert out == ""
    assert len(err.splitlines()) == 1, err
    assert f"needs the extra '{extra}'" in err
    assert f"pip install 'thetacomp[{extra}]'" in err
    assert sorted(tmp_path.iterdir()) == before


def project() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_the_extras_that_a_message_names_are_those_of_the_project():
    extras = project()["optional-dependencies"]
    assert set(extras) == {*_EXTRAS, "all"}
    assert [Requirement(text).extras for text in extras["all"]] == [set(_EXTRAS)]
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for extra, (package, _) in _EXTRAS.items():
        distribution = {"skfem": "scikit-fem", "sklearn": "scikit-learn"}.get(package, package)
        assert distribution in [Requirement(text).name for text in extras[extra]]
        assert f"| `{extra}` |" in readme


def test_no_optional_package_is_a_dependency_of_the_base():
    optional = {"scikit-fem", "pyarrow", "scikit-learn", "pandas", "threadpoolctl", "numba"}
    assert not optional & {Requirement(text).name for text in project()["dependencies"]}

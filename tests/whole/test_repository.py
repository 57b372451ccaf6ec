"""The repository around the code: what is promised to a reader, an installer and a maintainer is held here."""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from typer.main import get_command

from thetacomp.cli.main import app

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src"
DOCUMENTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]
HEAVY = ("numpy", "pandas", "sklearn", "scipy", "matplotlib", "pyarrow", "skfem")


def run_python(code: str) -> str:
    """Standard output of a fresh interpreter, warnings as errors."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(SOURCE)},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def repository_files() -> list[Path]:
    """Every file that is, or would be, committed; outside a git clone the files of the folders that hold our own."""
    if not (ROOT / ".git").exists():
        folders = ("src", "tests", "docs", "bench", "scripts")
        return [path for folder in folders for path in (ROOT / folder).rglob("*") if path.is_file()]
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return [ROOT / name for name in listed.split("\0") if name and (ROOT / name).is_file()]


def commands() -> dict[str, list[str]]:
    """Name of every command, with its long options."""
    group = get_command(app)
    return {
        name: [option for parameter in command.params for option in parameter.opts if option.startswith("--")]
        for name, command in group.commands.items()  # type: ignore[attr-defined]
    }


# --- start-up and imports ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("arguments", [["--help"], *([name, "--help"] for name in commands())], ids=" ".join)
def test_help_imports_nothing_heavy(arguments):
    code = f"""
import sys
from thetacomp.cli.main import app
app({arguments!r}, standalone_mode=False)
print("heavy:", sorted(set({HEAVY!r}) & sys.modules.keys()))
"""
    assert run_python(code).splitlines()[-1] == "heavy: []"


def test_the_machine_wing_runs_where_nothing_but_numpy_pydantic_and_structlog_is_installed():
    code = """
import importlib, pkgutil, sys

ALLOWED = {"numpy", "pydantic", "structlog"}
ALLOWED |= {"pydantic_core", "annotated_types", "typing_extensions", "typing_inspection"}  # what pydantic brings
BELOW = ("machine", "errors", "arrays", "files", "table_file", "safe_names")
ROOMS = {"thetacomp." + name for name in ("model", "controllers", *BELOW)}

class Blocked:
    def find_spec(self, name, path=None, target=None):
        top = name.split(".")[0]
        if top == "thetacomp" and (name == "thetacomp" or ".".join(name.split(".")[:2]) in ROOMS):
            return None
        if top in sys.stdlib_module_names or top in ALLOWED or top.startswith("_sysconfigdata"):
            return None
        raise ModuleNotFoundError(f"{name} is not there at the machine", name=name)

sys.meta_path.insert(0, Blocked())
count = 0
for room in ("thetacomp.model", "thetacomp.controllers"):
    package = importlib.import_module(room)
    for module in pkgutil.walk_packages(package.__path__, room + "."):
        importlib.import_module(module.name)
        count += 1
print(count)
"""
    assert int(run_python(code)) > 20


def test_no_module_needs_a_posix_system():
    posix_only = {"fcntl", "grp", "pty", "pwd", "resource", "termios", "syslog"}
    for path in sorted(SOURCE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            assert not posix_only & {name.split(".")[0] for name in names}, f"{path.name}, line {node.lineno}"


# --- what is committed ------------------------------------------------------------------------------------------------


def test_no_file_holds_a_path_of_one_computer_or_the_host_of_a_registry():
    # Written in pieces, so that this file does not find itself.
    private = re.compile(r"(?<![\w.~$}>-])/(?:" + "|".join(("work", "tmp", "root", "home", "Users")) + r")/\w")
    registry = re.compile("|".join((r"pypi\." + "org", r"python" + r"hosted\.org", r"npmjs\." + "org")))
    found = []
    for path in repository_files():
        try:
            text = path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue  # a picture
        for number, line in enumerate(text.splitlines(), start=1):
            if private.search(line) or registry.search(line):
                found.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()[:120]}")
    assert not found, "\n".join(found)


def test_there_is_no_pickle_and_notebooks_are_stored_without_outputs():
    unwanted = {".pkl", ".pickle", ".joblib"}
    assert [path.name for path in repository_files() if path.suffix in unwanted] == []
    for path in repository_files():
        if path.suffix == ".ipynb":
            cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
            code = [cell for cell in cells if cell["cell_type"] == "code"]
            assert [(cell["outputs"], cell["execution_count"]) for cell in code] == [([], None)] * len(code), path.name


# --- locked dependencies ----------------------------------------------------------------------------------------------


def locked(name: str) -> dict[str, list[Requirement]]:
    """Requirements of a locked file by package. Fails where one has no exact version or no hash."""
    text = (ROOT / name).read_text(encoding="utf-8").replace("\\\n", " ")
    out: dict[str, list[Requirement]] = {}
    for line in text.splitlines():
        if not line or line.startswith("#"):
            continue
        requirement, *hashes = line.split("--hash=")
        assert hashes, f"{requirement} has no hash"
        assert all(re.fullmatch(r"sha256:[0-9a-f]{64}\s*", item) for item in hashes), requirement
        parsed = Requirement(requirement.strip())
        assert [spec.operator for spec in parsed.specifier] == ["=="], requirement
        out.setdefault(parsed.name, []).append(parsed)
    return out


@pytest.mark.parametrize(
    ("name", "group"), [("requirements.txt", "build"), ("requirements-dev.txt", "dev")], ids=["base", "dev"]
)
def test_locked_requirements_meet_what_the_project_asks_for(name, group):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    pins = locked(name)
    wanted = [*project["project"]["dependencies"]]
    wanted += [item for item in project["dependency-groups"][group] if isinstance(item, str)]
    if group == "dev":  # the tests need every extra
        extras = project["project"]["optional-dependencies"]
        wanted += [text for name, extra in extras.items() if name != "all" for text in extra]
    for text in wanted:
        requirement = Requirement(text)
        assert requirement.name in pins, f"{requirement.name} is not in {name}: run `make lock`"
        for pin in pins[requirement.name]:
            version = next(iter(pin.specifier)).version
            assert requirement.specifier.contains(version), f"{pin} does not meet {requirement}: run `make lock`"


def test_the_base_lock_holds_no_optional_package():
    optional = {"numba", "llvmlite", "pyarrow", "pandas", "scikit-learn", "scikit-fem", "threadpoolctl", "joblib"}
    assert not optional & set(locked("requirements.txt"))


def test_tools_are_locked_to_the_same_versions_as_the_runtime():
    runtime, tools = locked("requirements.txt"), locked("requirements-dev.txt")
    for name, pins in runtime.items():
        assert sorted(map(str, tools[name])) == sorted(map(str, pins))


def test_the_lock_names_no_index_and_no_file():
    for name in ("requirements.txt", "requirements-dev.txt"):
        text = (ROOT / name).read_text(encoding="utf-8")
        assert "://" not in text
        assert not re.search(r"^\s*(-i|-f|-e|--index|--extra-index|--find-links|--trusted)", text, re.MULTILINE)


# --- what is installed ------------------------------------------------------------------------------------------------


def test_the_wheel_is_pure_python_and_holds_the_examples_and_templates(tmp_path):
    for name in ("pyproject.toml", "README.md", "LICENSE", ".gitignore"):
        shutil.copy(ROOT / name, tmp_path / name)
    shutil.copytree(SOURCE, tmp_path / "src", ignore=shutil.ignore_patterns("__pycache__"))
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", "wheels"],
        cwd=tmp_path,
        check=True,
        capture_output=True,
    )
    (wheel,) = (tmp_path / "wheels").glob("*.whl")
    assert wheel.name.endswith("-py3-none-any.whl")
    inside = set(zipfile.ZipFile(wheel).namelist())
    expected = {
        path.relative_to(SOURCE).as_posix()
        for path in SOURCE.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert expected <= inside, sorted(expected - inside)
    assert "thetacomp/examples/tk6920/machine.toml" in inside
    assert "thetacomp/py.typed" in inside


# --- documents --------------------------------------------------------------------------------------------------------


def command_sections() -> dict[str, str]:
    """Sections of docs/commands.md by command: `## thetacomp NAME`."""
    text = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    parts = re.split(r"^## `?thetacomp ([\w ]+?)`?$", text, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


@pytest.mark.parametrize("name", commands())
def test_every_command_is_documented_with_an_example_and_all_its_options(name):
    section = command_sections().get(name)
    assert section is not None, f"docs/commands.md has no section '## thetacomp {name}'"
    assert re.search(rf"^(?:\$ )?thetacomp {name}\b", section, re.MULTILINE), "no example"
    missing = [option for option in commands()[name] if f"`{option}" not in section and option != "--help"]
    assert missing == []


def test_no_document_describes_a_command_that_is_not_there():
    assert set(command_sections()) <= set(commands())


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_links_between_documents_lead_somewhere(document):
    text = document.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if "://" in target or target.startswith(("#", "mailto:")):
            continue
        assert (document.parent / target.split("#")[0]).exists(), f"{document.name} points at {target}"


def test_the_code_overview_names_files_that_exist_and_leaves_no_module_out():
    text = (ROOT / "docs" / "code_overview.md").read_text(encoding="utf-8")
    package = SOURCE / "thetacomp"
    named = set(re.findall(r"`((?:\.\./)?[\w/]+(?:\.py|/))`", text))
    assert [name for name in sorted(named) if not (package / name).exists()] == []
    modules = {path.name for path in package.glob("*.py") if not path.name.startswith("__")}
    packages = {path.name + "/" for path in package.iterdir() if (path / "__init__.py").exists()}
    assert modules | packages <= named, sorted((modules | packages) - named)


# --- the commands of the Makefile -------------------------------------------------------------------------------------


def test_a_missing_package_is_counted_by_name_and_never_allowed_in_the_check_of_a_change(tmp_path):
    (tmp_path / "scripts").mkdir()
    (tmp_path / "tests").mkdir()
    (tmp_path / "scripts" / "packages.txt").write_text("# list\nno-such-package command no-such-command\n", "utf-8")
    shutil.copy(ROOT / "tests" / "conftest.py", tmp_path / "tests")
    (tmp_path / "tests" / "test_it.py").write_text(
        "import pytest\n"
        "@pytest.mark.needs('no-such-package')\n"
        "def test_a(): pass\n"
        "@pytest.mark.shared_data('absent/data.xlsx')\n"
        "def test_b(): pass\n"
        "def test_c(): pass\n",
        "utf-8",
    )

    def run(no_skips: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "tests"],
            cwd=tmp_path,
            env={**os.environ, "THETACOMP_NO_SKIPS": no_skips},
            capture_output=True,
            text=True,
            check=False,
        )

    lenient = run("0")
    assert lenient.returncode == 0
    last = lenient.stdout.splitlines()[-3:]
    assert last[0] == "skipped, because a package is missing: no-such-package (1): tests/test_it.py::test_a"
    assert last[1] == "skipped, because shared data is absent: absent/data.xlsx (1): tests/test_it.py::test_b"
    assert "1 passed, 2 skipped" in last[2]
    strict = run("1")
    assert strict.returncode == 1
    assert "1 passed, 1 skipped, 1 error" in strict.stdout.splitlines()[-1]


def test_without_a_new_enough_python_make_says_what_to_do(tmp_path):
    done = subprocess.run(
        ["sh", str(ROOT / "scripts" / "make_venv.sh"), str(tmp_path / "venv")],
        env={"PATH": os.defpath, "PYTHON": "no-such-python"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert "needs Python 3.11 or newer" in done.stderr
    assert "apt-get install python3 python3-venv" in done.stderr
    assert not (tmp_path / "venv").exists()

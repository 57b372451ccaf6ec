"""Where results may go, and that a folder of results is the old one or the new one, whatever happens."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from machine_folders import valid_files, write_files
from small_models import component, document, term
from typer.testing import CliRunner

from thetacomp import files, folder_exchange
from thetacomp.cli.main import app
from thetacomp.errors import OutputError
from thetacomp.files import write_file
from thetacomp.outputs import output_folder, output_table

OWN = ("report.html", "table.csv", "figures/fit_*.svg")
FIRST = {"report.html": "first", "table.csv": "1\n", "figures/fit_X.svg": "x", "figures/fit_old.svg": "old"}
SECOND = {"report.html": "second", "table.csv": "2\n", "figures/fit_X.svg": "y", "figures/fit_Y.svg": "new"}
MINE = {"notes.txt": "mine", "figures/photo.jpg": "photo", "deep/er/still.txt": "mine too"}


def contents(folder: Path) -> dict[str, str]:
    found = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_text(encoding="utf-8") for path in found}


def fill(out: Path, what: dict[str, str]) -> None:
    with output_folder(out, (), OWN) as fresh:
        files.write_files(fresh, what)


def leftovers(place: Path) -> list[str]:
    return [path.name for path in place.iterdir() if path.name.startswith(".")]


# --- a folder is exchanged whole --------------------------------------------------------------------------------------


@pytest.mark.parametrize("swaps", [True, False], ids=["one step", "two renames"])
def test_new_results_replace_the_old_and_leave_what_is_the_users(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, swaps: bool
) -> None:
    if not swaps:
        monkeypatch.setattr(folder_exchange, "_swap", lambda a, b: False)
    out = tmp_path / "results"
    fill(out, FIRST)
    files.write_files(out, MINE)
    (out / "link").symlink_to("notes.txt")
    out.chmod(0o750)
    fill(out, SECOND)
    assert contents(out) == {**SECOND, **MINE, "link": "mine"}
    assert (out / "link").is_symlink()
    assert out.stat().st_mode & 0o777 == 0o750
    assert leftovers(tmp_path) == []


@pytest.mark.parametrize("error", [PermissionError(13, "in use"), KeyboardInterrupt()], ids=["in use", "Ctrl-C"])
def test_a_failure_between_two_renames_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    out, real = tmp_path / "results", Path.rename
    fill(out, FIRST)
    files.write_files(out, MINE)

    def rename(self: Path, target: Path) -> Path:
        if target == out and not self.name.endswith("-old"):
            raise error
        return real(self, target)

    monkeypatch.setattr(folder_exchange, "_swap", lambda a, b: False)
    monkeypatch.setattr(Path, "rename", rename)
    with pytest.raises((OutputError, KeyboardInterrupt)):
        fill(out, SECOND)
    assert contents(out) == {**FIRST, **MINE}
    assert leftovers(tmp_path) == []


def test_an_error_in_the_work_changes_nothing(tmp_path: Path) -> None:
    fill(tmp_path / "results", FIRST)

    def failing(out: Path) -> None:
        with output_folder(out, (), OWN) as fresh:
            write_file(fresh / "report.html", "half")
            raise ZeroDivisionError

    for out in (tmp_path / "results", tmp_path / "a" / "b" / "new"):
        with pytest.raises(ZeroDivisionError):
            failing(out)
    assert contents(tmp_path) == {f"results/{name}": text for name, text in FIRST.items()}
    assert not (tmp_path / "a").exists()


STEPS: tuple[tuple[object, str], ...] = (
    (os, "fsync"), (os, "link"), (os, "open"), (os, "unlink"), (os, "mkdir"), (os, "rename"), (os, "replace"),
    (os, "rmdir"), (folder_exchange, "_swap"),
)  # fmt: skip


def killed_at(step: int, work: Callable[[], None], swaps: bool) -> bool:
    """Do the work in a process of its own that dies at its n-th step on the disk; False where it came to its end."""
    child = os.fork()
    if child == 0:
        left = step

        def dying(real: Callable[..., object]) -> Callable[..., object]:
            def call(*arguments: object, **options: object) -> object:
                nonlocal left
                left -= 1
                if left < 0:
                    os.kill(os.getpid(), signal.SIGKILL)
                return real(*arguments, **options)

            return call

        if not swaps:
            folder_exchange._swap = lambda a, b: False
        for owner, name in STEPS:
            setattr(owner, name, dying(getattr(owner, name)))
        work()
        os._exit(0)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status) or os.WEXITSTATUS(status) == 0
    return os.WIFSIGNALED(status)


@pytest.mark.parametrize("swaps", [True, False], ids=["one step", "two renames"])
def test_killed_at_every_step_the_folder_is_the_old_or_the_new_one(tmp_path: Path, swaps: bool) -> None:
    out = tmp_path / "results"
    old, new = {**FIRST, **MINE}, {**SECOND, **MINE}
    seen = set()
    for step in range(400):
        if out.exists():
            fill(out, FIRST)
        else:
            fill(out, FIRST)
            files.write_files(out, MINE)
        assert contents(out) == old
        died = killed_at(step, lambda: fill(out, SECOND), swaps)
        if not out.exists():  # between the two renames; the next run finds the old folder beside
            assert not swaps
            fill(out, FIRST)
            assert contents(out) == old
            seen.add("between")
            continue
        assert contents(out) in (old, new), f"step {step}"
        seen.add("new" if contents(out) == new else "old")
        if not died:
            break
    else:
        pytest.fail("the work never came to its end")
    assert {"old", "new"} <= seen
    fill(out, SECOND)
    assert leftovers(tmp_path) == []


# --- two runs ---------------------------------------------------------------------------------------------------------


def test_a_second_run_into_one_folder_is_told_so_and_the_first_goes_on(tmp_path: Path) -> None:
    out, inside, done = tmp_path / "results", threading.Event(), threading.Event()

    def slow() -> None:
        with output_folder(out, (), OWN) as fresh:
            inside.set()
            done.wait(60)
            files.write_files(fresh, FIRST)

    run = threading.Thread(target=slow)
    run.start()
    inside.wait(10)
    with pytest.raises(OutputError, match=r"results: another run of thetacomp is writing here\. Fix: wait"):
        fill(out, SECOND)
    other = "import sys, pathlib; from thetacomp.outputs import output_folder\n"
    other += "with output_folder(pathlib.Path(sys.argv[1])): pass"
    told = subprocess.run([sys.executable, "-c", other, str(out)], capture_output=True, text=True, check=False)
    assert "another run of thetacomp is writing here" in told.stderr
    done.set()
    run.join()
    assert contents(out) == FIRST
    fill(out, SECOND)
    assert contents(out) == SECOND


def test_two_runs_into_one_table_are_told_apart(tmp_path: Path) -> None:
    with ExitStack() as stack:
        stack.enter_context(output_table(tmp_path / "error.csv"))
        with pytest.raises(OutputError, match="another run"):
            stack.enter_context(output_table(tmp_path / "error.csv"))
    (tmp_path / ".error.csv.0123abcd.thetacomp-new").write_text("half")  # of a run that was killed
    with output_table(tmp_path / "error.csv"):
        pass
    assert leftovers(tmp_path) == []


# --- a full disk ------------------------------------------------------------------------------------------------------


@pytest.fixture
def small_files() -> Iterator[None]:
    """Files may grow to 50,000 bytes, as on a disk that is full then."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_what_does_not_fit_is_named_with_its_file_and_nothing_changes(tmp_path: Path, small_files: None) -> None:
    out = tmp_path / "results"
    fill(out, FIRST)
    with pytest.raises(OutputError, match=r"results/figures/fit_Y\.svg: not written, .*What was there .* unchanged"):
        fill(out, {**SECOND, "figures/fit_Y.svg": "z" * 60_000})
    assert contents(out) == FIRST
    write_file(tmp_path / "error.csv", "old")
    with pytest.raises(OutputError, match=r"error\.csv: not written"):
        write_file(tmp_path / "error.csv", "z" * 60_000)
    assert (tmp_path / "error.csv").read_text() == "old"
    assert leftovers(tmp_path) == []


def test_a_full_console_is_no_traceback(tmp_path: Path) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "thetacomp", "check", str(tmp_path), "--json"],
            stdout=full, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr == "error: the results cannot be printed: No space left on device.\n"


# --- what --out may be ------------------------------------------------------------------------------------------------


@pytest.fixture
def machine(tmp_path: Path) -> Path:
    return write_files(tmp_path / "machine", valid_files())


def refused(*arguments: object) -> str:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == 1, result.output
    assert result.exception is None or isinstance(result.exception, SystemExit)
    lines = result.stderr.splitlines()
    assert len(lines) == 1, lines  # before the work begins: not even "reading" was said
    return lines[0]


def bad_folders(tmp_path: Path, machine: Path) -> Iterator[tuple[Path, str]]:
    yield machine, "is or holds the folder that is read"
    yield machine / ".." / "machine", "is or holds the folder that is read"
    yield tmp_path, "is or holds the folder that is read"
    yield machine / "campaigns", "among the campaigns"
    yield machine / "campaigns" / "new", "among the campaigns"
    yield machine / "CAMPAIGNS" / "new", "among the campaigns"
    yield machine / "machine.toml", "it is a file, expected a folder"
    yield machine / "machine.toml" / "below", "machine.toml is a file"
    yield Path("/dev/null"), "it is a device, expected a folder"
    yield Path("/"), "is or holds the folder that is read"
    link = tmp_path / "link"
    link.symlink_to(machine)
    yield link, "is or holds the folder that is read"
    yield link / "campaigns" / "new", "among the campaigns"
    loop = tmp_path / "loop"
    loop.symlink_to(loop)
    yield loop, "a link that leads back to itself"
    mine = tmp_path / "mine"
    files.write_files(mine, {"thesis.tex": "years of work"})
    yield mine, "it holds thesis.tex, but no results of thetacomp"
    yield tmp_path / ("x" * 300), "the name is too long"


def test_no_bad_folder_is_taken(tmp_path: Path, machine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = contents(machine)
    for out, words in bad_folders(tmp_path, machine):
        assert words in refused("analyze", machine, "--out", out), out
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    for out in (Path(), tmp_path / "here"):
        assert "the folder in which the command runs" in refused("iso230", machine, "--out", out)
    assert contents(machine) == before
    assert (tmp_path / "mine" / "thesis.tex").read_text() == "years of work"


def test_rights_are_asked_for_before_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(OutputError, match="no right to write in"), output_folder(tmp_path / "results"):
        pytest.fail("the work has begun")
    with pytest.raises(OutputError, match="no right to write here"), output_table(tmp_path / "error.csv"):
        pytest.fail("the work has begun")
    (tmp_path / "kept.csv").write_text("kept")
    with pytest.raises(OutputError, match="no right to write here"):
        write_file(tmp_path / "kept.csv", "new")


@pytest.fixture
def asked(tmp_path: Path) -> list[str]:
    parts = {"EXX": component("EXX", term(0.0, 2.0), term(0.0, 1.0), {"t": 20.0}, p=(0.0, 0.0, 1000.0))}
    document({"X": "+X"}, parts, {"t": (0.0, 10.0)}).save(tmp_path / "model.json")
    (tmp_path / "T.csv").write_text("t_s,t\n0,20\n60,25\n")
    (tmp_path / "P.csv").write_text("t_s,axis,position_mm\n0,X,0\n60,X,500\n")
    model, t, p = (str(tmp_path / name) for name in ("model.json", "T.csv", "P.csv"))
    return ["predict", model, "--temperatures", t, "--positions", p, "--out"]


def test_a_prediction_never_lands_on_what_it_reads(tmp_path: Path, asked: list[str]) -> None:
    before = contents(tmp_path)
    (tmp_path / "alias.csv").symlink_to("T.csv")
    os.link(tmp_path / "P.csv", tmp_path / "second-name.csv")
    for name in ("model.json", "T.csv", "P.csv", "alias.csv", "second-name.csv"):
        assert "it is read as well" in refused(*asked, tmp_path / name), name
    for name, words in (
        ("error.json", "expected a table"), ("no/such/error.csv", "there is no folder"), ("", "expected a table")
    ):  # fmt: skip
        assert words in refused(*asked, tmp_path / name)
    (tmp_path / "folder.csv").mkdir()
    assert "it is a folder" in refused(*asked, tmp_path / "folder.csv")
    assert {name: text for name, text in contents(tmp_path).items() if name in before} == before
    assert leftovers(tmp_path) == []


def test_a_prediction_keeps_the_link_and_the_rights_of_its_file(tmp_path: Path, asked: list[str]) -> None:
    (tmp_path / "real.csv").write_text("t_s,in_domain\n0,1\n")  # an older prediction
    (tmp_path / "real.csv").chmod(0o640)
    (tmp_path / "error.csv").symlink_to("real.csv")
    assert CliRunner().invoke(app, [*asked, str(tmp_path / "error.csv")]).exit_code == 0
    assert (tmp_path / "error.csv").is_symlink()
    assert (tmp_path / "real.csv").read_text().startswith("t_s,axis,position_mm,dX_um")
    assert (tmp_path / "real.csv").stat().st_mode & 0o777 == 0o640


def test_an_export_is_no_end_of_the_model_beside_it(tmp_path: Path, asked: list[str]) -> None:
    """The model lies in the folder of its analysis: exporting there keeps it; into the model's own name is refused."""
    model = tmp_path / "results" / "model.json"
    files.write_files(tmp_path / "results", {"report.html": "report", "model.json": Path(asked[1]).read_bytes()})
    before = model.read_bytes()
    assert "it is a file" in refused("export", model, "--target", "sinumerik", "--out", model)
    done = CliRunner().invoke(app, ["export", str(model), "--target", "sinumerik", "--out", str(model.parent)])
    assert done.exit_code == 0, done.output
    assert model.read_bytes() == before
    assert (tmp_path / "results" / "report.html").read_text() == "report"
    sheet = model.parent / "commissioning_sheet.html"
    assert sheet.exists()
    sheet.unlink()
    sheet.write_bytes(before)
    assert "would be replaced" in refused("export", sheet, "--target", "sinumerik", "--out", model.parent)
    assert sheet.read_bytes() == before


def test_what_comes_in_the_last_moment_stays_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out, real = tmp_path / "results", folder_exchange._swap
    fill(out, FIRST)

    def late(a: Path, b: Path) -> bool:
        (out / "late.txt").write_text("late")
        return real(a, b)

    monkeypatch.setattr(folder_exchange, "_swap", late)
    fill(out, SECOND)
    assert contents(out) == {**SECOND, "late.txt": "late"}


def test_where_a_disk_knows_no_second_names_files_are_copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_links(*arguments: object, **options: object) -> None:
        raise OSError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", no_links)
    fill(tmp_path / "results", FIRST)
    files.write_files(tmp_path / "results", MINE)
    fill(tmp_path / "results", SECOND)
    assert contents(tmp_path / "results") == {**SECOND, **MINE}

"""Real commands that are killed at any moment: what was there before is whole, or what comes after."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from machine_folders import valid_files, write_files
from small_models import component, document, term

from thetacomp.files import UNFINISHED

KILLS = 8


def contents(place: Path) -> dict[str, bytes]:
    """All files but hidden ones and what differs from run to run on purpose: the time of making."""
    found = (path for path in place.rglob("*") if path.is_file() and not path.name.startswith("."))
    return {
        path.relative_to(place).as_posix(): path.read_bytes()
        for path in found
        if not any(part.startswith(".") for part in path.relative_to(place).parts)
    }


def marks(place: Path) -> dict[str, int]:
    return {name: (place / name).stat().st_ino for name in contents(place)}


def run(*arguments: object) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "thetacomp", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def killed_again_and_again(out: Path, command: tuple[object, ...], rng: np.random.Generator) -> set[str]:
    """Kill the command at random moments of its life, most of them late, when it writes.

    A folder (or file) that is half new is seen by its files: those of one run are all new or all old.
    """
    begin = time.monotonic()
    assert run(*command).wait() in (0, 3)
    length_s = time.monotonic() - begin
    seen = set()
    place = out if out.is_dir() else out.parent
    for k in range(KILLS):
        before, old = marks(place), contents(place)
        child = run(*command)
        if k % 2:
            time.sleep(length_s * rng.uniform(0.05, 1.05))
        else:  # while it writes: something unfinished lies beside
            while child.poll() is None and not any(UNFINISHED in path.name for path in out.parent.iterdir()):
                time.sleep(0.002)
            written = [path for path in out.parent.iterdir() if UNFINISHED in path.name]
            wanted = int(rng.integers(0, max(len(before), 1)))
            while child.poll() is None and written and len(list(written[0].rglob("*"))) < wanted:
                time.sleep(0.001)
        child.send_signal(signal.SIGKILL)
        child.wait()
        after = marks(place)
        assert set(after) == set(before), "a file is missing or one too many"
        ours = {name for name in after if name != "mine.txt" and (out.is_dir() or name == out.name)}
        changed = {name for name in ours if after[name] != before[name]}
        assert changed in (set(), ours), f"half new: {sorted(changed)} of {sorted(ours)}"
        if not changed:
            assert contents(place) == old
        assert (place / "mine.txt").read_text() == "mine"
        seen.add("new" if changed else "old")
    assert run(*command).wait() in (0, 3)
    assert [path.name for path in out.parent.iterdir() if path.name.startswith(".")] == []
    return seen


@pytest.fixture(autouse=True)
def _one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "1")


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_an_analysis_that_is_killed_leaves_one_whole_folder(tmp_path: Path) -> None:
    machine = write_files(tmp_path / "machine", valid_files())
    out = tmp_path / "results"
    assert run("analyze", machine, "--out", out).wait() in (0, 3)
    (out / "mine.txt").write_text("mine")
    assert "old" in killed_again_and_again(out, ("analyze", machine, "--out", out), np.random.default_rng(1))


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_an_export_and_a_prediction_that_are_killed_leave_whole_files(tmp_path: Path) -> None:
    parts = {"EXX": component("EXX", term(0.0, 2.0), term(0.0, 1.0), {"t": 20.0}, p=(0.0, 0.0, 1000.0))}
    model = tmp_path / "input" / "model.json"
    model.parent.mkdir()
    document({"X": "+X"}, parts, {"t": (0.0, 10.0)}).save(model)
    rows = range(0, 60 * 20_000, 60)
    (model.parent / "T.csv").write_text("t_s,t\n" + "".join(f"{t},{20 + t % 600 / 60}\n" for t in rows))
    (model.parent / "P.csv").write_text("t_s,axis,position_mm\n" + "".join(f"{t},X,{t % 1000}\n" for t in rows))
    out = tmp_path / "sheet"
    assert run("export", model, "--target", "sinumerik", "--out", out).wait() == 0
    (out / "mine.txt").write_text("mine")
    command: tuple[object, ...] = ("export", model, "--target", "sinumerik", "--out", out)
    assert "old" in killed_again_and_again(out, command, np.random.default_rng(2))
    table = tmp_path / "tables" / "error.csv"
    table.parent.mkdir()
    (table.parent / "mine.txt").write_text("mine")
    command = ("predict", model, "--temperatures", model.parent / "T.csv", "--positions", model.parent / "P.csv")
    assert "old" in killed_again_and_again(table, (*command, "--out", table), np.random.default_rng(3))
    assert len(table.read_text().splitlines()) == 20_001
    assert sorted(os.listdir(table.parent)) == ["error.csv", "mine.txt"]

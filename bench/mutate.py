"""How much of a room the tests guard: seeded changes of one line each, and which of them the room's tests notice.

    python bench/mutate.py verification --count 60 --seed 1

The tracked files are copied to a temporary folder, so that the tree itself is never changed. One run of the room's
tests on the unchanged copy records which test reaches which line; each change is then put to the tests that reach its
line, the quickest first, until one fails. A survivor is either equivalent (no caller can see it) or a hole in the
tests. The share that is printed counts every survivor; what was judged equivalent, and why, stands in
bench/mutation.md.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import os
import pickle
import random
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
from collections import defaultdict
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from mutants import Mutant, changed, changes

ROOT = Path(__file__).parents[1]
SOURCE = Path("src/thetacomp")


@dataclass(frozen=True)
class Room:
    """What is changed (folders or files under src/thetacomp) and the tests that have to notice, under tests/.

    `slow` names what is left out, as pytest's -k has it: pages in a browser, commands, hundreds of random machines.
    """

    source: tuple[str, ...]
    tests: tuple[str, ...]
    slow: str = ""


ROOMS = {
    "separation": Room(("separation",), ("separation",), "intervals or test_bend or white_noise"),
    "reading": Room(
        ("reading",),
        ("reading", "standards/test_iso230_pages.py"),
        "random or spoilt_character or round_trip or damaged",
    ),
    "verification": Room(("verification",), ("verification",), "test_verify"),
    "controllers": Room(("controllers",), ("controllers",), "machine_folder"),
    "standards": Room(("standards",), ("standards",)),
    "labels": Room(
        ("screening/campaign_labels.py", "instrument.py"),
        ("screening/test_screening_labels.py",),
    ),
    "tracker": Room(("tracker",), ("tracker",)),
    "model": Room(("model",), ("model", "fitting/test_validity.py", "fitting/test_models.py")),
    "fitting": Room(("fitting",), ("fitting",)),
    "sensors": Room(("sensors",), ("sensors",)),
    "validation": Room(("validation",), ("validation",)),
}
# Loaded once, before the copies of this process run the tests.
LIBRARIES = ("numpy", "pandas", "scipy.stats", "scipy.optimize", "scipy.signal", "sklearn.linear_model",
             "pyarrow.parquet", "matplotlib.pyplot", "typer.testing", "pydantic", "openpyxl")  # fmt: skip


@dataclass(eq=False)
class Recorder:
    """pytest plugin: which test reaches which line of the room, and how long it takes.

    What a fixture of a wider scope reaches counts for every test that uses it; what the import of a module reaches
    counts for every test that reaches the module.
    """

    folder: str
    lines: dict[str, set[tuple[str, int]]] = field(default_factory=lambda: defaultdict(set))
    seconds: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    fixtures: dict[str, set[str]] = field(default_factory=dict)
    now: str = "import"
    failed: list[str] = field(default_factory=list)

    def trace(self, frame: FrameType, event: str, arg: object) -> Any:
        file = frame.f_code.co_filename
        if not file.startswith(self.folder):
            return None

        def local(frame: FrameType, event: str, arg: object) -> Any:
            self.lines[self.now].add((file, frame.f_lineno))
            return local

        return local(frame, event, arg)

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        for item in items:
            self.fixtures[item.nodeid] = {f"fixture {name}" for name in getattr(item, "fixturenames", ())}

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Any:
        before = self.now
        self.now = f"fixture {fixturedef.argname}" if fixturedef.scope != "function" else before
        sys.settrace(self.trace)
        try:
            return (yield)
        finally:
            sys.settrace(None)
            self.now = before

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> None:
        self.now = item.nodeid

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Any:
        sys.settrace(self.trace)
        try:
            return (yield)
        finally:
            sys.settrace(None)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call":
            self.seconds[report.nodeid] = report.duration
        if report.failed:
            self.failed.append(report.nodeid)

    def reached(self) -> dict[str, set[tuple[str, int]]]:
        """Lines by test."""
        return {
            test: set().union(self.lines[test], *(self.lines[name] for name in names if name in self.lines))
            for test, names in self.fixtures.items()
        }


@dataclass(eq=False)
class Chosen:
    """pytest plugin: only these tests, quick modules first and quick tests first within each."""

    seconds: dict[str, float]

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        kept = [item for item in items if item.nodeid in self.seconds]
        whole: dict[str, float] = defaultdict(float)
        for item in kept:
            whole[item.nodeid.split("::")[0]] += self.seconds[item.nodeid]
        kept.sort(key=lambda item: (whole[item.nodeid.split("::")[0]], self.seconds[item.nodeid]))
        items[:] = kept


def run_tests(root: Path, paths: list[str], plugin: object, *arguments: str) -> int:
    """pytest in this process, on the copy."""
    os.chdir(root)
    sys.path.insert(0, str(root / "src"))
    os.environ["PYTHONPATH"] = str(root / "src")
    return int(pytest.main(["-q", "-m", "not slow", "-p", "no:cacheprovider", *arguments, *paths], plugins=[plugin]))


def in_child(work: Any, seconds: float, log: Path) -> int | None:
    """Run `work()` in a copy of this process; its exit code, or None where it did not end in time."""
    child = os.fork()
    if not child:
        os.setsid()
        with log.open("wb") as file:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
        code = 99
        try:
            code = work()
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.05)
    os.killpg(child, 9)
    os.waitpid(child, 0)
    return None


def end_of(log: Path) -> str:
    return log.read_text(errors="replace")[-2000:]


def record(root: Path, room: Room, limit_s: float) -> tuple[dict[str, set[tuple[str, int]]], dict[str, float]]:
    """Reached lines and duration of every test of the room that takes at most `limit_s`."""
    store = root / "record"

    def work() -> int:
        recorder = Recorder(str(root / SOURCE))
        chosen = ("-k", f"not ({room.slow})") if room.slow else ()
        code = run_tests(root, [f"tests/{name}" for name in room.tests], recorder, *chosen)
        store.write_bytes(pickle.dumps((recorder.reached(), dict(recorder.seconds), recorder.failed)))
        return code

    code = in_child(work, 3600.0, root / "log")
    if not store.exists():
        sys.exit(f"the tests do not run:\n{end_of(root / 'log')}")
    reached, seconds, failed = pickle.loads(store.read_bytes())
    if code or failed:
        sys.exit(f"the unchanged copy fails ({code}): {failed[:5]}\n{end_of(root / 'log')}")
    return {test: lines for test, lines in reached.items() if seconds.get(test, float("inf")) <= limit_s}, seconds


def tests_of(mutant: Mutant, root: Path, source: bytes, reached: dict[str, set[tuple[str, int]]]) -> list[str]:
    """The tests that reach a changed line, or its module where the line is read at import."""
    file = str(root / mutant.file)
    holders = [
        node for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.FunctionDef) and node.body[0].lineno <= mutant.line <= (node.end_lineno or 0)
    ]  # fmt: skip
    if not holders:
        return [test for test, lines in reached.items() if any(name == file for name, _ in lines)]
    last = mutant.line + mutant.old.count(b"\n")
    statements = [
        node for holder in holders for node in ast.walk(holder)
        if isinstance(node, ast.stmt) and node is not holder and node.lineno <= mutant.line <= (node.end_lineno or 0)
    ]  # fmt: skip
    # The tracer names the line of an expression; a statement over several lines counts as a whole.
    inner = min(statements, key=lambda node: (node.end_lineno or 0) - node.lineno, default=None)
    first = mutant.line if inner is None else min(inner.lineno, mutant.line)
    if isinstance(inner, ast.If | ast.For | ast.While | ast.With | ast.Try | ast.FunctionDef):
        last = max(last, inner.body[0].lineno - 1)
    elif inner is not None:
        last = max(last, inner.end_lineno or 0)
    wanted = {(file, line) for line in range(first, last + 1)}
    return [test for test, lines in reached.items() if lines & wanted]


def survives(root: Path, mutant: Mutant, reached: dict[str, set[tuple[str, int]]], seconds: dict[str, float]) -> str:
    """ "" where a test noticed the change, else why not."""
    path = root / mutant.file
    source = path.read_bytes()
    tests = tests_of(mutant, root, source, reached)
    if not tests:
        return "no test reaches it"
    for cached in (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc"):
        cached.unlink()
    path.write_bytes(changed(source, mutant))
    chosen = {test: seconds[test] for test in tests}

    def work() -> int:
        sys.dont_write_bytecode = True
        return run_tests(root, sorted({test.split("::")[0] for test in tests}), Chosen(chosen), "-x")

    try:
        code = in_child(work, 90.0 + 6.0 * sum(chosen.values()), root / "log")
    finally:
        path.write_bytes(source)
    # 1: a test failed; 2: the changed module does not load; None: it does not come to an end.
    if code in (1, 2, None):
        return ""
    return f"{len(tests)} tests reach it" if code == 0 else f"not judged, pytest ended with {code}"


def copied(root: Path) -> None:
    """The tracked and the new files of the tree."""
    names = subprocess.run(
        ["git", "-C", str(ROOT), "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        capture_output=True, check=True, text=True,
    ).stdout.split("\0")  # fmt: skip
    for name in filter(None, names):
        if (ROOT / name).is_file():
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, root / name)


def sample(found: list[Mutant], count: int, seed: int) -> Iterator[Mutant]:
    """`count` changes, at most one a line as long as there are lines enough."""
    rng = random.Random(seed)
    by_line: dict[tuple[Path, int], list[Mutant]] = defaultdict(list)
    for mutant in found:
        by_line[mutant.file, mutant.line].append(mutant)
    places = sorted(by_line)
    for place in rng.sample(places, min(count, len(places))):
        yield rng.choice(by_line[place])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("room", choices=sorted(ROOMS))
    parser.add_argument("--count", type=int, default=50, help="number of changes (default 50)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="only files whose path holds this")
    parser.add_argument("--limit-s", type=float, default=6.0, help="leave out tests that take longer (default 6)")
    options = parser.parse_args()
    room = ROOMS[options.room]
    for name in LIBRARIES:
        with suppress(ImportError):
            importlib.import_module(name)
    with tempfile.TemporaryDirectory() as name:
        root = Path(name).resolve()
        copied(root)
        found = [
            mutant
            for mutant in changes(root, [root / SOURCE / name for name in room.source])
            if options.only in str(mutant.file)
        ]
        reached, seconds = record(root, room, options.limit_s)
        print(f"{len(found)} changes known, {len(reached)} tests, {sum(seconds.values()):.0f} s", flush=True)
        survivors, count = 0, 0
        for mutant in sample(found, options.count, options.seed):
            count += 1
            why = survives(root, mutant, reached, seconds)
            if why:
                survivors += 1
                row = (root / mutant.file).read_text(encoding="utf-8").splitlines()[mutant.line - 1].strip()
                print(f"{mutant.text()}   [{why}]\n        {row}", flush=True)
    print(f"{options.room}, seed {options.seed}: {count - survivors} of {count} noticed ({1 - survivors / count:.0%})")


if __name__ == "__main__":
    main()

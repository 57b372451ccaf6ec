"""Every machine of the ruler: how its folder is made, and how many of its campaigns make a row."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import thetacomp
from carry import lumped, store, twins
from carry.draws import drawn_lumped, drawn_twin
from carry.lumped_machines import LUMPED
from carry.twins import TWINS
from thetacomp.preparation import Prepared, prepare
from thetacomp.reading import read_folder

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
EXAMPLES = ROOT / "src" / "thetacomp" / "examples"
SPINDLE = ROOT / "examples" / "spindle"
HALL = ROOT / "tests" / "builders"
RECORDING = Path("caiviac_fl_thermal") / "data.xlsx"
LUMPED_SOURCES = (HERE / "network.py", HERE / "work.py", HERE / "lumped.py", HERE / "lumped_machines.py")
TWIN_SOURCES = (ROOT / "src" / "thetatwin", HERE / "twins.py")
HALL_SOURCES = (HALL / "hall_chain.py", HALL / "simulated_hall.py", HERE / "hall.py")
LUMPED_ROWS = {"lathe": (3, 6, 12, 22, 30), "borer": (2, 4, 6), "warm-ups": (2, 3, 5), "heated bed": (1, 2, 4)}
HALL_ROWS = (2, 4, 6)
TWIN_ROWS = (2, 3, 5, 9)
# No row depends on these, and prepared states not on those that fit and judge either.
ELSEWHERE = {"api.py", "analysis.py", "__main__.py", "cli", "controllers", "planning", "report", "verification"}
ABOVE = ELSEWHERE | {"fitting", "sensors", "validation", "folds.py"}


@dataclass(frozen=True)
class BenchMachine:
    """A machine: `make` writes its folder, `sources` are the files that decide what it writes, `rows` the numbers of
    campaigns to judge on (0: all). `apart` makes a row of every component: of a machine that is read at one place."""

    name: str
    make: Callable[[Path], None]
    sources: tuple[Path, ...]
    rows: tuple[int, ...]
    apart: bool = False
    draw: int = 0


def machines(data: Path, draw: int = 0) -> list[BenchMachine]:
    """All machines; `data` is the folder of shared data. A recording that is not there is left out.

    With `draw` others of the same kinds, and without the measured ones, of which there are no others.
    """
    out = [] if draw else _measured(data)
    out.append(BenchMachine("hall", _hall(max(HALL_ROWS), draw), HALL_SOURCES, HALL_ROWS))
    for name, rows in LUMPED_ROWS.items():
        make = _lumped(name, max(rows), draw)
        out.append(BenchMachine(f"lumped {name}", make, LUMPED_SOURCES, rows, apart=name == "lathe"))
    out += [BenchMachine(name, _twin(name, max(TWIN_ROWS), draw), TWIN_SOURCES, TWIN_ROWS) for name in TWINS]
    return [replace(one, draw=draw) for one in out]


def _measured(data: Path) -> list[BenchMachine]:
    out = [BenchMachine("TK6920", _copy(EXAMPLES / "tk6920"), (), (0,))]
    if (data / RECORDING).exists():
        out.append(BenchMachine("spindle", _recording(data), (), (2, 3, 4, 6), apart=True))
    return out


def _copy(source: Path) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        shutil.copytree(source, folder, ignore=shutil.ignore_patterns("*.xlsx", "*.md"))

    return make


def _recording(data: Path) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        shutil.copytree(SPINDLE, folder)
        shutil.copy(data / RECORDING, folder / "data.xlsx")

    return make


def _lumped(name: str, campaigns: int, draw: int) -> Callable[[Path], None]:
    machine = drawn_lumped(LUMPED[name], draw) if draw else LUMPED[name]
    return lambda folder: lumped.make_folder(machine, folder, campaigns)


def _twin(name: str, campaigns: int, draw: int) -> Callable[[Path], None]:
    return lambda folder: twins.make_folder(drawn_twin(TWINS[name], draw), folder, campaigns)


def _hall(campaigns: int, draw: int) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        from carry.hall import make_folder  # needs the builders of the tests

        make_folder(folder, campaigns, draw)

    return make


def folder_of(machine: BenchMachine, cache: Path) -> Path:
    """The machine's folder, made where the cache does not hold it."""
    words = [str(count) for count in machine.rows] + ([f"draw {machine.draw}"] if machine.draw else [])
    name = f"{machine.name} {store.digest(machine.sources, *words)}".replace(" ", "-")
    folder = cache / "machines" / name
    if not folder.exists():
        part = cache / "part" / f"{name}-{os.getpid()}"
        part.parent.mkdir(parents=True, exist_ok=True)
        machine.make(part)
        folder.parent.mkdir(parents=True, exist_ok=True)
        part.rename(folder)
    return folder


def prepared_of(machine: BenchMachine, campaigns: int, cache: Path) -> Prepared:
    """The first campaigns of a machine as the program under test prepares them, taken from the cache where it did."""
    folder = folder_of(machine, cache)
    path = cache / "prepared" / f"{folder.name}-{campaigns}-{store.digest(_program(ABOVE))}.npz"
    if path.exists():
        return store.load(path)  # type: ignore[no-any-return]
    read = read_folder(folder)
    names = [campaign.name for campaign in read.campaigns]
    made = prepare(read, names[:campaigns] if campaigns else (), mix=True)
    store.save(path, made)
    return made


def rows_path(machine: BenchMachine, campaigns: int, cache: Path, kind: str) -> Path:
    """Where the cache keeps what this program and this ruler have measured."""
    judged = store.digest([*_program(ELSEWHERE), HERE / "measure.py", HERE / "baselines.py"], kind)
    return cache / "rows" / f"{folder_of(machine, cache).name}-{campaigns}-{judged}.npz"


def _program(without: set[str]) -> list[Path]:
    """Files and folders of the program under test."""
    return [path for path in sorted(Path(thetacomp.__file__).parent.iterdir()) if path.name not in without]

"""Every machine of the ruler: how its folder is made, and how many of its campaigns make a row."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from carry import lumped, store
from carry.lumped_machines import LUMPED
from thetacomp.preparation import Prepared, prepare
from thetacomp.reading import read_folder

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
EXAMPLES = ROOT / "src" / "thetacomp" / "examples"
SPINDLE = ROOT / "examples" / "spindle"
RECORDING = Path("caiviac_fl_thermal") / "data.xlsx"
MACHINE_SOURCES = (HERE / "network.py", HERE / "work.py", HERE / "lumped.py", HERE / "lumped_machines.py")
TWIN_SOURCES = (ROOT / "src" / "thetatwin", HERE / "twins.py")
# What stands above the prepared states: a change there leaves them as they are.
ABOVE = ("api.py", "analysis.py", "cli", "controllers", "fitting", "planning", "report", "sensors", "validation",
         "verification", "folds.py", "outputs.py", "files.py", "table_file.py", "__main__.py")  # fmt: skip


@dataclass(frozen=True)
class BenchMachine:
    """A machine: `make` writes its folder, `sources` are the files that decide what it writes, `rows` the numbers of
    campaigns to judge on (0: all)."""

    name: str
    make: Callable[[Path], None]
    sources: tuple[Path, ...]
    rows: tuple[int, ...]


def machines(data: Path) -> list[BenchMachine]:
    """All machines; `data` is the folder of shared data. What is not there is left out."""
    out = [BenchMachine("TK6920", _copy(EXAMPLES / "tk6920"), (), (0,))]
    if (data / RECORDING).exists():
        out.append(BenchMachine("spindle", _recording(data), (), (2, 3, 4, 6)))
    counts = {"lathe": (3, 6, 12, 22, 36), "borer": (2, 4, 6), "warm-ups": (2, 3, 5), "heated bed": (1, 2, 4)}
    out += [
        BenchMachine(f"lumped {name}", _lumped(name, max(rows)), MACHINE_SOURCES, rows) for name, rows in counts.items()
    ]
    return out + _twins()


def _twins() -> list[BenchMachine]:
    from carry.twins import TWINS

    rows = (2, 3, 5, 9)
    return [BenchMachine(name, _twin(name, max(rows)), TWIN_SOURCES, rows) for name in TWINS]


def _copy(source: Path) -> Callable[[Path], None]:
    return lambda folder: shutil.copytree(source, folder, ignore=shutil.ignore_patterns("*.xlsx", "*.md", "*.py"))  # type: ignore[return-value]


def _recording(data: Path) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        shutil.copytree(SPINDLE, folder)
        shutil.copy(data / RECORDING, folder / "data.xlsx")

    return make


def _lumped(name: str, campaigns: int) -> Callable[[Path], None]:
    return lambda folder: lumped.make_folder(LUMPED[name], folder, campaigns)


def _twin(name: str, campaigns: int) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        from carry.twins import TWINS, make_folder

        make_folder(TWINS[name], folder, campaigns)

    return make


def folder_of(machine: BenchMachine, cache: Path) -> Path:
    """The machine's folder, made where the cache does not hold it."""
    name = f"{machine.name} {store.digest(machine.sources, *map(str, machine.rows))}".replace(" ", "-")
    folder = cache / "machines" / name
    if not folder.exists():
        part = cache / "part" / name
        shutil.rmtree(part, ignore_errors=True)
        part.parent.mkdir(parents=True, exist_ok=True)
        machine.make(part)
        folder.parent.mkdir(parents=True, exist_ok=True)
        part.rename(folder)
    return folder


def prepared_of(machine: BenchMachine, campaigns: int, cache: Path) -> Prepared:
    """The first campaigns of a machine as the program under test prepares them, taken from the cache where it did."""
    folder = folder_of(machine, cache)
    path = cache / "prepared" / f"{folder.name}-{campaigns}-{_below()}.npz"
    if path.exists():
        return store.load(path)  # type: ignore[no-any-return]
    read = read_folder(folder)
    names = [campaign.name for campaign in read.campaigns]
    made = prepare(read, names[:campaigns] if campaigns else (), mix=True)
    store.save(path, made)
    return made


def _below() -> str:
    """Digest of everything that prepared states depend on."""
    package = ROOT / "src" / "thetacomp"
    return store.digest([path for path in sorted(package.iterdir()) if path.name not in ABOVE])

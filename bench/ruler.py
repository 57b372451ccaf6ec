"""The ruler: does a changed version of the program still give the same numbers?

    python bench/ruler.py store bench/ruler/stored.tar.xz      # once, with the version that is right
    python bench/ruler.py compare bench/ruler/stored.tar.xz    # with any later version

The version under test is the one that `import thetacomp` finds: PYTHONPATH=TREE/src. `store` runs all commands on the
bundled example, on two virtual machines and on the spindle recording, and keeps numbers, inputs and models. `compare`
runs them again on the stored inputs, predicts from the new and from the stored models, and exits with 1 where
something differs that ruler/intended.toml does not list.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
from pathlib import Path

from ruler import difference, machines, store
from ruler.measure import MACHINES, MEASURES, Bench
from ruler.program import whereabouts
from ruler.tables import from_folder

HERE = Path(__file__).parent
INTENDED = HERE / "ruler" / "intended.toml"
SHARED_DATA = HERE.parents[1] / "shared" / "data"


def store_numbers(out: Path, data: Path) -> int:
    """Make the inputs, measure everything, and write the archive."""
    with tempfile.TemporaryDirectory() as name:
        bench = Bench(Path(name), data)
        for machine in machines.VIRTUAL:
            shutil.copytree(machines.make_virtual(machine, bench.work), bench.inputs / machine)
            bench.tables |= from_folder(f"twin/{machine}", bench.inputs / machine)
        for machine, folder in machines.EXAMPLES.items():
            shutil.copytree(folder, bench.inputs / machine, ignore=shutil.ignore_patterns("*.xlsx", "*.md"))
        for machine in MACHINES:
            _measure(machine, bench)
        bench.models.mkdir()
        for machine, model in bench.trained.items():
            machines.slim_copy(model, bench.models / f"{machine}.json", machines.LOST.get(machine, ""))
        _measure("stored", bench)
        if bench.failures:
            print("\n".join(bench.failures))
            return 1
        store.pack(out, bench.tables, bench.work)
    print(f"{out}: {len(bench.tables)} tables, {out.stat().st_size / 1e6:.2f} MB")
    return 0


def compare_numbers(stored: Path, data: Path, parts: list[str], every: bool, relative: float, keep: Path | None) -> int:
    """Measure again with the version under test and tell what differs; 1 where something does."""
    with tempfile.TemporaryDirectory() as name:
        bench = Bench(keep or Path(name), data)
        bench.work.mkdir(parents=True, exist_ok=True)
        expected = store.unpack(stored, bench.work)
        for part in parts:
            _measure(part, bench)
    # A model of today and the one that was stored answer alike.
    expected |= {f"stored/{title}": t for title, t in expected.items() if title.split("/")[1] == "prediction"}
    wanted = {title: table for title, table in expected.items() if title.split("/")[0] in parts}
    report = difference.compare(wanted, bench.tables, difference.read_intended(INTENDED), relative)
    print(difference.told(report, every))
    for line in bench.failures:
        print(f"FAILED: {line}")
    return 1 if bench.failures or report.failing() else 0


def _measure(part: str, bench: Bench) -> None:
    """Measure one part; what it raises is a failure of the version under test."""
    print(part, file=sys.stderr, flush=True)
    begin = sum(os.times()[:4])
    try:
        MEASURES[part](bench)
    except Exception as exc:
        bench.failures.append(f"{part}, not measured to its end: {type(exc).__name__}: {exc}")
    print(f"  {part}: {sum(os.times()[:4]) - begin:.0f} s of CPU", file=sys.stderr, flush=True)


def main() -> int:
    """Read the command line and do it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=SHARED_DATA, help=f"folder that holds {machines.RECORDING}")
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("store", help="measure and write the archive")
    one.add_argument("out", type=Path)
    two = commands.add_parser("compare", help="measure again and compare with the archive")
    two.add_argument("stored", type=Path)
    two.add_argument("--only", action="append", choices=MEASURES, help="only this part; repeat for more")
    two.add_argument("--every", action="store_true", help="a line for each column instead of each table")
    two.add_argument("--relative", type=float, default=difference.RELATIVE, help="for numbers with all digits")
    two.add_argument("--keep", type=Path, help="empty folder to work in, left as it is at the end")
    given = parser.parse_args()
    every_part = given.command == "store" or not given.only
    parts = [part for part in MEASURES if every_part or part in given.only]
    if {"spindle", "stored"} & set(parts) and not (given.data / machines.RECORDING).exists():
        parser.error(f"no {machines.RECORDING} in {given.data}: name its folder with --data, or choose parts by --only")
    print(f"version under test: {whereabouts()}", file=sys.stderr)
    if given.command == "store":
        return store_numbers(given.out, given.data)
    return compare_numbers(given.stored, given.data, parts, given.every, given.relative, given.keep)


if __name__ == "__main__":
    sys.exit(main())

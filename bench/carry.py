"""Does the default model carry over? Many machines times every model, against the simple baselines of each row.

    python bench/carry.py                          # all rows, default and baselines
    python bench/carry.py --only lathe --jobs 2    # the machines whose name holds a word
    python bench/carry.py --families               # other families too, which takes long

Made machines and prepared states are kept in a folder outside the tree (--cache), so that a changed model is judged
within minutes. The version under test is the one that `import thetacomp` finds: PYTHONPATH=TREE/src.
"""

from __future__ import annotations

import argparse
import getpass
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from carry.machines import machines, prepared_of
from carry.measure import Row, measure
from carry.page import HEAD, line

from thetacomp.errors import AnalysisError

SHARED_DATA = Path(__file__).parents[2] / "shared" / "data"
CACHE = Path(tempfile.gettempdir()) / f"thetacomp-carry-{getpass.getuser()}"


def main() -> int:
    """Read the command line, measure the rows and print them."""
    asked = _options().parse_args()
    chosen = [
        (machine.name, count)
        for machine in machines(asked.data)
        for count in machine.rows
        if asked.only in f"{machine.name} {count}"
    ]
    jobs = [(name, count, asked.data, asked.cache, asked.families) for name, count in chosen]
    print(HEAD)
    if asked.jobs == 1:
        rows = [_told(_measured(job)) for job in jobs]
    else:
        with ProcessPoolExecutor(asked.jobs, mp_context=get_context("spawn")) as pool:
            rows = [_told(row) for row in pool.map(_measured, jobs)]
    return 0 if all(rows) else 1


def _options() -> argparse.ArgumentParser:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--only", default="", help="rows whose name holds this text, such as lathe or 'twin 1 9'")
    options.add_argument("--jobs", type=int, default=1, help="processes side by side")
    options.add_argument("--families", action="store_true", help="the families of `analyze --compare` as well")
    options.add_argument("--cache", type=Path, default=CACHE, help=f"made machines are kept there ({CACHE})")
    options.add_argument("--data", type=Path, default=SHARED_DATA, help="folder of the shared data")
    return options


def _measured(job: tuple[str, int, Path, Path, bool]) -> Row | str:
    name, count, data, cache, families = job
    machine = next(one for one in machines(data) if one.name == name)
    try:
        return measure(name, prepared_of(machine, count, cache), families)
    except AnalysisError as exc:
        return f"{name}, {count} campaigns: {exc}"


def _told(row: Row | str) -> Row | None:
    if isinstance(row, str):
        print(row, file=sys.stderr, flush=True)
        return None
    print(line(row), flush=True)
    return row


if __name__ == "__main__":
    sys.exit(main())

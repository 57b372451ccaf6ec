"""Does the default model carry over? Many machines times every model, against the simple baselines of each row.

    python bench/carry.py                          # all rows, default and baselines
    python bench/carry.py --only lathe --jobs 2    # the machines whose name holds a word
    python bench/carry.py --families               # other families too, which takes long
    python bench/carry.py --draw 1                 # other machines of the same kinds, to judge what was developed here

Made machines, prepared states and measured rows are kept in a folder outside the tree (--cache), so that a changed
model is judged within minutes. The version under test is the one that `import thetacomp` finds: PYTHONPATH=TREE/src.
"""

from __future__ import annotations

import argparse
import getpass
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

from carry import store
from carry.machines import RECORDING, BenchMachine, machines, prepared_of, rows_path
from carry.measure import Row, measure
from carry.page import families_table, put_into, summary, tables

HERE = Path(__file__).parent
SHARED_DATA = HERE.parents[1] / "shared" / "data"
CACHE = Path(tempfile.gettempdir()) / f"thetacomp-carry-{getpass.getuser()}"


@dataclass(frozen=True)
class Job:
    """One machine, on its first campaigns of each number: done by one process, which makes the machine once."""

    machine: str
    campaigns: tuple[int, ...]
    draw: int
    data: Path
    cache: Path
    families: bool


def main() -> int:
    """Read the command line, measure the rows, print the tables and write the page."""
    options = _options()
    asked = options.parse_args()
    if asked.page and (asked.only or asked.families or asked.draw):
        options.error("--page holds the first draw of all machines: leave out --only, --families and --draw")
    if not (asked.data / RECORDING).exists():
        absent = f"no {RECORDING} in {asked.data}: name its folder with --data"
        if asked.page:
            options.error(absent)
        print(f"The spindle is left out: {absent}", file=sys.stderr)
    asked.cache.mkdir(parents=True, exist_ok=True, mode=0o700)
    jobs = []
    for machine in machines(asked.data, asked.draw):
        chosen = tuple(count for count in machine.rows if asked.only in f"{machine.name} {count}")
        if chosen:
            jobs.append(Job(machine.name, chosen, asked.draw, asked.data, asked.cache, asked.families))
    if not jobs:
        options.error(f"no row holds {asked.only!r} in its name; rows are named such as 'lumped lathe 12'")
    rows, failures = _all_rows(jobs, asked.jobs)
    text = tables(rows) + "\n\n" + summary(rows)
    print(text if not asked.families else text + "\n\n" + families_table(rows))
    if asked.page and not failures:
        put_into(asked.page, text)
    return 1 if failures else 0


def _options() -> argparse.ArgumentParser:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--only", default="", help="rows whose name holds this text, such as lathe or 'twin 1 9'")
    options.add_argument("--jobs", type=int, default=1, help="processes side by side")
    options.add_argument("--families", action="store_true", help="the families of `analyze --compare` as well")
    options.add_argument("--draw", type=int, default=0, help="1, 2, …: other machines of the same kinds")
    options.add_argument("--page", type=Path, help="document whose table is written anew between its two marks")
    options.add_argument(
        "--cache", type=Path, default=CACHE, help="what is made once is kept there (default %(default)s)"
    )
    options.add_argument("--data", type=Path, default=SHARED_DATA, help="folder of the shared data")
    return options


def _all_rows(jobs: Sequence[Job], processes: int) -> tuple[list[Row], int]:
    """The rows of all jobs in order, told as they come, and how many jobs failed."""
    rows: list[Row] = []
    failures = 0
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        for found in pool.map(_measured, jobs):
            for one in found:
                if isinstance(one, str):
                    failures += 1
                    print(one, file=sys.stderr, flush=True)
                    continue
                print(f"{one.name}, {one.campaigns}: {one.ratio():.2f}", file=sys.stderr, flush=True)
                rows.append(one)
    return rows, failures


def _measured(job: Job) -> list[Row | str]:
    """Rows of a job, or for each number of campaigns what stood in the way.

    What this very program has measured before is not measured again.
    """
    machine = next(one for one in machines(job.data, job.draw) if one.name == job.machine)
    out: list[Row | str] = []
    for campaigns in job.campaigns:
        out += _rows_of(machine, campaigns, job)
    return out


def _rows_of(machine: BenchMachine, campaigns: int, job: Job) -> Sequence[Row | str]:
    path = rows_path(machine, campaigns, job.cache, "families" if job.families else "")
    if path.exists():
        return store.load(path)  # type: ignore[no-any-return]
    try:
        prepared = prepared_of(machine, campaigns, job.cache)
        rows = measure(machine.name, prepared, machine.apart, job.families)
    except Exception as exc:  # whatever a version under test raises is a finding, not the end of the ruler
        return [f"{machine.name}, {campaigns} campaigns, not measured: {type(exc).__name__}: {exc}"]
    store.save(path, rows)
    return rows


if __name__ == "__main__":
    sys.exit(main())

"""Screening on machines that nobody tuned it to: false alarms on healthy ones, and planted faults found.

    python bench/bench_screening.py [--seeds 0 14] [--twins 0 6] [--faults 2] [--all] [--cache FOLDER]

Machines are drawn by `screening_machines`: lumped networks and copies of the virtual machine. A fault goes
into one campaign of a machine. It counts as found where its campaign and sensor are named, for a swap
both sensors; of two campaigns that merely differ, either may be named.
"""

from __future__ import annotations

import argparse
import pickle
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from screening_machines import KINDS, Planted, machines, planted

from thetacomp.campaign import MachineFolder
from thetacomp.screening import Finding
from thetacomp.screening.campaigns import screened

Found = list[tuple[str, Finding]]


def judged(folder: MachineFolder) -> tuple[Found, int]:
    """What was changed, and how much was only told."""
    findings = screened(folder, [c.name for c in folder.campaigns]).findings
    changed = [(name, f) for name, f in findings if f.repair != "none"]
    return changed, len(findings) - len(changed)


def is_named(found: Found, known: Planted, campaigns: int) -> bool:
    """Whether the planted fault was found."""
    anywhere = campaigns == 2 and known.kind in ("swap", "offset")
    wanted = {known.sensor, known.partner} - {""}
    return any(
        (anywhere or name == known.campaign) and wanted <= {f.sensor, f.partner} for name, f in found
    )  # fmt: skip


def is_another_blamed(found: Found, known: Planted, before: Found) -> bool:
    """Whether a sensor was changed that nothing was planted in, and that was left alone before."""
    wanted = {known.sensor, known.partner}
    usual = {(name, f.sensor) for name, f in before}
    return any(not wanted & {f.sensor, f.partner} and (name, f.sensor) not in usual for name, f in found)


def drawn(asked: argparse.Namespace) -> list[MachineFolder]:
    """All machines of the run; those in the cache are not built again."""
    made: list[MachineFolder] = []
    for kind, (first, end) in (("lumped", asked.seeds), ("twin", asked.twins)):
        cached = asked.cache / f"{kind}_{first}_{end}.pkl" if asked.cache else None
        if cached is not None and cached.exists():
            made += pickle.loads(cached.read_bytes())
        elif end > first:
            new = machines(kind, range(first, end))
            made += new
            if cached is not None:
                cached.write_bytes(pickle.dumps(new))
    return made


def score(made: Sequence[MachineFolder], faults: int, every: bool) -> None:
    """Print false alarms and what was found of `faults` planted faults of each kind and machine."""
    begin_s = time.process_time()
    healthy = [judged(folder) for folder in made]
    print(
        f"{len(made)} healthy machines, {sum(len(m.campaigns) for m in made)} campaigns:"
        f" {sum(bool(changed) for changed, _ in healthy)} machines changed,"
        f" {sum(told for _, told in healthy)} steps told, {time.process_time() - begin_s:.1f} s"
    )
    for folder, (changed, _) in zip(made, healthy, strict=True):
        for name, f in changed:
            print(f"  {folder.machine.name}, {name}: {f}")
    count, right, wrong = Counter[str](), Counter[str](), Counter[str]()
    for n, folder in enumerate(made):
        for number in range(faults):
            for k, kind in enumerate(KINDS):
                spoilt, known = planted(folder, kind, np.random.default_rng([n, k, number]))
                found, _ = judged(spoilt)
                count[kind] += 1
                right[kind] += (seen := is_named(found, known, len(folder.campaigns)))
                wrong[kind] += (other := is_another_blamed(found, known, healthy[n][0]))
                if every and (other or not seen):
                    print(f"  {folder.machine.name}: {known}, {[(name, str(f)) for name, f in found]}")
    for kind in (*KINDS, "all"):
        some = [kind] if kind != "all" else list(KINDS)
        of, good, bad = (sum(counter[k] for k in some) for counter in (count, right, wrong))
        if of:
            print(
                f"{kind:8s} {of:4d} planted, {100 * good / of:5.1f} % found, another blamed in {100 * bad / of:4.1f} %"
            )


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--seeds", type=int, nargs=2, default=(0, 14), metavar=("FIRST", "END"))
    options.add_argument("--twins", type=int, nargs=2, default=(0, 6), metavar=("FIRST", "END"))
    options.add_argument("--faults", type=int, default=1, help="of each kind, in each machine")
    options.add_argument("--all", action="store_true", help="print every fault that was missed or misjudged")
    options.add_argument("--cache", type=Path, help="folder that keeps the machines")
    asked = options.parse_args()
    score(drawn(asked), asked.faults, asked.all)


if __name__ == "__main__":
    main()

"""Exact choice of 4 of 60 correlated sensors for 18 targets: ours beside NumPy, R leaps, abess and scikit-learn.

Time is the median of several runs after a warm-up, of the search alone: programs that start from rows get them in
memory, ours gets campaign summaries (the time to build these is a line of its own). Quality stands beside it: how many
targets got the best subset, the largest residual sum against the best, and the error with each campaign left out.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import TypeVar

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.moments import Summary, held_out_squares, least_squares, merge, residual_squares, summarise
from thetacomp.sensors.subset import best_subset, best_subset_per_target

ROWS, SENSORS, TARGETS, CAMPAIGNS, CHOSEN, RUNS = 2000, 60, 18, 10, 4, 5
T = TypeVar("T")


@dataclass(frozen=True)
class Line:
    """One row of the table; `subsets` holds the chosen columns of each target in `targets`."""

    program: str
    time_s: float
    subsets: Sequence[Sequence[int]]
    targets: Sequence[int]
    note: str = ""


def make_rows(sensors: int, seed: int = 1) -> tuple[Floats, Floats]:
    """Ten warm-ups: every sensor follows a common rise and five local sources, every target some of the sensors."""
    rng = np.random.default_rng(seed)
    common, local = np.abs(rng.normal(1.0, 0.35, sensors)), 0.43 * rng.normal(size=(5, sensors))
    effect = rng.normal(size=(sensors, TARGETS)) * (rng.random((sensors, TARGETS)) < 0.25)
    inputs, targets = [], []
    for _ in range(CAMPAIGNS):
        n = ROWS // CAMPAIGNS
        rise = 10.0 * (1.0 - np.exp(-np.arange(n) / 60.0)) * rng.uniform(0.6, 1.4)
        sources = 0.1 * np.cumsum(rng.normal(size=(n, 5)), axis=0)
        x = 20.0 + np.outer(rise, common) + sources @ local + 0.4 * rng.normal(size=(n, sensors))
        inputs.append(x)
        targets.append((x - 20.0) @ effect * 2.0 + 2.0 * rng.normal(size=(n, TARGETS)) + rng.normal(size=TARGETS))
    return np.concatenate(inputs), np.concatenate(targets)


def summaries(x: Floats, y: Floats) -> list[Summary]:
    parts = zip(np.split(x, CAMPAIGNS), np.split(y, CAMPAIGNS), strict=True)
    sensors, targets = [str(i) for i in range(x.shape[1])], [str(i) for i in range(y.shape[1])]
    return [summarise(a, b, sensors, targets, str(i)) for i, (a, b) in enumerate(parts)]


def timed(work: Callable[[], T], runs: int = RUNS, warm: bool = True) -> tuple[float, T]:
    """Median time of `runs` runs, after one that does not count, and the last result."""
    if warm:
        work()
    times = []
    for _ in range(runs):
        began_s = time.perf_counter()
        result = work()
        times.append(time.perf_counter() - began_s)
    return statistics.median(times), result


def numpy_enumeration(x: Floats, y: Floats) -> list[tuple[int, ...]]:
    """Every subset of four: each pair is swept out, the closed 2 x 2 form does all pairs beyond it at once."""
    x, y = x - x.mean(axis=0), y - y.mean(axis=0)
    x, y = x / np.linalg.norm(x, axis=0), y / np.linalg.norm(y, axis=0)
    gram, mixed = x.T @ x, x.T @ y
    best, chosen = np.full(y.shape[1], -1.0), np.zeros((y.shape[1], 4), dtype=int)
    for a, b in combinations(range(x.shape[1]), 2):
        pair, rest = [a, b], np.arange(b + 1, x.shape[1])
        if len(rest) < 2:
            continue
        inverse = np.linalg.inv(gram[np.ix_(pair, pair)])
        lead = gram[np.ix_(rest, pair)] @ inverse
        A, B = gram[np.ix_(rest, rest)] - lead @ gram[np.ix_(pair, rest)], mixed[rest] - lead @ mixed[pair]
        base = np.sum(mixed[pair] * (inverse @ mixed[pair]), axis=0)
        c, d = np.triu_indices(len(rest), 1)
        own = np.diag(A)
        det = own[c] * own[d] - A[c, d] ** 2
        squares = B**2
        gain = squares[c] * own[d][:, None] - 2.0 * B[c] * B[d] * A[c, d][:, None] + squares[d] * own[c][:, None]
        gain = np.where(det[:, None] > 1e-12, gain / det[:, None], -1.0) + base
        top = gain.argmax(axis=0)
        for t in np.flatnonzero(gain[top, np.arange(len(top))] > best):
            best[t], chosen[t] = gain[top[t], t], (a, b, rest[c[top[t]]], rest[d[top[t]]])
    return [tuple(row) for row in chosen.tolist()]


LEAPS = """
library(leaps)
x <- as.matrix(read.csv("x.csv", header = FALSE)); y <- as.matrix(read.csv("y.csv", header = FALSE))
for (run in 1:3) {
  began <- proc.time()[["elapsed"]]
  fits <- lapply(1:ncol(y), function(t) regsubsets(x, y[, t], nvmax = 4, method = "exhaustive", really.big = TRUE))
  cat("time", proc.time()[["elapsed"]] - began, "\n")
}
for (fit in fits) cat("subset", which(summary(fit)$which[4, -1]) - 1, "\n")
"""


def leaps(x: Floats, y: Floats) -> Line:
    """R's branch and bound, called on CSV files; R itself takes the time of the search."""
    if shutil.which("Rscript") is None:
        return Line("R leaps", np.nan, [], [], "not run: Rscript not found (Debian: r-cran-leaps)")
    with tempfile.TemporaryDirectory() as folder:
        np.savetxt(Path(folder, "x.csv"), x, delimiter=",", fmt="%.17g")
        np.savetxt(Path(folder, "y.csv"), y, delimiter=",", fmt="%.17g")
        done = subprocess.run(["Rscript", "-e", LEAPS], cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        return Line("R leaps", np.nan, [], [], f"not run: {done.stderr.strip().splitlines()[-1]}")
    lines = [line.split() for line in done.stdout.splitlines()]
    subsets = [[int(i) for i in line[1:]] for line in lines if line[:1] == ["subset"]]
    time_s = statistics.median(float(line[1]) for line in lines if line[:1] == ["time"])
    return Line("R leaps, each target", time_s, subsets, range(TARGETS), "exhaustive, also sizes 1 to 3")


def abess(x: Floats, y: Floats) -> Line:
    if importlib.util.find_spec("abess") is None:
        return Line("abess", np.nan, [], [], "not run: package abess is not installed")
    from abess.linear import LinearRegression

    def one(t: int) -> list[int]:
        return np.flatnonzero(LinearRegression(support_size=CHOSEN).fit(x, y[:, t]).coef_).tolist()

    time_s, subsets = timed(lambda: [one(t) for t in range(TARGETS)])
    return Line("abess, each target", time_s, subsets, range(TARGETS), "not exact")


def sequential(x: Floats, y: Floats) -> Line:
    from sklearn.feature_selection import SequentialFeatureSelector
    from sklearn.linear_model import LinearRegression

    def one(t: int) -> list[int]:
        selector = SequentialFeatureSelector(LinearRegression(), n_features_to_select=CHOSEN)
        return np.flatnonzero(selector.fit(x, y[:, t]).get_support()).tolist()

    time_s, subsets = timed(lambda: [one(t) for t in range(3)], runs=1, warm=False)
    return Line("sklearn sequential, 3 targets", time_s, subsets, range(3), "not exact; one run")


def ours(campaigns: Sequence[Summary]) -> list[Line]:
    lines = []
    for score in ("residual", "held_out", "worst_campaign"):
        time_s, results = timed(lambda score=score: best_subset_per_target(campaigns, CHOSEN, score=score))
        subsets = [[int(s) for s in r.sensors] for r in results]
        note = "all proven" if all(r.proven for r in results) else "NOT ALL PROVEN"
        lines.append(Line(f"thetacomp {score}, each target", time_s, subsets, range(TARGETS), note))
        time_s, joint = timed(lambda score=score: best_subset(campaigns, CHOSEN, score=score))
        subsets = [[int(s) for s in joint.sensors]] * TARGETS
        note = f"{'proven' if joint.proven else 'NOT PROVEN'}, {joint.evaluated:,} of {joint.subsets:,} compared"
        lines.append(Line(f"thetacomp {score}, joint", time_s, subsets, range(TARGETS), note))
    return lines


def quality(campaigns: Sequence[Summary], subset: Sequence[int], target: int) -> tuple[float, float]:
    """Residual sum and held-out RMS, both in standard deviations of the target."""
    chosen = [c.select([str(i) for i in subset], [str(target)]) for c in campaigns]
    total = merge(chosen)
    squares = total.target_squares[0]
    residual = residual_squares(total, least_squares(total))[0] / squares
    return float(residual), float(np.sqrt(held_out_squares(chosen).sum() / squares))


def print_table(campaigns: Sequence[Summary], lines: Sequence[Line], best: Sequence[Sequence[int]]) -> None:
    lowest = [quality(campaigns, subset, t)[0] for t, subset in enumerate(best)]
    print(f"{'program':42} {'time s':>9} {'best':>7} {'RSS/best':>9} {'held-out':>9}  note")
    for line in lines:
        if not line.subsets:
            print(f"{line.program:42} {'-':>9} {'-':>7} {'-':>9} {'-':>9}  {line.note}")
            continue
        found = [quality(campaigns, s, t) for s, t in zip(line.subsets, line.targets, strict=True)]
        hits = sum(sorted(s) == sorted(best[t]) for s, t in zip(line.subsets, line.targets, strict=True))
        ratio = max(f[0] / lowest[t] for f, t in zip(found, line.targets, strict=True))
        held_out = float(np.mean([f[1] for f in found]))
        share = f"{hits}/{len(found)}"
        print(f"{line.program:42} {line.time_s:9.4f} {share:>7} {ratio:9.3f} {held_out:9.4f}  {line.note}")
    print(
        "best: targets with the best subset by residual; RSS/best: largest residual sum against it; held-out: mean RMS"
        " with each campaign left out, in standard deviations (the rows that choose by it have the advantage)"
    )


def print_wide() -> None:
    """3 of 300 sensors, joint over the targets."""
    campaigns = summaries(*make_rows(300))
    print(f"\n3 of 300 sensors, {TARGETS} targets, joint")
    for score in ("residual", "held_out", "worst_campaign"):
        time_s, found = timed(lambda score=score: best_subset(campaigns, 3, score=score))
        print(f"  thetacomp {score:15} {time_s:9.4f} s  {'proven' if found.proven else 'NOT PROVEN'}")


def main() -> None:
    x, y = make_rows(SENSORS)
    correlation = np.abs(np.corrcoef(x.T)[np.triu_indices(SENSORS, 1)]).mean()
    print(
        f"{CHOSEN} of {SENSORS} sensors (mean |r| {correlation:.2f}), {ROWS} rows, {CAMPAIGNS} campaigns, "
        f"{TARGETS} targets, {os.cpu_count()} cores"
    )
    summary_s, campaigns = timed(lambda: summaries(x, y))
    lines = ours(campaigns)
    numpy_s, enumerated = timed(lambda: numpy_enumeration(x, y), runs=3)
    lines.append(Line("NumPy enumeration, each target", numpy_s, enumerated, range(TARGETS), "exact"))
    lines += [leaps(x, y), abess(x, y), sequential(x, y)]
    print_table(campaigns, lines, enumerated)
    print(f"building the summaries from the rows: {summary_s:.4f} s")
    from_leaps = next(line for line in lines if line.program.startswith("R leaps"))
    if from_leaps.subsets:
        same = [sorted(s) for s in from_leaps.subsets] == [sorted(s) for s in lines[0].subsets]
        print(f"identical to R leaps in all {TARGETS} targets: {'yes' if same else 'NO'}")
    print_wide()


if __name__ == "__main__":
    main()

"""Greedy placement of 10 sensors among 100,000 candidates: ours beside straightforward code and QR pivoting.

Run: python bench/run.py placement
The field is made of 30 smooth modes over a box of places, 60 displacement outputs: as large as a fine mesh of a whole
machine. Time is the median of five runs after a warm-up, of the choice alone. The straightforward way refits the
information matrix for every candidate in every step; it runs on fewer candidates and its time per candidate and step
is told, with what that means for all of them. QR with column pivoting (Manohar and others 2018) asks for nothing but
well separated modes; what its places leave of the tool stands beside.
"""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable

import numpy as np
from scipy.linalg import qr

from thetatwin.placement import Field, Spacing, greedy, tool_covariance_um2

CANDIDATES, MODES, OUTPUTS, SENSORS, NOISE_K, RUNS = 100_000, 30, 60, 10, 0.09, 5
FEW = 2_000
LIMIT_S = 5.0


def make_field(seed: int = 1) -> tuple[Field, np.ndarray]:
    """Smooth random modes over a box of 6 x 5 x 2 m; the k-th is weaker than the first by k to the power of 1.5."""
    rng = np.random.default_rng(seed)
    places_m = rng.uniform(size=(CANDIDATES, 3)) * np.array([6.0, 5.0, 2.0])
    waves = rng.normal(size=(3, MODES)) * 0.6 * np.sqrt(np.arange(1, MODES + 1) / 10)
    strength = 6.0 / np.arange(1, MODES + 1) ** 1.5
    rows = np.cos(places_m @ waves + rng.uniform(0, 2 * np.pi, MODES)) * strength
    # Weak modes may move the tool as much as strong ones: a column bends from a small gradient.
    outputs = rng.normal(size=(OUTPUTS, MODES)) * 40.0 * rng.permutation(strength) / strength[0]
    return Field(rows, outputs), places_m


def straightforward(field: Field, count: int, goal: str) -> list[int]:
    """The definition: for every candidate in every step the information matrix is formed and inverted or its
    determinant taken."""
    information, chosen = np.eye(field.rows_K.shape[1]), []
    for _ in range(count):
        score = np.full(len(field.rows_K), -np.inf)
        for i, row in enumerate(field.rows_K):
            if i in chosen:
                continue
            trial = information + np.outer(row, row) / NOISE_K**2
            if goal == "information":
                score[i] = np.linalg.slogdet(trial)[1]
            else:
                score[i] = -np.trace(field.outputs_um @ np.linalg.solve(trial, field.outputs_um.T))
        best = int(np.argmax(score))
        chosen.append(best)
        information += np.outer(field.rows_K[best], field.rows_K[best]) / NOISE_K**2
    return chosen


def timed(work: Callable[[], object]) -> float:
    """Median time of five runs in s, after one that does not count."""
    work()
    times = []
    for _ in range(RUNS):
        begun = time.perf_counter()
        work()
        times.append(time.perf_counter() - begun)
    return statistics.median(times)


def left_um(field: Field, chosen: np.ndarray) -> float:
    """RMS of the displacement that readings at these places leave."""
    return float(np.sqrt(np.diag(tool_covariance_um2(field, NOISE_K, chosen)).mean()))


def main() -> None:
    field, places_m = make_field()
    few = Field(field.rows_K[:FEW], field.outputs_um)
    spacing = Spacing(places_m * 1e3, 200.0)
    print(f"\n{SENSORS} of {CANDIDATES:,} candidates, {MODES} modes, {OUTPUTS} outputs, {os.cpu_count()} cores")
    print(f"  {'way':<52} {'time s':>9} {'left µm':>8}")
    for goal in ("displacement", "information"):
        for name, apart in (("", None), (", 200 mm apart", spacing)):
            chosen = greedy(field, NOISE_K, SENSORS, goal, apart)
            taken_s = timed(lambda goal=goal, apart=apart: greedy(field, NOISE_K, SENSORS, goal, apart))
            verdict = "" if taken_s < LIMIT_S else f"   ABOVE {LIMIT_S:g} s"
            print(f"  {'thetacomp, ' + goal + name:<52} {taken_s:>9.3f} {left_um(field, chosen):>8.2f}{verdict}")
    pivots = qr(field.rows_K.T, mode="r", pivoting=True)[1][:SENSORS]
    taken_s = timed(lambda: qr(field.rows_K.T, mode="r", pivoting=True))
    print(f"  {'QR with column pivoting (SciPy)':<52} {taken_s:>9.3f} {left_um(field, pivots):>8.2f}")
    for goal in ("displacement", "information"):
        begun = time.perf_counter()
        plain = straightforward(few, SENSORS, goal)
        plain_s = time.perf_counter() - begun
        ours_s = timed(lambda goal=goal: greedy(few, NOISE_K, SENSORS, goal))
        same = "the same places" if plain == greedy(few, NOISE_K, SENSORS, goal).tolist() else "OTHER PLACES"
        print(
            f"  straightforward, {goal}, {FEW:,} candidates: {plain_s:.2f} s (ours {ours_s:.4f} s, {same});"
            f" scaled to all candidates {plain_s * CANDIDATES / FEW:.0f} s"
        )


if __name__ == "__main__":
    main()

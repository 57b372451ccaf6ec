"""Column deviation of twenty virtual machines before and after compensation, as the paper verifies it.

Run: python bench/run.py twenty_seeds, or python bench/bench_twenty_seeds.py [PRESET] [SEEDS] [CALIBRATIONS] [POINTS]
[READINGS]. Training and verification differ in duty, day and ambient; the default, the paper's one sensor and the
clock stand side by side, measured by the tracker (its noise included) and against the truth.
"""

from __future__ import annotations

import sys
import time

from thetacomp.trial.loop import MeasuringPlan, tenth_percentiles, verify_machine
from thetacomp.twin.conditions import load_conditions
from thetacomp.twin.description import load_description
from thetacomp.twin.virtual import build

LIMIT_PERCENT = 85.0


def main(preset: str = "standard", seeds: int = 20, calibrations: int = 8, points: int = 9, readings: int = 4) -> None:
    conditions = load_conditions(preset)
    machine = build(load_description(conditions.machine))
    plan = MeasuringPlan(calibrations, points, readings)
    print(f"\nColumn deviation, preset {preset}, {seeds} machines, {plan}")
    print(f"{'seed':>4} {'':2} {'method':11}{'measured (µm)':>18}{'%':>6}{'true (µm)':>18}{'%':>6}")
    rows, begin = [], time.perf_counter()
    for seed in range(1, seeds + 1):
        for row in verify_machine(machine, conditions, plan, seed):
            rows.append(row)
            measured = f"{row.measured_before_um:.0f} -> {row.measured_after_um:.0f}"
            true = f"{row.true_before_um:.0f} -> {row.true_after_um:.0f}"
            figures = f"{measured:>18}{row.measured_percent:6.0f}{true:>18}{row.true_percent:6.0f}"
            print(f"{seed:4} {row.direction:2} {row.method:11}{figures}", flush=True)
    print(f"10th percentile of the reduction over {seeds} machines, required {LIMIT_PERCENT:g} % (default, standard)")
    for method, direction, measured_percent, true_percent in tenth_percentiles(rows):
        print(f"  {method:11} {direction}: measured {measured_percent:5.1f} %, true {true_percent:5.1f} %")
    print(f"{time.perf_counter() - begin:.0f} s on one core")


if __name__ == "__main__":
    main(*sys.argv[1:2], *(int(text) for text in sys.argv[2:]))

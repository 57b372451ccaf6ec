"""Column deviation of twenty virtual machines before and after compensation, as the paper verifies it.

Training and verification differ in duty, day and ambient; the default, the paper's one sensor and the clock stand side
by side, measured by the tracker (its noise included) and against the truth, for the paper's fifteen places of sensors
and for fifteen that `thetacomp place` chooses, on the standard and on the hard preset.

Run: python bench/run.py twenty_seeds for everything, which takes long; for a part
python bench/bench_twenty_seeds.py --presets standard --sensors chosen --seeds 1-5 --calibrations 12 --cold-rounds 4
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path

from thetacomp.files import write_files
from thetatwin.conditions import PRESETS, Conditions, load_conditions
from thetatwin.description import load_description
from thetatwin.mounting import load_mounting
from thetatwin.placement_page import PLACES, placement_files
from thetatwin.sensor_places import place_sensors
from thetatwin.sensor_sets import read_places, with_sensors
from thetatwin.trial.many_machines import Deviation, VerificationPlan, summaries, verify_machine
from thetatwin.virtual_machine import VirtualMachine, build

LIMIT_PERCENT = 85.0
# A careful plan: the tracker stands beside the machine, so that the small deviation, X, lies along its beam.
PLAN = VerificationPlan(
    calibrations=16, points=9, readings=4, station_mm=(-3000.0, 2500.0, -2500.0), cold_rounds=4, lead_h=20.0
)
OWN, CHOSEN = "own", "chosen"
STRATEGY = "displacement"
PLACEMENT_SEED = 1  # of the work that the places are chosen by; it is no machine's

_machine: VirtualMachine | None = None  # inherited by the processes: it holds solvers that cannot be sent


def main(arguments: Sequence[str] = ()) -> None:
    asked = _options().parse_args(arguments)
    plan = VerificationPlan(
        calibrations=asked.calibrations,
        points=asked.points,
        readings=asked.readings,
        station_mm=tuple(asked.station_mm) if asked.station_mm else None,
        cold_rounds=asked.cold_rounds,
        lead_h=asked.lead_h,
        screening=not asked.no_screening,
    )
    print(f"\nColumn deviation; {', '.join(f'{name} {value}' for name, value in asdict(plan).items())}")
    print(f"Required: 10th percentile of the reduction at least {LIMIT_PERCENT:g} % (default, standard)")
    for preset in asked.presets:
        conditions = load_conditions(preset)
        for sensors in asked.sensors:
            begun = time.perf_counter()
            rows = _verified(_built(conditions, sensors, asked.places), conditions, plan, asked)
            taken_s = (time.perf_counter() - begun) / len(asked.seeds)
            print(f"\nPreset {preset}, sensors {sensors}, {len(asked.seeds)} machines, {taken_s:.0f} s each")
            _print_summary(rows)


def _options() -> argparse.ArgumentParser:
    plan, options = PLAN, argparse.ArgumentParser(description=__doc__.split("\n")[0])
    options.add_argument("--presets", nargs="+", default=list(PRESETS))
    options.add_argument("--sensors", nargs="+", choices=(OWN, CHOSEN), default=[OWN, CHOSEN])
    options.add_argument("--places", type=Path, help="places.csv of `thetacomp place`; by default they are chosen here")
    options.add_argument("--seeds", type=_seeds, default=_seeds("1-20"), help="as 1-20 or 1,4,7")
    options.add_argument("--calibrations", type=int, default=plan.calibrations)
    options.add_argument("--points", type=int, default=plan.points)
    options.add_argument("--readings", type=int, default=plan.readings)
    options.add_argument("--station-mm", type=float, nargs=3, default=plan.station_mm)
    options.add_argument("--cold-rounds", type=int, default=plan.cold_rounds)
    options.add_argument("--lead-h", type=float, default=plan.lead_h)
    options.add_argument("--no-screening", action="store_true", help="take the readings as they are: much faster")
    options.add_argument("--processes", type=int, default=2)
    options.add_argument("--each", action="store_true", help="print every machine")
    return options


def _seeds(text: str) -> list[int]:
    first, _, last = text.partition("-")
    return list(range(int(first), int(last) + 1)) if last else [int(seed) for seed in text.split(",")]


def _built(conditions: Conditions, sensors: str, places: Path | None) -> VirtualMachine:
    description = load_description(conditions.machine)
    if sensors == OWN:
        return build(description)
    if places is not None:
        return build(with_sensors(description, read_places(places, STRATEGY)))
    machine, mounting = build(description), load_mounting("tk6920_mounting", description)
    chosen = place_sensors(machine, conditions, mounting, len(description.sensors), PLACEMENT_SEED)
    with tempfile.TemporaryDirectory() as folder:
        write_files(Path(folder), placement_files(machine, conditions, mounting, chosen, PLACEMENT_SEED))
        return build(with_sensors(description, read_places(Path(folder) / PLACES, STRATEGY)))


def _verified(
    machine: VirtualMachine, conditions: Conditions, plan: VerificationPlan, asked: argparse.Namespace
) -> list[Deviation]:
    """All machines, in several processes; `fork` hands the machine on as it is."""
    global _machine
    _machine = machine
    jobs = [(conditions, plan, seed) for seed in asked.seeds]
    with ProcessPoolExecutor(asked.processes, mp_context=get_context("fork")) as pool:
        rows = []
        for some in pool.map(_verify, jobs):
            rows += some
            if asked.each:
                _print_machine(some)
    return rows


def _verify(job: tuple[Conditions, VerificationPlan, int]) -> list[Deviation]:
    assert _machine is not None
    return verify_machine(_machine, *job)


def _print_machine(rows: Iterable[Deviation]) -> None:
    for row in rows:
        measured = f"{row.measured_before_um:.0f} -> {row.measured_after_um:.0f}"
        true = f"{row.true_before_um:.0f} -> {row.true_after_um:.0f}"
        figures = f"{measured:>18}{row.measured_percent:6.0f}{true:>18}{row.true_percent:6.0f}"
        print(f"{row.seed:4} {row.direction:2} {row.method:11}{figures}", flush=True)


def _print_summary(rows: Sequence[Deviation]) -> None:
    print(f"{'':13}{'measured: 10 %, median':>24}{'µm':>13}{'true: 10 %, median':>22}{'µm':>13}")
    for one in summaries(rows):
        measured = f"{one.measured_percent[0]:.1f}, {one.measured_percent[1]:.1f}"
        true = f"{one.true_percent[0]:.1f}, {one.true_percent[1]:.1f}"
        moved = [f"{before:.0f} -> {after:.0f}" for before, after in (one.measured_um, one.true_um)]
        figures = f"{measured:>24}{moved[0]:>13}{true:>22}{moved[1]:>13}"
        print(f"{one.direction} {one.method:11}{figures}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])

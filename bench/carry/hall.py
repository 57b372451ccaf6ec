"""The simulated hall of the tests as a machine folder: planned by the program, measured by a tracker that sinks."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "builders"))

from hall_chain import PLAN_ARGUMENTS, draw_machine, draw_share, machine_toml, make_day, measure

SEED = 4505


def make_folder(folder: Path, campaigns: int, draw: int = 0) -> None:
    """One plan, and some days of different duty on one machine."""
    folder.mkdir(parents=True)
    (folder / "machine.toml").write_text(machine_toml(), encoding="utf-8")
    rng = np.random.default_rng([SEED, draw])
    machine = draw_machine(rng)
    with tempfile.TemporaryDirectory() as name:
        plan = Path(name) / "plan"
        command = [sys.executable, "-m", "thetacomp", "plan", str(folder), "--out", str(plan), *PLAN_ARGUMENTS]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        for number in range(campaigns):
            day = make_day(machine, plan, draw_share(rng), rng)
            measure(folder, f"day-{number + 1}", plan, machine, day, rng)

"""Times whole processes side by side: warm-up, then rounds in which every command runs once, in turn.

Two commands of one round meet the same machine in the same mood, so the ratio of a round (paired) is steadier than
the ratio of two medians taken minutes apart.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

MIB = 1024.0 * 1024.0


@dataclass(frozen=True)
class Sample:
    """One run of one process: wall-clock and CPU seconds, peak resident memory (0 where the system tells none)."""

    wall_s: float
    cpu_s: float
    peak_MiB: float


def run_once(command: Sequence[str], expected_exit: Sequence[int] = (0,)) -> Sample:
    """Run a command to its end and measure it. RuntimeError with its words where it fails."""
    with tempfile.TemporaryFile() as words:
        start_s = time.perf_counter()
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=words)
        cpu_s, peak_MiB = _wait(process)
        wall_s = time.perf_counter() - start_s
        if process.returncode not in expected_exit:
            words.seek(0)
            text = words.read().decode(errors="replace")
            raise RuntimeError(f"{' '.join(command)} ended with {process.returncode}:\n{text}")
    return Sample(wall_s, cpu_s, peak_MiB)


def _wait(process: subprocess.Popen[bytes]) -> tuple[float, float]:
    """Wait for the end; CPU seconds and peak MiB of this one process, zeros on a system without wait4."""
    if not hasattr(os, "wait4"):
        process.wait()
        return 0.0, 0.0
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    bytes_per_unit = 1 if sys.platform == "darwin" else 1024
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss * bytes_per_unit / MIB


def side_by_side(
    title: str, commands: Mapping[str, Sequence[str]], *, rounds: int, expected_exit: Sequence[int] = (0,)
) -> None:
    """Run every command `rounds` times in turn after one warm-up and print a table.

    The last column is the ratio of wall-clock times to the first command, median and range over the rounds.
    """
    for command in commands.values():
        run_once(command, expected_exit)
    samples: dict[str, list[Sample]] = {name: [] for name in commands}
    for _ in range(rounds):
        for name, command in commands.items():
            samples[name].append(run_once(command, expected_exit))
    yardstick = next(iter(samples.values()))

    width = max(map(len, commands))
    print(f"\n{title}  ({rounds} rounds after a warm-up, whole processes)")
    print(f"  {'':{width}}  {'wall s: min':>11} {'median':>7} {'max':>7} {'cpu s':>7} {'peak MiB':>9}   ratio (range)")
    for name, runs in samples.items():
        wall = sorted(run.wall_s for run in runs)
        ratios = [run.wall_s / base.wall_s for run, base in zip(runs, yardstick, strict=True)]
        ratio = f"{statistics.median(ratios):5.2f} ({min(ratios):.2f} to {max(ratios):.2f})"
        cpu_s, peak_MiB = statistics.median(run.cpu_s for run in runs), max(run.peak_MiB for run in runs)
        print(
            f"  {name:{width}}  {wall[0]:11.2f} {statistics.median(wall):7.2f} {wall[-1]:7.2f}"
            f" {cpu_s:7.2f} {peak_MiB:9.0f}   {ratio}"
        )

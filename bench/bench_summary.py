"""One-pass summary of a large Parquet telemetry file beside DuckDB's plain aggregate over the same columns.

DuckDB: count(*), avg and stddev of every column. Ours: count, means and all cross products of the same columns. Each
program runs in a process of its own; time is the median of several runs after a first one (the file is then in the
page cache for both), memory the peak of the process. The quarter file shows whether memory grows with the length.
"""

from __future__ import annotations

import importlib.util
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

SENSORS, TARGETS, ROWS, ROWS_PER_GROUP, RUNS = 60, 18, 1_000_000, 100_000, 7
INPUT_NAMES = [f"theta_{i + 1}" for i in range(SENSORS)]
TARGET_NAMES = [f"error_{i + 1}_um" for i in range(TARGETS)]


def write_telemetry(path: Path, rows: int) -> None:
    """Sensors that wander together, in full float64 precision so that nothing compresses."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rng = np.random.default_rng(0)
    mixing = rng.normal(size=(5, SENSORS + TARGETS))
    names = INPUT_NAMES + TARGET_NAMES
    with pq.ParquetWriter(path, pa.schema([(name, pa.float64()) for name in names])) as writer:
        for _ in range(rows // ROWS_PER_GROUP):
            sources = 0.01 * np.cumsum(rng.normal(size=(ROWS_PER_GROUP, 5)), axis=0)
            values = 20.0 + sources @ mixing + 0.01 * rng.normal(size=(ROWS_PER_GROUP, SENSORS + TARGETS))
            writer.write_table(pa.table(dict(zip(names, values.T, strict=True))))


def run_ours(path: Path) -> list[float]:
    from thetacomp.moments_parquet import summarise_parquet

    (summary,) = summarise_parquet(path, INPUT_NAMES, TARGET_NAMES)
    spread = np.sqrt(np.diag(summary.cross) / (summary.count - 1))
    return [float(summary.count), *np.column_stack((summary.mean, spread)).ravel().tolist()]


def run_duckdb(path: Path, functions: tuple[str, ...] = ("avg", "stddev")) -> list[float]:
    import duckdb

    columns = ", ".join(f"{f}({name})" for name in INPUT_NAMES + TARGET_NAMES for f in functions)
    row = duckdb.execute(f"SELECT count(*), {columns} FROM read_parquet(?)", [str(path)]).fetchone()
    return [float(value) for value in row or ()]


PROGRAMS: dict[str, Callable[[Path], list[float]]] = {
    "thetacomp": run_ours,
    "duckdb": run_duckdb,
    "duckdb-avg": lambda path: run_duckdb(path, ("avg",)),
}


def child(program: str, path: str) -> None:
    """One program in this process: times, peak memory and figures as JSON on the standard output."""
    figures, times = PROGRAMS[program](Path(path)), []
    for _ in range(RUNS):
        began_s = time.perf_counter()
        figures = PROGRAMS[program](Path(path))
        times.append(time.perf_counter() - began_s)
    print(json.dumps({"time_s": statistics.median(times), "peak_mb": peak_mb(), "figures": figures}))


def peak_mb() -> float | None:
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1 << 20 if sys.platform == "darwin" else 1 << 10)


def measure(program: str, path: Path) -> dict[str, object]:
    command = [sys.executable, __file__, program, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    result: dict[str, object] = json.loads(done.stdout)
    return result


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        files = {"whole": Path(folder, "telemetry.parquet"), "quarter": Path(folder, "quarter.parquet")}
        write_telemetry(files["whole"], ROWS)
        write_telemetry(files["quarter"], ROWS // 4)
        size_mb = files["whole"].stat().st_size / 1e6
        print(f"{ROWS:,} rows, {SENSORS + TARGETS} columns, {size_mb:.0f} MB of Parquet, {os.cpu_count()} cores")
        have_duckdb = importlib.util.find_spec("duckdb") is not None
        programs = list(PROGRAMS) if have_duckdb else ["thetacomp"]
        found = {(program, part): measure(program, path) for program in programs for part, path in files.items()}
    does = {
        "thetacomp": "count, means, all cross products",
        "duckdb": "count(*), avg, stddev",
        "duckdb-avg": "count(*), avg",
    }
    print(f"{'program':12} {'time s':>8} {'peak MB':>9} {'quarter file':>13}  computes")
    for program in programs:
        whole, quarter = found[program, "whole"], found[program, "quarter"]
        peaks = [f"{r['peak_mb']:.0f}" if r["peak_mb"] is not None else "not known" for r in (whole, quarter)]
        print(f"{program:12} {whole['time_s']:8.3f} {peaks[0]:>9} {peaks[1]:>13}  {does[program]}")
    if not have_duckdb:
        print("duckdb       not run: package duckdb is not installed")
        return
    for other in programs[1:]:
        ratio = found["thetacomp", "whole"]["time_s"] / found[other, "whole"]["time_s"]  # type: ignore[operator]
        print(f"time against {other}: {ratio:.2f}")
    ours, theirs = (np.array(found[p, "whole"]["figures"]) for p in ("thetacomp", "duckdb"))
    print(f"largest relative difference of the means and standard deviations: {np.abs(ours / theirs - 1.0).max():.1e}")


if __name__ == "__main__":
    if len(sys.argv) == 3:
        child(sys.argv[1], sys.argv[2])
    else:
        main()

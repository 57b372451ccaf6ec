"""What is not believed, rebuilt from the healthy sensors, with the uncertainty of the rebuilt values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thetacomp.arrays import Bools, Floats
from thetacomp.model.temperatures import Temperatures
from thetacomp.screening.faults import Finding
from thetacomp.screening.grid import BLOCK_S, Course, course
from thetacomp.screening.others import Teachers, teachers
from thetacomp.screening.record import REBUILT, Record
from thetacomp.screening.silent import FEWEST_MISSING

LOST_SHARE = 0.5  # a rebuilt value worse than half of the sensor's own movement is useless
ANCHOR_S = 600.0  # the last good readings that a rebuilt course goes on from


@dataclass(frozen=True)
class Repaired:
    """The table of a record as it can be used, `u_K` (n, p) of its changed values, the findings with what was done."""

    table: Temperatures
    u_K: Floats
    findings: tuple[Finding, ...]


def repaired(record: Record, others: Sequence[Record]) -> Repaired:
    """Rebuild what is not believed; single missing samples are bridged. A sensor that is lost stays missing."""
    t_s, ids = record.table.t_s, record.table.sensor_ids
    value, u_K = record.value.copy(), np.zeros(record.value.shape)
    rows = {f: (t_s >= f.start_s) & (t_s < (np.inf if f.end_s is None else f.end_s)) for f in record.findings}
    rebuilt = [f for f in record.findings if f.kind in REBUILT and f.repair != "none"]
    findings = {f: f for f in record.findings}
    if rebuilt:
        taught = teachers([o.course for o in others]) if others else None
        length_s = float(t_s[-1] - t_s[0])
        fine = course(Temperatures(t_s, ids, record.value), max(1, int(length_s / BLOCK_S)))
        for f in rebuilt:
            out = frozenset(ids.index(g.sensor) for g in rebuilt if (rows[f] & rows[g]).any())
            findings[f] = _rebuild(f, record, value, rows[f], fine, taught, out)
            if np.isfinite(findings[f].repair_u_K) and taught is not None:
                j = ids.index(f.sensor)
                grown = taught.rebuilt_u_K(j, out, t_s[rows[f]] - f.start_s)
                u_K[rows[f], j] = np.maximum(u_K[rows[f], j], grown)
    for f, on in rows.items():
        for name in (f.sensor, f.partner) if f.kind in ("jump", "offset", "swapped") and f.repair != "none" else ():
            if name:
                u_K[on, ids.index(name)] = np.maximum(u_K[on, ids.index(name)], max(f.repair_u_K, 1e-6))
    _bridge(t_s, value)
    return Repaired(replace(record.table, value_degC=value), u_K, tuple(findings.values()))


def _rebuild(
    found: Finding,
    record: Record,
    value: Floats,
    rows: Bools,
    fine: Course,
    taught: Teachers | None,
    out: frozenset[int],
) -> Finding:
    """Fill the values of one fault in `value`, anchored before it, and after it where it ended; say what was done."""
    ids, t_s = record.table.sensor_ids, record.table.t_s
    j = ids.index(found.sensor)
    last_s = t_s[-1] if found.end_s is None else found.end_s
    if taught is None:
        return replace(found, repair="none" if found.kind == "missing" else "lost", repair_u_K=float("nan"))
    u_K = float(taught.rebuilt_u_K(j, out, np.array([last_s - found.start_s]))[0])
    predicted = np.interp(t_s, fine.t_s, fine.inputs_K @ taught.weights(j, out))
    off = record.value[:, j] - predicted
    before = off[(t_s < found.start_s) & (t_s >= found.start_s - _anchor_s(record)) & np.isfinite(off)]
    after = off[(t_s >= last_s) & (t_s < last_s + _anchor_s(record)) & np.isfinite(off)]
    if not len(before) or u_K > LOST_SHARE * taught.moves_K(j):
        return replace(found, repair="lost", repair_u_K=u_K)
    level = np.full(int(rows.sum()), before.mean())
    if found.end_s is not None and len(after):
        share = (t_s[rows] - found.start_s) / max(last_s - found.start_s, 1e-9)
        level += share * (after.mean() - before.mean())
    value[rows, j] = predicted[rows] + level
    off_K = (record.table.value_degC[:, j] - value[:, j])[rows]
    off_K = off_K[np.isfinite(off_K)]
    size_K = float(off_K[np.argmax(np.abs(off_K))]) if len(off_K) and found.kind == "stuck" else found.size_K
    healthy = tuple(name for k, name in enumerate(ids) if k not in out and k != j and fine.read[k])
    return replace(found, repair="reconstructed", repaired_from=healthy, repair_u_K=u_K, size_K=size_K)


def _anchor_s(record: Record) -> float:
    return max(ANCHOR_S, 5.0 * record.table.interval_s)


def _bridge(t_s: Floats, value: Floats) -> None:
    """Single missing samples, or two, lie on the line between their neighbours."""
    for j in range(value.shape[1]):
        good = np.flatnonzero(np.isfinite(value[:, j]))
        if 0 < len(good) < len(value):
            hole = np.flatnonzero(~np.isfinite(value[:, j]))
            hole = hole[(hole > good[0]) & (hole < good[-1])]
            after = np.searchsorted(good, hole)
            short = good[after] - good[after - 1] <= FEWEST_MISSING
            value[hole[short], j] = np.interp(t_s[hole[short]], t_s[good], value[good, j])

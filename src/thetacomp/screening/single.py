"""Faults that a record shows by itself: readings that are missing, steps that stay, one reading for too long."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.screening import silent, steps
from thetacomp.screening.faults import Finding
from thetacomp.screening.others import Teachers, teachers
from thetacomp.screening.record import Record

FASTEST_S = 60.0  # noise is told from work at this sampling or faster
NEAR_S = 1800.0
DENIED = 0.5  # share of a step that the others leave unexplained at least
BACK = 0.25  # a step back that leaves this share of the shift ends it


def with_missing(record: Record) -> Record:
    """All stretches without reading, told; what is missing is rebuilt later."""
    t_s = record.table.t_s
    for gap in silent.missing(record.table, record.value):
        begin_s, limit_s = float(t_s[gap.begin]), silent.FEWEST_MISSING * record.table.interval_s
        found = Finding(
            record.table.sensor_ids[gap.j], "missing", begin_s, begin_s + limit_s, _end_s(t_s, gap.end), float("nan"),
            gap.length_s, limit_s, "reconstructed",
        )  # fmt: skip
        record = record.told(found)
    return record


def with_steps(record: Record, others: Sequence[Record], roles: Sequence[str], fast: Sequence[bool]) -> Record:
    """Steps that stay, shifted back; two channels that were exchanged at one moment, exchanged back."""
    if others:
        kin = [[k for k, role in enumerate(roles) if role == own] for own in roles]
        usual_K = steps.history_K([o.sharp for o in others], kin)
    else:  # the other sensors of the campaign say what is usual
        usual_K = np.full(len(roles), np.sort(record.sharp.sharpest_K)[-2:].min(initial=0.0))
    span_K = float(np.median([np.nanmax(r.value) - np.nanmin(r.value) for r in (record, *others)]))
    exchanged = steps.exchanges(record.sharp)
    for step, k, times in exchanged:
        found = replace(
            _finding(record, step, "swapped", "swapped back"),
            partner=record.table.sensor_ids[k], statistic=times,
        )  # fmt: skip
        record = record.exchanged(found, step.j, k)
    pairs = {j for step, k, _ in exchanged for j in (step.j, k)}
    taught = teachers([o.course for o in others]) if others else None
    for step in sorted(steps.steps(record.sharp, usual_K, fast, span_K), key=lambda s: s.t_s):
        if step.j in pairs:
            continue
        known = _finding(record, step, "unexplained", "none")
        is_fault = step.is_fault and (taught is None or _others_deny(record, taught, step))
        record = _shifted(record, step) if is_fault else record.told(known)
    return record


def _others_deny(record: Record, taught: Teachers, step: steps.Step) -> bool:
    """Whether the others do not explain most of a step; one before the campaign itself they cannot judge."""
    own = record.course
    off_K = own.rise_K[:, step.j] - own.inputs_K @ taught.weights(step.j)
    before = off_K[(own.t_s < step.t_s) & (own.t_s > step.t_s - NEAR_S)]
    after = off_K[(own.t_s > step.t_s) & (own.t_s < step.t_s + NEAR_S)]
    if not len(before) or not len(after):
        return True
    return bool((after.mean() - before.mean()) * np.sign(step.size_K) > DENIED * abs(step.size_K))


def _finding(record: Record, step: steps.Step, kind: str, repair: str) -> Finding:
    start_s = steps.first_sample_s(record.table.t_s, record.table.value_degC[:, step.j], step, record.sharp.step_s)
    seen_s = step.t_s + (steps.SIDE + 0.5) * record.sharp.step_s
    u_K = float(record.sharp.noise_K[step.j]) / 2.0 if repair == "shifted back" else 0.0
    return Finding(
        record.table.sensor_ids[step.j], kind, start_s, seen_s, None, step.size_K, abs(step.size_K),  # type: ignore[arg-type]
        step.limit_K, repair, (), u_K,  # type: ignore[arg-type]
    )  # fmt: skip


def _shifted(record: Record, step: steps.Step) -> Record:
    """The step taken off; one that goes back to where the sensor was ends the step before it."""
    found = _finding(record, step, "jump", "shifted back")
    earlier = [f for f in record.findings if f.sensor == found.sensor and f.kind == "jump" and f.end_s is None]
    if earlier and abs(earlier[-1].size_K + found.size_K) < BACK * abs(found.size_K):
        ended = replace(earlier[-1], end_s=found.start_s)
        back = record.shifted(found, step.j, -earlier[-1].size_K)
        return replace(back, findings=tuple(ended if f is earlier[-1] else f for f in record.findings))
    return record.shifted(found, step.j, step.size_K)


def with_noisy(record: Record, others: Sequence[Record]) -> Record:
    """Channels that scatter far more than they do elsewhere, not believed meanwhile."""
    own = record.sharp
    scatter = steps.scatter_K(own.x)
    if not others or not len(scatter):
        return record
    limit = np.maximum(steps.SCATTER_K, steps.RESTLESS * steps.usual_scatter_K([o.sharp for o in others]))
    restless = np.flatnonzero((scatter > limit).any(axis=0)).tolist()
    # Sampled slowly, work in short jobs looks like noise; so does anything that several sensors feel.
    if own.step_s > FASTEST_S or len(restless) > 1:
        return record
    for j in restless:
        rows = np.flatnonzero(scatter[:, j] > limit[j])
        last = min(int(rows[-1]) + steps.SCATTER_BLOCKS + 1, len(own.t_s) - 1)
        begin_s, end_s = float(own.t_s[rows[0]]), float(own.t_s[last]) if last < len(own.t_s) - 1 else None
        found = Finding(
            record.table.sensor_ids[j], "noisy", begin_s, begin_s + steps.SCATTER_BLOCKS * own.step_s,
            end_s, float("nan"), float(scatter[:, j].max()), float(limit[j]), "reconstructed",
        )  # fmt: skip
        record = record.silenced(found, j)
    return record


def with_held(record: Record, others: Sequence[Record]) -> Record:
    """Channels that show one reading for too long, not believed from then on."""
    t_s, read = record.table.t_s, silent.read_values(record.table)
    runs = silent.held(t_s, read, [o.longest_s for o in others])
    taught = teachers([o.course for o in others]) if others and runs else None
    for run in runs:
        column = read[:, run.j]
        elsewhere = [o.table.value_degC[:, run.j] for o in others]
        far = bool(others) and run.length_s > silent.FAR_LONGER * run.usual_s
        if far or silent.noise_forbids(run, column, elsewhere) or _should_move(record, taught, run, column):
            limit_s = max(silent.LONGER * run.usual_s, silent.SHORTEST_S)
            begin_s = float(t_s[run.begin])
            found = Finding(
                record.table.sensor_ids[run.j], "stuck", begin_s, begin_s + limit_s, _end_s(t_s, run.end), float("nan"),
                run.length_s, limit_s, "reconstructed",
            )  # fmt: skip
            record = record.silenced(found, run.j)
    return record


def _should_move(record: Record, taught: Teachers | None, run: silent.Silence, column: Floats) -> bool:
    """Whether the others say that the sensor moves meanwhile, by more than they can be wrong."""
    if taught is None:
        return False
    course = record.course
    rows = (course.t_s >= record.table.t_s[run.begin]) & (course.t_s <= record.table.t_s[run.end - 1])
    predicted_K = (course.inputs_K @ taught.weights(run.j))[rows]
    moves_K = float(np.ptp(predicted_K)) if rows.any() else 0.0
    return moves_K > 3.0 * (taught.usual_K(run.j) + silent.resolution_K(column))


def _end_s(t_s: Floats, end: int) -> float | None:
    return float(t_s[end]) if end < len(t_s) else None

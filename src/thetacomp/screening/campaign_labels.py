"""Held labels of a campaign: displacements of drift and sweeps that were not measured, left out with a count.

A frozen displacement is called held only where the instrument shows elsewhere that it does not repeat itself, and
where something should have moved: a machine at rest, a coarse probe and a table without noise stay as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thetacomp.arrays import CARTESIAN, Bools, Floats
from thetacomp.campaign import Campaign, Drift, SweepPoints
from thetacomp.model.temperatures import Duty
from thetacomp.screening.held_labels import find_held_labels

REPEATS_SHARE = 0.1  # an instrument that repeats more of its other readings is too coarse, or free of noise
MOVED_K = 0.5  # a machine whose temperatures move less may really stand still
FEWEST_POINTS = 3  # a line needs that many
HOUR_S = 3600.0
SHOWN = 6


@dataclass(frozen=True)
class HeldLabels:
    """Held rows of one column of one table (`drift` or `sweeps`), as stretches of time.

    `count` values are held; `removed` counts points that went with them, because a sweep kept fewer than a line needs.
    `kept_because` says why frozen values were kept; "" where they were left out.
    """

    campaign: str
    table: str
    column: str
    count: int
    stretches_s: tuple[tuple[float, float], ...]
    removed: int = 0
    kept_because: str = ""


def without_held_labels(campaign: Campaign, apply: bool = True) -> tuple[Campaign, list[HeldLabels]]:
    """The campaign with held displacements as missing values, and what was found; unchanged where `apply` is False."""
    drift, sweeps = campaign.drift, campaign.sweeps
    found: list[HeldLabels] = []
    if drift is not None:
        held, entries = _held_drift(campaign, drift)
        found += entries
        values = np.where(held, np.nan, _values(drift))
        drift = replace(
            drift, error_um=values[:, :3], rotation_urad=None if drift.rotation_urad is None else values[:, 3:]
        )
    if sweeps is not None:
        held, entries = _held_sweeps(campaign.name, sweeps)
        values = np.where(held, np.nan, _values(sweeps))
        short = _short_sweeps(sweeps, held, values)
        found += [replace(entry, removed=0 if entry.kept_because else int(short.sum())) for entry in entries]
        rotation = None if sweeps.rotation_urad is None else values[:, 3:]
        sweeps = _without_rows(replace(sweeps, error_um=values[:, :3], rotation_urad=rotation), short)
    left_out = any(not entry.kept_because for entry in found)
    return (replace(campaign, drift=drift, sweeps=sweeps) if apply and left_out else campaign), found


def labels_note(entry: HeldLabels, repair: bool) -> str:
    """How many labels are held, where, and what was done."""
    shown = ", ".join(f"{a / HOUR_S:.2f} to {b / HOUR_S:.2f} h" for a, b in entry.stretches_s[:SHOWN])
    more = f" and {len(entry.stretches_s) - SHOWN} stretches more" if len(entry.stretches_s) > SHOWN else ""
    what = (
        f"campaign {entry.campaign}, {entry.table}: {entry.count} values of {entry.column} are frozen ({shown}{more})"
    )
    why = (
        "while the machine is at rest and its temperatures change"
        if entry.table == "drift"
        else "in every direction, while the axis goes from point to point"
    )
    if entry.kept_because:
        return f"{what}; they are used as measured, because {entry.kept_because}"
    if not repair:
        return f"{what} {why}: no measurement. Used as read, because repair is switched off"
    besides = f", and {entry.removed} points of sweeps that keep too few for a line" if entry.removed else ""
    return f"{what} {why}: no measurement. Left out{besides}"


def _held_drift(campaign: Campaign, drift: Drift) -> tuple[Bools, list[HeldLabels]]:
    """Held values (n, columns) of a drift record; without a duty table it is not known when the machine stood."""
    values = _values(drift)
    held = np.zeros(values.shape, bool)
    if campaign.duty is None or not campaign.duty.columns:
        return held, []
    held = find_held_labels(values, drift.t_s, _running(campaign.duty, drift.t_s))
    entries = []
    for j in range(values.shape[1]):
        for begin, end in runs_of(held[:, j]):
            held[begin:end, j] = _temperatures_move(campaign, drift.t_s[begin - 1], drift.t_s[end - 1])
        if held[:, j].any():
            kept = _repeats_itself(values[:, j], held[:, j])
            entries.append(_entry(campaign.name, "drift", j, drift.t_s, held[:, j], kept))
            held[:, j] &= not kept
    return held, entries


def _held_sweeps(campaign: str, sweeps: SweepPoints) -> tuple[Bools, list[HeldLabels]]:
    """Held values (n, columns) of sweeps: an instrument that hangs repeats every coordinate while the axis moves.

    Every point is taken at a standstill, so the duty says nothing here. A sweep that is constant as a whole may be a
    table without noise: it is reported and kept.
    """
    values = _values(sweeps)
    read = np.flatnonzero(np.isfinite(values).any(axis=0))
    nothing = np.zeros(values.shape, bool)
    if not len(read) or len(values) < FEWEST_POINTS:
        return nothing, []
    every = find_held_labels(values[:, read], sweeps.t_s, np.zeros(len(values)), shortest_s=0.0)
    frozen: Bools = np.all(every, axis=1, keepdims=True)[:, 0]
    whole = np.zeros(len(values), bool)
    for begin, end in runs_of(frozen):
        run = slice(begin - 1, end)
        if len(np.unique(sweeps.position_mm[run])) < FEWEST_POINTS:
            frozen[begin:end] = False  # a dwell at one place
        elif begin == 1 or sweeps.sweep[begin - 2] != sweeps.sweep[begin - 1]:
            whole[begin:end] = True
    entries = []
    held = nothing
    for j in read:
        kept = _repeats_itself(values[:, j], frozen)
        held[:, j] = frozen & ~whole & (not kept)
        for rows, why in ((frozen & ~whole, kept), (whole, "the whole sweep is constant, as in a table without noise")):
            if rows.any():
                entries.append(_entry(campaign, "sweeps", int(j), sweeps.t_s, rows, why))
    return held, entries


def _entry(campaign: str, table: str, column: int, t_s: Floats, rows: Bools, kept_because: str) -> HeldLabels:
    names = (*(f"d{d}_um" for d in CARTESIAN), *(f"r{d}_urad" for d in "ABC"))
    stretches = tuple((float(t_s[begin]), float(t_s[end - 1])) for begin, end in runs_of(rows))
    return HeldLabels(campaign, table, names[column], int(rows.sum()), stretches, kept_because=kept_because)


def _values(table: Drift | SweepPoints) -> Floats:
    """Errors and rotations side by side, (n, 3) or (n, 6)."""
    return table.error_um if table.rotation_urad is None else np.hstack([table.error_um, table.rotation_urad])


def _running(duty: Duty, t_s: Floats) -> Floats:
    """0 where every column of the duty says standstill, 1 where something runs or nothing is known, (n,)."""
    row = np.searchsorted(duty.t_s, t_s, side="right") - 1
    running = np.any([~(column == 0.0) for column in duty.columns.values()], axis=0)
    return np.where(row < 0, True, running[np.maximum(row, 0)]).astype(float)


def _temperatures_move(campaign: Campaign, begin_s: float, end_s: float) -> bool:
    first, last = campaign.temperatures.at(np.array([begin_s, end_s]))
    change_K = np.abs(last - first)
    return bool(np.max(change_K[np.isfinite(change_K)], initial=0.0) > MOVED_K)


def _repeats_itself(value: Floats, held: Bools) -> str:
    """Why a repeated reading means nothing: the other readings repeat too, or there are none; "" where they do not."""
    pair = np.isfinite(value[1:]) & np.isfinite(value[:-1]) & ~held[1:] & ~held[:-1]
    if not pair.any():
        return "there is no other reading to compare with"
    share = float(np.mean(value[1:][pair] == value[:-1][pair]))
    return f"{100.0 * share:.0f} % of the other readings repeat the one before too" if share > REPEATS_SHARE else ""


def runs_of(marked: Bools) -> list[tuple[int, int]]:
    """Stretches [begin, end) of marked rows."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], marked.astype(int), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _short_sweeps(sweeps: SweepPoints, held: Bools, values: Floats) -> Bools:
    """Rows (n,) of sweeps in which a held column keeps fewer points than a line needs."""
    gone = np.zeros(len(sweeps.t_s), bool)
    for number in np.unique(sweeps.sweep[held.any(axis=1)]):
        rows = sweeps.sweep == number
        short = held[rows].any(axis=0) & (np.isfinite(values[rows]).sum(axis=0) < FEWEST_POINTS)
        gone |= rows & bool(short.any())
    return gone


def _without_rows(sweeps: SweepPoints, gone: Bools) -> SweepPoints | None:
    if gone.all():
        return None
    kept = np.flatnonzero(~gone)

    def texts(column: Sequence[str]) -> tuple[str, ...]:
        return tuple(column[int(i)] for i in kept)

    return replace(
        sweeps,
        t_s=sweeps.t_s[kept],
        axis=texts(sweeps.axis),
        sweep=sweeps.sweep[kept],
        position_mm=sweeps.position_mm[kept],
        direction=sweeps.direction[kept],
        error_um=sweeps.error_um[kept],
        run=None if sweeps.run is None else texts(sweeps.run),
        station=None if sweeps.station is None else texts(sweeps.station),
        rotation_urad=None if sweeps.rotation_urad is None else sweeps.rotation_urad[kept],
        at_mm={name: value[kept] for name, value in sweeps.at_mm.items()},
    )

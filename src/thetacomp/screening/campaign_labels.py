"""Held labels of a campaign: displacements of drift and sweeps that were not measured, left out with a count.

A frozen displacement is called held by the length of its run against what the instrument does when it lives: a coarse
probe in a quiet hour and a table without noise stay as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thetacomp.arrays import CARTESIAN, Bools, Floats
from thetacomp.campaign import Campaign, Drift, SweepPoints
from thetacomp.instrument import FEWEST_EQUAL, frozen, repeats, unlikely

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
        held, entries = _held_drift(campaign.name, drift)
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
        "for longer than the instrument ever stands still"
        if entry.table == "drift"
        else "in every direction, while the axis goes from point to point"
    )
    if entry.kept_because:
        return f"{what}; they are used as measured, because {entry.kept_because}"
    if not repair:
        return f"{what} {why}: no measurement. Used as read, because repair is switched off"
    besides = f", and {entry.removed} points of sweeps that keep too few for a line" if entry.removed else ""
    return f"{what} {why}: no measurement. Left out{besides}"


def _held_drift(campaign: str, drift: Drift) -> tuple[Bools, list[HeldLabels]]:
    """Held values (n, columns) of a drift record, each column on its own."""
    values = _values(drift)
    held = np.column_stack([frozen(drift.t_s, column) for column in values.T])
    return held, [_entry(campaign, "drift", int(j), drift.t_s, held[:, j]) for j in np.flatnonzero(held.any(axis=0))]


def _held_sweeps(campaign: str, sweeps: SweepPoints) -> tuple[Bools, list[HeldLabels]]:
    """Held values (n, columns) of sweeps: an instrument that hangs repeats every coordinate while the axis moves.

    A sweep that is constant as a whole may be a table without noise: it is reported and kept.
    """
    values = _values(sweeps)
    read = np.flatnonzero(np.isfinite(values).any(axis=0))
    nothing = np.zeros(values.shape, bool)
    if not len(read) or len(values) < FEWEST_POINTS:
        return nothing, []
    every: Bools = np.asarray(np.stack([repeats(values[:, j]) for j in read]).all(axis=0))
    known: Bools = np.asarray(np.isfinite(values[:, read]).all(axis=1))
    hung, whole = np.zeros(len(values), bool), np.zeros(len(values), bool)
    for begin, end in runs_of(np.concatenate([[False], every])):
        run = slice(begin - 1, end)
        if end - begin + 1 < FEWEST_EQUAL or len(np.unique(sweeps.position_mm[run])) < FEWEST_POINTS:
            continue  # short, or a dwell at one place
        starts_sweep = begin == 1 or sweeps.sweep[begin - 2] != sweeps.sweep[begin - 1]
        (whole if starts_sweep else hung)[begin:end] = True
    alive = known[1:] & known[:-1] & ~hung[1:] & ~whole[1:]
    for begin, end in runs_of(hung):
        hung[begin:end] = unlikely(end - begin + 1, every, alive)
    entries = []
    for j in read:
        for rows, why in ((hung, ""), (whole, "the whole sweep is constant, as in a table without noise")):
            if rows.any():
                entries.append(_entry(campaign, "sweeps", int(j), sweeps.t_s, rows, why))
    held = nothing
    held[:, read] = hung[:, None]
    return held, entries


def _entry(campaign: str, table: str, column: int, t_s: Floats, rows: Bools, kept_because: str = "") -> HeldLabels:
    names = (*(f"d{d}_um" for d in CARTESIAN), *(f"r{d}_urad" for d in "ABC"))
    stretches = tuple((float(t_s[begin]), float(t_s[end - 1])) for begin, end in runs_of(rows))
    return HeldLabels(campaign, table, names[column], int(rows.sum()), stretches, kept_because=kept_because)


def _values(table: Drift | SweepPoints) -> Floats:
    """Errors and rotations side by side, (n, 3) or (n, 6)."""
    return table.error_um if table.rotation_urad is None else np.hstack([table.error_um, table.rotation_urad])


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

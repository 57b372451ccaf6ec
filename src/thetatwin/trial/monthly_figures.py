"""What a trial came to: figures month by month, and whether the limits are kept."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import CARTESIAN, Floats, Ints
from thetacomp.validation.outcome import AcceptanceCheck
from thetatwin.hall import DAY_S
from thetatwin.trial.run import ADAPTIVE, FROZEN, NOTHING, Trial
from thetatwin.year import MONTH_DAYS

WORSE_BY_UM = 5.0
TOOL = "tool"  # the length of the error vector
LEAST_ADAPTIVE_PERCENT, LEAST_FROZEN_PERCENT, MOST_WORSE_PERCENT = 85.0, 70.0, 0.5


@dataclass(frozen=True)
class MonthRow:
    """One month of one column. `direction` is X, Y, Z or `tool`, the length of the error vector, over all places.

    `worst_hour_um` is the largest mean over one hour at one place. `hours_worse_percent` counts hours in which the
    largest of these means over the places exceeds that of the uncompensated machine by more than WORSE_BY_UM,
    `place_hours_worse_percent` the same place by place. `coverage_percent` is how often the band held the error, NaN
    where the column states none; `in_domain_percent` how often the model was inside its border.
    """

    month: int
    column: str
    direction: str
    p95_before_um: float
    p95_after_um: float
    reduction_percent: float
    worst_hour_um: float
    hours_worse_percent: float
    place_hours_worse_percent: float
    coverage_percent: float
    in_domain_percent: float


def monthly(trial: Trial) -> tuple[MonthRow, ...]:
    """All rows, month by month."""
    return tuple(
        _row(trial, month, column, direction)
        for month in range(trial.schedule.months)
        for column in trial.residual_um
        for direction in (TOOL, *CARTESIAN)
    )


def rows_of_month(trial: Trial, month: int) -> Ints:
    """Moments that belong to a month, counted from 0."""
    begin_s = (trial.schedule.training_days + month * MONTH_DAYS) * DAY_S
    return np.flatnonzero((trial.t_s > begin_s) & (trial.t_s <= begin_s + MONTH_DAYS * DAY_S))


def size_um(error_um: Floats, direction: str) -> Floats:
    """Size (n, places) of errors (n, places, 3) in one direction, or of the whole vector."""
    if direction == TOOL:
        return np.asarray(np.linalg.norm(error_um, axis=2))
    return np.asarray(np.abs(error_um[:, :, CARTESIAN.index(direction)]))


def by_hour(t_s: Floats, size: Floats) -> Floats:
    """Means (hours, places) over whole hours of sizes (n, places)."""
    hour = np.ceil(t_s / 3600.0).astype(np.int64)
    _, index, count = np.unique(hour, return_inverse=True, return_counts=True)
    sums = np.zeros((len(count), size.shape[1]))
    np.add.at(sums, index, size)
    return np.asarray(sums / count[:, None])


def _row(trial: Trial, month: int, column: str, direction: str) -> MonthRow:
    rows = rows_of_month(trial, month)
    before = size_um(trial.residual_um[NOTHING][rows], direction)
    after = size_um(trial.residual_um[column][rows], direction)
    p95_before, p95_after = float(np.quantile(before, 0.95)), float(np.quantile(after, 0.95))
    hour_before, hour_after = by_hour(trial.t_s[rows], before), by_hour(trial.t_s[rows], after)
    return MonthRow(
        month=month + 1,
        column=column,
        direction=direction,
        p95_before_um=p95_before,
        p95_after_um=p95_after,
        reduction_percent=100.0 * (1.0 - p95_after / p95_before) if p95_before > 0.0 else float("nan"),
        worst_hour_um=float(hour_after.max()),
        hours_worse_percent=100.0 * float(np.mean(hour_after.max(axis=1) > hour_before.max(axis=1) + WORSE_BY_UM)),
        place_hours_worse_percent=100.0 * float(np.mean(hour_after > hour_before + WORSE_BY_UM)),
        coverage_percent=_coverage_percent(trial, rows, column, direction),
        in_domain_percent=100.0 * float(trial.in_domain[rows].mean()) if column in (FROZEN, ADAPTIVE) else float("nan"),
    )


def _coverage_percent(trial: Trial, rows: Ints, column: str, direction: str) -> float:
    """The stored bands stand around the frozen model alone."""
    if column != FROZEN:
        return float("nan")
    chosen = slice(None) if direction == TOOL else [CARTESIAN.index(direction)]
    band = trial.band_um[rows][:, :, chosen]
    stated = np.isfinite(band)
    inside = np.abs(trial.residual_um[column][rows][:, :, chosen]) <= band
    return 100.0 * float(inside[stated].mean()) if stated.any() else float("nan")


def acceptance(rows: Iterable[MonthRow]) -> tuple[AcceptanceCheck, ...]:
    """The stated limits of the trial."""
    tool = [row for row in rows if row.direction == TOOL]
    adaptive = [row for row in tool if row.column == ADAPTIVE]
    frozen = [row for row in tool if row.column == FROZEN]
    worst = min(row.reduction_percent for row in adaptive)
    median = float(np.median([row.reduction_percent for row in frozen]))
    worse = max(
        float(np.mean([row.hours_worse_percent for row in adaptive])),
        float(np.mean([row.place_hours_worse_percent for row in adaptive])),
    )
    return (
        AcceptanceCheck(
            "adaptive_month",
            worst,
            ">=",
            LEAST_ADAPTIVE_PERCENT,
            worst >= LEAST_ADAPTIVE_PERCENT,
            "reduction of p95 in the worst month, with one probe a day, in %",
        ),
        AcceptanceCheck(
            "adaptive_hours_worse",
            worse,
            "<=",
            MOST_WORSE_PERCENT,
            worse <= MOST_WORSE_PERCENT,
            f"hours made worse by more than {WORSE_BY_UM:g} µm with one probe a day, by machine or by place, in %",
        ),
        AcceptanceCheck(
            "frozen_month",
            median,
            ">=",
            LEAST_FROZEN_PERCENT,
            median >= LEAST_FROZEN_PERCENT,
            "reduction of p95 in the median month, frozen, in %",
        ),
    )

"""Accuracy against the number of sensors: the proven best k of an axis, and how often each sensor is chosen.

The states of every campaign go through one summary, so a recording of any length costs the same search.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import comb
from typing import TYPE_CHECKING, Literal

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.axis_states import AxisStates
from thetacomp.errors import AnalysisError
from thetacomp.moments import Summary, summarise
from thetacomp.sensors.holdout import line_targets
from thetacomp.sensors.parameters import parameter_table
from thetacomp.sensors.subset import best_subset, selection_frequency

if TYPE_CHECKING:
    from thetacomp.sensors.subset import SearchProgress, SubsetResult

ScoreName = Literal["residual", "held_out", "worst_campaign"]

MIN_CAMPAIGNS = 3
MOST_SENSORS = 6
MISSING_SHARE = 0.10
BUDGET_S = 20.0
"""Most seconds of one search inside `analyze`; what stops there says so."""

ENOUGH = 1.05
"""The fewest sensors whose score is within this of the best one are enough."""

SEED = 20120951


@dataclass(frozen=True)
class CurvePoint:
    """The best `count` sensors: RMS in µm over travel and states of the error vector that remains.

    `residual_um` is in-sample, `held_out_um` with each campaign left out in turn. No other set can score below
    `bound_um`; `proven` says that none does. `compared` of the `sets` were looked at one by one.
    """

    count: int
    sensors: tuple[str, ...]
    residual_um: float
    held_out_um: float
    score_um: float
    bound_um: float
    proven: bool
    compared: int
    sets: int
    worst_campaign: str


@dataclass(frozen=True)
class SelectionShares:
    """How often each sensor is among the best `count` when campaigns are drawn again: `share` (0..1) over `draws`."""

    count: int
    sensors: tuple[str, ...]
    share: tuple[float, ...]
    draws: int


@dataclass(frozen=True)
class SensorCurve:
    """The curve of one moving axis ("" for drift). `best` is the number of sensors that is enough.

    `notes` say what was not searched or not proven. `shares` is absent where the draws would take too long.
    """

    axis: str
    score: ScoreName
    campaigns: tuple[str, ...]
    points: tuple[CurvePoint, ...]
    best: int
    shares: SelectionShares | None
    notes: tuple[str, ...] = ()


def sensor_curves(everything: Sequence[AxisStates], progress: Callable[[str], None]) -> tuple[SensorCurve, ...]:
    """Curves of all axes with at least three campaigns; what has no answer is left out."""
    curves = []
    for states in everything:
        if len(np.unique(states.campaign)) < MIN_CAMPAIGNS:
            continue
        progress(f"searching the best sensors: {'axis ' + states.axis if states.axis else 'drift'}")
        try:
            curves.append(sensor_curve(states, budget_s=BUDGET_S))
        except AnalysisError:
            continue
    return tuple(curves)


def sensor_curve(
    states: AxisStates,
    counts: Sequence[int] | None = None,
    score: ScoreName = "held_out",
    budget_s: float | None = None,
    progress: Callable[[int, SearchProgress], None] | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> SensorCurve:
    """Search the best sets of `counts` sensors (default 1 to 6, less than all) and draw the campaigns again.

    `budget_s` is for each number of sensors; `stop` is polled between rounds of the search. Raises AnalysisError where
    campaigns, states or sensors are too few.
    """
    summaries = campaign_summaries(states)
    inputs, rows = len(summaries[0].inputs), sum(s.count for s in summaries)
    training_rows = (rows - max(s.count for s in summaries)) // (2 if states.exact_zero else 1)
    most = min(inputs, training_rows - 2)
    asked = range(1, min(MOST_SENSORS, inputs - 1, most) + 1) if counts is None else counts
    weights_um = [(len(summaries[0].targets) / 2.0) ** 0.5] * len(summaries[0].targets)
    points: list[CurvePoint] = []
    notes: list[str] = []
    for k in asked:
        if k > most:
            raise AnalysisError(_too_many(states, k, inputs, training_rows))
        if stop():
            notes.append(f"stopped before {k} sensors")
            break
        try:
            found = best_subset(
                summaries,
                k,
                score=score,
                weights_um=weights_um,
                budget_s=budget_s,
                progress=None if progress is None else lambda state, k=k: progress(k, state),  # type: ignore[misc]
                stop=stop,
            )
        except AnalysisError as exc:
            if counts is not None or not points:
                raise
            notes.append(f"no more than {k - 1} sensors: {exc}")
            break
        points.append(_point(k, found, weights_um))
    if not points:
        raise AnalysisError(f"{_label(states)}: {'; '.join(notes) or 'fewer than two sensors can be chosen from'}.")
    notes += [f"{p.count} sensors: stopped early, not proven" for p in points if not p.proven]
    best = enough(points)
    shares = None if stop() else _shares(summaries, best, score, weights_um)
    if shares is None:
        notes.append("campaigns were not resampled: that would take too long, or the search was stopped")
    return SensorCurve(states.axis, score, tuple(s.name for s in summaries), tuple(points), best, shares, tuple(notes))


def campaign_summaries(states: AxisStates) -> list[Summary]:
    """One summary a campaign: rises of the sensors that are read nearly throughout, errors in µm over the travel.

    Where the error is zero at the reference by definition, cold states are left out, as in the fit, and the rows are
    taken with their negatives, so that every regression runs through zero. Raises AnalysisError for fewer than two
    campaigns.
    """
    table = parameter_table(states)
    known = np.isfinite(table.rise_K)
    shares = [known[states.campaign == label].mean(axis=0) for label in np.unique(states.campaign)]
    columns = np.flatnonzero(np.min(shares, axis=0) >= 1.0 - MISSING_SHARE)
    sensors = [states.sensors[j] for j in columns]
    target_um, _ = line_targets(table, [True] * len(table.parameters))
    names = [f"{k}" for k in range(target_um.shape[1])]
    used = ~states.cold if states.exact_zero else np.ones(len(states), dtype=bool)
    out = []
    for label in np.unique(states.campaign):
        rows = used & (states.campaign == label)
        x, y = table.rise_K[rows][:, columns], target_um[rows]
        if states.exact_zero:
            x, y = np.vstack([x, -x]), np.vstack([y, -y])
        summary = summarise(x, y, sensors, names, states.campaigns[label])
        if summary.count:
            out.append(summary)
    if len(out) < 2 or not sensors:
        raise AnalysisError(
            f"{_label(states)}: choosing sensors by held-out campaigns needs two campaigns with complete states and"
            f" sensors that are read in all of them; found {len(out)} campaigns, {len(sensors)} sensors."
        )
    return out


def enough(points: Sequence[CurvePoint]) -> int:
    """The fewest sensors whose held-out error is within 5 % of the least one; of the score where there is none."""
    errors = np.array([p.held_out_um for p in points])
    if not np.isfinite(errors).all():
        errors = np.array([p.score_um for p in points])
    return points[int(np.argmax(errors <= ENOUGH * errors.min()))].count


def _point(k: int, found: SubsetResult, weights_um: Sequence[float]) -> CurvePoint:
    def vector_um(rms: Floats) -> float:
        # Two targets a component, at the Gauss points of the travel; the components are directions of one vector.
        return float(np.sqrt(np.mean((rms * np.asarray(weights_um)) ** 2)))

    return CurvePoint(
        count=k,
        sensors=found.sensors,
        residual_um=vector_um(found.residual_rms),
        held_out_um=vector_um(found.held_out_rms),
        score_um=found.score,
        bound_um=found.bound,
        proven=found.proven,
        compared=found.evaluated,
        sets=found.subsets,
        worst_campaign=found.worst_campaign,
    )


def _shares(
    summaries: Sequence[Summary], count: int, score: ScoreName, weights_um: Sequence[float]
) -> SelectionShares | None:
    """200 draws where there are few sets, 50 where there are many, none where they would take minutes."""
    sets = comb(len(summaries[0].inputs), count)
    draws = 200 if sets <= 20_000 else 50 if sets <= 1_000_000 else 0
    if not draws:
        return None
    try:
        found = selection_frequency(summaries, count, seed=SEED, draws=draws, score=score, weights_um=weights_um)
    except AnalysisError:  # in a draw of few campaigns the sensors may be collinear
        return None
    return SelectionShares(count, found.sensors, tuple(float(share) for share in found.share), draws)


def _too_many(states: AxisStates, k: int, inputs: int, rows: int) -> str:
    return (
        f"{_label(states)}: {k} sensors cannot be chosen from {inputs} that are read in all campaigns, with {rows}"
        " states left when the longest campaign is held out. Fix: ask for fewer with --sensors."
    )


def _label(states: AxisStates) -> str:
    return f"axis {states.axis}" if states.axis else "drift at a fixed position"

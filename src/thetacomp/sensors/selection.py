"""From correlations or measured states to the key points of every axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.axis_states import AxisStates
from thetacomp.campaign import CorrelationTable
from thetacomp.errors import AnalysisError
from thetacomp.folds import fold_numbers
from thetacomp.machine import Machine
from thetacomp.sensors import strategies
from thetacomp.sensors.correlation import correlations, effective_count, full_symmetric, p_value, pair_p_value
from thetacomp.sensors.holdout import HoldOut, line_targets
from thetacomp.sensors.key_points import AxisKeyPoints, StrategyDecision, StrategyTable
from thetacomp.sensors.parameters import ParameterTable, parameter_table

Method = Literal["weighted", "paper"]

SIGNIFICANCE = 0.05
PAIR_SIGNIFICANCE = 0.01  # a second chance for what was judged at 5 % already
FEW_STATES = 10
FEW_STATES_INPUTS = 2
STATES_PER_INPUT = 5
MAX_KEY_POINTS = 4
MISSING_SHARE = 0.10


def drive_sensors(machine: Machine | None, axis: str) -> tuple[str, ...]:
    """Sensors on the drive of a moving axis: the one that the axis names first, then those of role `drive`."""
    if machine is None:
        return ()
    named = [a.sensor for a in machine.axes if a.name == axis and a.sensor is not None]
    return tuple(dict.fromkeys([*named, *(s.id for s in machine.sensors if s.role == "drive" and s.axis == axis)]))


def key_points(machine: Machine, states: AxisStates, method: Method = "weighted") -> AxisKeyPoints:
    """Key points of one axis from its training states, by our way or the paper's."""
    choose = select_key_points if method == "weighted" else paper_key_points
    return choose(parameter_table(states), drive_sensors(machine, states.axis))


def key_points_from_correlations(
    parameter_correlations: CorrelationTable,
    sensor_correlations: CorrelationTable,
    machine: Machine | None = None,
    thresholds: Mapping[str, float] | None = None,
) -> tuple[AxisKeyPoints, ...]:
    """The paper's way from published tables alone, one result a moving axis.

    Rows of `parameter_correlations` are named such as `EYX slope`. `machine` says which sensors sit on a drive and
    how long the names of its axes are; without it the medoid of each group represents it. `thresholds` sets the
    largest regret by axis. Raises AnalysisError for a row whose name is not understood, or where the two tables have
    no sensor in common.
    """
    sensors = tuple(s for s in parameter_correlations.columns if s in _names(sensor_correlations))
    if not sensors:
        raise AnalysisError(
            "the two correlation tables have no sensor in common: parameters against"
            f" {', '.join(parameter_correlations.columns)}; sensors {', '.join(sensor_correlations.rows)}."
            " Fix: use the same sensor names in both."
        )
    column = [parameter_correlations.columns.index(s) for s in sensors]
    by_axis: dict[str, list[int]] = {}
    for i, name in enumerate(parameter_correlations.rows):
        by_axis.setdefault(_axis_of(name), []).append(i)
    between = full_symmetric(sensor_correlations, sensors)
    unknown = tuple(
        (s, "is not in the table of sensor correlations") for s in parameter_correlations.columns if s not in sensors
    )
    return tuple(
        _paper(
            axis,
            sensors,
            [parameter_correlations.rows[i] for i in rows],
            parameter_correlations.value[np.ix_(rows, column)],
            between,
            drive_sensors(machine, axis),
            (thresholds or {}).get(axis),
            unknown,
        )
        for axis, rows in by_axis.items()
    )


def _names(table: CorrelationTable) -> set[str]:
    return {*table.rows, *table.columns}


def _axis_of(parameter: str) -> str:
    """Moving axis of a parameter name such as `EYX slope`; "" for a drift such as `DX intercept`."""
    component = parameter.split()[0] if parameter.split() else ""
    if len(component) == 2 and component[0] == "D" and component[1] in "XYZ":
        return ""
    if len(component) >= 3 and component[0] == "E" and component[1] in "XYZABC":
        return component[2:]
    raise AnalysisError(
        f"the row name {parameter!r} of the parameter correlations is not understood. Expected a component of ISO 230-1"
        " and the parameter, such as 'EYX slope' (error in Y while X moves) or 'DX intercept'."
        " Fix: rename the row; a publication's I_yx (Y moves, error in X) is 'EXY intercept'."
    )


def paper_key_points(
    table: ParameterTable, drives: Sequence[str] = (), threshold: float | None = None
) -> AxisKeyPoints:
    """The paper's way on measured states: regret rule, then one representative of each group."""
    usable, excluded = _usable_sensors(table)
    sensors = tuple(table.sensors[j] for j in usable)
    rise = table.rise_K[:, usable]
    result = _paper(
        table.axis,
        sensors,
        table.names,
        correlations(table.value, rise)[0],
        correlations(rise, rise)[0],
        drives,
        threshold,
        (),
    )
    return _with_excluded(result, excluded)


def _paper(
    axis: str,
    sensors: tuple[str, ...],
    parameters: Sequence[str],
    correlation: Floats,
    between: Floats,
    drives: Sequence[str],
    threshold: float | None,
    left_out: tuple[tuple[str, str], ...],
) -> AxisKeyPoints:
    known = np.flatnonzero(np.isfinite(correlation).any(axis=1))
    voting = [parameters[int(i)] for i in known]
    silent = tuple((name, "has no correlation with any sensor") for name in parameters if name not in voting)
    factors = strategies.main_factor_paper(axis, sensors, voting, correlation[known], threshold)
    index = [sensors.index(s) for s in factors.kept]
    inside = between[np.ix_(index, index)]
    irrelevance, groups = strategies.mutual_irrelevance(axis, factors.kept, inside, drives, strategies.PAPER_GROUP_R)
    return AxisKeyPoints(
        axis=axis,
        method="paper",
        main_factors=factors.kept,
        groups=groups,
        key_points=irrelevance.kept,
        smallest_correlation=_smallest(inside),
        tables=(factors, irrelevance),
        left_out=(*silent, *left_out),
    )


def _smallest(inside: Floats) -> float:
    pairs = np.abs(inside[np.triu_indices(len(inside), 1)])
    return float(np.nanmin(pairs)) if np.isfinite(pairs).any() else float("nan")


def select_key_points(
    table: ParameterTable, drives: Sequence[str] = (), max_key_points: int = MAX_KEY_POINTS
) -> AxisKeyPoints:
    """The default choice: parameters weighted by their µm, rows without significance left out, hold-out decides.

    1. A parameter votes where its best sensor is significant: p-value times number of sensors (Bonferroni) at most
       5 %. 2. Main factors by the mean regret of |r|, weighted by µm. 3. One representative of each group with
    |r| ≥ 0.95: the sensor on the drive of the moving axis (`drives`), else the medoid. 4. Representatives are taken
    one by one while the hold-out error over the travel falls by more than 5 %; at most `max_key_points`, at most a
    fifth of the number of states, and never more than two below ten states.

    Where no parameter votes, one that a pair of sensors explains significantly does, and both are main factors.

    Nothing is random. The result may hold no key point: then no sensor predicts a state that was held out.
    """
    usable, excluded = _usable_sensors(table)
    sensors = tuple(table.sensors[j] for j in usable)
    rise = table.rise_K[:, usable]
    r, count = correlations(table.value, rise)
    votes, left_out = _voting(table, sensors, rise, r, count)
    pairs = _pairs(table, rise, r, count) if not any(votes) else {}
    votes = [vote or i in pairs for i, vote in enumerate(votes)]
    left_out = tuple(entry for entry in left_out if entry[0] not in {table.names[i] for i in pairs})
    rows = np.flatnonzero(votes)
    value, voting = table.value[:, rows], [table.parameters[i] for i in rows]
    weight_um = strategies.spans(value) * np.array([p.um_per_unit for p in voting])
    factors = strategies.main_factor(table.axis, sensors, [p.name for p in voting], r[rows], weight_um)
    named = {table.names[i]: pair for i, pair in pairs.items()}
    factors = _with_pairs(factors, sensors, named)
    index = [sensors.index(s) for s in factors.kept]
    inside = correlations(rise[:, index], rise[:, index])[0] if index else np.empty((0, 0))
    irrelevance, groups = strategies.mutual_irrelevance(table.axis, factors.kept, inside, drives)
    # The difference of two sensors that rise alike is what a pair is for: their group does not part them.
    irrelevance = _with_pairs(irrelevance, sensors, named)
    fewest = _fewest(table, rise, sensors, irrelevance.kept, votes, max_key_points)
    result = AxisKeyPoints(
        axis=table.axis,
        method="weighted",
        main_factors=factors.kept,
        groups=groups,
        key_points=fewest.kept,
        smallest_correlation=_smallest(inside),
        tables=(
            factors,
            irrelevance,
            fewest,
            strategies.maximum_sensitivity(table.axis, sensors, rise),
            strategies.nearest_linear(table.axis, sensors, rise, value, weight_um),
        ),
        left_out=left_out,
    )
    return _with_excluded(result, excluded)


def _pairs(table: ParameterTable, rise_K: Floats, r: Floats, count: Floats) -> dict[int, tuple[int, int]]:
    """Parameters that no sensor explains alone and a pair does, with the columns of the pair.

    Two sensors that work against each other correlate with the error only when both are taken. The chance is counted
    over all pairs.
    """
    between = correlations(rise_K, rise_K)[0]
    independent = effective_count(table.value, rise_K, count, table.campaign)
    found = {}
    for i, own in enumerate(r):
        chance = pair_p_value(own, between, independent[i])
        a, b = divmod(int(np.argmin(chance)), len(own)) if chance.size else (0, 0)
        if a != b and chance[a, b] * len(own) * (len(own) - 1) / 2.0 <= PAIR_SIGNIFICANCE:
            found[i] = (a, b)
    return found


def _with_pairs(
    verdicts: StrategyTable, sensors: tuple[str, ...], pairs: Mapping[str, tuple[int, int]]
) -> StrategyTable:
    """A table in which both sensors of every pair stay."""
    partner = {sensors[a]: (name, sensors[b]) for name, pair in pairs.items() for a, b in (pair, pair[::-1])}
    return replace(
        verdicts,
        decisions=tuple(
            replace(d, stays=True, reason=f"explains {partner[d.sensor][0]} together with {partner[d.sensor][1]} only")
            if d.sensor in partner
            else d
            for d in verdicts.decisions
        ),
    )


def _usable_sensors(table: ParameterTable) -> tuple[list[int], tuple[StrategyDecision, ...]]:
    """Columns of the sensors that can be used, and a verdict for each of the others."""
    usable: list[int] = []
    excluded: list[StrategyDecision] = []
    n = len(table.campaign)
    for j, sensor in enumerate(table.sensors):
        column = table.rise_K[:, j]
        missing = int(np.count_nonzero(~np.isfinite(column)))
        if missing == n:
            reason = "no reading in the campaigns of this axis"
        elif missing > MISSING_SHARE * n:
            reason = f"no reading at {missing} of {n} states"
        elif not np.nanmax(column) > np.nanmin(column):
            reason = "does not change"
        else:
            usable.append(j)
            continue
        excluded.append(StrategyDecision(sensor, False, float("nan"), reason))
    return usable, tuple(excluded)


def _with_excluded(result: AxisKeyPoints, excluded: tuple[StrategyDecision, ...]) -> AxisKeyPoints:
    """Every sensor appears in the first table, those that could not be used at its end."""
    first, *others = result.tables
    return replace(result, tables=(replace(first, decisions=first.decisions + excluded), *others))


def _voting(
    table: ParameterTable, sensors: tuple[str, ...], rise_K: Floats, r: Floats, count: Floats
) -> tuple[list[bool], tuple[tuple[str, str], ...]]:
    """Which parameters vote, and for the others the reason."""
    independent = effective_count(table.value, rise_K, count, table.campaign)
    p = np.minimum(p_value(r, independent) * max(len(sensors), 1), 1.0)
    votes: list[bool] = []
    left_out: list[tuple[str, str]] = []
    for i, name in enumerate(table.names):
        if not np.isfinite(r[i]).any():
            known = np.count_nonzero(np.isfinite(table.value[:, i]))
            reason = f"does not change, or has too few values ({known})" if sensors else "no sensor can be used"
            votes.append(False)
            left_out.append((name, reason))
            continue
        best = int(np.argmin(p[i]))
        best = int(np.nanargmax(np.abs(r[i]))) if p[i, best] >= 1.0 else best
        votes.append(bool(p[i, best] <= SIGNIFICANCE))
        if not votes[-1]:
            n, n_eff = int(count[i, best]), float(independent[i, best])
            same = f"{n} states" if n_eff == n else f"{n} states worth {n_eff:.0f} independent ones"
            left_out.append(
                (
                    name,
                    f"not significant: best |r| {abs(r[i, best]):.2f} ({sensors[best]}), p = {p[i, best]:.2g} over"
                    f" {len(sensors)} sensor{'s' if len(sensors) > 1 else ''} and {same}",
                )
            )
    return votes, tuple(left_out)


def _fewest(
    table: ParameterTable,
    rise_K: Floats,
    sensors: tuple[str, ...],
    candidates: tuple[str, ...],
    votes: list[bool],
    max_key_points: int,
) -> StrategyTable:
    """The forward step on the states in which every candidate was read."""
    columns = [sensors.index(s) for s in candidates]
    rows = np.isfinite(rise_K[:, columns]).all(axis=1)
    target, owner = line_targets(table, votes)
    rows &= np.isfinite(target).any(axis=1) if target.size else False
    n = int(np.count_nonzero(rows))
    limit = min(max_key_points, max(n // STATES_PER_INPUT, 1), FEW_STATES_INPUTS if n < FEW_STATES else max_key_points)
    fold = fold_numbers(table.campaign[rows])
    hold_out = HoldOut(rise_K[rows][:, columns], target[rows], owner, fold.index)
    fewest = strategies.fewest_sensors(table.axis, candidates, hold_out.rms_um, limit, fold.in_words)
    if n >= FEW_STATES:
        return fewest
    warning = f"; only {n} states, so chance can look like a cause: measure more before trusting it"
    return replace(
        fewest, decisions=tuple(replace(v, reason=v.reason + warning) if v.stays else v for v in fewest.decisions)
    )

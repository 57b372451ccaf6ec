"""Hold-out validation of the model and its baselines: everything is chosen again inside every fold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Bools, Floats, Ints
from thetacomp.axis_states import AxisStates, Samples
from thetacomp.errors import AnalysisError
from thetacomp.fitting.key_point_law import AnyProcedure, Predictor
from thetacomp.folds import Fold, training_states
from thetacomp.validation.outcome import NOTHING, HeldOutStates, ValidationRow

ALL_CAMPAIGNS = "all"


@dataclass(frozen=True)
class AxisTask:
    """One axis to judge: its states, the kind of split and its folds, and its Cartesian direction."""

    states: AxisStates
    split: str
    folds: tuple[Fold, ...]
    cartesian: str


@dataclass(frozen=True)
class Residuals:
    """Held-out samples of one component and model, (n,): error before and after in µm, state, campaign and position.

    `half_width_um` is the model's 95 % interval, NaN where the model states none.
    """

    component: str
    model: str
    split: str
    state: Ints
    campaign: Ints
    position_mm: Floats
    before_um: Floats
    after_um: Floats
    half_width_um: Floats
    in_sample_um: Floats


def held_out_residuals(
    states: AxisStates, split: str, folds: Sequence[Fold], procedures: Mapping[str, AnyProcedure]
) -> tuple[Residuals, ...]:
    """Residuals of every component and procedure over all folds; `nothing` comes first.

    A procedure that a fold cannot support (too few states) is left out as a whole.
    """
    tested = np.unique(np.concatenate([fold.test for fold in folds]))
    out = [_nothing(states, split, c, tested) for c in range(len(states.components))]
    for name, procedure in procedures.items():
        try:
            fitted = [(fold, procedure(training_states(states, fold))) for fold in folds]
            whole = procedure(states)
        except AnalysisError:
            continue
        out += [_residuals(states, split, c, name, fitted, whole) for c in range(len(states.components))]
    return tuple(out)


def _nothing(states: AxisStates, split: str, component: int, tested: Ints) -> Residuals:
    samples = states.samples[component]
    chosen = _judged(states, samples, tested)
    value = samples.value_um[chosen]
    nan = np.full(len(value), np.nan)
    state = samples.state[chosen]
    at_mm = _position_mm(states, samples.lever_m[chosen])
    return Residuals(
        states.components[component], NOTHING, split, state, states.campaign[state], at_mm, value, value, nan, value
    )


def _residuals(
    states: AxisStates,
    split: str,
    component: int,
    name: str,
    fitted: Sequence[tuple[Fold, Predictor]],
    whole: Predictor,
) -> Residuals:
    samples, label = states.samples[component], states.components[component]
    parts = []
    for fold, model in fitted:
        chosen = _judged(states, samples, fold.test)
        value, half_width = model.predict(label, states, samples.take(chosen))
        parts.append((np.flatnonzero(chosen), value, half_width))
    rows = np.concatenate([part[0] for part in parts])
    order = np.argsort(rows, kind="stable")
    rows = rows[order]
    predicted = np.concatenate([part[1] for part in parts])[order]
    half_width = np.concatenate([part[2] for part in parts])[order]
    value = samples.value_um[rows]
    flattering, _ = whole.predict(label, states, samples.take(rows))
    known = np.isfinite(predicted)
    state = samples.state[rows][known]
    return Residuals(
        component=label,
        model=name,
        split=split,
        state=state,
        campaign=states.campaign[state],
        position_mm=_position_mm(states, samples.lever_m[rows][known]),
        before_um=value[known],
        after_um=(value - predicted)[known],
        half_width_um=half_width[known],
        in_sample_um=(value - flattering)[known],
    )


def _position_mm(states: AxisStates, lever_m: Floats) -> Floats:
    return states.p0_mm + 1000.0 * lever_m


def _judged(states: AxisStates, samples: Samples, tested: Ints) -> Bools:
    """Samples of the tested states; a cold state that is zero by definition proves nothing and is left out."""
    chosen = np.isin(samples.state, tested)
    return chosen & ~states.cold[samples.state] if states.exact_zero else chosen


def rows_of(residuals: Residuals, campaigns: Sequence[str]) -> tuple[ValidationRow, ...]:
    """One row a campaign and, where there are several, one over `all`."""
    groups = _by_campaign(residuals.campaign, campaigns)
    return tuple(_row(residuals, residuals.component, name, chosen) for name, chosen in groups)


def pooled(rows: Sequence[ValidationRow]) -> list[ValidationRow]:
    """Of each component the rows over all campaigns, or those of its campaigns where there are none."""
    over_all = {row.component for row in rows if row.campaign == ALL_CAMPAIGNS}
    return [row for row in rows if row.campaign == ALL_CAMPAIGNS or row.component not in over_all]


def _by_campaign(campaign: Ints, names: Sequence[str]) -> list[tuple[str, Bools]]:
    """Name and rows of every campaign that occurs, and of `all` where there are several."""
    present = np.unique(campaign)
    groups = [(names[index], campaign == index) for index in present]
    if len(present) > 1:
        groups.append((ALL_CAMPAIGNS, np.ones(len(campaign), dtype=bool)))
    return groups


def _row(residuals: Residuals, component: str, campaign: str, chosen: np.ndarray) -> ValidationRow:
    inside = np.abs(residuals.after_um[chosen]) <= residuals.half_width_um[chosen]
    stated = np.isfinite(residuals.half_width_um[chosen])
    coverage = 100.0 * float(inside[stated].mean()) if stated.any() else float("nan")
    return _figures(
        component,
        campaign,
        residuals,
        np.abs(residuals.before_um[chosen]),
        np.abs(residuals.after_um[chosen]),
        np.abs(residuals.in_sample_um[chosen]),
        coverage,
    )


def _figures(
    component: str, campaign: str, origin: Residuals, before: Floats, after: Floats, in_sample: Floats, coverage: float
) -> ValidationRow:
    max_before, max_after = float(before.max()), float(after.max())
    fitted = in_sample[np.isfinite(in_sample)]  # the stored model may use a sensor that this campaign does not have
    return ValidationRow(
        component=component,
        campaign=campaign,
        model=origin.model,
        split=origin.split,
        n=len(before),
        max_before_um=max_before,
        max_after_um=max_after,
        p95_before_um=float(np.quantile(before, 0.95)),
        p95_after_um=float(np.quantile(after, 0.95)),
        rms_before_um=float(np.sqrt(np.mean(before**2))),
        rms_after_um=float(np.sqrt(np.mean(after**2))),
        reduction_percent=100.0 * (1.0 - max_after / max_before) if max_before > 0 else float("nan"),
        coverage_percent=coverage,
        rms_in_sample_um=float(np.sqrt(np.mean(fitted**2))) if len(fitted) else float("nan"),
    )


def column_rows(states: AxisStates, residuals: Sequence[Residuals], cartesian: str) -> tuple[ValidationRow, ...]:
    """Column deviation: for every state the largest deviation of the tool over the column's travel.

    Applies to the axis that moves along Y; `column_X` comes from its error in X, `column_Z` from that in Z. The
    figures are the maximum, p95 and RMS over the states.
    """
    if cartesian != "Y":
        return ()
    rows: list[ValidationRow] = []
    for item in residuals:
        direction = item.component[1]
        if direction not in ("X", "Z"):
            continue
        present, before, after, in_sample = _largest_by_state(item)
        worst = np.column_stack([before, after, in_sample])
        for name, chosen in _by_campaign(states.campaign[present], states.campaigns):
            before, after, in_sample = worst[chosen].T
            rows.append(_figures(f"column_{direction}", name, item, before, after, in_sample, float("nan")))
    return tuple(rows)


def held_out_states(states: AxisStates, residuals: Sequence[Residuals], model: str) -> tuple[HeldOutStates, ...]:
    """The largest error of every held-out state before and after one model, component by component and campaign."""
    out = []
    for item in residuals:
        if item.model != model:
            continue
        present, before, after, _ = _largest_by_state(item)
        for index in np.unique(states.campaign[present]):
            rows = states.campaign[present] == index
            out.append(
                HeldOutStates(
                    item.component, states.campaigns[index], states.t_s[present[rows]], before[rows], after[rows]
                )
            )
    return tuple(out)


def _largest_by_state(item: Residuals) -> tuple[Ints, Floats, Floats, Floats]:
    """The states, and the largest |error| of each before, after and in-sample."""
    present, index = np.unique(item.state, return_inverse=True)
    largest = []
    for values in (item.before_um, item.after_um, item.in_sample_um):
        out = np.zeros(len(present))
        np.maximum.at(out, index, np.abs(values))
        largest.append(out)
    return present, largest[0], largest[1], largest[2]

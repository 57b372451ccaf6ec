"""The comparison table: every family with the folds of the validation, with the stored model and the clock."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

from thetacomp.axis_states import AxisStates
from thetacomp.errors import AnalysisError
from thetacomp.fitting.key_point_law import AnyProcedure, Predictor, clock
from thetacomp.fitting.ridge import STRENGTHS
from thetacomp.model.document import AxisLaw
from thetacomp.validation.families.choice import FamilyModel, family_procedure
from thetacomp.validation.families.comparison_row import BASELINE, COMPARISON_ONLY, STORED, ComparisonRow
from thetacomp.validation.families.family import LAGS, Family
from thetacomp.validation.joint_view import with_drift
from thetacomp.validation.outcome import CLOCK, DEFAULT, KEY_POINTS, NOTHING, ValidationRow
from thetacomp.validation.validate import AxisTask, column_rows, held_out_residuals, pooled, rows_of


def compare_families(
    tasks: Sequence[AxisTask],
    everything: Sequence[AxisStates],
    history: Mapping[str, AxisLaw],
    standing: Mapping[str, AnyProcedure],
    validation: Sequence[ValidationRow],
    progress: Callable[[str], None],
    families: Sequence[Family],
) -> tuple[tuple[ComparisonRow, ...], tuple[str, ...]]:
    """Rows of all axes over all held-out campaigns, and notes on what could not be compared.

    `standing` names the procedures of the stored laws, `history` the axes with a heat-history model; their held-out
    figures come from `validation`.
    """
    rows: list[ComparisonRow] = []
    notes: list[str] = []
    for task in tasks:
        label = task.states.label
        found: list[ComparisonRow] = []
        left_out = []
        for family in families:
            progress(f"comparing families: {label}, {family.name}")
            own = _family_rows(task, everything, family)
            found += own
            left_out += [] if own else [family.name]
        if left_out:
            notes.append(
                f"comparison of families, {label}: {', '.join(left_out)} left out: no setting could be fitted, or"
                " too few campaigns train in a fold; settings are chosen by holding out one of at least two"
            )
        if found:
            beside = _standing_rows(task, everything, history, standing, validation)
            known = {row.component for row in found}
            rows += [row for row in beside if row.component in known] + found
    return tuple(rows), tuple(notes)


class _Watched:
    """A procedure that keeps the seconds and the model of its last call, which is the one on all campaigns."""

    def __init__(self, procedure: AnyProcedure) -> None:
        self._procedure = procedure
        self.seconds, self.scored = 0.0, 0

    def __call__(self, states: AxisStates) -> Predictor:
        began_s = time.perf_counter()
        model = self._procedure(states)
        self.seconds = time.perf_counter() - began_s
        own = getattr(model, "own", model)  # the joint form adds the drift to the axis
        self.scored = own.scored if isinstance(own, FamilyModel) else 0
        return model


def _family_rows(task: AxisTask, everything: Sequence[AxisStates], family: Family) -> list[ComparisonRow]:
    judged, procedures = with_drift(task.states, everything, {family.name: family_procedure(family)})
    watched = _Watched(procedures[family.name])
    residuals = held_out_residuals(judged, task.split, task.folds, {family.name: watched})
    own = [item for item in residuals if item.model != NOTHING]
    rows = [row for item in own for row in rows_of(item, judged.campaigns)]
    rows += column_rows(judged, own, task.cartesian)
    layout = task.states.layout
    speed = family.inputs == LAGS and layout is not None and bool(layout.speed_powers)
    inputs = "rises, lags, speed" if speed else family.inputs
    described = f"{inputs}; {family.remark}" if family.remark else inputs
    return [
        _row(row, family.name, COMPARISON_ONLY, described, watched.scored, family.max_rows, watched.seconds)
        for row in pooled(rows)
    ]


def _standing_rows(
    task: AxisTask,
    everything: Sequence[AxisStates],
    history: Mapping[str, AxisLaw],
    standing: Mapping[str, AnyProcedure],
    validation: Sequence[ValidationRow],
) -> list[ComparisonRow]:
    """The stored model, its law on key points and the clock: their held-out figures stand in the validation."""
    axis = task.states.axis
    stored = history.get(axis)
    told = {
        DEFAULT: (STORED, "rises, lags, speed" if stored and stored.layout.speed_powers else "rises and lags"),
        KEY_POINTS: (STORED, "rises of key points"),
        CLOCK: (BASELINE, "elapsed time"),
    }
    components = {*task.states.components, *(("column_X", "column_Z") if task.cartesian == "Y" else ())}
    procedures = with_drift(task.states, everything, {**standing, CLOCK: clock})[1]
    out = []
    for name, (use, inputs) in told.items():
        # Without heat history the default is the law on key points: it stands once.
        source = DEFAULT if name == KEY_POINTS and stored is None else name
        if (name == DEFAULT and stored is None) or name not in procedures:
            continue
        watched = _Watched(procedures[name])
        try:
            watched(task.states)
        except AnalysisError:
            continue
        count = (
            (stored.candidates or 1) * len(STRENGTHS) if name == DEFAULT and stored else 1 if name == CLOCK else None
        )
        rows = [
            row for row in validation if row.split == task.split and row.model == source and row.component in components
        ]
        out += [_row(row, name, use, inputs, count, 0, watched.seconds) for row in pooled(rows)]
    return out


def _row(
    row: ValidationRow, family: str, use: str, inputs: str, configurations: int | None, most_rows: int, fit_s: float
) -> ComparisonRow:
    return ComparisonRow(
        component=row.component,
        campaign=row.campaign,
        family=family,
        use=use,
        inputs=inputs,
        configurations=configurations,
        rows_per_campaign=most_rows,
        fit_s=fit_s,
        n=row.n,
        max_before_um=row.max_before_um,
        max_after_um=row.max_after_um,
        p95_before_um=row.p95_before_um,
        p95_after_um=row.p95_after_um,
        rms_before_um=row.rms_before_um,
        rms_after_um=row.rms_after_um,
        rms_in_sample_um=row.rms_in_sample_um,
    )

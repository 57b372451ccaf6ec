"""Quality of trained models: held out with every baseline, against chance, and in a table of checks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thetacomp.axis_states import AxisStates
from thetacomp.fitting.key_point_law import AnyProcedure, all_sensors, clock, training_mean
from thetacomp.fitting.procedures import key_point_procedure
from thetacomp.fitting.training import Procedures, Trained
from thetacomp.folds import Fold, forward_in_time, main_split, training_states
from thetacomp.model.document import ModelDocument
from thetacomp.preparation import Prepared, Progress
from thetacomp.validation.acceptance import (
    MAX_CLOCK_RATIO,
    acceptance_checks,
    acceptance_of_static_law,
    fit_for_use,
    in_words,
)
from thetacomp.validation.harm import harm_notes
from thetacomp.validation.joint_view import with_drift
from thetacomp.validation.outcome import (
    ALL_SENSORS,
    CLOCK,
    DEFAULT,
    KEY_POINTS,
    ONE_SENSOR,
    TRAINING_MEAN,
    AcceptanceCheck,
    HeldOutStates,
    PermutationTest,
    ValidationRow,
)
from thetacomp.validation.permutation import permutation_test
from thetacomp.validation.validate import (
    ALL_CAMPAIGNS,
    AxisTask,
    Residuals,
    column_rows,
    held_out_residuals,
    held_out_states,
    rows_of,
)
from thetacomp.validation.verdict import with_verdict

SEED = 20120951
FORWARD = "forward"


@dataclass(frozen=True, repr=False)
class Judged:
    """A model with what validation found: `model` holds its held-out figures and the checks that failed.

    `held_out` is the default model on states that it has not seen. `permutations` are absent where too few states
    exist to shuffle.
    """

    model: ModelDocument
    validation: tuple[ValidationRow, ...]
    held_out: tuple[HeldOutStates, ...]
    permutations: tuple[PermutationTest, ...]
    acceptance: tuple[AcceptanceCheck, ...]

    def __repr__(self) -> str:
        return f"Judged: {self.model.machine or 'machine'}, {verdict_in_words(self.acceptance)}"


def judge(prepared: Prepared, trained: Trained, progress: Progress = lambda message: None) -> Judged:
    """Repeat the whole training inside every fold, for the model and each baseline, and make the acceptance checks."""
    progress("validating on held-out data")
    residuals: list[Residuals] = []
    rows: list[ValidationRow] = []
    by_state: list[HeldOutStates] = []
    notes = list(prepared.notes)
    stored = {model.axis: model.inputs for _, model in trained.fitted}
    for task in axis_tasks(prepared):
        judged, own = _held_out(prepared, trained, task)
        for item in own:
            rows += rows_of(item, judged.campaigns)
        rows += column_rows(judged, own, task.cartesian)
        by_state += held_out_states(judged, [item for item in own if item.split != FORWARD], DEFAULT)
        residuals += own
        notes += _fold_notes(task, trained.procedures, stored.get(task.states.axis, ()))
    permutations = _permutations(prepared)
    known = [r for r in residuals if r.split != FORWARD]
    known_rows = [row for row in rows if row.split != FORWARD]
    acceptance = acceptance_checks(known, known_rows, permutations, trained.model)
    static = (
        acceptance_of_static_law(known, known_rows, permutations, trained.model) if trained.model.prediction else ()
    )
    notes += [*harm_notes(known), *_clock_notes(known_rows)]
    model = with_verdict(trained.model, known_rows, _failed(acceptance), _failed(static), notes)
    return Judged(model, tuple(rows), tuple(by_state), permutations, acceptance)


def axis_tasks(prepared: Prepared) -> tuple[AxisTask, ...]:
    """Every axis with the folds that judge it."""
    cartesian = {axis.name: axis.cartesian for axis in prepared.folder.machine.axes}
    return tuple(
        AxisTask(states, *main_split(states, prepared.test), cartesian.get(states.axis, ""))
        for states in prepared.everything
    )


def verdict_in_words(acceptance: Sequence[AcceptanceCheck]) -> str:
    """One line: fit for use or not."""
    if fit_for_use(acceptance):
        return f"fit for use: all {len(acceptance)} acceptance checks passed"
    return f"not fit for use: {len(_failed(acceptance))} of {len(acceptance)} acceptance checks failed"


def judged_procedures(prepared: Prepared, trained: Trained, states: AxisStates) -> dict[str, AnyProcedure]:
    """What an axis is judged by: the default as it is stored, the law on key points beside it, and the baselines."""
    made = trained.procedures
    procedures: dict[str, AnyProcedure] = {DEFAULT: made.key_points}
    if states.axis in trained.model.prediction:
        procedures = {DEFAULT: made.history, KEY_POINTS: made.key_points}
    procedures |= {CLOCK: clock, ONE_SENSOR: made.paper, ALL_SENSORS: all_sensors}
    if prepared.folder.campaign(states.campaigns[0]).settings.datum == "common":
        procedures[TRAINING_MEAN] = training_mean
    return procedures


def _held_out(prepared: Prepared, trained: Trained, task: AxisTask) -> tuple[AxisStates, tuple[Residuals, ...]]:
    """Residuals of one axis, held out by its main split and forward in time, and the states that they belong to."""
    states = task.states
    # In the joint form a point of a sweep is judged with the drift of its moment: the whole error of the tool.
    judged, procedures = with_drift(states, prepared.everything, judged_procedures(prepared, trained, states))
    forward = _new_folds(forward_in_time(states), task.folds)
    splits = [(kind, some) for kind, some in ((task.split, task.folds), (FORWARD, forward)) if some]
    return judged, tuple(r for kind, some in splits for r in held_out_residuals(judged, kind, some, procedures))


def _new_folds(some: Sequence[Fold], known: Sequence[Fold]) -> list[Fold]:
    """Folds that are not among the known ones: of two campaigns the forward split repeats the second hold-out."""
    return [fold for fold in some if not any(np.array_equal(fold.test, other.test) for other in known)]


def _fold_notes(task: AxisTask, procedures: Procedures, stored: tuple[str, ...]) -> list[str]:
    """Where the folds chose other sensors than the stored model, its held-out figures are those of its relatives."""
    chosen = [procedures.key_points(training_states(task.states, fold)).inputs for fold in task.folds]
    others = {inputs for inputs in chosen if set(inputs) != set(stored)}
    if not others:
        return []
    listed = "; ".join(", ".join(inputs) or "none" for inputs in sorted(others))
    count = sum(set(inputs) != set(stored) for inputs in chosen)
    return [
        f"{task.states.label}: the stored model uses {', '.join(stored) or 'no sensor'}, but {count} of"
        f" {len(task.folds)} folds chose otherwise ({listed}); the held-out figures judge the way of choosing, not this"
        " very set of sensors"
    ]


def _clock_notes(rows: Sequence[ValidationRow]) -> list[str]:
    """Components in which the clock does about as well: the acceptance table judges an axis as a whole."""
    pooled = {(r.component, r.model): r.rms_after_um for r in rows if r.campaign == ALL_CAMPAIGNS}
    notes = []
    for (component, model), after_um in pooled.items():
        clock_um = pooled.get((component, CLOCK), float("nan"))
        if model in (DEFAULT, KEY_POINTS) and after_um > MAX_CLOCK_RATIO * clock_um:
            name = "the model" if model == DEFAULT else "the law on key points"
            notes.append(
                f"{component}: {name} leaves {after_um:.1f} µm RMS held out, the clock alone {clock_um:.1f} µm"
            )
    return notes


def _permutations(prepared: Prepared) -> tuple[PermutationTest, ...]:
    rng = np.random.default_rng(SEED)
    procedure = key_point_procedure(prepared.folder.machine)
    tests = (permutation_test(states, procedure, rng) for states in prepared.training)
    return tuple(test for test in tests if test is not None)


def _failed(checks: Sequence[AcceptanceCheck]) -> tuple[str, ...]:
    return tuple(in_words(check) for check in checks if not check.passed)

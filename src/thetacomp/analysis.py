"""The spine of the analysis wing, readable from top to bottom: screen, separate, choose, fit, validate."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from thetacomp.analysis_result import Analysis
from thetacomp.campaign import Campaign, MachineFolder
from thetacomp.errors import AnalysisError
from thetacomp.fitting.build import build_document
from thetacomp.fitting.calibrated import calibrated_history
from thetacomp.fitting.fallbacks import AxisFallback, axis_fallbacks
from thetacomp.fitting.folds import Fold, forward_in_time, hold_out, named_test, training_states
from thetacomp.fitting.history_model import MIN_CAMPAIGNS
from thetacomp.fitting.key_point_law import AnyProcedure, AxisModel, Procedure, all_sensors, clock, training_mean
from thetacomp.fitting.lost_sensors import with_fallbacks
from thetacomp.fitting.procedures import key_point_procedure, paper_procedure
from thetacomp.fitting.rotations import with_form
from thetacomp.mixtures import refuse_mixtures
from thetacomp.model.document import AxisLaw
from thetacomp.screening.campaigns import screened
from thetacomp.sensors.parameters import correlation_tables, parameter_table
from thetacomp.sensors.sensor_curve import sensor_curves
from thetacomp.separation import ComponentSeparation, separate_all
from thetacomp.separation.reference import cold_block_change_K, reference_time_s
from thetacomp.states import AxisStates, axis_states
from thetacomp.temperature.field import sensor_rises
from thetacomp.temperature.layout import layout_checks
from thetacomp.validation.acceptance import (
    DEFAULT,
    KEY_POINTS,
    MAX_CLOCK_RATIO,
    acceptance_checks,
    acceptance_of_static_law,
    in_words,
)
from thetacomp.validation.families.rows import ComparisonRow
from thetacomp.validation.joint_view import with_drift
from thetacomp.validation.permutation import permutation_test
from thetacomp.validation.rows import AcceptanceCheck, HeldOutStates, PermutationTest, ValidationRow
from thetacomp.validation.validate import (
    ALL_CAMPAIGNS,
    Residuals,
    column_rows,
    held_out_residuals,
    held_out_states,
    rows_of,
)
from thetacomp.validation.verdict import with_verdict

SEED = 20120951
FORWARD = "forward"
METHOD = "weighted key points with least squares; heat history with averaged block ridge where campaigns suffice"

Progress = Callable[[str], None]


def analyze_folder(
    folder: MachineFolder,
    train: Sequence[str] = (),
    test: Sequence[str] = (),
    progress: Progress = lambda message: None,
    repair: bool = True,
    mix: bool = False,
    compare: bool = False,
) -> Analysis:
    """Run the whole analysis of a machine folder.

    `train` and `test` name campaigns; by default all campaigns train and each is held out in turn. `progress` hears
    one line a step. With `repair` the faulty temperatures and held labels that screening finds are mended or left out,
    else only told. `mix` allows campaigns of different operating modes or active tables in one model. With
    `compare` other families of models are fitted and judged beside the stored one, which takes minutes. Raises
    AnalysisError where the measurements cannot carry an analysis.
    """
    train, test = _chosen(folder, train, test)
    campaigns = [folder.campaign(name) for name in (*train, *test)]
    mixed = refuse_mixtures(campaigns, mix)

    progress("screening temperatures")
    screening = screened(folder, train, test, repair)
    folder, campaigns = screening.folder, [screening.folder.campaign(c.name) for c in campaigns]
    progress("separating geometry and heat")
    separated = separate_all(folder.machine, campaigns)
    separations = separated.components
    if not separations:
        raise AnalysisError(
            "there are no sweeps, parameters or drift in the chosen campaigns: nothing to model."
            " Fix: put sweeps.csv, parameters.csv or drift.csv into a campaign."
        )
    everything = axis_states(folder, separations, [*train, *test])
    training = axis_states(folder, separations, train) if test else everything

    progress("choosing key points and fitting")
    procedure, paper = key_point_procedure(folder.machine), paper_procedure(folder.machine)
    fitted = _fit(training, procedure)
    fitted_paper = _fit_where_possible(training, paper)
    notes = mixed + _notes(campaigns, separations) + separated.notes + _dropped_notes(separations, everything)
    notes += screening.notes
    progress("fitting heat history, and a fallback for every sensor")
    history = _fit_history(folder, separations, train, everything, training, test)
    model = build_document(folder, fitted, METHOD, train, notes, _fallbacks(fitted, procedure), history)
    paper_model = build_document(folder, fitted_paper, "paper: one key sensor, least squares", train, notes)
    model, paper_model = (
        with_form(document, folder, separated, some, train)
        for document, some in ((model, fitted), (paper_model, fitted_paper))
    )

    progress("validating on held-out data")
    residuals, rows, held_out, fold_notes = _validate(
        folder, everything, test, fitted, model.prediction, procedure, paper
    )
    permutations = _permutations(training, procedure)
    judged = [r for r in residuals if r.split != FORWARD]
    judged_rows = [row for row in rows if row.split != FORWARD]
    acceptance = acceptance_checks(judged, judged_rows, permutations, model)
    static = acceptance_of_static_law(judged, judged_rows, permutations, model) if model.prediction else ()
    notes += fold_notes + _clock_notes(judged_rows)
    model = with_verdict(model, judged_rows, _failed(acceptance), _failed(static), notes)
    curves = sensor_curves(training, progress)
    compared, compare_notes = (
        _compare(folder, everything, test, model.prediction, procedure, rows, progress) if compare else ((), ())
    )
    parameter_correlations, sensor_correlations = correlation_tables([parameter_table(s) for s in training])
    return Analysis(
        folder=folder,
        rises=sensor_rises(folder),
        layout=layout_checks(folder),
        separations=separations,
        parameter_correlations=parameter_correlations,
        sensor_correlations=sensor_correlations,
        key_points=tuple(m.key_points for _, m in fitted if m.key_points is not None),
        model=model,
        paper_model=paper_model,
        validation=rows,
        permutations=permutations,
        acceptance=acceptance,
        notes=notes + compare_notes,
        held_out=held_out,
        angles=separated.angles,
        screening=screening,
        comparison=compared,
        sensor_curves=curves,
    )


def _chosen(folder: MachineFolder, train: Sequence[str], test: Sequence[str]) -> tuple[list[str], list[str]]:
    known = [campaign.name for campaign in folder.campaigns]
    unknown = [name for name in (*train, *test) if name not in known]
    if unknown:
        raise AnalysisError(
            f"there is no campaign {', '.join(unknown)}; the folder has {', '.join(known)}."
            " Fix: use these names with --train and --test."
        )
    twice = sorted({name for names in (train, test) for name in names if list(names).count(name) > 1})
    if twice:
        raise AnalysisError(f"campaign {', '.join(twice)} is named twice. Fix: name every campaign once.")
    both = sorted(set(train) & set(test))
    if both:
        raise AnalysisError(f"campaign {', '.join(both)} is named in --train and in --test. Fix: name it once.")
    # In the order of the folder, which is the order of time for the forward split.
    chosen = [name for name in known if name in set(train or known) and name not in set(test)]
    if not chosen:
        raise AnalysisError("no campaign is left for training. Fix: leave one out of --test.")
    return chosen, [name for name in known if name in set(test)]


def _fit(training: Sequence[AxisStates], procedure: Procedure) -> list[tuple[AxisStates, AxisModel]]:
    return [(states, procedure(states)) for states in training]


def _fit_history(
    folder: MachineFolder,
    separations: Sequence[ComponentSeparation],
    train: Sequence[str],
    everything: Sequence[AxisStates],
    training: Sequence[AxisStates],
    test: Sequence[str],
) -> tuple[AxisLaw, ...]:
    """Models on heat history for the axes that have enough campaigns to choose everything inside and to hold out."""
    enough = {s.axis for s in everything if _has_history(s, _main_folds(s, test))}
    return tuple(
        with_fallbacks(folder, separations, train, states, calibrated_history(states))
        for states in training
        if states.axis in enough
    )


def _fallbacks(fitted: Sequence[tuple[AxisStates, AxisModel]], procedure: Procedure) -> tuple[AxisFallback, ...]:
    """The law on key temperatures again without each of its sensors, judged by the training states alone."""
    made: list[AxisFallback] = []
    for states, model in fitted:
        folds = [(fold.train, fold.test) for fold in hold_out(states)[1]]
        made += axis_fallbacks(states, model, procedure, folds)
    return tuple(made)


def _has_history(states: AxisStates, folds: Sequence[Fold]) -> bool:
    """A model on heat history holds out campaigns inside its training, so every fold must train on enough of them."""
    trained = [len(np.unique(states.campaign[fold.train])) for fold in folds]
    return states.layout is not None and min(trained, default=0) >= MIN_CAMPAIGNS


def _main_folds(states: AxisStates, test: Sequence[str]) -> tuple[Fold, ...]:
    return named_test(states, test) if test else hold_out(states)[1]


def _failed(checks: Sequence[AcceptanceCheck]) -> tuple[str, ...]:
    return tuple(in_words(check) for check in checks if not check.passed)


def _fit_where_possible(training: Sequence[AxisStates], procedure: Procedure) -> list[tuple[AxisStates, AxisModel]]:
    """The paper's model stands beside ours: an axis that it cannot serve does not stop the analysis."""
    fitted = []
    for states in training:
        try:
            fitted.append((states, procedure(states)))
        except AnalysisError:
            continue
    return fitted


def _dropped_notes(separations: Sequence[ComponentSeparation], everything: Sequence[AxisStates]) -> tuple[str, ...]:
    """Components that were measured in some campaigns of their axis only: they are not in the model."""
    kept = {component for states in everything for component in states.components}
    measured: dict[str, list[str]] = {}
    for s in separations:
        measured.setdefault(s.component, []).append(s.campaign)
    return tuple(
        f"{component} was measured in {', '.join(names)} only, not in all campaigns of its axis: it is not modelled"
        for component, names in measured.items()
        if component not in kept
    )


def _validate(
    folder: MachineFolder,
    everything: Sequence[AxisStates],
    test: Sequence[str],
    fitted: Sequence[tuple[AxisStates, AxisModel]],
    history: Mapping[str, AxisLaw],
    procedure: Procedure,
    paper: Procedure,
) -> tuple[list[Residuals], tuple[ValidationRow, ...], tuple[HeldOutStates, ...], tuple[str, ...]]:
    """Hold out by campaign or state, and forward in time, with every baseline beside the model."""
    residuals: list[Residuals] = []
    rows: list[ValidationRow] = []
    by_state: list[HeldOutStates] = []
    notes: list[str] = []
    stored = {model.axis: model.inputs for _, model in fitted}
    for states in everything:
        procedures: dict[str, AnyProcedure] = {DEFAULT: procedure}
        if states.axis in history:
            procedures = {DEFAULT: calibrated_history, KEY_POINTS: procedure}
        procedures |= {"clock": clock, "one_sensor": paper, "all_sensors": all_sensors}
        if folder.campaign(states.campaigns[0]).settings.datum == "common":
            procedures["training_mean"] = training_mean
        split, folds = "test" if test else hold_out(states)[0], _main_folds(states, test)
        own: list[Residuals] = []
        # In the joint form a point of a sweep is judged with the drift of its moment: the whole error of the tool.
        judged, procedures = with_drift(states, everything, procedures)
        for kind, some in ((split, folds), (FORWARD, _new_folds(forward_in_time(states), folds))):
            if some:
                own += held_out_residuals(judged, kind, some, procedures)
        notes += _fold_notes(states, folds, procedure, stored.get(states.axis, ()))
        cartesian = next((a.cartesian for a in folder.machine.axes if a.name == states.axis), "")
        for item in own:
            rows += rows_of(item, states.campaigns)
        rows += column_rows(judged, own, cartesian)
        by_state += held_out_states(states, [item for item in own if item.split != FORWARD], DEFAULT)
        residuals += own
    return residuals, tuple(rows), tuple(by_state), tuple(notes)


def _compare(
    folder: MachineFolder,
    everything: Sequence[AxisStates],
    test: Sequence[str],
    history: Mapping[str, AxisLaw],
    procedure: Procedure,
    rows: Sequence[ValidationRow],
    progress: Progress,
) -> tuple[tuple[ComparisonRow, ...], tuple[str, ...]]:
    """Families of models beside the stored one, with the folds of the main hold-out."""
    from thetacomp.validation.families.compare import AxisTask, compare_families  # loads scikit-learn
    from thetacomp.validation.families.families import FAMILIES

    cartesian = {axis.name: axis.cartesian for axis in folder.machine.axes}
    tasks = [
        AxisTask(s, "test" if test else hold_out(s)[0], _main_folds(s, test), cartesian.get(s.axis, ""))
        for s in everything
    ]
    standing: dict[str, AnyProcedure] = {DEFAULT: calibrated_history, KEY_POINTS: procedure}
    return compare_families(tasks, everything, history, standing, rows, progress, FAMILIES)


def _new_folds(some: Sequence[Fold], known: Sequence[Fold]) -> list[Fold]:
    """Folds that are not among the known ones: of two campaigns the forward split repeats the second hold-out."""
    return [fold for fold in some if not any(np.array_equal(fold.test, other.test) for other in known)]


def _fold_notes(states: AxisStates, folds: Sequence[Fold], procedure: Procedure, stored: tuple[str, ...]) -> list[str]:
    """Where the folds chose other sensors than the stored model, its held-out figures are those of its relatives."""
    chosen = [procedure(training_states(states, fold)).inputs for fold in folds]
    others = {inputs for inputs in chosen if set(inputs) != set(stored)}
    if not others:
        return []
    label = f"axis {states.axis}" if states.axis else "drift"
    told = "; ".join(", ".join(inputs) or "none" for inputs in sorted(others))
    count = sum(set(inputs) != set(stored) for inputs in chosen)
    return [
        f"{label}: the stored model uses {', '.join(stored) or 'no sensor'}, but {count} of {len(folds)} folds chose"
        f" otherwise ({told}); the held-out figures judge the way of choosing, not this very set of sensors"
    ]


def _clock_notes(rows: Sequence[ValidationRow]) -> tuple[str, ...]:
    """Components in which the clock does about as well: the acceptance table judges an axis as a whole."""
    pooled = {(r.component, r.model): r.rms_after_um for r in rows if r.campaign == ALL_CAMPAIGNS}
    told = []
    for (component, model), after_um in pooled.items():
        clock_um = pooled.get((component, "clock"), float("nan"))
        if model in (DEFAULT, KEY_POINTS) and after_um > MAX_CLOCK_RATIO * clock_um:
            name = "the model" if model == DEFAULT else "the law on key points"
            told.append(f"{component}: {name} leaves {after_um:.1f} µm RMS held out, the clock alone {clock_um:.1f} µm")
    return tuple(told)


def _permutations(training: Sequence[AxisStates], procedure: Procedure) -> tuple[PermutationTest, ...]:
    rng = np.random.default_rng(SEED)
    tests = (permutation_test(states, procedure, rng) for states in training)
    return tuple(test for test in tests if test is not None)


def _notes(campaigns: Sequence[Campaign], separations: Sequence[ComponentSeparation]) -> tuple[str, ...]:
    notes = [
        f"sign unproven: campaign {campaign.name} does not state its sign convention; a wrong sign doubles the error"
        for campaign in campaigns
        if campaign.settings.sign == "unproven"
    ]
    notes += [f"origin of campaign {c.name}: {c.settings.origin.strip()}" for c in campaigns if c.settings.origin]
    notes += [
        f"campaign {c.name} was measured while the control applied {', '.join(c.settings.active_tables)} compensation;"
        " these tables must be active whenever the model is used"
        for c in campaigns
        if c.settings.active_tables
    ]
    ties = [(c.name, c.tracker) for c in campaigns if c.tracker is not None]
    notes += [f"campaign {name}, tracker: {note}" for name, tie in ties for note in (*tie.notes, *tie.doubts)]
    notes += [note for campaign in campaigns for note in _cold_notes(campaign)]
    notes += [f"campaign {s.campaign}, {s.component}: {note}" for s in separations for note in s.notes]
    return tuple(dict.fromkeys(notes))


def _cold_notes(campaign: Campaign) -> list[str]:
    """A cold block that warms up is no reference: its heat is taken for geometry."""
    if campaign.sweeps is None:
        return []
    change_K = cold_block_change_K(campaign, reference_time_s(campaign))
    span_K = np.nanmax(campaign.temperatures.value_degC, axis=0) - np.nanmin(campaign.temperatures.value_degC, axis=0)
    moved = np.flatnonzero((np.abs(change_K) > 0.5) & (np.abs(change_K) > 0.1 * span_K))
    if not len(moved):
        return []
    worst = ", ".join(f"{campaign.temperatures.sensor_ids[j]} {change_K[j]:+.1f} K" for j in moved[:4])
    return [
        f"campaign {campaign.name}: {len(moved)} sensors move during the cold block ({worst}), more than a tenth of"
        " their span: part of the thermal error is taken for geometry; measure the cold block before any heat"
    ]


def fit_for_use(acceptance: Sequence[AcceptanceCheck]) -> bool:
    """True where every acceptance check is passed."""
    return all(check.passed for check in acceptance)

"""The spine of the analysis wing, readable from top to bottom: prepare, train, judge, and everything in one result."""

from __future__ import annotations

from collections.abc import Sequence

from thetacomp.analysis_result import AnalysisResult
from thetacomp.campaign import MachineFolder
from thetacomp.fitting.calibrated import calibrated_history
from thetacomp.fitting.key_point_law import AnyProcedure
from thetacomp.fitting.procedures import key_point_procedure
from thetacomp.fitting.training import train as train_models
from thetacomp.preparation import Prepared, Progress, prepare
from thetacomp.sensors.parameters import correlation_tables, parameter_table
from thetacomp.sensors.sensor_curve import sensor_curves
from thetacomp.temperature.field import sensor_rises
from thetacomp.temperature.layout import layout_checks
from thetacomp.validation.families.comparison_row import ComparisonRow
from thetacomp.validation.judge import Judged, axis_tasks, judge
from thetacomp.validation.outcome import DEFAULT, KEY_POINTS


def analyze_folder(
    folder: MachineFolder,
    train: Sequence[str] = (),
    test: Sequence[str] = (),
    progress: Progress = lambda message: None,
    repair: bool = True,
    mix: bool = False,
    compare: bool = False,
) -> AnalysisResult:
    """Run the whole analysis of a machine folder.

    `train` and `test` name campaigns; by default all campaigns train and each is held out in turn. `progress` hears
    one line a step. With `repair` the faulty temperatures and held labels that screening finds are repaired or left
    out, else only reported. `mix` allows campaigns of different operating modes or active tables in one model. With
    `compare` other families of models are fitted and validated alongside the stored one, which takes minutes. Raises
    AnalysisError where the measurements cannot carry an analysis.
    """
    prepared = prepare(folder, train, test, faults="repair" if repair else "tell", mix=mix, progress=progress)
    trained = train_models(prepared, progress=progress)
    judged = judge(prepared, trained, progress)
    curves = sensor_curves(prepared.training, progress)
    compared, compare_notes = _compare(prepared, judged, progress) if compare else ((), ())
    tables = [parameter_table(states) for states in prepared.training]
    parameter_correlations, sensor_correlations = correlation_tables(tables)
    return AnalysisResult(
        folder=prepared.folder,
        rises=sensor_rises(prepared.folder),
        layout=layout_checks(prepared.folder),
        separations=prepared.separated.components,
        parameter_correlations=parameter_correlations,
        sensor_correlations=sensor_correlations,
        key_points=tuple(m.key_points for _, m in trained.fitted if m.key_points is not None),
        model=judged.model,
        paper_model=trained.paper_model,
        validation=judged.validation,
        permutations=judged.permutations,
        acceptance=judged.acceptance,
        notes=judged.model.notes + compare_notes,
        held_out=judged.held_out,
        angles=prepared.separated.angles,
        screening=prepared.screening,
        comparison=compared,
        sensor_curves=curves,
    )


def _compare(
    prepared: Prepared, judged: Judged, progress: Progress
) -> tuple[tuple[ComparisonRow, ...], tuple[str, ...]]:
    """Families of models compared with the stored one, on the folds of the main hold-out."""
    from thetacomp.validation.families.compare import compare_families  # loads scikit-learn
    from thetacomp.validation.families.families import FAMILIES

    # Fitted anew, not taken from the training: the table states how long each takes.
    standing: dict[str, AnyProcedure] = {
        DEFAULT: calibrated_history,
        KEY_POINTS: key_point_procedure(prepared.folder.machine),
    }
    history = judged.model.prediction
    return compare_families(
        axis_tasks(prepared), prepared.everything, history, standing, judged.validation, progress, FAMILIES
    )

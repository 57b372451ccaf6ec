"""The one place that trains: key points and their law, heat history, fallbacks, and the documents of both models."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from thetacomp.axis_states import AxisStates
from thetacomp.errors import AnalysisError
from thetacomp.fitting.build import build_document
from thetacomp.fitting.calibrated import CalibratedHistory, calibrated_history
from thetacomp.fitting.fallbacks import AxisFallback, axis_fallbacks, with_fallbacks
from thetacomp.fitting.fit_cache import CachedProcedure
from thetacomp.fitting.history_model import MIN_CAMPAIGNS
from thetacomp.fitting.key_point_law import AxisModel, Procedure
from thetacomp.fitting.procedures import key_point_procedure, paper_procedure
from thetacomp.fitting.rotations import with_joint_form
from thetacomp.folds import hold_out, main_split
from thetacomp.model.document import AxisLaw, ModelDocument
from thetacomp.preparation import Prepared, Progress

METHOD = "weighted key points with least squares; heat history with averaged block ridge where campaigns suffice"
PAPER_METHOD = "paper: one key sensor, least squares"

Fitted = tuple[tuple[AxisStates, AxisModel], ...]


@dataclass(frozen=True)
class Procedures:
    """What was done to the training states, to be repeated whole inside every fold."""

    key_points: CachedProcedure[AxisModel]
    paper: CachedProcedure[AxisModel]
    history: CachedProcedure[CalibratedHistory]


@dataclass(frozen=True, repr=False)
class Trained:
    """The models of a folder: `model` is the default, `paper_model` the paper's with one key sensor.

    `fitted` and `fitted_paper` are their laws on key temperatures, axis by axis.
    """

    model: ModelDocument
    paper_model: ModelDocument
    fitted: Fitted
    fitted_paper: Fitted
    procedures: Procedures

    def __repr__(self) -> str:
        laws = "; ".join(f"{s.label}: {', '.join(law.inputs) or 'no sensor'}" for s, law in self.fitted)
        with_history = ", ".join(axis or "drift" for axis in self.model.prediction) or "no axis"
        return (
            f"Trained on {', '.join(self.model.training.campaigns)}: {self.model.machine or 'machine'},"
            f" {len(self.model.components)} components, {self.model.form} form\n"
            f"key points of {laws}\n"
            f"heat history: {with_history}"
        )


def train(
    prepared: Prepared,
    axes: Collection[str] | None = None,
    lost: Collection[str] | None = None,
    progress: Progress = lambda message: None,
) -> Trained:
    """Fit everything that is stored on the training states.

    Heat history is fitted for the `axes` ("" is the drift; default all) that have enough campaigns, and the fallbacks
    for the sensors of `lost` (default all; each is fitted on its own and takes its time). Raises AnalysisError where
    the states cannot carry a law.
    """
    progress("choosing key points and fitting")
    machine = prepared.folder.machine
    procedures = Procedures(
        CachedProcedure(key_point_procedure(machine)),
        CachedProcedure(paper_procedure(machine)),
        CachedProcedure(calibrated_history),
    )
    fitted = tuple((states, procedures.key_points(states)) for states in prepared.training)
    fitted_paper = _where_possible(prepared.training, procedures.paper)
    progress("fitting heat history" + (", and a fallback for every sensor" if lost is None else ""))
    history = [
        with_fallbacks(states, procedures.history(states), lost)
        for states in _enough_for_history(prepared)
        if axes is None or states.axis in axes
    ]
    fallbacks = _fallbacks(fitted, procedures.key_points) if lost is None or lost else ()
    return Trained(
        model=_document(prepared, fitted, METHOD, fallbacks, history),
        paper_model=_document(prepared, fitted_paper, PAPER_METHOD),
        fitted=fitted,
        fitted_paper=fitted_paper,
        procedures=procedures,
    )


def _document(
    prepared: Prepared,
    fitted: Fitted,
    method: str,
    fallbacks: Sequence[AxisFallback] = (),
    history: Sequence[AxisLaw] = (),
) -> ModelDocument:
    plain = build_document(prepared.folder, fitted, method, prepared.train, prepared.notes, fallbacks, history)
    return with_joint_form(plain, prepared.folder, prepared.separated, fitted, prepared.train)


def _where_possible(training: Sequence[AxisStates], procedure: Procedure) -> Fitted:
    """The paper's model, for comparison: an axis that it cannot serve does not stop the analysis."""
    fitted = []
    for states in training:
        try:
            fitted.append((states, procedure(states)))
        except AnalysisError:
            continue
    return tuple(fitted)


def _enough_for_history(prepared: Prepared) -> list[AxisStates]:
    """Training states of the axes on which heat history can choose everything inside every fold that judges it.

    It holds out campaigns inside its training, so every fold must train on enough of them.
    """
    enough = set()
    for states in prepared.everything:
        folds = main_split(states, prepared.test)[1]
        campaigns = [len(np.unique(states.campaign[fold.train])) for fold in folds]
        if states.layout is not None and min(campaigns, default=0) >= MIN_CAMPAIGNS:
            enough.add(states.axis)
    return [states for states in prepared.training if states.axis in enough]


def _fallbacks(fitted: Fitted, procedure: Procedure) -> tuple[AxisFallback, ...]:
    """The law on key temperatures again without each of its sensors, judged by the training states alone."""
    made: list[AxisFallback] = []
    for states, model in fitted:
        folds = [(fold.train, fold.test) for fold in hold_out(states)[1]]
        made += axis_fallbacks(states, model, procedure, folds)
    return tuple(made)

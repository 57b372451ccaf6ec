"""One machine's models as `analyze` stores them, without its report and held-out tables, for the axes that are wanted.

Screening, joint form, states, choice and fit are those of every user. A fallback is fitted when its sensor is lost:
`analyze` stores one for each sensor, which takes longer than all the rest.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from thetacomp.analysis import METHOD
from thetacomp.campaign import MachineFolder
from thetacomp.errors import AnalysisError
from thetacomp.fitting.build import build_document
from thetacomp.fitting.calibrated import CalibratedHistory, calibrated_history
from thetacomp.fitting.fallbacks import AxisFallback, axis_fallbacks
from thetacomp.fitting.folds import hold_out
from thetacomp.fitting.history_model import MIN_CAMPAIGNS
from thetacomp.fitting.key_point_law import AxisModel, Procedure
from thetacomp.fitting.lost_sensors import with_fallbacks
from thetacomp.fitting.procedures import key_point_procedure, paper_procedure
from thetacomp.fitting.rotations import with_form
from thetacomp.model.document import AxisLaw, ModelDocument
from thetacomp.screening.campaigns import screened
from thetacomp.separation import Separated, separate_all
from thetacomp.states import DRIFT, AxisStates, axis_states

Fitted = tuple[tuple[AxisStates, AxisModel], ...]


@dataclass(frozen=True)
class Calibration:
    """What a machine was taught by its training campaigns.

    `folder` holds them as screened, `separated` their components, `states` all axes with the drift last. `fitted` are
    the laws on key temperatures, `history` those on heat history of the wanted axes.
    """

    folder: MachineFolder
    train: tuple[str, ...]
    separated: Separated
    states: tuple[AxisStates, ...]
    fitted: Fitted
    fitted_paper: Fitted
    history: tuple[tuple[AxisStates, CalibratedHistory], ...]

    def of_axis(self, axis: str) -> AxisStates:
        """The states of one axis, `DRIFT` for the drift; StopIteration where it was not measured."""
        return next(states for states in self.states if states.axis == axis)


def calibrate(
    folder: MachineFolder, train: Sequence[str], axes: Collection[str], screening: bool = True
) -> Calibration:
    """Teach a machine by the named campaigns; `axes` and the drift get heat history where campaigns suffice.

    Campaigns of several modes are used together, as with `analyze --mix`. Without `screening` the readings are taken
    as they are. Raises AnalysisError where the campaigns cannot carry a model.
    """
    if screening:
        folder = screened(folder, train).folder
    separated = separate_all(folder.machine, [folder.campaign(name) for name in train])
    states = axis_states(folder, separated.components, train)
    paper = paper_procedure(folder.machine)
    procedure = key_point_procedure(folder.machine)
    wanted = [s for s in states if s.axis in {*axes, DRIFT} and _enough_for_history(s)]
    return Calibration(
        folder=folder,
        train=tuple(train),
        separated=separated,
        states=states,
        fitted=tuple((s, procedure(s)) for s in states),
        fitted_paper=_where_possible(states, paper),
        history=tuple((s, calibrated_history(s)) for s in wanted),
    )


def stored_models(taught: Calibration, lost: Collection[str] = ()) -> tuple[ModelDocument, ModelDocument]:
    """The default model and the paper's, as documents, with fallbacks for the sensors of `lost`."""
    folder, components = taught.folder, taught.separated.components
    history = [with_fallbacks(folder, components, taught.train, s, fit, lost) for s, fit in taught.history]
    fallbacks = _fallbacks(taught) if lost else []
    model = _document(taught, taught.fitted, METHOD, fallbacks, history)
    return model, _document(taught, taught.fitted_paper, "paper: one key sensor, least squares", [], [])


def _document(
    taught: Calibration,
    fitted: Fitted,
    method: str,
    fallbacks: Sequence[AxisFallback],
    history: Sequence[AxisLaw],
) -> ModelDocument:
    plain = build_document(taught.folder, fitted, method, taught.train, (), fallbacks, history)
    return with_form(plain, taught.folder, taught.separated, fitted, taught.train)


def _where_possible(states: Sequence[AxisStates], procedure: Procedure) -> Fitted:
    """The paper's method cannot serve every axis: one that it cannot stays without it, as in `analyze`."""
    fitted = []
    for some in states:
        try:
            fitted.append((some, procedure(some)))
        except AnalysisError:
            continue
    return tuple(fitted)


def _fallbacks(taught: Calibration) -> list[AxisFallback]:
    procedure = key_point_procedure(taught.folder.machine)
    made: list[AxisFallback] = []
    for states, model in taught.fitted:
        folds = [(fold.train, fold.test) for fold in hold_out(states)[1]]
        made += axis_fallbacks(states, model, procedure, folds)
    return made


def _enough_for_history(states: AxisStates) -> bool:
    """As in `analyze`: every fold of the hold-out trains on enough campaigns to hold out once more inside."""
    trained = [len(np.unique(states.campaign[fold.train])) for fold in hold_out(states)[1]]
    return states.layout is not None and min(trained, default=0) >= MIN_CAMPAIGNS

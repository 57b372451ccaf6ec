"""Models from measured campaigns by the procedures of `analyze`, without its report, screening and held-out tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thetacomp.analysis import METHOD
from thetacomp.arrays import Floats, Ints
from thetacomp.campaign import MachineFolder
from thetacomp.fitting.build import build_document
from thetacomp.fitting.calibrated import calibrated_history
from thetacomp.fitting.procedures import key_point_procedure, paper_procedure
from thetacomp.model.document import ModelDocument
from thetacomp.model.temperatures import Duty
from thetacomp.separation import separate_campaign
from thetacomp.states import AxisStates, Samples, axis_states
from thetatwin.operation import STEP_S, Work

SPEED = "spindle_rpm"


@dataclass(frozen=True)
class Positions:
    """Rows for `predict`."""

    t_s: Floats
    axis: tuple[str, ...]
    position_mm: Floats


@dataclass(frozen=True)
class Trained:
    """The default model with heat history, the paper's with one key sensor, and the states they were made from."""

    model: ModelDocument
    paper_model: ModelDocument
    states: tuple[AxisStates, ...]


def train(folder: MachineFolder, axes: Sequence[str] | None = None) -> Trained:
    """Fit on all campaigns of a folder; `axes` names those that are wanted ("" is the drift), default all.

    Raises AnalysisError where the campaigns cannot carry a model.
    """
    names = [campaign.name for campaign in folder.campaigns]
    separations = [s for campaign in folder.campaigns for s in separate_campaign(folder.machine, campaign)]
    states = [s for s in axis_states(folder, separations, names) if axes is None or s.axis in axes]
    default, paper = key_point_procedure(folder.machine), paper_procedure(folder.machine)
    history = [calibrated_history(s).document for s in states]
    model = build_document(folder, [(s, default(s)) for s in states], METHOD, names, history=history)
    paper_model = build_document(folder, [(s, paper(s)) for s in states], "paper: one key sensor", names)
    return Trained(model, paper_model, tuple(states))


def spindle_duty(work: Work, t_s: Floats, own_s: Floats) -> Duty:
    """Spindle speed at times counted from the first minute of `work`, under the times `own_s` of a table.

    The machine stands still before the first minute.
    """
    rows = np.floor(t_s / STEP_S).astype(np.int64)
    rpm = np.where(rows < 0, 0.0, work.rpm[np.clip(rows, 0, len(work.rpm) - 1)])
    return Duty(own_s, {SPEED: rpm})


def at_minute(by_minute: Floats, t_s: Floats) -> Floats:
    """Values of the minutes in which the times lie."""
    rows: Ints = np.clip(np.floor(t_s / STEP_S).astype(np.int64), 0, len(by_minute) - 1)
    return np.asarray(by_minute[rows])


def clock_samples(states: AxisStates, hours: Floats, lever_m: Floats | float) -> Samples:
    """Rows for the clock: hours (n,) and the distance from P0, nothing else."""
    n = len(hours)
    nothing = np.zeros(n)
    return Samples(
        state=np.zeros(n, dtype=np.int64),
        lever_m=np.broadcast_to(np.asarray(lever_m, dtype=np.float64), (n,)),
        value_um=nothing,
        elapsed_h=hours,
        rise_K=np.zeros((n, len(states.sensors))),
        noise_sd_um=nothing,
        history=np.zeros((n, 0)),
        drift_um=nothing,
    )

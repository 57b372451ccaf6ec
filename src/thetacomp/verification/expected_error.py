"""The uncompensated error expected from the temperatures of any run: by a stored model, or by a fit to the off run.

With it both runs are compared at the same heat, and the share of the correction that was applied is estimated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thetacomp.arrays import CARTESIAN, Floats
from thetacomp.axis_states import AxisStates
from thetacomp.campaign import Campaign, MachineFolder
from thetacomp.errors import AnalysisError
from thetacomp.fitting.key_point_law import Procedure
from thetacomp.fitting.procedures import key_point_procedure
from thetacomp.folds import hold_out, training_states
from thetacomp.model.document import ModelDocument
from thetacomp.model.prediction import law_values
from thetacomp.model.volumetric import volume_along
from thetacomp.separation import ComponentSeparation


@dataclass(frozen=True)
class Expected:
    """Uncompensated error expected at n samples of a component: intercept in µm, slope in µm/m, both (n,).

    NaN where none is known. `left_um` is the RMS that the law leaves of data it has not seen, 0 where nobody knows;
    `campaigns` counts those that the law was fitted to.
    """

    intercept_um: Floats
    slope_um_per_m: Floats
    left_um: float = 0.0
    campaigns: int = 0


def expected_from_fit(
    folder: MachineFolder, states: AxisStates, off: Sequence[str]
) -> tuple[tuple[Expected, ...], tuple[str, ...]]:
    """What a fit to the off campaigns alone expects, component by component.

    All NaN where no sensor explains the error, or where the states are too few; the second value says so.
    """
    numbers = [k for k, name in enumerate(states.campaigns) if name in set(off)]
    training = states.take(np.flatnonzero(np.isin(states.campaign, numbers)))
    label = f"axis {states.axis}" if states.axis else "drift"
    procedure = key_point_procedure(folder.machine)
    try:
        model = procedure(training)
    except AnalysisError as exc:
        return tuple(_nothing(len(s.value_um)) for s in states.samples), (f"{label}: {exc}",)
    if not model.inputs:
        note = (
            f"{label}: no sensor explains the error of the run with compensation off; it is not converted to equal heat"
        )
        return tuple(_nothing(len(s.value_um)) for s in states.samples), (note,)
    out = []
    for name, samples, left_um in zip(states.components, states.samples, _left_um(training, procedure), strict=True):
        zeros = np.zeros(len(samples.value_um))
        at_p0, _ = model.predict(name, states, replace(samples, lever_m=zeros))
        at_1m, _ = model.predict(name, states, replace(samples, lever_m=zeros + 1.0))
        out.append(Expected(at_p0, at_1m - at_p0, left_um, len(numbers)))
    return tuple(out), ()


def _left_um(training: AxisStates, procedure: Procedure) -> list[float]:
    """RMS of each component that fits leave in the heated states of a campaign that they have not seen.

    0 where there is only one campaign.
    """
    squares: list[list[Floats]] = [[] for _ in training.components]
    split, folds = hold_out(training)
    for fold in folds if split == "campaign" else ():
        try:
            model = procedure(training_states(training, fold))
        except AnalysisError:
            continue
        for found, name, samples in zip(squares, training.components, training.samples, strict=True):
            unseen = samples.take(np.isin(samples.state, fold.test) & ~training.cold[samples.state])
            found.append((unseen.value_um - model.predict(name, training, unseen)[0]) ** 2)
    return [float(np.sqrt(np.nanmean(np.concatenate(found)))) if found else 0.0 for found in squares]


def expected_from_model(
    model: ModelDocument, folder: MachineFolder, states: AxisStates, separations: Sequence[ComponentSeparation]
) -> tuple[tuple[Expected, ...], tuple[str, ...]]:
    """What a stored model expects, component by component; NaN for components that it does not predict.

    The zero is that of the measured error: the mean over the moments at which the cold state was measured.
    """
    out, notes = [], []
    for component, samples in zip(states.components, states.samples, strict=True):
        nothing = _nothing(len(samples.value_um))
        law = model.in_use.get(states.axis)
        known = None if law is None else law.components.get(component)
        if known is None or not known.predicted:
            notes.append(f"{component}: the model does not predict it; its residual is not caused by the model")
            out.append(nothing)
            continue
        at_p0, slope = nothing.intercept_um, nothing.slope_um_per_m
        for number, name in enumerate(states.campaigns):
            rows = np.flatnonzero(states.campaign[samples.state] == number)
            own = next(s for s in separations if s.campaign == name and s.component == component)
            t_s = 3600.0 * samples.elapsed_h[rows] + float(own.zero_t_s.mean())
            campaign = folder.campaign(name)
            line, slope[rows], bend = _along(model, campaign, own, t_s, states.p0_mm)
            # What bends counts with the intercept: a slope is what changes sign with the position.
            at_p0[rows] = line + bend * samples.lever_m[rows] ** 2
        left_um = known.held_out_um[0] if known.held_out_um else 0.0
        out.append(Expected(at_p0, slope, left_um, len(model.training.campaigns)))
    return tuple(out), tuple(notes)


def _along(
    model: ModelDocument, campaign: Campaign, own: ComponentSeparation, t_s: Floats, p0_mm: float
) -> tuple[Floats, Floats, Floats]:
    """Predicted error at `p0_mm`, slope and bend about it, each less its mean over the cold block, (n,).

    A tracker measures true metres, so a wanted length that follows the workpiece plays no part.
    """
    times = np.concatenate([own.zero_t_s, t_s])
    temperatures, duty = campaign.recording()
    zero_s = float(own.zero_t_s.mean())

    def place(i: int) -> str:
        return f"campaign {campaign.name}, {own.component} at {times[i]:.0f} s"

    if model.form == "joint" and own.axis:
        # Here the drift is a component of its own, and the other axes tilt where they stand.
        places_mm = _standing_mm(model, campaign, own.axis, times) | {own.axis: np.full(len(times), p0_mm)}
        terms = volume_along(model, temperatures, times, places_mm, own.axis, zero_s, place, duty)
        at_p0, slope, bend = (term[:, CARTESIAN.index(own.direction)] for term in terms)
    else:
        values = law_values(model, own.axis or "", temperatures, times, zero_s, place, duty)
        u_m = values.law.u_m(np.full(len(times), p0_mm))
        at_p0, slope = values.error_um(own.component, u_m), values.slope_um_per_m(own.component, u_m)
        bend = values.term(2)[:, CARTESIAN.index(own.direction)]
    at_p0, slope, bend = (_less_cold(term, len(own.zero_t_s)) for term in (at_p0, slope, bend))
    return at_p0, slope, bend


def _less_cold(value: Floats, cold: int) -> Floats:
    """Values after the first `cold` ones, less the mean of those."""
    known = value[:cold][np.isfinite(value[:cold])]
    return np.asarray(value[cold:] - (float(known.mean()) if len(known) else 0.0))


def _standing_mm(model: ModelDocument, campaign: Campaign, moving: str, times: Floats) -> dict[str, Floats]:
    """Where the other axes of the model stood while an axis moved, each (n,); at P0 where it was not recorded."""
    p0_mm = {name: law.p0_mm for name, law in model.in_use.items() if law.p0_mm is not None}
    out = {}
    points = campaign.sweeps
    for name, middle_mm in p0_mm.items():
        if name == moving:
            continue
        out[name] = np.full(len(times), middle_mm)
        if points is None or name not in points.at_mm:
            continue
        known = np.isfinite(points.at_mm[name]) & (np.array(points.axis) == moving)
        if known.any():
            nearest = np.abs(points.t_s[known][None, :] - times[:, None]).argmin(axis=1)
            out[name] = points.at_mm[name][known][nearest]
    return out


def _nothing(n: int) -> Expected:
    return Expected(np.full(n, np.nan), np.full(n, np.nan))

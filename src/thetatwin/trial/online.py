"""A stored model in use on one machine: readings screened sample by sample, lost sensors replaced by fallbacks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.campaign import Campaign
from thetacomp.model.document import ModelDocument
from thetacomp.model.fallback import DECAY_S, degraded
from thetacomp.model.temperatures import Duty, Temperatures
from thetacomp.model.volumetric import predict_volume
from thetacomp.screening import Detector, ScreeningModel


@dataclass(frozen=True)
class OnlineReadings:
    """What a machine uses of the readings of a run, with what the loggers read before it.

    `lost` says from which moment on which sensors count as lost, in order of time. A sensor that came back would have
    no heat history: it stays lost to the end of the run.
    """

    table: Temperatures
    duty: Duty | None
    lost: tuple[tuple[float, frozenset[str]], ...]

    @property
    def ever_lost(self) -> frozenset[str]:
        """Sensors that are lost at the end."""
        return self.lost[-1][1] if self.lost else frozenset()


def online_readings(campaign: Campaign, screening: ScreeningModel | None) -> OnlineReadings:
    """The readings of a campaign as they are used while it runs: no sample is judged by a later one.

    Without `screening` they are used as they were read, single missing samples bridged.
    """
    table, duty = campaign.recording()
    if screening is None:
        return OnlineReadings(table.bridged(), duty, ())
    detector, lost = Detector(screening), frozenset[str]()
    value, switches = np.empty_like(table.value_degC), []
    for i, (t_s, reading) in enumerate(zip(table.t_s, table.value_degC, strict=True)):
        sample = detector.update(float(t_s), reading)
        value[i] = sample.value_degC
        gone = {name for name, state in zip(table.sensor_ids, sample.state, strict=True) if state == "lost"}
        if gone - lost:
            lost = lost | gone
            switches.append((float(t_s), lost))
    return OnlineReadings(replace(table, value_degC=value), duty, tuple(switches))


def online_error_um(
    model: ModelDocument, live: OnlineReadings, t_s: Floats, positions_mm: Mapping[str, Floats], reference_s: float
) -> Floats:
    """What the machine takes for its error at n moments and positions of all axes, (n, 3) in µm.

    Zero where the model has no such component. When a sensor is lost the fallback continues from the last output;
    the difference decays as `model.fallback` says. Raises AnalysisError as `predict_volume` does.
    """
    begins = [(-np.inf, frozenset[str]()), *live.lost]
    ends = [*(begin_s for begin_s, _ in live.lost), np.inf]
    out, carried, since_s = np.zeros((len(t_s), 3)), np.zeros((len(t_s), 3)), -np.inf
    for number, ((begin_s, lost), end_s) in enumerate(zip(begins, ends, strict=True)):
        if number:
            then_s = np.full(len(t_s), begin_s)
            old = _error_um(model, live, begins[number - 1][1], then_s, positions_mm, reference_s)
            new = _error_um(model, live, lost, then_s, positions_mm, reference_s)
            carried, since_s = old + carried * _left(begin_s, since_s) - new, begin_s
        rows = np.flatnonzero((t_s >= begin_s) & (t_s < end_s))
        there = {name: position[rows] for name, position in positions_mm.items()}
        out[rows] = _error_um(model, live, lost, t_s[rows], there, reference_s)
        out[rows] += carried[rows] * _left(t_s[rows], since_s)
    return out


def _left(t_s: Floats | float, since_s: float) -> Floats:
    """Share of what was carried over at `since_s` that is left, (n, 1)."""
    return np.exp((since_s - np.atleast_1d(t_s)) / DECAY_S)[:, None]


def _error_um(
    model: ModelDocument,
    live: OnlineReadings,
    lost: frozenset[str],
    t_s: Floats,
    positions_mm: Mapping[str, Floats],
    reference_s: float,
) -> Floats:
    """Prediction (n, 3) of the model for the sensors that are left."""
    rest = degraded(model, lost).model if lost else model
    known = set(rest.in_use)
    if not len(t_s) or not known:
        return np.zeros((len(t_s), 3))
    table = live.table.without(lost)
    there = {name: position for name, position in positions_mm.items() if name in known}
    found = predict_volume(rest, table, t_s, there, reference=reference_s, duty=live.duty)
    return np.nan_to_num(found.error_um)

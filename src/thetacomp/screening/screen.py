"""Screening of the temperatures of a campaign: what is believed, repaired or lost, with the evidence.

Every sensor's increments are predicted from the others; a sensor that leaves its prediction by more than healthy ones
ever did is taken out, watched, and rebuilt from the healthy ones. `Detector` does the same for live samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from thetacomp.errors import AnalysisError
from thetacomp.model.temperatures import Temperatures
from thetacomp.screening.detector import Detector, finding
from thetacomp.screening.events import Event
from thetacomp.screening.faults import Finding
from thetacomp.screening.fit import fit_plain
from thetacomp.screening.model import DetectionLimit, ScreeningModel
from thetacomp.screening.repair import REBUILT, repaired, sample_spikes

CLEAR = 1.5


@dataclass(frozen=True)
class Screening:
    """The screened table of a campaign.

    `repaired` holds the repaired values, NaN where a sensor is lost; `believed` (n, p) is True where the reading stands
    as it was read; `lost` names the sensors of which a model has to do without, with the start of the loss in s.
    """

    findings: tuple[Finding, ...]
    repaired: Temperatures
    believed: NDArray[np.bool_]
    lost: tuple[tuple[str, float], ...]
    limits: tuple[DetectionLimit, ...]


def fit_screening(campaigns: Sequence[Temperatures]) -> ScreeningModel:
    """Learn the healthy behaviour from training campaigns of one machine.

    Faults within the training are found by screening each campaign with what the others teach; the second fit uses the
    repaired tables, without the stretches that had to be rebuilt. AnalysisError where the campaigns are too few, too
    short or of different sensors.
    """
    if len(campaigns) < 3:
        return fit_plain(campaigns)
    try:
        tables = [cleaned(c, [other for k, other in enumerate(campaigns) if k != i]) for i, c in enumerate(campaigns)]
    except AnalysisError:
        return fit_plain(campaigns)
    return fit_plain(tables)


def cleaned(table: Temperatures, others: Sequence[Temperatures]) -> Temperatures:
    """A training table without the faults that the others show: repaired, or missing where it had to be rebuilt.

    AnalysisError as in `fit_screening`.
    """
    plain = fit_plain(others)
    # Only what is beyond doubt is taken out: healthy extremes must stay in the calibration.
    return _healthy_part(screen(replace(plain, threshold=CLEAR * plain.threshold), table))


def _healthy_part(result: Screening) -> Temperatures:
    value = result.repaired.value_degC.copy()
    t_s = result.repaired.t_s
    for found in result.findings:
        if found.kind in REBUILT:
            end_s = np.inf if found.end_s is None else found.end_s
            value[(t_s >= found.start_s) & (t_s < end_s), result.repaired.sensor_ids.index(found.sensor)] = np.nan
    return replace(result.repaired, value_degC=value)


def screen(model: ScreeningModel, temperatures: Temperatures) -> Screening:
    """Screen a whole record. AnalysisError where its sensors, or their order, are not those of the model."""
    if temperatures.sensor_ids != model.sensor_ids:
        raise AnalysisError(
            "the temperatures to screen have other sensors, or another order, than the training:"
            f" {', '.join(temperatures.sensor_ids)} instead of {', '.join(model.sensor_ids)}"
        )
    read = np.isfinite(temperatures.value_degC)
    temperatures = _without_dropouts(temperatures)
    detector = Detector(model)
    for t_s, value in zip(temperatures.t_s, temperatures.value_degC, strict=True):
        detector.update(float(t_s), value)
    detector.finish()
    events = detector.monitor.events
    events += [e for e in sample_spikes(model, temperatures) if not any(_within(e, other) for other in events)]
    mended, believed = repaired(model, temperatures, [e for e in events if e.kind != "unexplained"])
    believed &= read
    until_s = float(temperatures.t_s[-1])
    findings = []
    for event in sorted(events, key=lambda e: e.onset_s):
        end_s = until_s if event.end_s is None else event.end_s
        together = frozenset(
            e.j
            for e in events
            if e.kind in REBUILT and e.onset_s <= end_s and (e.end_s is None or e.end_s >= event.onset_s)
        )
        findings.append(finding(model, event, together - {event.j}, until_s))
    lost = tuple((f.sensor, f.start_s) for f in findings if f.repair == "lost")
    return Screening(tuple(findings), mended, believed, lost, model.limits())


def _without_dropouts(table: Temperatures) -> Temperatures:
    """One missing sample between two readings is no fault: the line between them is nearer than any other sensor."""
    value = table.value_degC.copy()
    read = np.isfinite(value)
    step_s = np.diff(table.t_s)
    near = step_s <= 1.5 * np.median(step_s) if len(step_s) else np.zeros(0, dtype=np.bool_)
    lone = np.zeros(value.shape, dtype=np.bool_)
    lone[1:-1] = ~read[1:-1] & read[:-2] & read[2:] & (near[:-1] & near[1:])[:, None]
    for j in np.flatnonzero(lone.any(axis=0)):
        value[lone[:, j], j] = np.interp(table.t_s[lone[:, j]], table.t_s[read[:, j]], value[read[:, j], j])
    return replace(table, value_degC=value)


def _within(spike: Event, other: Event) -> bool:
    """A spike that belongs to another fault of the same sensor: its begin, its end, or all of it."""
    near_s = 600.0
    end_s = np.inf if other.end_s is None else other.end_s
    rebuilt = other.kind in REBUILT and other.onset_s - near_s <= spike.onset_s <= end_s + near_s
    edge = min(abs(spike.onset_s - other.onset_s), abs(spike.onset_s - end_s)) <= near_s
    return spike.j in (other.j, other.partner) and (rebuilt or edge)

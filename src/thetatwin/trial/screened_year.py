"""The readings of a year as a machine would use them: screened sample by sample, by what the training days taught.

Only the live verdicts of the screening are used: no reading is judged or repaired by a later one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from thetacomp.arrays import Floats
from thetacomp.campaign import MachineFolder
from thetacomp.model.document import ModelDocument
from thetacomp.model.temperatures import Temperatures
from thetacomp.screening import Detector, Finding, ScreeningModel, fit_screening
from thetatwin.hall import DAY_S
from thetatwin.year import LEAD_DAYS, Readings

PASSING = ("missing",)  # reported only where they last
SHORTEST_S = 3600.0


@dataclass(frozen=True)
class ScreenedMonth:
    """Readings of a month, with LEAD_DAYS before it: values (n, p) in °C as screening leaves them, NaN where nothing
    is left, and `out` (n, p), where a sensor is lost. Times count from the schedule's first midnight.
    """

    temperatures: Temperatures
    out: NDArray[np.bool_]


@dataclass(frozen=True)
class ScreenedYear:
    """All months, and the faults that were found, in their final state; short missing readings left out.

    A fault ends where the channel lives again. `repair` is `lost` where the sensor was
    left out for some of that time. `judged` is False where no fault was looked for.
    """

    months: tuple[ScreenedMonth, ...]
    findings: tuple[Finding, ...]
    judged: bool = True


def as_read(sensor_ids: Sequence[str], months: Sequence[Readings]) -> ScreenedYear:
    """The readings of all months as they are: no fault is looked for, no sensor is ever lost."""
    return ScreenedYear(
        tuple(
            ScreenedMonth(
                Temperatures(month.t_s, tuple(sensor_ids), month.value_degC),
                np.zeros(month.value_degC.shape, dtype=np.bool_),
            )
            for month in months
        ),
        (),
        judged=False,
    )


def screening_model(folder: MachineFolder) -> ScreeningModel:
    """What the training campaigns teach. Raises AnalysisError where they are too few or too short."""
    return fit_screening([campaign.temperatures for campaign in folder.campaigns])


def screen_year(model: ScreeningModel, months: Sequence[Readings], begins_s: Sequence[float]) -> ScreenedYear:
    """Follow the readings of all months in one unbroken stream; `begins_s` says when each month begins.

    A rebuilt value serves for as long as the screening rebuilds it. A sensor that cannot be rebuilt well enough is lost
    from that moment on, until it is used again.
    """
    detector = Detector(model)
    t_s, value = _stream(months, begins_s)
    used, out = np.empty_like(value), np.zeros(value.shape, dtype=np.bool_)
    for i, moment_s in enumerate(t_s):
        sample = detector.update(float(moment_s), value[i])
        used[i] = sample.value_degC
        out[i] = [state == "lost" for state in sample.state]
    end_s = float(t_s[-1])
    lasting = [
        f
        for f in detector.findings()
        if f.kind not in PASSING or (end_s if f.end_s is None else f.end_s) - f.start_s >= SHORTEST_S
    ]
    cut = [(begin_s - LEAD_DAYS * DAY_S, float(month.t_s[-1])) for begin_s, month in zip(begins_s, months, strict=True)]
    return ScreenedYear(
        tuple(_month(model.sensor_ids, t_s, used, out, *span) for span in cut),
        tuple(_left_out(f, model, t_s, out) for f in lasting),
    )


def _left_out(found: Finding, model: ScreeningModel, t_s: Floats, out: NDArray[np.bool_]) -> Finding:
    end_s = np.inf if found.end_s is None else found.end_s
    rows = (t_s >= found.start_s) & (t_s < end_s)
    return replace(found, repair="lost") if out[rows, model.sensor_ids.index(found.sensor)].any() else found


def _stream(months: Sequence[Readings], begins_s: Sequence[float]) -> tuple[Floats, Floats]:
    """One unbroken record (n,), (n, p): the lead of the first month, then every month's own readings."""
    own = [
        month.t_s > begin_s if k else np.ones(len(month.t_s), dtype=np.bool_)
        for k, (month, begin_s) in enumerate(zip(months, begins_s, strict=True))
    ]
    t_s = np.concatenate([month.t_s[rows] for month, rows in zip(months, own, strict=True)])
    return t_s, np.vstack([month.value_degC[rows] for month, rows in zip(months, own, strict=True)])


def _month(
    ids: tuple[str, ...], t_s: Floats, used: Floats, out: NDArray[np.bool_], begin_s: float, end_s: float
) -> ScreenedMonth:
    rows = (t_s >= begin_s) & (t_s <= end_s)
    return ScreenedMonth(Temperatures(t_s[rows], ids, used[rows]), out[rows])


def used_sensors(model: ModelDocument) -> frozenset[str]:
    """All sensors that a model reads."""
    laws = (*model.prediction.values(), *model.control.values())
    return frozenset(name for law in laws for name in law.layout.sensors)

"""One row of the ruler: every model of one machine on some of its campaigns, held out by whole campaigns."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carry.baselines import BEST_THREE, MEAN_CURVE, best_three, mean_curve
from thetacomp.arrays import Bools, Floats
from thetacomp.fitting.key_point_law import AnyProcedure
from thetacomp.fitting.training import train
from thetacomp.preparation import Prepared
from thetacomp.validation.joint_view import with_drift
from thetacomp.validation.judge import axis_tasks, judged_procedures
from thetacomp.validation.outcome import ALL_SENSORS, DEFAULT, NOTHING, ONE_SENSOR
from thetacomp.validation.validate import AxisTask, Residuals, held_out_residuals

SIMPLE = (NOTHING, MEAN_CURVE, ONE_SENSOR, BEST_THREE, ALL_SENSORS)


HeldOut = tuple[Residuals, NDArray[np.str_]]
"""Residuals of one component and the name of the campaign of each."""


@dataclass(frozen=True)
class Figures:
    """Held-out errors of one model over all components of a row, µm; NaN where there is no such model.

    `coverage_percent` (over all, and least of a component) and `half_width_um` (median) belong to the 95 % band.
    `cpu_s` is for choosing and fitting on all campaigns and in every fold; rows of one machine share it.
    """

    points: int
    rms_um: float
    p95_um: float
    worst_campaign_um: float
    coverage_percent: float
    least_coverage_percent: float
    half_width_um: float
    cpu_s: float
    rms_by_component_um: Mapping[str, float]


@dataclass(frozen=True)
class Row:
    """One machine on some of its campaigns. `split` is what was held out; `models` by name."""

    name: str
    campaigns: int
    split: str
    models: Mapping[str, Figures]

    @property
    def best_simple(self) -> str:
        """The simple baseline that leaves least."""
        known = [name for name in SIMPLE if name in self.models]
        return min(known, key=lambda name: self.models[name].rms_um)

    def ratio(self, model: str = DEFAULT) -> float:
        """What a model leaves against the best simple baseline of this row; NaN where there is no such model."""
        if model not in self.models:
            return float("nan")
        return self.models[model].rms_um / self.models[self.best_simple].rms_um

    @property
    def unserved_share(self) -> float:
        """Share of the measured points that the default does not predict: a reading is missing there."""
        return 1.0 - self.models[DEFAULT].points / self.models[NOTHING].points

    @property
    def worst_component(self) -> tuple[str, float]:
        """The component in which the default stands worst against the baseline that is best in it, and the ratio."""
        if DEFAULT not in self.models:
            return "", float("nan")
        simple = [self.models[name].rms_by_component_um for name in SIMPLE if name in self.models]
        ratios = {
            component: value / min(own[component] for own in simple)
            for component, value in self.models[DEFAULT].rms_by_component_um.items()
        }
        worst = max(ratios, key=lambda name: ratios[name])
        return worst, ratios[worst]


def measure(name: str, prepared: Prepared, apart: bool = False, families: bool = False) -> tuple[Row, ...]:
    """Fit and hold out everything on prepared measurements; fallbacks, report and pictures are left out.

    One row over all components, or with `apart` one for each. A model that does not serve all of them is left out.
    """
    begin = time.process_time()
    trained = train(prepared, lost=())
    residuals: dict[str, list[HeldOut]] = {}
    seconds: dict[str, float] = {DEFAULT: time.process_time() - begin}
    tasks = axis_tasks(prepared)
    for task in tasks:
        procedures = judged_procedures(prepared, trained, task.states)
        procedures |= {MEAN_CURVE: mean_curve, BEST_THREE: best_three}
        if families:
            procedures |= _families()
        _hold_out(prepared, task, procedures, residuals, seconds)
    components = [item.component for item, _ in residuals[NOTHING]]
    groups = {f"{name} {one}": (one,) for one in components} if apart else {name: tuple(components)}
    return tuple(
        Row(title, len(prepared.train), tasks[0].split, _models(residuals, seconds, members))
        for title, members in groups.items()
    )


def _models(
    residuals: Mapping[str, list[HeldOut]], seconds: Mapping[str, float], components: tuple[str, ...]
) -> dict[str, Figures]:
    own = {name: [one for one in items if one[0].component in components] for name, items in residuals.items()}
    return {
        name: _figures(items, seconds.get(name, 0.0)) for name, items in own.items() if len(items) == len(components)
    }


def _families() -> dict[str, AnyProcedure]:
    from thetacomp.validation.families.choice import family_procedure  # loads scikit-learn
    from thetacomp.validation.families.families import FAMILIES

    return {family.name: family_procedure(family) for family in FAMILIES}


def _hold_out(
    prepared: Prepared,
    task: AxisTask,
    procedures: Mapping[str, AnyProcedure],
    residuals: dict[str, list[HeldOut]],
    seconds: dict[str, float],
) -> None:
    """Residuals of one axis by model, added to those of the others."""
    judged, procedures = with_drift(task.states, prepared.everything, procedures)
    names = np.array(judged.campaigns)
    for name, procedure in procedures.items():
        begin = time.process_time()
        found = held_out_residuals(judged, task.split, task.folds, {name: procedure})
        seconds[name] = seconds.get(name, 0.0) + time.process_time() - begin
        for item in found:
            if item.model == name:
                residuals.setdefault(name, []).append((item, names[item.campaign]))
    residuals.setdefault(NOTHING, []).extend((item, names[item.campaign]) for item in found if item.model == NOTHING)


def _figures(held_out: list[HeldOut], cpu_s: float) -> Figures:
    items = [item for item, _ in held_out]
    after_um = np.concatenate([item.after_um for item in items])
    half_um = np.concatenate([item.half_width_um for item in items])
    campaign = np.concatenate([names for _, names in held_out])
    return Figures(
        points=len(after_um),
        rms_um=_rms(after_um),
        p95_um=float(np.quantile(np.abs(after_um), 0.95)),
        worst_campaign_um=max(_rms(after_um[campaign == name]) for name in np.unique(campaign)),
        coverage_percent=_coverage(after_um, half_um),
        least_coverage_percent=min(_coverage(item.after_um, item.half_width_um) for item in items),
        half_width_um=float(np.nanmedian(half_um)) if np.isfinite(half_um).any() else float("nan"),
        cpu_s=cpu_s,
        rms_by_component_um={item.component: _rms(item.after_um) for item in items},
    )


def _rms(value: Floats) -> float:
    return float(np.sqrt(np.mean(value**2)))


def _coverage(after_um: Floats, half_um: Floats) -> float:
    stated: Bools = np.isfinite(half_um)
    return 100.0 * float(np.mean(np.abs(after_um[stated]) <= half_um[stated])) if stated.any() else float("nan")

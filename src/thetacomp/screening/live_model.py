"""What live screening knows of a healthy machine, learnt from training campaigns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.errors import AnalysisError
from thetacomp.model.temperatures import Temperatures
from thetacomp.screening import silent, steps
from thetacomp.screening.grid import BLOCK_S
from thetacomp.screening.judge import MIN_SAMPLES, Judge
from thetacomp.screening.others import Teachers, teachers
from thetacomp.screening.record import as_read


@dataclass(frozen=True)
class ScreeningModel:
    """p sensors, blocks of `step_s`.

    A step counts beyond `step_K` (p,), `noise_K` (p,) is its standard deviation; a scatter counts beyond `scatter_K`
    (p,), one reading after `held_s` (p,). `taught` predicts a sensor from the others.
    """

    sensor_ids: tuple[str, ...]
    step_s: float
    step_K: Floats
    noise_K: Floats
    scatter_K: Floats
    held_s: Floats
    taught: Teachers


def fit_screening(campaigns: Sequence[Temperatures]) -> ScreeningModel:
    """Learn from training campaigns of one machine; what is faulty in them is put right first.

    AnalysisError where the campaigns are too few, too short or of different sensors.
    """
    if len(campaigns) < 2 or min(len(c.t_s) for c in campaigns) < MIN_SAMPLES:
        raise AnalysisError(
            f"live screening learns from two campaigns with {MIN_SAMPLES} samples each, at least;"
            f" the {len(campaigns)} given have {', '.join(str(len(c.t_s)) for c in campaigns) or 'none'}"
        )
    ids = campaigns[0].sensor_ids
    if any(c.sensor_ids != ids for c in campaigns):
        raise AnalysisError("the campaigns of the training have other sensors, or another order, than the first")
    names = tuple(str(number) for number in range(len(campaigns)))
    judge = Judge(dict.fromkeys(ids, "structure"), names, lambda mended, others: True)
    known = {name: as_read(name, table, float(table.t_s[0])) for name, table in zip(names, campaigns, strict=True)}
    records = list(judge.verdict(known).values())
    sharps = [record.sharp for record in records]
    noise_K = np.max([s.noise_K for s in sharps], axis=0)
    usual_K = steps.history_K(sharps, [[j] for j in range(len(ids))])
    return ScreeningModel(
        sensor_ids=ids,
        step_s=max(BLOCK_S, *(c.interval_s for c in campaigns)),
        step_K=np.maximum.reduce([np.full(len(ids), steps.SMALLEST_K), steps.NOISE * noise_K, steps.OWN * usual_K]),
        noise_K=noise_K,
        scatter_K=np.maximum(steps.SCATTER_K, steps.RESTLESS * steps.usual_scatter_K(sharps)),
        held_s=np.maximum(
            silent.SHORTEST_S, silent.FAR_LONGER * np.median([record.longest_s for record in records], axis=0)
        ),
        taught=teachers([record.course for record in records]),
    )

"""Calibrating the border of validity on held-out campaigns, so that the flag stays quiet where the model holds."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from thetacomp.arrays import Floats
from thetacomp.errors import AnalysisError
from thetacomp.fitting.conformal import CampaignShapes, attainable_level, conformal_quantile
from thetacomp.model.border import Validity, furthest
from thetacomp.temperature.trajectory import Trajectory

QUIET_LEVEL = 0.9


def calibrate_validity(
    inputs: Floats, campaign: NDArray[Any], passed: Trajectory | None = None, quiet_level: float = QUIET_LEVEL
) -> Validity:
    """The border from the inputs (n, k) that a model was fitted on and their campaigns (n,).

    Two measures share the work. The leverage comes from the fitted moments: it measures what the coefficients were
    fitted on. The range is that of all moments that the training campaigns `passed` through: while a machine is
    measured it stands, and what it did in between was heat that the next measurement has judged. Without `passed` the
    fitted moments are all there is. Every campaign is held out in turn, and its largest leverage and range over all its
    moments, seen from the others, are noted. The larger of the two (each in units of its median) is the campaign's
    score, and the border is the conformal quantile of the scores (Vovk, Gammerman and Shafer, *Algorithmic Learning in
    a Random World*, 2005, with the campaign as the unit): a new campaign of the same kind stays inside from its first
    to its last measurement with about the probability `quiet_level`. With too few campaigns the border is the largest
    score and the attainable level is said. Raises AnalysisError for fewer than 2 campaigns.
    """
    every, of = (inputs, campaign) if passed is None else (passed.inputs, passed.campaign)
    shapes = CampaignShapes.of(inputs, campaign)
    labels = shapes.campaigns
    m = len(labels)
    if m < 2:
        raise AnalysisError(f"{m} campaign: the border of validity needs at least 2. Fix: measure one more campaign.")
    highest = np.empty((m, 2))
    for row, label in enumerate(labels):
        leverage = shapes.without(label).leverage(centred=True)
        highest[row] = furthest(leverage, *_range(every[of != label]), every[of == label]).max(axis=0)
    unit = np.median(highest, axis=0)
    scores = (highest / unit).max(axis=1)
    level = min(quiet_level, attainable_level(m))
    middle, half_span = _range(every)
    sentence = f"A campaign like the {m} of training stays inside the border with a probability of about {level:.0%}."
    if level < quiet_level:
        sentence += f" {quiet_level:.0%} was wanted: measure more campaigns."
    return Validity(
        leverage=shapes.leverage(centred=True),
        middle=tuple(float(value) for value in middle),
        half_span=tuple(float(value) for value in half_span),
        leverage_unit=float(unit[0]),
        range_unit=float(unit[1]),
        limit=conformal_quantile(scores, labels, level),
        quiet_level=level,
        campaigns=m,
        sentence=sentence,
    )


def _range(inputs: Floats) -> tuple[Floats, Floats]:
    low, high = inputs.min(axis=0), inputs.max(axis=0)
    return (low + high) / 2, (high - low) / 2

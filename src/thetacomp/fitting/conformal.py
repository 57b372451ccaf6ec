"""Bands with a guaranteed coverage: conformal calibration over whole campaigns.

Rows of one campaign are nearly copies of each other, campaigns are exchangeable at best. So the campaign is the unit:
its rows share one vote. With m calibration campaigns, N_k rows in campaign k and scores s_ki = |residual| / scale the
quantile at level 1 - α is that of the distribution

    Σ_k Σ_i  1 / ((m + 1) N_k) δ(s_ki)  +  1 / (m + 1) δ(∞)

(hierarchical conformal prediction: Lee, Barber and Willett, "Distribution-free inference with hierarchical data",
arXiv:2306.06342, section 3; it is CDF pooling of Dunn, Wasserman and Ramdas, JASA 118, 2023, with the point at
infinity). A row of a new campaign then lies in the band with probability at least 1 - α, for any distribution of
the errors, if the campaigns are exchangeable and took no part in the fit. The quantile is finite only up to the
level m / (m + 1): nine campaigns give 90 % at most, nineteen are needed for 95 %.

The point at infinity prepares for the worst case, in which a campaign lies either wholly inside or wholly outside. On
real rows it makes the band too wide: with m = 40 it takes the pooled quantile at 97.4 %. The band therefore takes the
smallest quantile that holds the level when every campaign is judged by the others (`crossed_quantile`), and says
and the level that is guaranteed in the worst case.

Where every campaign is needed for the fit, the residuals come from models that left out the campaign.
The band then stands around the model of all campaigns, which is the jackknife form. Its coverage is near 1 - α for a
model that changes little when one campaign leaves, and it has no proof without that; the jackknife+ and CV+ of Barber,
Candès, Ramdas and Tibshirani (Annals of Statistics 49, 2021) prove 1 - 2α, and ask for every fold's model on the
machine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import special

from thetacomp.arrays import Floats
from thetacomp.errors import AnalysisError
from thetacomp.model.band import Band
from thetacomp.model.leverage import Leverage

LEVEL = 0.95
# directions with less than this share of an input's own mean square cannot be distinguished from noise
FLOOR = 1e-2
_TRIES = 41
_GROWTH_RATIOS = tuple(float(ratio) for ratio in np.geomspace(0.1, 1e3, 21))
# where the growth bends, as shares of the held-out rows that lie nearer to the reference
_KNEES = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0)


@dataclass(frozen=True)
class HeldOut:
    """Held-out rows, n of them: `residual_um` measured less predicted, `leverage` seen from the training campaigns.

    `campaign` (n,) says which rows belong together.
    """

    residual_um: Floats
    leverage: Floats
    campaign: NDArray[Any]


def attainable_level(campaigns: int) -> float:
    """Highest level of a band from this many calibration campaigns, m / (m + 1)."""
    return campaigns / (campaigns + 1)


def campaigns_needed(level: float) -> int:
    """Fewest calibration campaigns for a level: the smallest m with m / (m + 1) >= level."""
    return math.ceil(level / (1.0 - level) - 1e-9)


def campaign_weights(campaign: NDArray[Any]) -> Floats:
    """Weight of every row, (n,): campaigns weigh the same, rows within one share its weight; they add up to 1."""
    _, index, rows = np.unique(campaign, return_inverse=True, return_counts=True)
    weights: Floats = 1.0 / (len(rows) * rows[index])
    return weights


@dataclass(frozen=True)
class CampaignShapes:
    """Means (m, k) and centred second moments (m, k, k) of k inputs in each of m campaigns, labelled `campaigns` (m,).

    A campaign is left out by leaving out its moments: no row is read twice.
    """

    campaigns: NDArray[Any]
    mean: Floats
    moment: Floats

    @classmethod
    def of(cls, inputs: Floats, campaign: NDArray[Any]) -> CampaignShapes:
        """One pass over inputs (n, k) and the campaign of each row (n,)."""
        labels = np.unique(campaign)
        mean, moment = np.empty((len(labels), inputs.shape[1])), np.empty((len(labels), *2 * inputs.shape[1:]))
        for row, label in enumerate(labels):
            own = inputs[campaign == label]
            mean[row] = own.mean(axis=0)
            moved = own - mean[row]
            moment[row] = moved.T @ moved / len(own)
        return cls(labels, mean, moment)

    def without(self, label: Any) -> CampaignShapes:
        """All campaigns but one."""
        kept = self.campaigns != label
        return CampaignShapes(self.campaigns[kept], self.mean[kept], self.moment[kept])

    def leverage(self, *, centred: bool = False) -> Leverage:
        """The shape of all rows, each campaign counting alike, about their mean or, if not `centred`, about zero."""
        centre = self.mean.mean(axis=0) if centred else np.zeros(self.mean.shape[1])
        apart = self.mean - centre
        square = self.moment.mean(axis=0) + apart.T @ apart / len(apart)
        scale = np.sqrt(np.diag(square))
        scale = np.where(scale > 1e-9, scale, 0.0)
        inverse = np.divide(1.0, scale, out=np.zeros(len(scale)), where=scale > 0)
        moments, vectors = np.linalg.eigh(square * inverse[:, None] * inverse)
        kept = moments > FLOOR
        return Leverage(
            centre=as_tuple(centre),
            scale=as_tuple(scale),
            directions=tuple(as_tuple(vector) for vector in vectors[:, kept].T),
            moments=as_tuple(moments[kept]),
            floor=FLOOR,
        )


def conformal_quantile(scores: Floats, campaign: NDArray[Any], level: float) -> float:
    """Quantile of scores (n,) with the guarantee of the module's head; infinite where m is too small for the level."""
    m = len(np.unique(campaign))
    if level > attainable_level(m) + 1e-12:
        return math.inf
    return float(_pooled_quantile(scores, campaign_weights(campaign), level * (m + 1) / m))


def crossed_quantile(scores: Floats, campaign: NDArray[Any], level: float) -> float:
    """The smallest quantile of scores (n,) that holds `level` of the campaigns it is not made from.

    Every campaign is judged by the quantile of the others at one common guaranteed level, which rises towards `level`
    until the mean share inside reaches `level`. At the latest this is `conformal_quantile`, the answer to the worst
    case, in which a campaign lies wholly inside or outside. Infinite where m is too small for the level.
    """
    labels, index = np.unique(campaign, return_inverse=True)
    m = len(labels)
    if level > attainable_level(m) + 1e-12:
        return math.inf
    guaranteed = np.linspace(level * m / (m + 1), level, _TRIES)
    inside = np.zeros(_TRIES)
    for k in range(m):
        own = index == k
        limits = _pooled_quantile(scores[~own], campaign_weights(index[~own]), guaranteed * m / (m - 1))
        inside += np.mean(scores[own][:, None] <= limits, axis=0) / m
    if inside[-1] < level - 1e-12:
        return conformal_quantile(scores, campaign, level)
    # of the tries that hold the same share the highest: the share moves in steps where rows fall in or out together
    share = inside[inside >= level - 1e-12].min()
    chosen = guaranteed[np.flatnonzero(inside <= share + 1e-12)[-1]]
    return conformal_quantile(scores, campaign, float(chosen))


def _pooled_quantile(scores: Floats, weights: Floats, level: float | Floats) -> Any:
    order = np.argsort(scores)
    mass = np.cumsum(weights[order])
    return scores[order][np.minimum(np.searchsorted(mass, np.asarray(level) - 1e-12), len(order) - 1)]


def held_out_leverage(inputs: Floats, campaign: NDArray[Any]) -> Floats:
    """Leverage (n,) of every row of inputs (n, k), seen from the other campaigns.

    Raises AnalysisError for fewer than 2 campaigns.
    """
    shapes = CampaignShapes.of(inputs, campaign)
    if len(shapes.campaigns) < 2:
        raise AnalysisError(
            f"{len(shapes.campaigns)} campaign: a band needs at least 2, one to fit and one to be held out."
            " Fix: measure one more campaign."
        )
    leverage = np.empty(len(inputs))
    for label in shapes.campaigns:
        own = campaign == label
        leverage[own] = shapes.without(label).leverage().at(inputs[own])
    return leverage


def calibrate_band(rows: HeldOut, level: float = LEVEL) -> Band:
    """The band from held-out rows.

    With enough campaigns for the level its quantile is the conformal one. With fewer no quantile can be proven, and
    the scores are taken for normal (`_normal_quantile`); the sentence says so. Rows without a residual are left out.
    Raises AnalysisError where none is left or the level is not between 0 and 1.
    """
    if not 0.0 < level < 1.0:
        raise AnalysisError(f"the level of a band must lie between 0 and 1, found {level:g}.")
    known = np.isfinite(rows.residual_um) & np.isfinite(rows.leverage)
    if not known.any():
        raise AnalysisError("no held-out residual: a band cannot be calibrated. Fix: hold out complete campaigns.")
    size_um, leverage, campaign = np.abs(rows.residual_um[known]), rows.leverage[known], rows.campaign[known]
    m = len(np.unique(campaign))
    weights = campaign_weights(campaign)
    shape = _likeliest_shape(size_um, leverage, weights)
    scores = size_um / shape.half_width_um(leverage)
    if level <= attainable_level(m):
        quantile = crossed_quantile(scores, campaign, level)
    else:
        quantile = _normal_quantile(scores, campaign, level)
    guaranteed = float(weights @ (scores <= quantile)) * m / (m + 1)
    return replace(
        shape,
        level=level,
        guaranteed_level=guaranteed,
        attainable_level=attainable_level(m),
        campaigns=m,
        quantile=quantile,
        sentence=level_sentence(m, level, guaranteed),
    )


def _normal_quantile(scores: Floats, campaign: NDArray[Any], level: float) -> float:
    """`t(ν, level) × √v`, v the mean over m campaigns of their mean square scores v_k.

    ν = 2 m v² / s² are Satterthwaite's degrees of freedom (Biometrics Bulletin 2, 1946), s² the variance of the v_k:
    m where a campaign is wholly one error, many where each holds many independent ones. A variance from few campaigns
    may be small by chance: two squares of what a single error would show, 2 v² each, join it.
    """
    squares = np.array([np.mean(scores[campaign == label] ** 2) for label in np.unique(campaign)])
    m, v = len(squares), float(squares.mean())
    variance = (float(np.sum((squares - v) ** 2)) + 4.0 * v**2) / (m + 1)
    dof = 2.0 * m * v**2 / max(variance, 1e-300)
    return float(special.stdtrit(dof, 0.5 + level / 2)) * math.sqrt(v)


def level_sentence(campaigns: int, level: float, guaranteed: float) -> str:
    """What the band holds, in words."""
    counted = f"{campaigns} calibration campaign{'s' if campaigns > 1 else ''}"
    if level <= attainable_level(campaigns):
        return (
            f"The band holds {level:.0%} of the points of a new campaign like the {counted}"
            f" ({guaranteed:.1%} guaranteed in the worst case)."
        )
    return (
        f"The band is made for {level:.0%} on the assumption that the errors of campaigns are normal: {counted} can"
        f" guarantee no more than {attainable_level(campaigns):.1%}, {level:.0%} needs"
        f" {campaigns_needed(level)} campaigns."
    )


def _likeliest_shape(size_um: Floats, leverage: Floats, weights: Floats) -> Band:
    """The band of one standard deviation under which the sizes (n,) are most likely, if they were normal.

    On a grid of growth and knee.
    """
    best, out = math.inf, Band(1.0, (0.0,), growth=0.0)
    far = max(float(leverage.max()), 1e-9)
    for knee in np.maximum(np.quantile(leverage, _KNEES), 1e-9 * far):
        bent = Band(1.0, (1.0,), knee=float(knee), far=far).grown(leverage)
        for growth in _GROWTH_RATIOS:
            shape = 1.0 + growth * bent
            # the smallest scale that a displacement can have: it keeps the score finite where all residuals are zero
            base_square = max(float(weights @ (size_um**2 / shape)), 1e-12)
            unlikely = math.log(base_square) + float(weights @ np.log(shape))
            if unlikely < best:
                best = unlikely
                out = Band(1.0, (math.sqrt(base_square),), growth=float(growth), knee=float(knee), far=far)
    return out


def as_tuple(values: Floats) -> tuple[float, ...]:
    """Values (n,) as plain numbers, for a document."""
    return tuple(float(value) for value in values)

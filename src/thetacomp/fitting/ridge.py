"""Ridge regression on heat history: several block models, strengths found by holding out campaigns, averaged.

One fixed procedure for every machine and component. A candidate says which blocks of inputs take part and how wide
the prior of their coefficients is. Inside the training campaigns each campaign is held out in turn; every candidate
takes the ridge strength with the least held-out square error, and the candidates are averaged with weights
`mse ** -2`. An average of linear models is one linear model, so a controller needs no more than a dot product.
Averaging instead of picking the best: with few campaigns the best candidate is best mostly by chance.

There is no intercept. The error is zero at the reference by definition (the datum is set there), so inputs must be
differences from the reference row; see `rise_since`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thetacomp.arrays import Floats
from thetacomp.errors import AnalysisError
from thetacomp.fitting.estimator import Regressor
from thetacomp.model.filters import InputLayout
from thetacomp.moments import summarise

# strengths relative to inputs of unit variance, half a decade between neighbours
STRENGTHS: tuple[float, ...] = tuple(10.0 ** (k / 2) for k in range(-6, 7))
_WEIGHT_POWER = 2.0


@dataclass(frozen=True)
class BlockUse:
    """One block of inputs in a candidate.

    `width` is the prior standard deviation of its coefficients against the other blocks'. `scale` is `each` where
    every input counts in its own standard deviation, `common` where the block has one scale, so that a sensor that
    hardly moves is not blown up.
    """

    block: str
    width: float
    scale: Literal["each", "common"]


Candidate = tuple[BlockUse, ...]


def history_candidates(layout: InputLayout) -> tuple[Candidate, ...]:
    """The fixed list of candidates for a layout: 144 with speed and its square, 8 without speed.

    Every candidate has the temperatures. It may have their differences to lags, speed lags (one power or all, narrow
    or wide) and products of the lagged highest power with the mean rise. Its lags are three of the layout's time
    constants, every second one, so that fast and slow machines are both served.
    """
    all_taus_s = layout.time_constants_s
    grids = [all_taus_s[i : i + 5 : 2] for i in range(max(1, len(all_taus_s) - 4))]
    powers = list(dict.fromkeys([*((power,) for power in layout.speed_powers), layout.speed_powers]))
    speeds = product(powers, (0.3, 1.0), (0.0, 0.3)) if layout.speed_powers else [((), 0.0, 0.0)]
    scales: tuple[Literal["each", "common"], ...] = ("common", "each")
    # without lags and speed the grids give the same candidate: it counts once
    return tuple(
        dict.fromkeys(
            _candidate(taus_s, scale, lag_width, *speed)
            for scale, lag_width, speed, taus_s in product(scales, (0.0, 0.3), speeds, grids)
        )
    )


def _candidate(
    taus_s: tuple[float, ...],
    scale: Literal["each", "common"],
    lag_width: float,
    powers: tuple[int, ...],
    speed_width: float,
    product_width: float,
) -> Candidate:
    """One block model; `product_width` counts against `speed_width`, a width of 0 leaves the block out."""
    uses = [BlockUse("temperature", 1.0, scale)]
    if lag_width:
        uses += [BlockUse(f"difference {tau_s:g} s", lag_width, "each") for tau_s in taus_s]
    uses += [BlockUse(f"speed^{power} {tau_s:g} s", speed_width, scale) for power in powers for tau_s in taus_s]
    if product_width:
        width = product_width * speed_width
        uses += [BlockUse(f"speed^{powers[-1]} x rise {tau_s:g} s", width, scale) for tau_s in taus_s]
    return tuple(uses)


def rise_since(inputs: Floats, reference: Floats) -> Floats:
    """Inputs (n, inputs) as differences from the reference row (inputs,): zero where the error is zero."""
    return np.asarray(inputs) - np.asarray(reference)


@dataclass(frozen=True)
class CampaignMoments:
    """Sums over each campaign's rows, from which any union of campaigns is fitted without its rows.

    `n` (c,), `x` (c, k), `xx` (c, k, k), `xy` (c, k, m), `yy` (c, m) for c campaigns, k inputs, m targets.
    """

    n: Floats
    x: Floats
    xx: Floats
    xy: Floats
    yy: Floats

    @classmethod
    def of(cls, x: Floats, y: Floats, groups: NDArray[Any]) -> CampaignMoments:
        """One pass over the rows; campaigns in the order of their sorted labels."""
        k = x.shape[1]
        inputs, targets = [f"{i}" for i in range(k)], [f"{i}" for i in range(y.shape[1])]
        parts = [summarise(x[groups == label], y[groups == label], inputs, targets) for label in np.unique(groups)]
        products = np.array([part.about_zero() for part in parts])
        return cls(
            n=np.array([float(part.count) for part in parts]),
            x=np.array([part.count * part.input_mean for part in parts]),
            xx=products[:, :k, :k],
            xy=products[:, :k, k:],
            yy=np.diagonal(products[:, k:, k:], axis1=1, axis2=2),
        )

    def spread(self, rows: Sequence[int]) -> Floats:
        """Standard deviation of every input over some campaigns, (k,)."""
        n = self.n[rows].sum()
        square = np.diagonal(self.xx[rows], axis1=1, axis2=2).sum(axis=0) / n - (self.x[rows].sum(axis=0) / n) ** 2
        spread: Floats = np.sqrt(np.maximum(square, 0.0))
        return spread

    def square_error(self, held_out: int, columns: NDArray[np.intp], coef: Floats) -> Floats:
        """Sum of squared errors (m, strengths) over one campaign, for coefficients (k, m, strengths)."""
        xx = self.xx[held_out][np.ix_(columns, columns)]
        cross = np.einsum("km,kma->ma", self.xy[held_out][columns], coef)
        square = np.einsum("kma,kma->ma", coef, np.tensordot(xx, coef, axes=1))
        error: Floats = np.maximum(self.yy[held_out][:, None] - 2.0 * cross + square, 0.0)
        return error


def ridge_path(
    moments: CampaignMoments, rows: Sequence[int], columns: NDArray[np.intp], width: Floats, strengths: Floats
) -> Floats:
    """Coefficients (k, m, strengths) of `min Σ (y - x b)² / n + strength Σ (b / width)²` over some campaigns.

    One eigen-decomposition serves all strengths and targets. An input of width 0 gets the coefficient 0.
    """
    n = moments.n[rows].sum()
    xx = moments.xx[rows].sum(axis=0)[np.ix_(columns, columns)] / n
    xy = moments.xy[rows].sum(axis=0)[columns] / n
    values, vectors = np.linalg.eigh(xx * width[:, None] * width)
    shrunk = (vectors.T @ (xy * width[:, None]))[:, :, None] / (np.maximum(values, 0.0)[:, None, None] + strengths)
    path: Floats = np.tensordot(vectors, shrunk, axes=1) * width[:, None, None]
    return path


class HistoryRidge(Regressor):
    """The averaged block ridge as a scikit-learn regressor; fit(X, y, groups) with one group label a row.

    `blocks` names the inputs block by block (`InputLayout.blocks`), `candidates` the block models to average.
    X (n, inputs) are differences from the reference row, y (n,) or (n, targets) errors in µm.

    After fit: `coef_` (inputs,) or (targets, inputs) in µm per unit of input; `weights_`, `strengths_` and
    `held_out_rmse_um_` (targets, candidates) of every candidate inside the training campaigns. `left_out_coef_` has a
    row more in front, one for each of `groups_`: the same average made without that group. Only weights and strengths
    have seen it, so residuals against it calibrate a band.
    """

    def __init__(
        self,
        blocks: Mapping[str, tuple[str, ...]],
        candidates: tuple[Candidate, ...],
        strengths: tuple[float, ...] = STRENGTHS,
    ) -> None:
        self.blocks = blocks
        self.candidates = candidates
        self.strengths = strengths

    def fit(self, X: ArrayLike, y: ArrayLike, groups: ArrayLike) -> HistoryRidge:
        """Choose strengths and weights by holding out each group once, then fit on all.

        A row with a missing input or target is left out. Raises AnalysisError for fewer than 2 groups or shapes that
        do not fit together.
        """
        x, target, labels = self._checked(X, y, groups)
        moments = CampaignMoments.of(x, target, labels)
        campaigns = list(range(len(moments.n)))
        rests = [[c for c in campaigns if c != held_out] for held_out in campaigns]
        spreads, spread = [moments.spread(rest) for rest in rests], moments.spread(campaigns)
        strengths = np.asarray(self.strengths)
        size = np.maximum(moments.yy.sum(axis=0) / moments.n.sum(), 1e-12)
        m, k = target.shape[1], x.shape[1]
        mse, chosen = np.empty((m, len(self.candidates))), np.empty((m, len(self.candidates)), dtype=np.intp)
        weights, coef, left_out = np.empty_like(mse), np.zeros((m, k)), np.zeros((len(campaigns), m, k))
        blocks = self._block_columns()
        for i, candidate in enumerate(self.candidates):
            uses = [(use, blocks[use.block]) for use in candidate]
            columns = np.concatenate([own for _, own in uses])
            paths = [
                ridge_path(moments, rest, columns, _widths(uses, own), strengths)
                for rest, own in zip(rests, spreads, strict=True)
            ]
            error = sum(moments.square_error(c, columns, path) for c, path in enumerate(paths)) / moments.n.sum()
            chosen[:, i] = best = np.argmin(error, axis=1)
            mse[:, i] = error[np.arange(m), best]
            weights[:, i] = (mse[:, i] / size + 1e-12) ** -_WEIGHT_POWER
            whole = ridge_path(moments, campaigns, columns, _widths(uses, spread), strengths)
            coef[:, columns] += weights[:, i, None] * whole[:, np.arange(m), best].T
            for c, path in enumerate(paths):
                left_out[c][:, columns] += weights[:, i, None] * path[:, np.arange(m), best].T
        total = weights.sum(axis=1, keepdims=True)
        coef, left_out = coef / total, left_out / total
        self.coef_ = coef if np.ndim(y) == 2 else coef[0]
        self.left_out_coef_ = left_out if np.ndim(y) == 2 else left_out[:, 0]
        self.groups_ = np.unique(labels)
        self.weights_ = weights / total
        self.strengths_ = strengths[chosen]
        self.held_out_rmse_um_ = np.sqrt(mse)
        self.n_features_in_ = k
        return self

    def predict(self, X: ArrayLike) -> Floats:
        """Errors (n,) or (n, targets) in µm."""
        self._require_fit()
        predicted: Floats = np.asarray(X, dtype=np.float64) @ self.coef_.T
        return predicted

    def parameters(self) -> dict[str, Any]:
        """The fitted model as JSON-able numbers: coefficient of every input by name, a list over the targets."""
        self._require_fit()
        names = [name for block in self.blocks.values() for name in block]
        coef = np.atleast_2d(self.coef_)
        return {"inputs": names, "coefficients": [[float(value) for value in row] for row in coef]}

    def _block_columns(self) -> dict[str, NDArray[np.intp]]:
        ends = np.cumsum([len(names) for names in self.blocks.values()])
        return {
            block: np.arange(end - len(names), end)
            for (block, names), end in zip(self.blocks.items(), ends, strict=True)
        }

    def _checked(self, X: ArrayLike, y: ArrayLike, groups: ArrayLike) -> tuple[Floats, Floats, NDArray[Any]]:
        x, target, labels = np.asarray(X, dtype=np.float64), np.asarray(y, dtype=np.float64), np.asarray(groups)
        target = target.reshape(len(target), -1)
        width = sum(len(names) for names in self.blocks.values())
        if x.shape != (len(target), width) or labels.shape != (len(target),):
            raise AnalysisError(
                f"{len(target)} targets need as many groups and inputs of {width} columns;"
                f" found {labels.shape} groups and {x.shape} inputs."
            )
        good = np.isfinite(x).all(axis=1) & np.isfinite(target).all(axis=1)
        if len(np.unique(labels[good])) < 2:
            raise AnalysisError(
                "a model with heat history needs at least 2 training campaigns with complete rows: its settings are"
                " chosen by holding out one of them. Fix: measure one more campaign, or use the paper's model."
            )
        return x[good], target[good], labels[good]


def _widths(uses: Sequence[tuple[BlockUse, NDArray[np.intp]]], spread: Floats) -> Floats:
    """Prior width of each input's coefficient: the block's width over the input's or the block's scale."""
    scales = []
    for use, columns in uses:
        scale = spread[columns]
        scales.append(np.full(len(scale), np.sqrt(np.mean(scale**2))) if use.scale == "common" else scale)
    scale, width = np.concatenate(scales), np.repeat([use.width for use, _ in uses], [len(own) for _, own in uses])
    widths: Floats = np.divide(width, scale, out=np.zeros(len(scale)), where=scale > 1e-9)
    return widths

"""Ridge regression on heat history: several block models, strengths found by holding out campaigns, averaged.

One fixed procedure for every machine and component. A candidate says which blocks of inputs take part and how wide
the prior of their coefficients is. Every candidate takes the ridge strength with the least square error on rows that
are left out, and the candidates are averaged with weights `mse ** -2`. An average of linear models is one linear
model, so a controller needs no more than a dot product. Averaging instead of picking the best: with few campaigns the
best candidate is best mostly by chance.

Rows are means over stretches, so that a campaign of ten thousand samples counts like one of twenty, and the noise of a
thermometer is not taken for its course. What is left out are whole campaigns, or halves of them where campaigns are
few: with three of them, leaving one out and another one inside leaves nothing to compare strengths on.

Errors on left-out rows come from one decomposition `Z = U s Vᵀ` a candidate, without a fit for each: with the hat
matrix `H = U s² / (s² + n λ) Uᵀ` the rows c that are left out together keep `e_c = (1 - H_cc)⁻¹ (y - H y)_c`, exactly
(the blockwise form of PRESS: Allen, Technometrics 16, 1974; Golub, Heath and Wahba, Technometrics 21, 1979).

There is no intercept. The error is zero at the reference by definition (the datum is set there), so inputs must count
from the reference row (`InputLayout.since`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thetacomp.arrays import Floats, Ints
from thetacomp.errors import AnalysisError
from thetacomp.fitting.estimator import Regressor
from thetacomp.model.filters import LEVEL_CAMPAIGNS, InputLayout

# strengths relative to inputs of unit variance, half a decade between neighbours
STRENGTHS: tuple[float, ...] = tuple(10.0 ** (k / 2) for k in range(-6, 7))
_WEIGHT_POWER = 2.0
# rows of all campaigns together, and the fewest and most of one
_ROWS, _FEWEST, _MOST = 400, 8, 80
# below this many campaigns their halves are left out instead of the whole
WHOLE_CAMPAIGNS = 5
# from this many campaigns on an outlying one counts less: where its mean square is above three times the median
OUTLYING_CAMPAIGNS, OUTLYING_TIMES = 9, 3.0


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


def history_candidates(layout: InputLayout, campaigns: int) -> tuple[Candidate, ...]:
    """The fixed list of candidates for a layout and a number of training campaigns.

    Every candidate has the temperatures. It may have their differences to lags, speed lags (none, one power or all,
    narrow or wide), products of the lagged highest power with the mean rise, and products of the rises with the median
    rise. From LEVEL_CAMPAIGNS on what is still open is the level at the start: candidates have products with it or not,
    all have those with the median rise, and speeds come with all their powers.
    """
    taus_s, many = layout.time_constants_s, campaigns >= LEVEL_CAMPAIGNS
    powers = dict.fromkeys([*((power,) for power in layout.speed_powers if not many), layout.speed_powers])
    speeds = [((), 0.0, 0.0), *product([p for p in powers if p], (0.3, 1.0), (0.0, 0.3))]
    most = tuple(factor for factor in layout.products if many or factor != "level")
    scales: tuple[Literal["each", "common"], ...] = ("common", "each")
    return tuple(
        _candidate(taus_s, scale, lag_width, *speed, factors)
        for factors in dict.fromkeys([most[:-1], most])
        for scale, lag_width, speed in product(scales, (0.0, 0.3) if taus_s else (0.0,), speeds)
    )


def _candidate(
    taus_s: tuple[float, ...],
    scale: Literal["each", "common"],
    lag_width: float,
    powers: tuple[int, ...],
    speed_width: float,
    product_width: float,
    factors: tuple[str, ...],
) -> Candidate:
    """One block model; `product_width` counts against `speed_width`, a width of 0 leaves the block out."""
    uses = [BlockUse("temperature", 1.0, scale)]
    if lag_width:
        uses += [BlockUse(f"difference {tau_s:g} s", lag_width, "each") for tau_s in taus_s]
    uses += [BlockUse(f"speed^{power} {tau_s:g} s", speed_width, scale) for power in powers for tau_s in taus_s]
    if product_width:
        width = product_width * speed_width
        uses += [BlockUse(f"speed^{powers[-1]} x rise {tau_s:g} s", width, scale) for tau_s in taus_s]
    uses += [BlockUse(f"rise x {factor}", 0.2, scale) for factor in factors]
    return tuple(uses)


@dataclass(frozen=True)
class Stretches:
    """Means over stretches of each campaign's rows: inputs `x` (n, k), targets `y` (n, m), the row's `campaign` (n,).

    Campaigns are numbered from 0 in the order of `labels`; each stands in rows that follow one another.
    """

    x: Floats
    y: Floats
    campaign: Ints
    labels: NDArray[Any]

    @classmethod
    def of(cls, x: Floats, y: Floats, groups: NDArray[Any]) -> Stretches:
        """Stretches of equal length, as many in a campaign as all of them together allow; rows in order of time."""
        labels = np.unique(groups)
        most = int(np.clip(_ROWS // len(labels), _FEWEST, _MOST))
        parts = [np.array_split(rows, min(most, len(rows))) for rows in (np.flatnonzero(groups == g) for g in labels)]
        every = [rows for campaign in parts for rows in campaign]
        return cls(
            x=np.array([x[rows].mean(axis=0) for rows in every]),
            y=np.array([y[rows].mean(axis=0) for rows in every]),
            campaign=np.repeat(np.arange(len(labels)), [len(campaign) for campaign in parts]),
            labels=labels,
        )

    def left_out_together(self) -> Ints:
        """Number (n,) of what is left out together to choose by: a campaign, or half of one where they are few."""
        if len(self.labels) >= WHOLE_CAMPAIGNS:
            return self.campaign
        rows = np.bincount(self.campaign)[self.campaign]
        number = np.arange(len(self.campaign)) - np.searchsorted(self.campaign, self.campaign)
        return np.unique(2 * self.campaign + (2 * number >= rows), return_inverse=True)[1]


class _Decomposition:
    """`Z = U s Vᵀ` of scaled inputs (n, k), and targets (n, m): ridge of any strength, with and without some rows."""

    def __init__(self, z: Floats, y: Floats) -> None:
        wide = z.shape[1] > len(z)
        squares, vectors = np.linalg.eigh(z @ z.T if wide else z.T @ z)
        kept = squares > 1e-12 * max(squares[-1], 1e-300)
        self.square, vectors = squares[kept], vectors[:, kept]
        self.s = np.sqrt(self.square)
        self.u: Floats = vectors if wide else z @ vectors / self.s
        self.v: Floats = z.T @ vectors / self.s if wide else vectors
        self.y, self.uy, self.n = y, self.u.T @ y, len(z)

    def left_out(self, strengths: Sequence[float], together: Ints) -> Floats:
        """Errors (strengths, n, m) of rows by fits without those left `together`, numbered 0, 1 … in their order."""
        counts = np.bincount(together)
        at = together, np.arange(self.n) - np.searchsorted(together, together)
        u, rest = (np.zeros((len(counts), counts.max(), a.shape[1])) for a in (self.u, self.y))
        u[at], one, out = self.u, np.eye(counts.max()) * (1.0 + 1e-9), []
        for strength in strengths:
            share = self.square / (self.square + self.n * strength)
            rest[at] = self.y - self.u @ (share[:, None] * self.uy)
            out.append(np.linalg.solve(one - (u * share) @ u.transpose(0, 2, 1), rest)[at])
        return np.array(out)

    def coefficients(self, strength: float, campaign: Ints) -> tuple[Floats, Floats]:
        """Coefficients (k, m) of the scaled inputs, and without each campaign of rows (n,), (campaigns, k, m)."""
        gain = (self.s / (self.square + self.n * strength))[:, None]
        (left_um,) = self.left_out((strength,), campaign)
        shift = np.array([self.u[campaign == c].T @ left_um[campaign == c] for c in range(campaign[-1] + 1)])
        whole = self.v @ (gain * self.uy)
        return whole, whole - self.v @ (gain * shift)


class HistoryRidge(Regressor):
    """The averaged block ridge as a scikit-learn regressor; fit(X, y, groups) with one group label a row.

    `blocks` names the inputs block by block (`InputLayout.blocks`), `candidates` the block models to average.
    X (n, inputs) are differences from the reference row in order of time, y (n,) or (n, targets) errors in µm.

    After fit: `coef_` (inputs,) or (targets, inputs) in µm per unit of input; `weights_`, `strengths_` and
    `held_out_rmse_um_` (targets, candidates) of every candidate inside the training campaigns. `left_out_coef_` has a
    row more in front, one for each of `groups_`: the same average made without that group. Only weights and strengths
    have seen it, so residuals against it calibrate a band. `group_weights_` is below 1 for an outlying group.
    """

    groups_: NDArray[Any]
    group_weights_: Floats

    def __init__(
        self,
        blocks: Mapping[str, tuple[str, ...]],
        candidates: tuple[Candidate, ...],
        strengths: tuple[float, ...] = STRENGTHS,
    ) -> None:
        self.blocks = blocks
        self.candidates = candidates
        self.strengths = strengths

    def fit(self, X: ArrayLike, y: ArrayLike, groups: ArrayLike, like: HistoryRidge | None = None) -> HistoryRidge:
        """Choose strengths and weights on rows that are left out, then fit on all; or take both from a fit `like` it.

        A row with a missing input or target is left out. Raises AnalysisError for fewer than 2 groups or shapes that
        do not fit together.
        """
        rows = Stretches.of(*self._checked(X, y, groups))
        if like is not None:
            weight = like.group_weights_[np.searchsorted(like.groups_, rows.labels)]
            averaged = self._average(rows, weight, like)
        else:
            weight = np.ones(len(rows.labels))
            averaged = self._average(rows, weight)
            if len(rows.labels) >= OUTLYING_CAMPAIGNS:
                weight = _outlying(rows, averaged.left_out)
                averaged = self._average(rows, weight) if weight.min() < 1.0 else averaged
        several = np.ndim(y) == 2
        self.coef_ = averaged.coef if several else averaged.coef[0]
        self.left_out_coef_ = averaged.left_out if several else averaged.left_out[:, 0]
        self.groups_, self.group_weights_ = rows.labels, weight
        self.weights_, self.strengths_, self.held_out_rmse_um_ = averaged.weights, averaged.strengths, averaged.rmse_um
        self.n_features_in_ = rows.x.shape[1]
        return self

    def _average(self, rows: Stretches, group_weight: Floats, like: HistoryRidge | None = None) -> _Average:
        """All candidates at their best strengths, averaged; groups count by `group_weight` (groups,)."""
        root = np.sqrt(group_weight)[rows.campaign][:, None]
        spread, blocks, m = rows.x.std(axis=0), self._block_columns(), rows.y.shape[1]
        z, y = rows.x * root, rows.y * root
        shape = (m, len(self.candidates))
        mse, strengths, weights = np.full(shape, np.nan), np.empty(shape), np.empty(shape)
        coef = np.zeros((m, rows.x.shape[1]))
        left_out = np.zeros((len(rows.labels), *coef.shape))
        for i, candidate in enumerate(self.candidates):
            uses = [(use, blocks[use.block]) for use in candidate]
            columns, width = np.concatenate([own for _, own in uses]), _widths(uses, spread)
            fitted = _Decomposition(z[:, columns] * width, y)
            if like is None:
                mse[:, i], strengths[:, i] = self._best(fitted, rows.left_out_together())
                weights[:, i] = (mse[:, i] / np.maximum(np.mean(y**2, axis=0), 1e-12) + 1e-12) ** -_WEIGHT_POWER
            else:
                mse[:, i], strengths[:, i] = like.held_out_rmse_um_[:, i] ** 2, like.strengths_[:, i]
                weights[:, i] = like.weights_[:, i]
            for strength in np.unique(strengths[:, i]):
                own = np.flatnonzero(strengths[:, i] == strength)
                whole, without = fitted.coefficients(strength, rows.campaign)
                weight = weights[own, i, None]
                coef[np.ix_(own, columns)] += weight * (whole * width[:, None]).T[own]
                left_out[:, own[:, None], columns] += weight * (without * width[:, None]).transpose(0, 2, 1)[:, own]
        total = weights.sum(axis=1, keepdims=True)
        return _Average(coef / total, left_out / total, weights / total, strengths, np.sqrt(mse))

    def _best(self, fitted: _Decomposition, together: Ints) -> tuple[Floats, Floats]:
        """Least mean square error (m,) on left-out rows, and the strength (m,) that gives it."""
        errors = np.mean(fitted.left_out(self.strengths, together) ** 2, axis=1)
        return errors.min(axis=0), np.asarray(self.strengths)[errors.argmin(axis=0)]

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


@dataclass(frozen=True)
class _Average:
    """Of m targets and a candidates: `coef` (m, k), `left_out` (campaigns, m, k), the others (m, a)."""

    coef: Floats
    left_out: Floats
    weights: Floats
    strengths: Floats
    rmse_um: Floats


def _outlying(rows: Stretches, left_out: Floats) -> Floats:
    """Weight of every campaign: below 1 where the fit without it misses it by far more than the others are missed."""
    missed = rows.y - np.einsum("nk,nmk->nm", rows.x, left_out[rows.campaign])
    square = np.array([np.mean(missed[rows.campaign == c] ** 2, axis=0) for c in range(len(rows.labels))])
    times = np.mean(square / np.maximum(np.median(square, axis=0), 1e-12), axis=1)
    weight: Floats = 1.0 / np.maximum(1.0, times / OUTLYING_TIMES)
    return weight


def _widths(uses: Sequence[tuple[BlockUse, NDArray[np.intp]]], spread: Floats) -> Floats:
    """Prior width of each input's coefficient: the block's width over the input's or the block's scale."""
    scales = []
    for use, columns in uses:
        scale = spread[columns]
        scales.append(np.full(len(scale), np.sqrt(np.mean(scale**2))) if use.scale == "common" else scale)
    scale, width = np.concatenate(scales), np.repeat([use.width for use, _ in uses], [len(own) for _, own in uses])
    widths: Floats = np.divide(width, scale, out=np.zeros(len(scale)), where=scale > 1e-9)
    return widths

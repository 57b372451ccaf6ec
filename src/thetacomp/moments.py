"""Mergeable cross products of inputs and targets: the one small thing that all linear work is done on.

A `Summary` holds the row count, the means and the centred cross products of one campaign. Summaries are built in one
pass and merged (Chan, Golub, LeVeque 1979, "Updating formulae and a pairwise algorithm for computing sample
variances"), and give least squares, ridge and leave-one-campaign-out errors without going back to the rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.errors import AnalysisError

# A column that varies by less than this share of its own mean is constant: float64 rounding makes more than that.
CONSTANT_SHARE = 1e-14
# An input of which less than this share of the variance is its own is a combination of the others.
DEPENDENT_SHARE = 1e-12
_BLOCK_ROWS = 8192


@dataclass(frozen=True)
class Summary:
    """Cross products of `count` complete rows, p inputs and q targets.

    `mean` is (p + q,), `cross` (p + q, p + q): sums over the rows of products of the deviations from the means, inputs
    first, in the products of the columns' own units. `skipped` counts rows left out because a value was missing.
    """

    name: str
    inputs: tuple[str, ...]
    targets: tuple[str, ...]
    count: int
    mean: Floats
    cross: Floats
    skipped: int = 0

    @property
    def input_cross(self) -> Floats:
        """Centred cross products of the inputs, (p, p)."""
        return self.cross[: len(self.inputs), : len(self.inputs)]

    @property
    def mixed_cross(self) -> Floats:
        """Centred cross products of inputs and targets, (p, q)."""
        return self.cross[: len(self.inputs), len(self.inputs) :]

    @property
    def target_squares(self) -> Floats:
        """Centred sums of squares of the targets, (q,)."""
        return np.diag(self.cross)[len(self.inputs) :].copy()

    @property
    def input_mean(self) -> Floats:
        """Means of the inputs, (p,)."""
        return self.mean[: len(self.inputs)]

    @property
    def target_mean(self) -> Floats:
        """Means of the targets, (q,)."""
        return self.mean[len(self.inputs) :]

    def about_zero(self) -> Floats:
        """Sums over the rows of products of the columns themselves, (p + q, p + q): for fits without a constant."""
        products: Floats = self.cross + self.count * np.outer(self.mean, self.mean)
        return products

    def is_constant(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Which of the p + q columns do not vary beyond rounding."""
        spread = np.sqrt(np.maximum(np.diag(self.cross), 0.0) / max(self.count, 1))
        return spread <= CONSTANT_SHARE * np.abs(self.mean)

    def select(self, inputs: Sequence[str] | None = None, targets: Sequence[str] | None = None) -> Summary:
        """The same rows with some of the columns, in the order asked for. AnalysisError for an unknown name."""
        new_inputs = self.inputs if inputs is None else tuple(inputs)
        new_targets = self.targets if targets is None else tuple(targets)
        kept = [_position(self.inputs, name, "input") for name in new_inputs]
        kept += [len(self.inputs) + _position(self.targets, name, "target") for name in new_targets]
        return replace(
            self,
            inputs=new_inputs,
            targets=new_targets,
            mean=self.mean[kept],
            cross=self.cross[np.ix_(kept, kept)],
        )

    def repeated(self, times: int) -> Summary:
        """The summary of the same rows, each taken `times` times."""
        return replace(self, count=self.count * times, cross=self.cross * times, skipped=self.skipped * times)


def _position(names: tuple[str, ...], name: str, kind: str) -> int:
    if name not in names:
        raise AnalysisError(f"there is no {kind} '{name}'; the {kind}s are: {', '.join(names)}")
    return names.index(name)


class SummaryBuilder:
    """Builds one Summary from rows that come in any number of pieces; memory does not grow with the rows."""

    def __init__(self, inputs: Sequence[str], targets: Sequence[str], name: str = "") -> None:
        self._inputs, self._targets, self._name = tuple(inputs), tuple(targets), name
        columns = len(self._inputs) + len(self._targets)
        self._count = 0
        self._skipped = 0
        self._mean = np.zeros(columns)
        self._cross = np.zeros((columns, columns))

    def add(self, columns: Floats) -> None:
        """Take rows in, given as (p + q, rows): inputs first. Rows with a value that is not finite are skipped."""
        if columns.ndim != 2 or columns.shape[0] != len(self._mean):
            raise ValueError(f"expected ({len(self._mean)}, rows), got {columns.shape}")
        for start in range(0, columns.shape[1], _BLOCK_ROWS):
            self._add_block(columns[:, start : start + _BLOCK_ROWS])

    def _add_block(self, block: Floats) -> None:
        mean = block.mean(axis=1)
        if not np.isfinite(mean).all():
            complete = np.isfinite(block).all(axis=0)
            self._skipped += int((~complete).sum())
            block = block[:, complete]
            if block.shape[1] == 0:
                return
            mean = block.mean(axis=1)
        deviation = block - mean[:, None]
        self._count, self._mean, self._cross = _merged(
            (self._count, self._mean, self._cross), (block.shape[1], mean, deviation @ deviation.T)
        )

    def build(self) -> Summary:
        """The summary of everything added so far."""
        return Summary(
            name=self._name,
            inputs=self._inputs,
            targets=self._targets,
            count=self._count,
            mean=self._mean.copy(),
            cross=self._cross.copy(),
            skipped=self._skipped,
        )


_Moments = tuple[int, Floats, Floats]


def _merged(a: _Moments, b: _Moments) -> _Moments:
    """Moments of the rows of both: Chan et al., pairwise update."""
    count = a[0] + b[0]
    if a[0] == 0 or b[0] == 0:
        return b if a[0] == 0 else a
    step = b[1] - a[1]
    mean = a[1] + step * (b[0] / count)
    return count, mean, a[2] + b[2] + np.outer(step, step) * (a[0] * b[0] / count)


def summarise(
    inputs: Floats, targets: Floats, input_names: Sequence[str], target_names: Sequence[str], name: str = ""
) -> Summary:
    """Summary of rows that are in memory: `inputs` (n, p) and `targets` (n, q). NaN is a missing value."""
    builder = SummaryBuilder(input_names, target_names, name)
    for start in range(0, len(inputs), _BLOCK_ROWS):
        rows = slice(start, start + _BLOCK_ROWS)
        builder.add(np.ascontiguousarray(np.concatenate((inputs[rows], targets[rows]), axis=1).T))
    return builder.build()


def _same_columns(a: Summary, b: Summary) -> None:
    if (a.inputs, a.targets) != (b.inputs, b.targets):
        raise AnalysisError(
            f"'{a.name}' and '{b.name}' do not hold the same inputs and targets in the same order; "
            "choose the common columns with select() first"
        )


def merge(summaries: Sequence[Summary], name: str = "") -> Summary:
    """The summary of all rows together. AnalysisError where the columns differ or nothing is given."""
    if not summaries:
        raise AnalysisError("no campaign to merge; give at least one")
    first = summaries[0]
    moments = (first.count, first.mean, first.cross)
    for other in summaries[1:]:
        _same_columns(first, other)
        moments = _merged(moments, (other.count, other.mean, other.cross))
    skipped = sum(s.skipped for s in summaries)
    return replace(first, name=name, count=moments[0], mean=moments[1], cross=moments[2], skipped=skipped)


def leave_one_out(campaigns: Sequence[Summary]) -> tuple[Summary, ...]:
    """For every campaign the summary of all the others. AnalysisError where there are fewer than two campaigns.

    The others are added up, not subtracted from the total: a campaign far larger than the rest then costs no digits.
    """
    if len(campaigns) < 2:
        raise AnalysisError(f"leaving one campaign out needs at least 2 campaigns, found {len(campaigns)}")
    before: list[Summary] = [campaigns[0]]
    after: list[Summary] = [campaigns[-1]]
    for campaign in campaigns[1:-1]:
        before.append(merge([before[-1], campaign]))
    for campaign in campaigns[-2:0:-1]:
        after.append(merge([campaign, after[-1]]))
    after.reverse()
    inner = [merge([before[i - 1], after[i]]) for i in range(1, len(campaigns) - 1)]
    others = [after[0], *inner, before[-1]]
    return tuple(replace(o, name=f"all but {c.name}") for o, c in zip(others, campaigns, strict=True))


@dataclass(frozen=True)
class LinearFit:
    """targets = intercept + inputs @ coefficients; `coefficients` (p, q), `intercept` (q,), in the columns' units."""

    inputs: tuple[str, ...]
    targets: tuple[str, ...]
    coefficients: Floats
    intercept: Floats


def least_squares(summary: Summary) -> LinearFit:
    """Ordinary least squares with intercept.

    AnalysisError names the first input that is constant or a combination of the inputs before it.
    """
    scale = np.sqrt(np.diag(summary.input_cross))
    constant = summary.is_constant()[: len(summary.inputs)]
    if constant.any():
        raise AnalysisError(f"input '{summary.inputs[int(constant.argmax())]}' does not vary; leave it out")
    correlation = summary.input_cross / np.outer(scale, scale)
    dependent = _first_dependent(correlation)
    if dependent is not None:
        raise AnalysisError(
            f"input '{summary.inputs[dependent]}' is a combination of the inputs before it; leave it out"
        )
    standardised = np.linalg.solve(correlation, summary.mixed_cross / scale[:, None])
    return _fit(summary, standardised / scale[:, None])


def residual_squares(summary: Summary, fit: LinearFit) -> Floats:
    """Sum of squared residuals of `fit` over the rows of any summary with the same columns, (q,)."""
    bias = summary.target_mean - fit.intercept - summary.input_mean @ fit.coefficients
    explained = np.sum(fit.coefficients * (summary.input_cross @ fit.coefficients - 2.0 * summary.mixed_cross), axis=0)
    squares: Floats = summary.target_squares + explained + summary.count * bias**2
    return np.maximum(squares, 0.0)


def held_out_squares(campaigns: Sequence[Summary]) -> Floats:
    """Sum of squared errors of each campaign under the least-squares fit to all the others, (campaigns, q)."""
    fits = [least_squares(rest) for rest in leave_one_out(campaigns)]
    return np.array([residual_squares(campaign, fit) for campaign, fit in zip(campaigns, fits, strict=True)])


def _fit(summary: Summary, coefficients: Floats) -> LinearFit:
    intercept = summary.target_mean - summary.input_mean @ coefficients
    return LinearFit(summary.inputs, summary.targets, coefficients, intercept)


def _first_dependent(correlation: Floats) -> int | None:
    """Index of the first column that the columns before it explain: Gaussian elimination without pivoting."""
    rest = correlation.copy()
    for i in range(len(rest)):
        if rest[i, i] < DEPENDENT_SHARE:
            return i
        rest[i + 1 :, i + 1 :] -= np.outer(rest[i + 1 :, i], rest[i, i + 1 :] / rest[i, i])
    return None

"""The inner work of the exact subset search, many subsets at a time: sweeps, gains of pairs, exact scores.

Inputs have unit length over all rows (the diagonal of `gram` is 1), targets carry the square roots of their weights and
together have the sum of squares 1. A subset's `residual` is then the unexplained share, its score in 0..1 or above.

The search walks a tree: a node is a set of chosen columns and an ordered list of free ones, and represents all subsets
that add `k - chosen` of the free columns. Nodes lie in rows (columns chosen, columns free, the chosen, the free ...);
those with as many chosen and free columns are worked on together. With the chosen columns swept out of A = XᵀX and
M = XᵀYWYᵀX, the pair (i, j) explains (A_jj M_ii - 2 A_ij M_ij + A_ii M_jj) / det more. That form is a filter: what it
lets through is scored again by a Cholesky factorisation of the original products.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import comb
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thetacomp.arrays import Floats

RESIDUAL, HELD_OUT, WORST = 0, 1, 2

# A column of which less than this share of the variance is its own, given those before it, makes a subset unfit.
DEPENDENT_SHARE = 1e-12
# Scores this close (as a share of the targets' sum of squares) count as equal: the subset listed first wins.
TIE = 1e-12
# Rounding of a swept product, before division by the smallest pivot of the sweep.
SWEEP_ERROR = 8e-15

# Numbers in one block of work: large enough to hide the cost of a call, small enough for the cache.
_BLOCK = 1 << 16
# So many candidates are gathered before they are scored, as a score costs the same calls for one or for hundreds.
_POOL = 8192
# Of these the most promising come first: their score may spare the others.
_FIRST = 128

Nodes = NDArray[np.int32]
Subsets = NDArray[np.int64]


class Products(NamedTuple):
    """What the search works on: p inputs, q targets, c campaigns (arrays with c = 0 where none are held out).

    `train_*` belong to all campaigns but one, `test_*` to that one, taken about the training means. `share` turns a sum
    of squares into a campaign's score: 1 for HELD_OUT, rows / rows of the campaign for WORST.
    """

    mode: int
    gram: Floats  # (p, p)
    mixed: Floats  # (p, q)
    train_gram: Floats  # (c, p, p)
    train_mixed: Floats  # (c, p, q)
    test_gram: Floats  # (c, p, p)
    test_mixed: Floats  # (c, p, q)
    test_squares: Floats  # (c,)
    share: Floats  # (c,)


# --- exact scores -----------------------------------------------------------------------------------------------------


def _forward(gram: Floats, mixed: Floats, subsets: Subsets) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Cholesky factors (f, k, k, n; reciprocal diagonal), L⁻¹ of the targets (f, k, n, q) and fitness (f, n).

    `gram` (f, p, p) and `mixed` (f, p, q) are the products of f folds, `subsets` (k, n). A subset is unfit where some
    column has less than the share DEPENDENT_SHARE of its own, given those before it.
    """
    lower = gram[:, subsets[:, None], subsets[None]]
    solved = mixed[:, subsets]
    own = np.einsum("fiin->fin", lower).copy()
    fit = np.ones((lower.shape[0], lower.shape[3]), dtype=bool)
    for i in range(len(subsets)):
        pivot = lower[:, i, i]
        fit &= (own[:, i] >= DEPENDENT_SHARE) & (pivot >= DEPENDENT_SHARE * own[:, i])
        lower[:, i, i] = 1.0 / np.sqrt(np.where(fit, pivot, 1.0))
        lower[:, i + 1 :, i] *= lower[:, None, i, i]
        solved[:, i] *= lower[:, i, i, :, None]
        below = lower[:, i + 1 :, i]
        lower[:, i + 1 :, i + 1 :] -= below[:, :, None] * below[:, None]
        solved[:, i + 1 :] -= below[..., None] * solved[:, None, i]
    return lower, solved, fit


def _held_out(products: Products, folds: slice, subsets: Subsets) -> Floats:
    """Sums of squared errors (f, n) of the campaigns `folds` under the fits to the others; infinite where unfit."""
    lower, beta, fit = _forward(products.train_gram[folds], products.train_mixed[folds], subsets)
    for i in range(len(subsets) - 1, -1, -1):
        beta[:, i] *= lower[:, i, i, :, None]
        beta[:, :i] -= lower[:, i, :i, :, None] * beta[:, None, i]
    test = products.test_gram[folds][:, subsets[:, None], subsets[None]]
    total = products.test_squares[folds, None] - 2.0 * np.einsum(
        "finq,finq->fn", products.test_mixed[folds][:, subsets], beta
    )
    total += np.einsum("fijn,fijn->fn", test, np.einsum("finq,fjnq->fijn", beta, beta))
    return np.where(fit, np.maximum(total, 0.0), np.inf)


def scores(products: Products, subsets: Subsets, limit: float = np.inf) -> Floats:
    """Scores (n,) of subsets (n, k), ascending columns: infinite where unfit, some value above `limit` where worse."""
    out = np.empty(len(subsets))
    folds = max(1, len(products.share))
    step = max(1, 8 * _BLOCK // (folds * products.mixed.shape[1] * subsets.shape[1]))
    for first in range(0, len(subsets), step):
        part = slice(first, first + step)
        out[part] = _scores(products, np.ascontiguousarray(subsets[part].T), limit)
    return out


def _scores(products: Products, subsets: Subsets, limit: float) -> Floats:
    _, solved, fit = _forward(products.gram[None], products.mixed[None], subsets)
    residual = np.maximum(1.0 - np.einsum("finq,finq->n", solved, solved), 0.0)
    out = np.where(fit[0], residual, np.inf)
    if products.mode == RESIDUAL:
        return out
    left = np.flatnonzero(out <= limit)  # a held-out sum is never below the residual
    out[left] = 0.0
    # The campaign that is hardest to predict stands first: most subsets fail there already.
    for folds in (slice(0, 1), slice(1, None)):
        squares = _held_out(products, folds, subsets[:, left]) * products.share[folds, None]
        out[left] = (
            np.maximum(out[left], squares.max(axis=0, initial=0.0))
            if products.mode == WORST
            else out[left] + squares.sum(axis=0)
        )
        left = left[out[left] <= limit]
    return out


def fold_squares(products: Products, subset: Subsets) -> Floats:
    """Sum of squared errors (c,) of every campaign, held out, for one subset (k,)."""
    return _held_out(products, slice(None), subset[:, None])[:, 0]


class Incumbent:
    """The best subset so far; of those with equal scores the one listed first."""

    def __init__(self, products: Products, k: int) -> None:
        self.products = products
        self.subset: Subsets = np.zeros(k, dtype=np.int64)
        self.value = np.inf
        self._waiting: list[tuple[Subsets, Floats]] = []
        self._count = 0

    def offer(self, subsets: Subsets) -> None:
        """Score subsets (n, k) in any order of columns and keep the best."""
        ordered = np.sort(subsets, axis=1)
        values = scores(self.products, ordered, self.value + TIE)
        lowest = min(float(values.min(initial=np.inf)), self.value)
        if lowest == np.inf:
            return
        alike = np.flatnonzero(values <= lowest + TIE)
        rivals = [(ordered[i].tolist(), float(values[i])) for i in alike]
        if self.value <= lowest + TIE:
            rivals.append((self.subset.tolist(), self.value))
        best, self.value = min(rivals)
        self.subset = np.array(best, dtype=np.int64)

    def put_by(self, subsets: Subsets, residual: Floats) -> None:
        """Keep subsets that may be better, with lower limits of their residuals, until there are enough to score."""
        self._waiting.append((subsets, residual))
        self._count += len(subsets)
        if self._count >= _POOL:
            self.settle()

    def settle(self) -> None:
        """Score what was put by, the most promising first, so that the others need not be."""
        if not self._waiting:
            return
        subsets = np.concatenate([s for s, _ in self._waiting])
        residual = np.concatenate([r for _, r in self._waiting])
        self._waiting, self._count = [], 0
        order = np.argsort(residual, kind="stable")
        first, size = 0, _FIRST
        while first < len(order) and residual[order[first]] <= self.value + TIE:
            self.offer(subsets[order[first : first + size]])
            first, size = first + size, 2 * size


def local_search(incumbent: Incumbent) -> None:
    """A good subset: columns added one by one, then exchanged one by one until nothing improves.

    Its score starts the exact search off with a strong limit; for k = 1 it is the exact answer.
    """
    products, k = incumbent.products, len(incumbent.subset)
    every = np.arange(len(products.gram))
    best = Incumbent(products, 0)
    for size in range(1, k + 1):
        longer, best = best, Incumbent(products, size)
        rest = np.setdiff1d(every, longer.subset)
        best.offer(np.column_stack([np.tile(longer.subset, (len(rest), 1)), rest]))
        if best.value == np.inf:
            return
    before = np.inf
    while best.value < before - TIE and k > 1:
        before = best.value
        rest = np.setdiff1d(every, best.subset)
        trials = np.tile(best.subset, (k, len(rest), 1))
        trials[np.arange(k), :, np.arange(k)] = rest
        best.offer(trials.reshape(-1, k))
    incumbent.subset, incumbent.value = best.subset, best.value


# --- nodes of the tree ------------------------------------------------------------------------------------------------


class Swept(NamedTuple):
    """Products of the free columns of b nodes, the chosen ones swept out; `kept` says which of the nodes are fit."""

    gram: Floats  # (b, s, s)
    mixed: Floats  # (b, s, q)
    explained: Floats  # (b,)
    smallest: Floats  # (b,), the smallest pivot
    kept: NDArray[np.intp]  # (b,)


def alike(nodes: Nodes) -> Iterator[NDArray[np.intp]]:
    """Places of nodes with as many chosen and as many free columns, in blocks; the order of the nodes is kept."""
    kind = nodes[:, 0].astype(np.int64) * nodes.shape[1] + nodes[:, 1]
    order = np.argsort(kind, kind="stable")
    for group in np.split(order, np.flatnonzero(np.diff(kind[order])) + 1):
        step = max(1, _BLOCK // int(nodes[group[0], :2].sum()) ** 2)
        for first in range(0, len(group), step):
            yield group[first : first + step]


def sweep(products: Products, nodes: Nodes) -> Swept:
    """Sweep the chosen columns of nodes, all with as many chosen and free ones; nodes that are unfit are left out."""
    chosen, size = int(nodes[0, 0]), int(nodes[0, :2].sum())
    columns = nodes[:, 2 : 2 + size]
    gram, mixed = products.gram[columns[:, :, None], columns[:, None]], products.mixed[columns]
    explained, smallest = np.zeros(len(nodes)), np.ones(len(nodes))
    for s in range(chosen):
        smallest = np.minimum(smallest, gram[:, s, s])
        own = np.maximum(gram[:, s, s], 0.1 * DEPENDENT_SHARE)
        explained += np.einsum("bq,bq->b", mixed[:, s], mixed[:, s]) / own
        lead = gram[:, s + 1 :, s] / own[:, None]
        mixed[:, s + 1 :] -= lead[..., None] * mixed[:, None, s]
        gram[:, s + 1 :, s + 1 :] -= lead[..., None] * gram[:, None, s, s + 1 :]
    kept = np.flatnonzero(smallest >= 0.1 * DEPENDENT_SHARE)
    return Swept(gram[kept, chosen:, chosen:], mixed[kept, chosen:], explained[kept], smallest[kept], kept)


def pair_margins(gram: Floats, mixed_gram: Floats, needed: Floats, error: Floats) -> Floats:
    """(gain - needed) det of every pair of columns, (b, s, s): what it explains more than is `needed` (b,), times det.

    `gram` and `mixed_gram` (b, s, s) are A and M with everything else swept out; rounding (`error`, b) is added.
    """
    own, mixed_own = np.einsum("bii->bi", gram), np.einsum("bii->bi", mixed_gram)
    half = mixed_own + error[:, None] - 0.5 * needed[:, None] * own
    crossed: Floats = half[:, :, None] * own[:, None]
    return crossed + crossed.transpose(0, 2, 1) - gram * (2.0 * mixed_gram - needed[:, None, None] * gram)


def compare(nodes: Nodes, k: int, incumbent: Incumbent) -> int:
    """Offer every subset of nodes of one shape, two or three columns to add, that may be the best.

    Returns the number of subsets compared.
    """
    swept = sweep(incumbent.products, nodes)
    add, size, gram = k - int(nodes[0, 0]), int(nodes[0, 1]), swept.gram
    nodes = nodes[swept.kept]
    if not len(nodes):
        return 0
    mixed_gram = swept.mixed @ swept.mixed.transpose(0, 2, 1)
    columns, unexplained = nodes[:, 2 : 2 + k - add + size], 1.0 - swept.explained
    if add == 2:
        _put_by(gram, mixed_gram, unexplained, swept.smallest, columns, incumbent)
        return len(nodes) * comb(size, 2)
    for p in range(size - 2):  # three columns to add: every free column with two after it is swept once
        own, after = np.maximum(gram[:, p, p], 0.1 * DEPENDENT_SHARE), slice(p + 1, size)
        row, lead = gram[:, p, after], gram[:, p, after] / own[:, None]
        part = mixed_gram[:, p, after] - lead * mixed_gram[:, p, p, None]
        left = gram[:, after, after] - lead[:, :, None] * row[:, None]
        mixed_left = mixed_gram[:, after, after] - lead[:, :, None] * mixed_gram[:, p, None, after]
        mixed_left -= part[:, :, None] * lead[:, None]
        chosen = np.column_stack([columns[:, : k - 3], columns[:, k - 3 + p :]])
        smallest = np.minimum(swept.smallest, own)
        _put_by(left, mixed_left, unexplained - mixed_gram[:, p, p] / own, smallest, chosen, incumbent)
    return len(nodes) * comb(size, 3)


def _put_by(
    gram: Floats, mixed_gram: Floats, unexplained: Floats, smallest: Floats, columns: Nodes, incumbent: Incumbent
) -> None:
    """Put by the pairs of free columns that may be better: A and M (b, s, s) of the last s of the `columns`."""
    needed = np.maximum(unexplained - incumbent.value - TIE, -1.0)
    margins = pair_margins(gram, mixed_gram, needed, SWEEP_ERROR / smallest)
    if margins.max() < 0.0:
        return
    b, i, j = np.nonzero(margins >= 0.0)
    b, i, j = b[i < j], i[i < j], j[i < j]
    det = gram[b, i, i] * gram[b, j, j] - gram[b, i, j] ** 2
    fit = det > 0.1 * DEPENDENT_SHARE * np.maximum(gram[b, i, i], gram[b, j, j])
    b, i, j, det = b[fit], i[fit], j[fit], det[fit]
    if len(b):
        first = columns.shape[1] - gram.shape[1]
        subsets = np.column_stack([columns[b, :first], columns[b, first + i], columns[b, first + j]])
        incumbent.put_by(subsets.astype(np.int64), unexplained[b] - needed[b] - margins[b, i, j] / det)

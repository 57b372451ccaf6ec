"""The compiled inner loops of the exact subset search. They stand alone and are tested against plain NumPy.

Inputs have unit length over all rows (the diagonal of `gram` is 1), targets carry the square roots of their weights and
together have the sum of squares 1. A subset's `residual` is then the unexplained share, its score in 0..1 or above.

The search walks a tree: a node is a set of chosen columns and an ordered list of free ones, and stands for all subsets
that add `k - chosen` of the free columns. A node with two columns to add is done by the closed form: with the chosen
columns swept out of A = XᵀX and M = XᵀYWYᵀX, the pair (i, j) explains (A_jj M_ii - 2 A_ij M_ij + A_ii M_jj) / det more.
That form is a filter: what it lets through is scored again by a Cholesky factorisation of the original products.

The functions run without the interpreter lock: the caller shares nodes out to threads. `incumbent[0]` is the best score
known to any of them; a late or lost update costs time and never a result, as every thread keeps its own best.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from numba import njit

from thetacomp.arrays import Floats

RESIDUAL, HELD_OUT, WORST = 0, 1, 2

# A column of which less than this share of the variance is its own, given those before it, makes a subset unfit.
DEPENDENT_SHARE = 1e-12
# Scores this close (as a share of the targets' sum of squares) count as equal: the subset listed first wins.
TIE = 1e-12
# Up to so many subsets of a row are scored one by one at once, more are first filtered together.
_FEW = 3
# Rounding of a swept product, before division by the smallest pivot of the sweep.
SWEEP_ERROR = 8e-15

_Function = TypeVar("_Function", bound=Callable[..., object])


def compiled(function: _Function) -> _Function:
    """Compile on first use, keep the machine code on disk, run without the interpreter lock."""
    return cast(_Function, njit(nogil=True, cache=True, error_model="numpy")(function))


def _compiled_in_any_order(function: _Function) -> _Function:
    """As `compiled`, with promises without which a row is not worked on several pairs at a time.

    No value is NaN, and the order of a maximum is free; nothing here is summed up.
    """
    promises = {"nnan", "nsz", "reassoc", "contract", "arcp"}
    return cast(_Function, njit(nogil=True, cache=True, error_model="numpy", fastmath=promises)(function))


class Products(NamedTuple):
    """What the kernels work on: p inputs, q targets, c campaigns (arrays with c = 0 where none are held out).

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
    row_parts: Floats  # (c, 4, p, p): train_gram, train_mixed @ its T, test_gram, train_mixed @ test_mixed.T, symmetric
    share: Floats  # (c,)


@compiled
def _factor(gram: Any, subset: Any, least: float, lower: Any) -> bool:
    """Cholesky factor of the subset's products into `lower`, reciprocal diagonal.

    False where the subset is unfit: of some column less than the share `least` is its own, given those before it.
    """
    for i in range(len(subset)):
        own = gram[subset[i], subset[i]]
        if own < least:
            return False
        for j in range(i + 1):
            value = gram[subset[i], subset[j]]
            for m in range(j):
                value -= lower[i, m] * lower[j, m]
            if i != j:
                lower[i, j] = value * lower[j, j]
            elif value < least * own:
                return False
            else:
                lower[i, i] = 1.0 / np.sqrt(value)
    return True


@compiled
def _forward(mixed: Any, subset: Any, lower: Any, solved: Any) -> float:
    """Forward substitution of the targets into `solved`; returns the explained sum of squares."""
    explained = 0.0
    for i in range(len(subset)):
        row = solved[i]
        row[:] = mixed[subset[i]]
        for m in range(i):
            factor = lower[i, m]
            for t in range(len(row)):
                row[t] -= factor * solved[m, t]
        for t in range(len(row)):
            row[t] *= lower[i, i]
            explained += row[t] * row[t]
    return explained


@compiled
def _held_out(products: Any, fold: int, subset: Any, lower: Any, beta: Any) -> float:
    """Sum of squared errors of campaign `fold` under the fit to the others; infinite where that fit is impossible."""
    if not _factor(products.train_gram[fold], subset, DEPENDENT_SHARE, lower):
        return np.inf
    _forward(products.train_mixed[fold], subset, lower, beta)
    k = len(subset)
    for i in range(k - 1, -1, -1):
        for m in range(i + 1, k):
            factor = lower[m, i]
            for t in range(beta.shape[1]):
                beta[i, t] -= factor * beta[m, t]
        for t in range(beta.shape[1]):
            beta[i, t] *= lower[i, i]
    total: float = products.test_squares[fold]
    gram, mixed = products.test_gram[fold], products.test_mixed[fold]
    for i in range(k):
        a = subset[i]
        for t in range(beta.shape[1]):
            inner = -2.0 * mixed[a, t] + gram[a, a] * beta[i, t]
            total += beta[i, t] * inner
        for m in range(i):
            double = 2.0 * gram[a, subset[m]]
            for t in range(beta.shape[1]):
                total += double * beta[i, t] * beta[m, t]
    return max(total, 0.0)


@compiled
def score(products: Any, subset: Any, limit: float, lower: Any, solved: Any, campaign_squares: Any) -> float:
    """Score of one subset (ascending columns); infinite where it is unfit, or some value above `limit` early."""
    if not _factor(products.gram, subset, DEPENDENT_SHARE, lower):
        return np.inf
    if products.mode == RESIDUAL:
        return max(1.0 - _forward(products.mixed, subset, lower, solved), 0.0)
    result = 0.0
    for fold in range(len(products.test_squares)):
        squares = _held_out(products, fold, subset, lower, solved)
        campaign_squares[fold] = squares
        squares *= products.share[fold]
        result = max(result, squares) if products.mode == WORST else result + squares
        if result > limit:
            break
    return result


@compiled
def workspace(products: Any, k: int) -> Any:
    lower = np.empty((k, k))
    solved = np.empty((k, products.mixed.shape[1]))
    return lower, solved, np.empty(len(products.test_squares))


@compiled
def subtract(row: Any, factor: float, other: Any) -> None:
    for j in range(len(row)):
        row[j] -= factor * other[j]


@compiled
def row_held_out(products: Any, shared: Any, last: Any, limit: float, folds: Any, bounds: Any) -> None:
    """Lower limits of the held-out scores of the subsets `shared` + one column of `last`, into `bounds`.

    With T = L Lᵀ the training products of a fold, its error is test_squares - 2 tr(N') + tr(H' P') where N' = L⁻¹NL⁻ᵀ
    and so on for the other `row_parts`. All but the last row of L is common to the subsets, so only that row is worked
    out one by one, as vectors over `last`.
    """
    lower, inner, rows, own = folds
    s, count = len(shared), len(last)
    train, joint = rows[0, :, :count], rows[1, :, :count]
    for fold in range(len(products.test_squares)):
        parts = products.row_parts[fold]
        if not _factor(parts[0], shared, 0.1 * DEPENDENT_SHARE, lower):
            bounds[:] = np.inf
            return
        for kind in range(4):
            _last_row(parts[kind], shared, last, lower, rows[kind, :, :count], own[kind, :count])
        pivot = own[0, :count]
        for m in range(s):
            for j in range(count):
                pivot[j] -= train[m, j] * train[m, j]
        for kind in range(1, 4):
            _congruent(parts[kind], shared, lower, inner[kind])
            _finish(inner[kind], train, rows[kind, :, :count], own[kind, :count], own[4, :count])
        base, spread, smallest = products.test_squares[fold], 1.0, 1.0
        for m in range(s):
            smallest = min(smallest, 1.0 / lower[m, m] ** 2)
            spread += inner[2, m, m]
            base -= 2.0 * inner[3, m, m]
            for n in range(s):
                base += inner[1, m, n] * inner[2, m, n]
        cross = own[4, :count]
        cross[:] = 0.0
        for m in range(s):
            for j in range(count):
                cross[j] += joint[m, j] * rows[2, m, j]
        lowest = np.inf
        for j in range(count):
            # The last column's own products, divided by its pivot: H', P' and N' of the new row.
            h, p, n = own[2, j] / pivot[j], own[1, j] / pivot[j], own[3, j] / pivot[j]
            squares = base - 2.0 * n + 2.0 * cross[j] / pivot[j] + h * p
            squares -= SWEEP_ERROR / smallest * (spread + h) / pivot[j]
            fit = pivot[j] >= 0.1 * DEPENDENT_SHARE * parts[0, last[j], last[j]]
            squares = max(squares, 0.0) * products.share[fold] if fit else np.inf
            bounds[j] = max(bounds[j], squares) if products.mode == WORST else bounds[j] + squares
            lowest = min(lowest, bounds[j])
        if lowest > limit:
            return


@compiled
def _last_row(part: Any, shared: Any, last: Any, lower: Any, row: Any, own: Any) -> None:
    """L⁻¹ applied to the products of the shared columns with each of `last`, (s, count); `own`: `last` with itself."""
    for j in range(len(last)):
        own[j] = part[last[j], last[j]]
    for m in range(len(shared)):
        source = part[shared[m]]
        for j in range(len(last)):
            row[m, j] = source[last[j]]
        for n in range(m):
            subtract(row[m], lower[m, n], row[n])
        for j in range(len(last)):
            row[m, j] *= lower[m, m]


@compiled
def _finish(inner: Any, train: Any, row: Any, own: Any, spare: Any) -> None:
    """Turn a last row into that of L⁻¹ part L⁻ᵀ, still to be divided by the root of the pivot (`own`: by the pivot)."""
    for m in range(len(inner)):
        spare[:] = 0.0
        for n in range(len(inner)):
            subtract(spare, -inner[m, n], train[n])
        for j in range(len(own)):
            own[j] += train[m, j] * (spare[j] - 2.0 * row[m, j])
            row[m, j] -= spare[j]


@compiled
def _congruent(part: Any, shared: Any, lower: Any, out: Any) -> None:
    """L⁻¹ part L⁻ᵀ of the shared columns, (s, s)."""
    s = len(shared)
    for i in range(s):
        for j in range(s):
            out[i, j] = part[shared[i], shared[j]]
        for m in range(i):
            subtract(out[i], lower[i, m], out[m])
        for j in range(s):
            out[i, j] *= lower[i, i]
    for j in range(s):
        for i in range(s):
            for m in range(j):
                out[i, j] -= lower[j, m] * out[i, m]
            out[i, j] *= lower[j, j]


@compiled
def _is_before(a: Any, b: Any) -> bool:
    for i in range(len(a)):
        if a[i] != b[i]:
            return bool(a[i] < b[i])
    return False


@compiled
def _offer(products: Any, subset: Any, best: Any, best_score: float, incumbent: Any, work: Any) -> float:
    """Score `subset` and keep it in `best` where it is better, or as good and listed first. Returns the best score."""
    ordered = np.sort(subset)
    limit = min(best_score, incumbent[0]) + TIE
    value = score(products, ordered, limit, work[0], work[1], work[2])
    if value > limit:
        return best_score
    if value < best_score - TIE or (value <= best_score + TIE and _is_before(ordered, best)):
        best[:] = ordered
        best_score = value
    if value < incumbent[0]:
        incumbent[0] = value
    return best_score


@compiled
def local_search(products: Any, k: int, usable: Any, best: Any) -> float:
    """A good subset into `best`: columns added one by one, then exchanged one by one until nothing improves.

    Its score starts the exact search off with a strong limit; for k = 1 it is the exact answer.
    """
    work = workspace(products, k)
    value = np.inf
    for size in range(1, k + 1):
        trial, incumbent = best[:size].copy(), np.array([np.inf])
        kept, value = trial.copy(), np.inf
        for column in usable:
            trial[size - 1] = column
            if not _holds(trial[: size - 1], column):
                value = _offer(products, trial, kept, value, incumbent, work)
        if value == np.inf:
            return value
        best[:size] = kept
    improved = True
    while improved:
        improved = False
        for place in range(k):
            trial, kept, incumbent = best.copy(), best.copy(), np.array([value])
            for column in usable:
                trial[place] = column
                if not _holds(best, column):
                    new = _offer(products, trial, kept, value, incumbent, work)
                    if new < value - TIE:
                        improved = True
                    value = new
            best[:] = kept
    return value


@compiled
def _holds(columns: Any, column: int) -> bool:
    return bool(np.any(columns == column))


@compiled
def take(products: Any, node: Any, gram: Any, mixed: Any) -> Any:
    """Products of a node's free columns with its chosen ones swept out, in the first rows of `gram` and `mixed`.

    Returns what the chosen columns explain and their smallest pivot, which is 0 where they are unfit.
    """
    chosen, size = node[0], node[0] + node[1]
    for i in range(size):
        mixed[i] = products.mixed[node[2 + i]]
        for j in range(size):
            gram[i, j] = products.gram[node[2 + i], node[2 + j]]
    explained, smallest = 0.0, 1.0
    for s in range(chosen):
        own = gram[s, s]
        if own < 0.1 * DEPENDENT_SHARE:
            return 0.0, 0.0
        smallest = min(smallest, own)
        explained += np.sum(mixed[s] ** 2) / own
        for i in range(s + 1, size):
            lead = gram[i, s] / own
            subtract(mixed[i], lead, mixed[s])
            subtract(gram[i, s + 1 : size], lead, gram[s, s + 1 : size])
    for i in range(size - chosen):
        mixed[i] = mixed[chosen + i]
        gram[i, : size - chosen] = gram[chosen + i, chosen:size]
    return explained, smallest


@_compiled_in_any_order
def _pair_gain(a: float, m: float, a_ii: float, m_ii: float, a_jj: float, m_jj: float, error: float) -> float:
    """Upper limit of what a pair explains (closed 2 x 2 form, rounding added); -1 where the pair is unfit."""
    det = a_ii * a_jj - a * a
    gain = (a_jj * m_ii - 2.0 * a * m + a_ii * m_jj + error * (a_ii + a_jj)) / det
    return gain if det > 0.1 * DEPENDENT_SHARE * max(a_ii, a_jj) else -1.0


@_compiled_in_any_order
def _row_gains(gram_row: Any, joint_row: Any, gram_pivot: Any, joint_pivot: Any, lead: Any, own: Any, joint_own: Any,
               first: Any, error: float, gains: Any) -> float:  # fmt: skip
    """Gains of the pairs of one column (`first`: lead, part, own, joint_own) with all after it; returns the largest.

    The pivot column is swept out on the fly: nothing is written back.
    """
    own_lead, own_part, a_ii, m_ii = first
    most = -1.0
    for j in range(len(gains)):
        a = gram_row[j] - own_lead * gram_pivot[j]
        m = joint_row[j] - own_lead * joint_pivot[j] - own_part * lead[j]
        gain = _pair_gain(a, m, a_ii, m_ii, own[j], joint_own[j], error)
        gains[j] = gain
        most = max(most, gain)
    return most


@compiled
def _search_pairs(products: Any, node: Any, pivot: int, explained: float, smallest: float, scratch: Any, folds: Any,
                  best: Any, best_score: float, incumbent: Any, work: Any) -> float:  # fmt: skip
    """Every pair of free columns after `pivot` (itself swept out too; -1: none). Returns the best score."""
    gram, joint, lead, part, own, joint_own, gains, bounds = scratch
    chosen, size, start, p = node[0], node[1], pivot + 1, max(pivot, 0)
    subset = np.empty(len(best), np.int64)  # places in the node until the end
    subset[:chosen] = np.arange(chosen)
    lead[:size] = 0.0
    part[:size] = 0.0
    if pivot >= 0:
        if gram[p, p] < 0.1 * DEPENDENT_SHARE:
            return best_score
        subset[chosen] = chosen + p
        smallest = min(smallest, gram[p, p])
        explained += joint[p, p] / gram[p, p]
        for i in range(start, size):
            lead[i] = gram[p, i] / gram[p, p]
            part[i] = joint[p, i] - lead[i] * joint[p, p]
    for i in range(start, size):
        own[i] = gram[i, i] - lead[i] * gram[p, i]
        joint_own[i] = joint[i, i] - lead[i] * (joint[p, i] + part[i])
    columns = node[2 : 2 + chosen + size]
    for i in range(start, size - 1):
        after, count = slice(i + 1, size), size - 1 - i
        most = _row_gains(
            gram[i, after], joint[i, after], gram[p, after], joint[p, after], lead[after], own[after],
            joint_own[after], (lead[i], part[i], own[i], joint_own[i]), SWEEP_ERROR / smallest, gains[:count],
        )  # fmt: skip
        needed = 1.0 - explained - min(best_score, incumbent[0]) - TIE
        if most < needed:
            continue
        subset[-2] = chosen + i
        bounds[:count] = 0.0
        if products.mode != RESIDUAL and np.sum(gains[:count] >= needed) > _FEW:
            limit = min(best_score, incumbent[0]) + TIE
            row_held_out(products, columns[subset[:-1]], columns[chosen + i + 1 :], limit, folds, bounds[:count])
        for j in range(count):
            limit = min(best_score, incumbent[0]) + TIE
            if gains[j] >= 1.0 - explained - limit and bounds[j] <= limit:
                subset[-1] = chosen + i + 1 + j
                best_score = _offer(products, columns[subset].astype(np.int64), best, best_score, incumbent, work)
    return best_score


@compiled
def _self_products(mixed: Any) -> Any:
    out = np.empty((len(mixed), len(mixed)))
    for i in range(len(mixed)):
        for j in range(i + 1):
            value = 0.0
            for t in range(mixed.shape[1]):
                value += mixed[i, t] * mixed[j, t]
            out[i, j] = value
            out[j, i] = value
    return out


@compiled
def search(products: Any, k: int, nodes: Any, bounds: Any, first: int, step: int, best: Any, best_score: float,
           incumbent: Any) -> Any:  # fmt: skip
    """Compare all subsets of nodes `first`, `first + step`, ..., which have two or three columns to add.

    A single node is shared out by its first column instead. A node is (columns chosen, columns free, the chosen, the
    free ...). Returns the best score and the number of subsets compared; the best subset is in `best`.
    """
    p, q = products.mixed.shape
    gram, mixed, joint = np.empty((p, p)), np.empty((p, q)), np.empty((p, p))
    scratch = (gram, joint, np.empty(p), np.empty(p), np.empty(p), np.empty(p), np.empty(p), np.empty(p))
    folds = (np.empty((k, k)), np.empty((4, k - 1, k - 1)), np.empty((4, k - 1, p)), np.empty((5, p)))
    work = workspace(products, k)
    compared, shared = 0, len(nodes) == 1
    for n in range(0 if shared else first, len(nodes), 1 if shared else step):
        node, size = nodes[n], nodes[n, 1]
        if bounds[n] > min(best_score, incumbent[0]) + TIE:
            continue
        explained, smallest = take(products, node, gram, mixed)
        if smallest == 0.0:
            continue
        joint[:size, :size] = _self_products(mixed[:size])
        # Two columns to add: no pivot (-1). Three: every free column with two after it is the pivot once.
        lowest, stop = (-1, 0) if k - node[0] == 2 else (0, size - 2)
        for pivot in range(lowest + (first if shared else 0), stop, step if shared else 1):
            best_score = _search_pairs(
                products, node, pivot, explained, smallest, scratch, folds, best, best_score, incumbent, work
            )
            left = size - pivot - 1
            compared += left * (left - 1) // 2
    return best_score, compared

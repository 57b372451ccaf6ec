"""The bound of the exact subset search: splits nodes into the children that may still hold the best subset."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thetacomp.arrays import Floats
from thetacomp.sensors._subset_kernel import DEPENDENT_SHARE, SWEEP_ERROR, TIE, Nodes, Products, sweep

# Rounding of a bound from a long factorisation, in addition to what the smallest pivot adds.
_SLACK = 1e-10


def _order_by_loss(gram: Floats, mixed: Floats) -> NDArray[np.intp]:
    """Order (b, s) of the columns so that what is left explains less as fast as possible: the greatest loss first.

    Only the speed of the search depends on it, so a little is added to the diagonal against dependent columns.
    """
    size = gram.shape[1]
    inverse = np.linalg.inv(gram + 1e-9 * np.eye(size))
    beta = inverse @ mixed
    every = np.arange(len(gram))
    order = np.empty(gram.shape[:2], dtype=np.intp)
    left = np.ones(gram.shape[:2], dtype=bool)
    for place in range(size):
        own = np.einsum("bii->bi", inverse)
        loss = np.einsum("bsq,bsq->bs", beta, beta) / np.where(own > 0.0, own, np.inf)
        out = np.where(left, loss, -1.0).argmax(axis=1)
        order[:, place], left[every, out] = out, False
        row = inverse[every, out]
        lead = row / row[every, out][:, None]
        beta -= lead[:, :, None] * beta[every, out][:, None]
        inverse -= lead[:, :, None] * row[:, None]
    return order


def _suffix_explained(gram: Floats, mixed: Floats) -> Floats:
    """For every place (b, s) the most that the columns from there on can explain together; both inputs are used up.

    No subset of columns explains more than all of them: this is the bound of the search. Columns that depend on the
    ones after them add nothing.
    """
    total, smallest = np.zeros(len(gram)), np.ones(len(gram))
    out = np.empty(gram.shape[:2])
    for s in range(gram.shape[1] - 1, -1, -1):
        counts = gram[:, s, s] >= DEPENDENT_SHARE
        own = np.where(counts, gram[:, s, s], np.inf)
        smallest = np.minimum(smallest, own)
        total = total + np.einsum("bq,bq->b", mixed[:, s], mixed[:, s]) / own
        lead = gram[:, :s, s] / own[:, None]
        mixed[:, :s] -= lead[..., None] * mixed[:, None, s]
        gram[:, :s, :s] -= lead[..., None] * gram[:, None, s, :s]
        out[:, s] = total + _SLACK + SWEEP_ERROR / smallest
    return out


def branch(products: Products, k: int, nodes: Nodes, bounds: Floats, limit: float) -> tuple[Nodes, Floats]:
    """Children of nodes of one shape, each with more than three columns to add, and their bounds.

    What cannot hold anything better than `limit` is left out.
    """
    chosen, size = int(nodes[0, 0]), int(nodes[0, 1])
    swept = sweep(products, nodes)
    nodes, bounds = nodes[swept.kept], bounds[swept.kept]
    order = _order_by_loss(swept.gram, swept.mixed)
    rows = np.arange(len(nodes))[:, None]
    suffix = _suffix_explained(swept.gram[rows[..., None], order[:, :, None], order[:, None]], swept.mixed[rows, order])
    free = nodes[rows, 2 + chosen + order]
    children, child_bounds = [], []
    # A child chooses one column and may add only columns after it, so every subset is met exactly once.
    for i in range(size - (k - chosen) + 1):
        bound = np.maximum(bounds, 1.0 - swept.explained - suffix[:, i])
        kept = np.flatnonzero(bound <= limit + TIE)
        child = np.zeros((len(kept), nodes.shape[1]), dtype=np.int32)
        child[:, 0], child[:, 1] = chosen + 1, size - 1 - i
        child[:, 2 : 2 + chosen] = nodes[kept, 2 : 2 + chosen]
        child[:, 2 + chosen : 2 + chosen + size - i] = free[kept, i:]
        children.append(child)
        child_bounds.append(bound[kept])
    return np.concatenate(children), np.concatenate(child_bounds)

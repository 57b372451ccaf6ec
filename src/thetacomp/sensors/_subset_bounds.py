"""The compiled bound of the exact subset search: splits a node into the children that may still hold the best subset.

Numba's cache looks at this file alone: after a change of `take` or `subtract` touch this file too.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from thetacomp.sensors._subset_kernel import DEPENDENT_SHARE, SWEEP_ERROR, TIE, compiled, subtract, take

# Rounding of a bound from a long factorisation, beside what the smallest pivot adds.
_SLACK = 1e-10


@compiled
def _order_by_loss(gram: Any, mixed: Any, order: Any) -> None:
    """Order the columns so that what is left explains less as fast as possible: the greatest loss first.

    Only the speed of the search hangs on it, so a little is added to the diagonal to keep dependent columns apart.
    """
    size = len(order)
    inverse, beta = gram.copy(), mixed.copy()
    for s in range(size):
        inverse[s, s] += 1e-9
    for s in range(size):
        pivot = 1.0 / inverse[s, s]
        for i in range(size):
            if i != s:
                factor = inverse[i, s] * pivot
                inverse[i, s] = 0.0
                subtract(inverse[i], factor, inverse[s])
                subtract(beta[i], factor, beta[s])
                inverse[i, s] = -factor
        for j in range(size):
            inverse[s, j] *= pivot
        for t in range(beta.shape[1]):
            beta[s, t] *= pivot
        inverse[s, s] = pivot
    left = np.arange(size)
    for place in range(size):
        worst, loss = place, -1.0
        for i in range(place, size):
            a = left[i]
            own = 0.0
            for t in range(beta.shape[1]):
                own += beta[a, t] * beta[a, t]
            if own / inverse[a, a] > loss:
                worst, loss = i, own / inverse[a, a]
        out = left[worst]
        left[worst] = left[place]
        left[place] = out
        for i in range(place + 1, size):
            a = left[i]
            factor = inverse[a, out] / inverse[out, out]
            for j in range(place + 1, size):
                inverse[a, left[j]] -= factor * inverse[out, left[j]]
            subtract(beta[a], factor, beta[out])
    order[:] = left


@compiled
def _suffix_explained(gram: Any, mixed: Any, explained: Any) -> None:
    """For every place the most that the columns from there on can explain together, into `explained`; both are used up.

    No subset of columns explains more than all of them: this is the bound of the search. Columns that depend on the
    ones after them add nothing.
    """
    total, smallest = 0.0, 1.0
    for s in range(len(gram) - 1, -1, -1):
        own = gram[s, s]
        if own >= DEPENDENT_SHARE:
            smallest = min(smallest, own)
            total += np.sum(mixed[s] ** 2) / own
            for i in range(s):
                lead = gram[i, s] / own
                subtract(mixed[i], lead, mixed[s])
                subtract(gram[i, :s], lead, gram[s, :s])
        explained[s] = total + _SLACK + SWEEP_ERROR / smallest


@compiled
def _children(k: int, node: Any, bound: float, gram: Any, mixed: Any, explained: float, limit: float,
            children: Any, bounds: Any) -> int:  # fmt: skip
    """Children of a node that may hold something better than `limit`; returns their number."""
    chosen, size = node[0], node[1]
    free = node[2 + chosen : 2 + chosen + size].copy()
    order = np.arange(size)
    _order_by_loss(gram, mixed, order)
    ordered_gram, ordered_mixed = np.empty((size, size)), np.empty((size, mixed.shape[1]))
    for i in range(size):
        ordered_mixed[i] = mixed[order[i]]
        for j in range(size):
            ordered_gram[i, j] = gram[order[i], order[j]]
    suffix = np.empty(size)
    _suffix_explained(ordered_gram, ordered_mixed, suffix)
    number = 0
    # A child chooses one column and may add only columns after it, so every subset is met exactly once.
    for i in range(size - (k - chosen) + 1):
        child_bound = max(bound, 1.0 - explained - suffix[i])
        if child_bound > limit:
            break
        child = children[number]
        child[0], child[1] = chosen + 1, size - 1 - i
        child[2 : 2 + chosen] = node[2 : 2 + chosen]
        for j in range(i, size):
            child[2 + chosen + j - i] = free[order[j]]
        bounds[number] = child_bound
        number += 1
    return number


@compiled
def branch(products: Any, k: int, nodes: Any, bounds: Any, limit: float, children: Any, child_bounds: Any) -> int:
    """Replace nodes, each with more than three columns to add, by their children; returns the number of these."""
    p, q = products.mixed.shape
    gram, mixed = np.empty((p, p)), np.empty((p, q))
    number = 0
    for n in range(len(nodes)):
        node, size = nodes[n], nodes[n, 1]
        explained, smallest = take(products, node, gram, mixed)
        if smallest > 0.0:
            number += _children(
                k, node, bounds[n], gram[:size, :size], mixed[:size], explained, limit + TIE,
                children[number:], child_bounds[number:],
            )  # fmt: skip
    return number

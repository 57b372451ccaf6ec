"""The proven best k of p sensors: branch and bound over subsets, from campaign summaries alone.

A subset explains the targets by least squares with intercept. It is scored by its residual over all rows, by its
leave-one-campaign-out error, or by that error in the worst campaign. Its residual sum of squares never exceeds its
leave-one-campaign-out sum, and no subset explains more than a set that contains it: both bounds are exact, so what the
search leaves out cannot be better (Furnival, Wilson 1974, "Regressions by leaps and bounds").
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import comb, inf, nan
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from thetacomp.arrays import Floats
from thetacomp.errors import AnalysisError
from thetacomp.moments import Summary, held_out_squares, least_squares, leave_one_out, merge, residual_squares
from thetacomp.sensors import _subset_kernel as kernel
from thetacomp.sensors._subset_bounds import branch

Score = Literal["residual", "held_out", "worst_campaign"]
_MODES = {"residual": kernel.RESIDUAL, "held_out": kernel.HELD_OUT, "worst_campaign": kernel.WORST}

# Subsets compared in one round: some tenths of a second, so that progress and budget are kept.
_ROUND_WORK = 3e7
_ROUND_CELLS = 4_000_000
# Beyond this many open nodes the deepest are worked on first, to keep the memory bounded.
_MOST_OPEN = 200_000


@dataclass(frozen=True)
class SearchProgress:
    """Where a search stands: the share of all subsets settled, the best score so far, and the bound below it."""

    settled_share: float
    score: float
    bound: float
    elapsed_s: float


@dataclass(frozen=True)
class SubsetResult:
    """The best subset found and what is known about it.

    `score` is a root mean square over rows and targets: in µm where `weights_um` was given, else as a share of each
    target's standard deviation. No other subset can score below `bound`; `proven` says that the two are equal.
    `evaluated` of the `subsets` were compared one by one, the others excluded by bounds.
    `residual_rms` and `held_out_rms` are (q,), each in its target's own unit; the latter and `worst_campaign` need two
    campaigns (else NaN and ""). A held-out figure of a subset that was chosen by it is a little flattering.
    """

    sensors: tuple[str, ...]
    targets: tuple[str, ...]
    score_name: Score
    score: float
    bound: float
    proven: bool
    evaluated: int
    subsets: int
    residual_rms: Floats
    held_out_rms: Floats
    worst_campaign: str


@dataclass(frozen=True)
class SelectionFrequency:
    """How often each sensor is chosen when the campaigns are drawn anew: `share` (p,) in 0..1 over `draws` draws."""

    sensors: tuple[str, ...]
    share: Floats
    draws: int


def best_subset(
    campaigns: Sequence[Summary],
    k: int,
    *,
    score: Score = "residual",
    targets: Sequence[str] | None = None,
    weights_um: Sequence[float] | None = None,
    progress: Callable[[SearchProgress], None] | None = None,
    budget_s: float | None = None,
    budget_nodes: int | None = None,
    stop: Callable[[], bool] | None = None,
) -> SubsetResult:
    """The k inputs that explain the targets best together.

    `campaigns` holds one summary per campaign. `weights_um` gives for each target the µm of tool error that one of its
    units stands for (1 for an intercept in µm, the travel in m for a slope in µm/m); without it every target is
    standardised. Of subsets with equal scores the one listed first wins. A subset whose columns depend on each other,
    in all campaigns or in those that train a fold, is never chosen.

    The search stops after `budget_s` seconds or `budget_nodes` nodes, or when `stop` says so; `bound` then says what
    may have been missed.
    AnalysisError where the question has no answer: too few sensors or campaigns, a target that does not vary.
    """
    total = merge(campaigns)
    names = total.targets if targets is None else tuple(targets)
    weights = _weights(total.select(targets=names), weights_um)
    return _best_subset(campaigns, k, score, names, weights, progress, budget_s, budget_nodes, stop)


def best_subset_per_target(
    campaigns: Sequence[Summary], k: int, *, score: Score = "residual", budget_s: float | None = None
) -> tuple[SubsetResult, ...]:
    """The best k inputs for every target alone, in the order of the targets; `budget_s` is for each."""
    targets = merge(campaigns).targets
    return tuple(best_subset(campaigns, k, score=score, targets=[t], budget_s=budget_s) for t in targets)


def accuracy_curve(
    campaigns: Sequence[Summary],
    most: int,
    *,
    score: Score = "residual",
    targets: Sequence[str] | None = None,
    weights_um: Sequence[float] | None = None,
    budget_s: float | None = None,
) -> tuple[SubsetResult, ...]:
    """Accuracy against number of sensors: the best subset of 1, 2, ... `most` inputs; `budget_s` is for each."""
    return tuple(
        best_subset(campaigns, k, score=score, targets=targets, weights_um=weights_um, budget_s=budget_s)
        for k in range(1, most + 1)
    )


def selection_frequency(
    campaigns: Sequence[Summary],
    k: int,
    *,
    seed: int,
    draws: int = 200,
    score: Score = "residual",
    targets: Sequence[str] | None = None,
    weights_um: Sequence[float] | None = None,
) -> SelectionFrequency:
    """How often each input is among the best k when whole campaigns are drawn with replacement (bootstrap).

    A campaign drawn twice counts twice, and is held out as one. Draws that hold a single campaign are drawn again.
    """
    if len(campaigns) < 2:
        raise AnalysisError(f"resampling needs at least 2 campaigns, found {len(campaigns)}")
    total = merge(campaigns)
    names = total.targets if targets is None else tuple(targets)
    weights = _weights(total.select(targets=names), weights_um)
    rng = np.random.default_rng(seed)
    chosen = np.zeros(len(total.inputs))
    for _ in range(draws):
        times = np.zeros(len(campaigns), dtype=int)
        while np.count_nonzero(times) < 2:
            times = np.bincount(rng.integers(len(campaigns), size=len(campaigns)), minlength=len(campaigns))
        drawn = [c.repeated(int(n)) for c, n in zip(campaigns, times, strict=True) if n]
        for sensor in _best_subset(drawn, k, score, names, weights, None, None, None).sensors:
            chosen[total.inputs.index(sensor)] += 1
    return SelectionFrequency(total.inputs, chosen / draws, draws)


def _weights(total: Summary, weights_um: Sequence[float] | None) -> Floats:
    """Weight of each target's sum of squares; they make the score a mean over the targets."""
    q = len(total.targets)
    if q == 0:
        raise AnalysisError("no target given; a subset is chosen for at least one")
    constant = total.is_constant()[len(total.inputs) :]
    if constant.any():
        raise AnalysisError(f"target '{total.targets[int(constant.argmax())]}' does not vary; leave it out")
    if weights_um is None:
        return total.count / (total.target_squares * q)
    if len(weights_um) != q or min(weights_um) <= 0.0:
        raise AnalysisError(f"expected {q} weights above 0, one for each target, found {list(weights_um)}")
    return np.asarray(weights_um, dtype=np.float64) ** 2 / q


def _best_subset(
    campaigns: Sequence[Summary],
    k: int,
    score: Score,
    targets: tuple[str, ...],
    weights: Floats,
    progress: Callable[[SearchProgress], None] | None,
    budget_s: float | None,
    budget_nodes: int | None,
    stop: Callable[[], bool] | None = None,
) -> SubsetResult:
    total = merge(campaigns)
    varies = ~total.is_constant()[: len(total.inputs)]
    usable = [name for name, good in zip(total.inputs, varies, strict=True) if good]
    if not 1 <= k <= len(usable):
        raise AnalysisError(f"cannot choose {k} of {len(usable)} sensors that vary (of {len(total.inputs)})")
    reduced = [campaign.select(usable, targets) for campaign in campaigns]
    products, mean_square = _products(reduced, weights, score)
    report = _reporter(progress, mean_square)
    subset, value, bound, evaluated = _search(products, k, report, budget_s, budget_nodes, stop)
    if value == inf:
        raise AnalysisError(
            f"no {k} of the sensors are independent of each other in every fold; ask for fewer or join short campaigns"
        )
    sensors = tuple(usable[i] for i in subset)
    residual_rms, held_out_rms, worst = _errors([c.select(sensors) for c in reduced], weights)
    return SubsetResult(
        sensors=sensors,
        targets=targets,
        score_name=score,
        score=float(np.sqrt(value * mean_square)),
        bound=float(np.sqrt(max(bound, 0.0) * mean_square)),
        proven=bound == value,
        evaluated=evaluated,
        subsets=comb(len(usable), k),
        residual_rms=residual_rms,
        held_out_rms=held_out_rms,
        worst_campaign=worst,
    )


def _reporter(
    progress: Callable[[SearchProgress], None] | None, mean_square: float
) -> Callable[[float, float, float, float], None]:
    """The user's callback, fed with root mean squares in place of shares."""

    def report(settled: float, value: float, bound: float, elapsed_s: float) -> None:
        if progress is not None:
            rms, rms_bound = np.sqrt(value * mean_square), np.sqrt(max(bound, 0.0) * mean_square)
            progress(SearchProgress(settled, float(rms), float(rms_bound), elapsed_s))

    return report


def _errors(campaigns: Sequence[Summary], weights: Floats) -> tuple[Floats, Floats, str]:
    """RMS of the residuals and of the held-out errors, each (q,), and the campaign that is held out worst."""
    total = merge(campaigns)
    residual_rms = np.sqrt(residual_squares(total, least_squares(total)) / total.count)
    if len(campaigns) < 2:
        return residual_rms, np.full(len(weights), nan), ""
    try:
        squares = held_out_squares(campaigns)
    except AnalysisError:  # the sensors are collinear without one of the campaigns
        return residual_rms, np.full(len(weights), nan), ""
    per_row = squares @ weights / np.array([c.count for c in campaigns])
    return residual_rms, np.sqrt(squares.sum(axis=0) / total.count), campaigns[int(per_row.argmax())].name


def _products(campaigns: Sequence[Summary], weights: Floats, score: Score) -> tuple[kernel.Products, float]:
    """The kernels' products, and the weighted mean square of the targets that a score of 1 means."""
    total = merge(campaigns)
    p, q = len(total.inputs), len(total.targets)
    squares = float(total.target_squares @ weights)
    scale = np.concatenate((1.0 / np.sqrt(np.diag(total.input_cross)), np.sqrt(weights / squares)))
    scales = np.outer(scale, scale)

    def parts(cross: Floats) -> tuple[Floats, Floats, float]:
        scaled = cross * scales
        return scaled[:p, :p], scaled[:p, p:], float(np.trace(scaled[p:, p:]))

    gram, mixed, _ = parts(total.cross)
    np.fill_diagonal(gram, 1.0)
    rests = () if score == "residual" else leave_one_out(campaigns)
    train = [parts(rest.cross)[:2] for rest in rests]
    test = [
        parts(c.cross + c.count * np.outer(c.mean - rest.mean, c.mean - rest.mean))
        for c, rest in zip(campaigns, rests, strict=False)
    ]
    counts = np.array([float(c.count) for c in campaigns[: len(rests)]])
    products = kernel.Products(
        mode=_MODES[score],
        gram=np.ascontiguousarray(gram),
        mixed=np.ascontiguousarray(mixed),
        train_gram=np.array([t[0] for t in train]).reshape(-1, p, p),
        train_mixed=np.array([t[1] for t in train]).reshape(-1, p, q),
        test_gram=np.array([t[0] for t in test]).reshape(-1, p, p),
        test_mixed=np.array([t[1] for t in test]).reshape(-1, p, q),
        test_squares=np.array([t[2] for t in test]),
        share=total.count / counts if score == "worst_campaign" else np.ones(len(rests)),
    )
    return products, squares / total.count


def _search(
    products: kernel.Products,
    k: int,
    report: Callable[[float, float, float, float], None],
    budget_s: float | None,
    budget_nodes: int | None,
    stop: Callable[[], bool] | None,
) -> tuple[list[int], float, float, int]:
    """Best subset, its score, the bound below all scores, and the number of subsets compared."""
    p = len(products.gram)
    began_s = time.monotonic()
    best = kernel.Incumbent(products, k)
    kernel.local_search(best)
    if k == 1:
        return best.subset.tolist(), best.value, best.value, p
    best.products = _hardest_first(products, best.subset)
    nodes = np.concatenate(([0, p], np.arange(p))).astype(np.int32)[None, :]
    bounds = np.zeros(1)
    evaluated, worked = 0, 0
    while len(nodes):
        batch = _next_batch(nodes, bounds, k, len(products.share))
        compared, children, child_bounds = _work_batch(best, k, nodes[batch], bounds[batch])
        worked, evaluated = worked + len(batch), evaluated + compared
        kept = np.ones(len(nodes), dtype=bool)
        kept[batch] = False
        nodes = np.concatenate((nodes[kept], *children))
        bounds = np.concatenate((bounds[kept], *child_bounds))
        alive = bounds <= best.value + kernel.TIE
        nodes, bounds = nodes[alive], bounds[alive]
        elapsed_s = time.monotonic() - began_s
        kinds, number = np.unique(nodes[:, :2], axis=0, return_counts=True)
        open_subsets = sum(n * comb(free, k - chosen) for (chosen, free), n in zip(kinds.tolist(), number, strict=True))
        report(1.0 - open_subsets / comb(p, k), best.value, float(bounds.min(initial=best.value)), elapsed_s)
        spent = (
            (budget_s is not None and elapsed_s >= budget_s)
            or (budget_nodes is not None and worked >= budget_nodes)
            or (stop is not None and stop())
        )
        if spent:
            break
    return best.subset.tolist(), best.value, float(bounds.min(initial=best.value)), evaluated


def _hardest_first(products: kernel.Products, best: NDArray[np.int64]) -> kernel.Products:
    """The campaigns in falling order of their error under a good subset: most others then fail at the first one."""
    order = np.argsort(-kernel.fold_squares(products, best) * products.share, kind="stable")
    per_campaign = ("train_gram", "train_mixed", "test_gram", "test_mixed", "test_squares", "share")
    return products._replace(**{name: getattr(products, name)[order] for name in per_campaign})


def _next_batch(nodes: kernel.Nodes, bounds: Floats, k: int, folds: int) -> NDArray[np.intp]:
    """The open nodes to work on next: those with the lowest bounds, as they hold the gap open."""
    most = max(1, min(len(nodes), _ROUND_CELLS // nodes.shape[1] ** 2))
    rank = bounds if len(nodes) <= _MOST_OPEN else -nodes[:, 0]
    order = np.argpartition(rank, most - 1)[:most]
    order = order[np.argsort(rank[order], kind="stable")]
    add, free = k - nodes[order, 0].astype(float), nodes[order, 1].astype(float)
    # Three columns to add: all subsets are compared. More: a factorisation and an ordering of the free columns.
    work = np.where(add > 3, 2.0 * free**3, free**3 / 6.0 * (1 + 10 * folds))
    return order[: max(1, int(np.searchsorted(np.cumsum(work), _ROUND_WORK)))]


def _work_batch(
    best: kernel.Incumbent, k: int, nodes: kernel.Nodes, bounds: Floats
) -> tuple[int, list[kernel.Nodes], list[Floats]]:
    """Compare the subsets of nodes near the leaves, split the others: subsets compared, children and their bounds."""
    compared, children = 0, []
    for group in kernel.alike(nodes):
        if k - nodes[group[0], 0] > 3:
            children.append(branch(best.products, k, nodes[group], bounds[group], best.value))
        else:
            compared += kernel.compare(nodes[group], k, best)
    best.settle()
    return compared, [nodes for nodes, _ in children], [bounds for _, bounds in children]

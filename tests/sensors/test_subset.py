"""The exact subset search against brute force: numpy least squares on the rows, subset by subset and fold by fold."""

from itertools import combinations, pairwise
from math import comb, inf

import numpy as np
import pytest

from thetacomp.errors import AnalysisError
from thetacomp.moments import merge, summarise
from thetacomp.sensors import _subset_kernel as kernel
from thetacomp.sensors import subset as module
from thetacomp.sensors._subset_bounds import branch
from thetacomp.sensors.subset import accuracy_curve, best_subset, best_subset_per_target, selection_frequency

SCORES = ("residual", "held_out", "worst_campaign")


def names(letter, count):
    return tuple(f"{letter}{i}" for i in range(count))


def summaries(rows):
    return [summarise(x, y, names("s", x.shape[1]), names("y", y.shape[1]), f"c{i}") for i, (x, y) in enumerate(rows)]


def problem(seed, p, q=2, campaigns=3, noise=1.0):
    """Correlated sensors (three heat sources) and errors that follow some of them, with a level per campaign."""
    rng = np.random.default_rng(seed)
    mixing, effect = rng.normal(size=(3, p)), rng.normal(size=(p, q)) * (rng.random((p, q)) < 0.5)
    rows = []
    for _ in range(campaigns):
        n = int(rng.integers(25, 45))
        x = np.cumsum(rng.normal(size=(n, 3)), axis=0) @ mixing + 0.7 * rng.normal(size=(n, p))
        rows.append((x, x @ effect + 2.0 * rng.normal(size=q) + noise * rng.normal(size=(n, q))))
    return rows


def fit_squares(train, test, columns):
    """Sum of squared errors per target on `test`; None where the columns depend on each other in `train`."""
    x, y = train[0][:, columns], train[1]
    centred = x - x.mean(axis=0)
    spread = np.linalg.norm(centred, axis=0)
    if (spread < 1e-9).any() or np.linalg.svd(centred / spread, compute_uv=False)[-1] < 1e-7:
        return None
    beta, *_ = np.linalg.lstsq(centred, y - y.mean(axis=0))
    return ((test[1] - y.mean(axis=0) - (test[0][:, columns] - x.mean(axis=0)) @ beta) ** 2).sum(axis=0)


def stacked(rows):
    return np.concatenate([x for x, _ in rows]), np.concatenate([y for _, y in rows])


def brute_score(rows, columns, score, weights):
    everything = stacked(rows)
    n = len(everything[0])
    whole = fit_squares(everything, everything, columns)
    if whole is None:
        return inf
    if score == "residual":
        return float(whole @ weights) / n
    folds = [fit_squares(stacked(rows[:i] + rows[i + 1 :]), rows[i], columns) for i in range(len(rows))]
    if any(fold is None for fold in folds):
        return inf
    if score == "held_out":
        return sum(float(fold @ weights) for fold in folds) / n
    return max(float(fold @ weights) / len(x) for fold, (x, _) in zip(folds, rows, strict=True))


def brute_force(rows, k, score, weights_um=None):
    y = stacked(rows)[1]
    q = y.shape[1]
    weights = 1.0 / (y.var(axis=0) * q) if weights_um is None else np.asarray(weights_um) ** 2 / q
    found = [(c, brute_score(rows, list(c), score, weights)) for c in combinations(range(rows[0][0].shape[1]), k)]
    lowest = min(value for _, value in found)
    first = next(c for c, value in found if value <= lowest + 1e-11)
    return tuple(f"s{i}" for i in first), lowest**0.5


@pytest.mark.parametrize("score", SCORES)
@pytest.mark.parametrize("seed", range(12))
def test_equals_brute_force(seed, score):
    rng = np.random.default_rng(100 + seed)
    p, k = int(rng.integers(5, 9)), 1 + seed % 5
    rows = problem(seed, p, q=1 + seed % 3, campaigns=2 + seed % 3)
    sensors, value = brute_force(rows, k, score)
    found = best_subset(summaries(rows), k, score=score)
    assert found.sensors == sensors
    assert found.score == pytest.approx(value, rel=1e-9)
    assert found.proven
    assert found.bound == found.score
    assert found.subsets == comb(p, k)


@pytest.fixture
def poor_start(monkeypatch):
    """Start the exact search from the last k columns, so that it has to find every better subset itself."""

    def last_columns(best):
        k, p = len(best.subset), len(best.products.gram)
        best.offer(np.arange(p - k, p)[None])

    monkeypatch.setattr(kernel, "local_search", last_columns)


@pytest.mark.parametrize("score", SCORES)
@pytest.mark.parametrize("seed", range(8))
def test_equals_brute_force_from_a_poor_start(poor_start, seed, score):
    k = 2 + seed % 4
    rows = problem(200 + seed, 9, q=2, noise=0.2)
    assert best_subset(summaries(rows), k, score=score).sensors == brute_force(rows, k, score)[0]


def test_of_equal_subsets_the_one_listed_first_wins_whatever_the_search_begins_with(poor_start):
    rows = problem(31, 7, q=1, noise=0.1)
    for x, y in rows:
        x[:, 2] = x[:, 1]
        y[:, 0] = x[:, [1, 4, 5]].sum(axis=1) + 0.1 * y[:, 0]
    assert best_subset(summaries(rows), 3).sensors == ("s1", "s4", "s5")


def test_closed_form_of_pairs_equals_numpy():
    products, _ = module._products(
        summaries(rows := problem(32, 8)), module._weights(merge(summaries(rows)), None), "residual"
    )
    gram, joint = products.gram, products.mixed @ products.mixed.T
    lead = gram[0] / gram[0, 0]
    left, joint_left = gram - np.outer(lead, gram[0]), joint - np.outer(lead, joint[0])
    joint_left -= np.outer(joint_left[:, 0], lead)
    margins = kernel.pair_margins(left[None], joint_left[None], np.zeros(1), np.zeros(1))[0]
    gains = margins[2, 3:] / (left[2, 2] * np.diag(left)[3:] - left[2, 3:] ** 2)
    y = products.mixed
    for j, gain in zip(range(3, 8), gains, strict=True):
        c = [0, 2, j]
        explained = np.sum(y[c] * np.linalg.solve(gram[np.ix_(c, c)], y[c]))
        assert gain + joint[0, 0] == pytest.approx(explained, rel=1e-10)


@pytest.mark.parametrize("score", SCORES)
@pytest.mark.parametrize("k", [1, 2, 3, 4, 5])
def test_equals_brute_force_with_collinear_doubled_and_constant_sensors(k, score):
    rows = problem(7, 9)
    for x, _ in rows:
        x[:, 2] = x[:, 6]  # the same sensor logged twice: the one listed first must win
        x[:, 4] = x[:, 0] - x[:, 1]  # a difference beside both of its sensors
        x[:, 8] = 21.5
    sensors, value = brute_force([(x[:, :8], y) for x, y in rows], k, score)
    found = best_subset(summaries(rows), k, score=score)
    assert found.sensors == sensors
    assert found.score == pytest.approx(value, rel=1e-8)


@pytest.mark.parametrize(("own_share", "chosen"), [(1e-10, True), (1e-13, False)])
@pytest.mark.parametrize("score", SCORES)
def test_a_sensor_with_next_to_nothing_of_its_own_makes_a_subset_unfit(score, own_share, chosen):
    """The errors follow the small difference of two sensors, which explains them as long as it stands for anything."""
    rows = problem(4, 6, q=1)
    rng = np.random.default_rng(0)
    spread = stacked(rows)[0][:, 0].std()
    for x, y in rows:
        difference = rng.normal(size=len(x))
        x[:, 3] = x[:, 0] + own_share**0.5 * spread * difference
        y[:, 0] = difference + 0.1 * y[:, 0] / y[:, 0].std()
    found = best_subset(summaries(rows), 2, score=score)
    assert (found.sensors == ("s0", "s3")) == chosen
    assert found.proven


@pytest.mark.parametrize("score", SCORES[1:])
def test_a_sensor_that_is_constant_in_the_training_of_a_fold_is_never_chosen(score):
    rows = problem(3, 6)
    for i, (x, y) in enumerate(rows):
        if i != 1:
            x[:, 0] = 20.0
        y[:, 0] += 5.0 * x[:, 0]
    found = best_subset(summaries(rows), 3, score=score)
    assert found.sensors == brute_force(rows, 3, score)[0]
    assert "s0" not in found.sensors


@pytest.mark.parametrize("score", SCORES)
def test_branch_and_bound_equals_brute_force(score):
    rows = problem(21, 12, campaigns=3)
    sensors, value = brute_force(rows, 6, score)
    found = best_subset(summaries(rows), 6, score=score)
    assert found.sensors == sensors
    assert found.score == pytest.approx(value, rel=1e-9)


def test_bounds_leave_most_subsets_out_where_few_sensors_matter():
    rng = np.random.default_rng(5)
    x = rng.normal(size=(400, 24))
    y = x[:, [2, 5, 7, 11, 13, 17, 19, 23]] @ rng.uniform(1.0, 2.0, (8, 1)) + 0.1 * rng.normal(size=(400, 1))
    found = best_subset(summaries([(x, y)]), 8)
    assert found.sensors == ("s2", "s5", "s7", "s11", "s13", "s17", "s19", "s23")
    assert found.proven
    assert found.evaluated < found.subsets / 100


@pytest.mark.parametrize("score", SCORES)
@pytest.mark.parametrize("seed", [31, 32, 33])
def test_no_bound_of_a_node_lies_above_the_best_of_its_subsets(seed, score):
    """A bound that is too high prunes the best. Every child's bound is held against all subsets that it stands for.

    The best of a node comes from brute force on the rows; what is tight is asked, too: a bound of nothing prunes
    nothing.
    """
    rows, k = problem(seed, 9, campaigns=3), 5
    campaigns = summaries(rows)
    weights = module._weights(merge(campaigns), None)
    products, _ = module._products(campaigns, weights, score)
    nodes, given = np.array([[0, 9, *range(9)]], dtype=np.int32), np.zeros(1)
    everything = stacked(rows)
    spread = ((everything[1] - everything[1].mean(axis=0)) ** 2).sum(axis=0)
    tight = []
    for _ in range(2):
        split = [branch(products, k, nodes[group], given[group], inf) for group in kernel.alike(nodes)]
        nodes, given = np.concatenate([n for n, _ in split]), np.concatenate([b for _, b in split])
        for child, bound in zip(nodes, given, strict=True):
            chosen, free = child[2 : 2 + child[0]], child[2 + child[0] : 2 + child[0] + child[1]]
            left = [
                np.mean(fit_squares(everything, everything, [*chosen, *added]) / spread)
                for added in combinations(free.tolist(), k - int(child[0]))
            ]
            assert bound <= min(left) + 1e-12
            whole = fit_squares(everything, everything, [*chosen, *free]) / spread
            tight.append(abs(bound - np.mean(whole)) < 1e-6)
    assert np.mean(tight) > 0.9


def test_no_subset_is_forgotten_where_nothing_is_pruned():
    campaigns = summaries(problem(18, 10))
    products, _ = module._products(campaigns, module._weights(merge(campaigns), None), "residual")
    root = np.array([[0, 10, *range(10)]], dtype=np.int32)
    children, bounds = branch(products, 5, root, np.zeros(1), inf)
    assert len(children) == len(bounds) == 6
    assert sum(comb(int(free), 4) for free in children[:, 1]) == comb(10, 5)
    for k in (2, 3):
        best = kernel.Incumbent(products, k)
        assert kernel.compare(root, k, best) == comb(10, k)
        waiting = np.concatenate([subsets for subsets, _ in best._waiting])
        assert len({frozenset(subset) for subset in waiting.tolist()}) == len(waiting) == comb(10, k)


def test_every_candidate_that_may_be_better_is_scored_however_many_wait():
    campaigns = summaries(problem(34, 13))
    products, _ = module._products(campaigns, module._weights(merge(campaigns), None), "held_out")
    subsets = np.array(list(combinations(range(13), 4)))
    values = kernel.scores(products, subsets)
    worst_first = np.argsort(-values)
    best = kernel.Incumbent(products, 4)
    best.put_by(subsets[worst_first], np.zeros(len(subsets)))
    best.settle()
    assert best.subset.tolist() == subsets[worst_first[-1]].tolist()
    assert best.value == values.min()


def test_no_subset_of_dependent_columns_scores_under_the_bound_of_its_node():
    rows = problem(33, 9)
    for x, _ in rows:
        x[:, 4], x[:, 7] = x[:, 0] - x[:, 1], x[:, 2]
    campaigns = summaries(rows)
    products, _ = module._products(campaigns, module._weights(merge(campaigns), None), "residual")
    children, bounds = branch(products, 5, np.array([[0, 9, *range(9)]], dtype=np.int32), np.zeros(1), inf)
    for child, bound in zip(children, bounds, strict=True):
        below = np.sort([[child[2], *rest] for rest in combinations(child[3 : 3 + child[1]], 4)], axis=1)
        assert (kernel.scores(products, below) >= bound).all()


def test_weights_in_um_decide_which_target_counts():
    rows = problem(8, 7, q=3)
    weights = (0.01, 3.0, 1.0)
    found = best_subset(summaries(rows), 2, weights_um=weights)
    sensors, value = brute_force(rows, 2, "residual", weights)
    assert found.sensors == sensors
    assert found.score == pytest.approx(value, rel=1e-9)


def test_single_targets_are_searched_alone():
    rows = problem(9, 8, q=3)
    found = best_subset_per_target(summaries(rows), 3, score="held_out")
    for t, result in enumerate(found):
        alone = [(x, y[:, [t]]) for x, y in rows]
        assert result.targets == (f"y{t}",)
        assert result.sensors == brute_force(alone, 3, "held_out")[0]


def test_a_large_offset_changes_nothing():
    rows = problem(10, 8)
    moved = [(x + 1e6, y - 1e6) for x, y in rows]
    plain, far = (best_subset(summaries(r), 3, score="held_out") for r in (rows, moved))
    assert plain.sensors == far.sensors
    assert plain.score == pytest.approx(far.score, rel=1e-7)


def test_errors_of_the_result_are_in_the_units_of_the_targets():
    rows = problem(11, 6, q=2)
    found = best_subset(summaries(rows), 2)
    columns = [int(s[1:]) for s in found.sensors]
    x, y = stacked(rows)
    np.testing.assert_allclose(found.residual_rms, np.sqrt(fit_squares((x, y), (x, y), columns) / len(x)), rtol=1e-10)
    folds = [fit_squares(stacked(rows[:i] + rows[i + 1 :]), rows[i], columns) for i in range(3)]
    np.testing.assert_allclose(found.held_out_rms, np.sqrt(sum(folds) / len(x)), rtol=1e-9)
    per_row = [float((f / y.var(axis=0)).sum() / len(r[0])) for f, r in zip(folds, rows, strict=True)]
    assert found.worst_campaign == f"c{int(np.argmax(per_row))}"


@pytest.mark.parametrize("score", SCORES)
def test_a_search_stopped_early_keeps_an_honest_bound(score):
    campaigns = summaries(problem(12, 26, q=1, noise=4.0))
    best = best_subset(campaigns, 6, score=score)
    seen = []
    stopped = best_subset(campaigns, 6, score=score, budget_nodes=3, progress=seen.append)
    assert best.proven
    assert not stopped.proven
    assert stopped.bound <= best.score <= stopped.score
    assert stopped.bound > 0.0
    assert seen[-1].settled_share < 1.0
    assert seen[-1].bound == stopped.bound


def test_a_time_budget_stops_the_search_after_the_first_round():
    stopped = best_subset(summaries(problem(12, 26, q=1, noise=4.0)), 6, budget_s=0.0)
    assert not stopped.proven


def test_progress_reaches_the_end_and_bounds_only_rise():
    seen = []
    best_subset(summaries(problem(13, 22, q=1)), 6, score="held_out", progress=seen.append)
    assert seen[-1].settled_share == 1.0
    assert seen[-1].bound == seen[-1].score
    assert all(a.bound <= b.bound and a.settled_share <= b.settled_share for a, b in pairwise(seen))


def test_curve_of_accuracy_against_number_of_sensors():
    rows = problem(14, 7)
    curve = accuracy_curve(summaries(rows), 7)
    assert [len(point.sensors) for point in curve] == [1, 2, 3, 4, 5, 6, 7]
    for k, point in enumerate(curve, 1):
        assert point.sensors == brute_force(rows, k, "residual")[0]
    assert all(a.score >= b.score for a, b in pairwise(curve))


def test_selection_frequency_is_the_share_over_resampled_campaigns():
    rows = problem(15, 6, q=1, campaigns=5, noise=0.3)
    found = selection_frequency(summaries(rows), 2, seed=4, draws=20, score="held_out")
    assert found.share.sum() == pytest.approx(2.0)
    again = selection_frequency(summaries(rows), 2, seed=4, draws=20, score="held_out")
    np.testing.assert_array_equal(found.share, again.share)
    rng, counts = np.random.default_rng(4), np.zeros(6)
    for _ in range(20):
        drawn = rng.integers(5, size=5)
        # A campaign that is drawn twice is one fold with its rows doubled.
        doubled = [
            tuple(np.repeat(a, n, axis=0) for a in rows[i])
            for i, n in zip(*np.unique(drawn, return_counts=True), strict=True)
        ]
        weights = 1.0 / stacked(rows)[1].var(axis=0)
        scores = {c: brute_score(doubled, list(c), "held_out", weights) for c in combinations(range(6), 2)}
        counts[list(min(scores, key=scores.get))] += 1
    np.testing.assert_allclose(found.share, counts / 20)


@pytest.mark.parametrize("score", SCORES)
def test_scores_of_many_subsets_equal_those_of_each_alone_and_a_limit_spares_only_worse_ones(score):
    campaigns = summaries(problem(16, 10, q=3))
    products, _ = module._products(campaigns, module._weights(merge(campaigns), None), score)
    subsets = np.array(list(combinations(range(10), 4)))
    exact = kernel.scores(products, subsets)
    alone = [kernel.scores(products, subset[None])[0] for subset in subsets]
    np.testing.assert_allclose(exact, alone, rtol=1e-12)
    limit = float(np.median(exact))
    limited = kernel.scores(products, subsets, limit)
    np.testing.assert_array_equal(limited <= limit, exact <= limit)
    np.testing.assert_array_equal(limited[exact <= limit], exact[exact <= limit])


def test_what_cannot_be_chosen_is_said():
    rows = problem(17, 4)
    campaigns = summaries(rows)
    with pytest.raises(AnalysisError, match="cannot choose 5 of 4"):
        best_subset(campaigns, 5)
    with pytest.raises(AnalysisError, match="cannot choose 0 of 4"):
        best_subset(campaigns, 0)
    with pytest.raises(AnalysisError, match="at least 2 campaigns, found 1"):
        best_subset(campaigns[:1], 2, score="held_out")
    with pytest.raises(AnalysisError, match="at least 2 campaigns, found 1"):
        selection_frequency(campaigns[:1], 2, seed=0)
    with pytest.raises(AnalysisError, match="expected 2 weights above 0"):
        best_subset(campaigns, 2, weights_um=[1.0])
    with pytest.raises(AnalysisError, match="no target given"):
        best_subset(campaigns, 2, targets=[])
    for x, y in rows:
        y[:, 1] = 4.0
        x[:, 3] = x[:, 0] + x[:, 1]
        x[:, 2] = x[:, 0] - x[:, 1]
    with pytest.raises(AnalysisError, match="target 'y1' does not vary"):
        best_subset(summaries(rows), 2)
    with pytest.raises(AnalysisError, match="no 3 of the sensors are independent"):
        best_subset(summaries(rows), 3, targets=["y0"])

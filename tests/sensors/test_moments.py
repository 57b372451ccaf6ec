"""Summaries against the rows themselves: numpy least squares and scikit-learn, fold by fold."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from thetacomp.errors import AnalysisError
from thetacomp.moments import (
    SummaryBuilder,
    held_out_squares,
    least_squares,
    leave_one_out,
    merge,
    residual_squares,
    summarise,
)

INPUTS = ("theta_1", "theta_2", "theta_3", "theta_4", "theta_5")
TARGETS = ("EXX", "EYX")


def campaign_rows(seed, rows=80, offset=0.0):
    """Five warming sensors and two errors that follow them, with a level of their own in every campaign."""
    rng = np.random.default_rng(seed)
    rise = 8.0 * (1.0 - np.exp(-np.arange(rows) / 30.0))[:, None] * rng.uniform(0.5, 1.5, 5)
    inputs = offset + 20.0 + rise + rng.normal(size=(rows, 5))
    targets = offset + rise @ rng.normal(size=(5, 2)) + 3.0 * rng.normal(size=(1, 2)) + rng.normal(size=(rows, 2))
    return inputs, targets


def campaigns(count=4, offset=0.0):
    rows = [campaign_rows(seed, 60 + 25 * seed, offset) for seed in range(count)]
    return rows, [summarise(x, y, INPUTS, TARGETS, f"c{i}") for i, (x, y) in enumerate(rows)]


def two_pass(inputs, targets):
    """Means and cross products as the textbook has them, in extended precision."""
    rows = np.concatenate((inputs, targets), axis=1).astype(np.longdouble)
    deviation = rows - rows.mean(axis=0)
    return rows.mean(axis=0).astype(float), (deviation.T @ deviation).astype(float)


def without(rows, held_out):
    kept = [r for i, r in enumerate(rows) if i != held_out]
    return np.concatenate([x for x, _ in kept]), np.concatenate([y for _, y in kept])


@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_products_equal_the_two_pass_textbook_form(offset):
    inputs, targets = campaign_rows(1, 20_000, offset)
    summary = summarise(inputs, targets, INPUTS, TARGETS)
    mean, cross = two_pass(inputs, targets)
    scale = np.sqrt(np.outer(np.diag(cross), np.diag(cross)))
    np.testing.assert_allclose(summary.mean, mean, rtol=1e-15)
    np.testing.assert_allclose(summary.cross / scale, cross / scale, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(cuts=st.lists(st.integers(0, 300), max_size=6))
def test_one_pass_in_pieces_equals_the_whole(cuts):
    inputs, targets = campaign_rows(2, 300, 1e6)
    rows = np.concatenate((inputs, targets), axis=1).T
    builder = SummaryBuilder(INPUTS, TARGETS)
    for start, end in zip([0, *sorted(cuts)], [*sorted(cuts), 300], strict=True):
        builder.add(rows[:, start:end])
    whole, pieces = summarise(inputs, targets, INPUTS, TARGETS), builder.build()
    assert pieces.count == 300
    np.testing.assert_allclose(pieces.mean, whole.mean, rtol=1e-15)
    np.testing.assert_allclose(pieces.cross, whole.cross, rtol=1e-9, atol=1e-9 * np.diag(whole.cross).max())


def test_merged_campaigns_equal_all_rows():
    rows, parts = campaigns(offset=1e6)
    total = merge(parts)
    mean, cross = two_pass(*(np.concatenate(a) for a in zip(*rows, strict=True)))
    scale = np.sqrt(np.outer(np.diag(cross), np.diag(cross)))
    np.testing.assert_allclose(total.cross / scale, cross / scale, atol=1e-10)
    np.testing.assert_allclose(total.mean, mean, rtol=1e-15)
    for i, (part, added) in enumerate(zip(parts, leave_one_out(parts), strict=True)):
        mean, cross = two_pass(*without(rows, i))
        assert added.count == total.count - part.count
        np.testing.assert_allclose(added.mean, mean, rtol=1e-15)
        np.testing.assert_allclose(added.cross / scale, cross / scale, atol=1e-10)


def test_products_about_zero_are_those_of_the_columns():
    inputs, targets = campaign_rows(8, offset=20.0)
    columns = np.hstack([inputs, targets])
    found = summarise(inputs, targets, INPUTS, TARGETS).about_zero()
    np.testing.assert_allclose(found, columns.T @ columns, rtol=1e-12, atol=1e-12 * np.abs(found).max())


@pytest.mark.parametrize(("offset", "tolerance"), [(0.0, 1e-11), (1e6, 1e-8)])
def test_least_squares_equals_numpy_lstsq(offset, tolerance):
    inputs, targets = campaign_rows(3, offset=offset)
    summary = summarise(inputs, targets, INPUTS, TARGETS)
    fit = least_squares(summary)
    centred = inputs - inputs.mean(axis=0)
    direct, squares, *_ = np.linalg.lstsq(centred, targets - targets.mean(axis=0))
    np.testing.assert_allclose(fit.coefficients, direct, rtol=tolerance)
    np.testing.assert_allclose(residual_squares(summary, fit), squares, rtol=tolerance)
    np.testing.assert_allclose(
        (inputs - inputs.mean(axis=0)) @ fit.coefficients + (fit.intercept + inputs.mean(axis=0) @ fit.coefficients),
        centred @ direct + targets.mean(axis=0),
        rtol=1e-9,
    )


@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_held_out_errors_of_least_squares_equal_a_fit_per_fold(offset):
    rows, parts = campaigns(offset=offset)
    squares = held_out_squares(parts)
    for i, (x, y) in enumerate(rows):
        train_x, train_y = without(rows, i)
        direct, *_ = np.linalg.lstsq(train_x - train_x.mean(axis=0), train_y - train_y.mean(axis=0))
        error = y - train_y.mean(axis=0) - (x - train_x.mean(axis=0)) @ direct
        np.testing.assert_allclose(squares[i], (error**2).sum(axis=0), rtol=1e-7 if offset else 1e-11)


def test_rows_with_a_missing_value_are_skipped_and_counted():
    inputs, targets = campaign_rows(5)
    inputs[3, 1] = np.nan
    targets[7, 0] = np.inf
    summary = summarise(inputs, targets, INPUTS, TARGETS)
    complete = np.delete(np.arange(80), [3, 7])
    assert (summary.count, summary.skipped) == (78, 2)
    np.testing.assert_allclose(summary.cross, two_pass(inputs[complete], targets[complete])[1], rtol=1e-12)


def test_select_keeps_names_and_products_together():
    inputs, targets = campaign_rows(6)
    some = summarise(inputs, targets, INPUTS, TARGETS).select(["theta_4", "theta_2"], ["EYX"])
    direct = summarise(inputs[:, [3, 1]], targets[:, [1]], ["theta_4", "theta_2"], ["EYX"])
    assert (some.inputs, some.targets) == (direct.inputs, direct.targets)
    np.testing.assert_allclose(some.cross, direct.cross, rtol=1e-12)


def test_what_cannot_be_computed_is_said():
    inputs, targets = campaign_rows(7)
    inputs[:, 4] = inputs[:, 0] - inputs[:, 1]
    summary = summarise(inputs, targets, INPUTS, TARGETS)
    with pytest.raises(AnalysisError, match="'theta_5' is a combination"):
        least_squares(summary)
    with pytest.raises(AnalysisError, match="no input 'theta_9'"):
        summary.select(["theta_9"])
    with pytest.raises(AnalysisError, match="at least 2 campaigns, found 1"):
        leave_one_out([summary])
    with pytest.raises(AnalysisError, match="same inputs and targets"):
        merge([summary, summary.select(["theta_1"])])
    inputs[:, 4] = 1e6 + 0.1
    with pytest.raises(AnalysisError, match="'theta_5' does not vary"):
        least_squares(summarise(inputs, targets, INPUTS, TARGETS))

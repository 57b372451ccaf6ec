"""Probes: arithmetic of the offset, and a model fitted for life between probes."""

from __future__ import annotations

import numpy as np
import pytest

from thetacomp.errors import AnalysisError
from thetacomp.fitting.probe import fit_between_probes, follow_probes, probe_rows, since_probe
from thetacomp.fitting.ridge import BlockUse, HistoryRidge

T_S = np.arange(0.0, 100.0, 10.0)


def test_probe_corrects_later_rows_only():
    out = follow_probes(T_S, np.full(10, 2.0), np.array([20.0, 60.0]), np.array([5.0, 1.0]))
    np.testing.assert_array_equal(out, [2, 2, 2, 5, 5, 5, 5, 1, 1, 1])


def test_gain_moves_part_of_the_way_and_nan_is_no_probe():
    probes = np.array([20.0, 45.0, 60.0])
    out = follow_probes(T_S, np.zeros(10), probes, np.array([4.0, np.nan, 4.0]), gain=0.5)
    # 0 -> 2 -> 3: each probe takes half of what is missing
    np.testing.assert_array_equal(out, [0, 0, 0, 2, 2, 2, 2, 3, 3, 3])


def test_exact_model_with_wrong_offset_is_exact_after_first_probe():
    truth_um = np.sin(T_S / 30.0)
    out = follow_probes(T_S, truth_um - 7.0, np.array([30.0]), np.array([np.sin(1.0)]))
    np.testing.assert_allclose(out[4:], truth_um[4:])


def test_since_probe_never_reaches_into_another_campaign():
    groups = np.repeat([0, 1], 5)
    values = np.arange(10.0)[:, None] ** 2
    out = since_probe(values, groups, np.array([2]))
    np.testing.assert_array_equal(out[:, 0], [0, 1, 4, 9 - 4, 16 - 4, 25, 36, 49, 64, 81])


def test_clock_strikes_inside_campaigns():
    t_s = np.array([0.0, 1800.0, 3600.0, 5400.0, 7300.0, 7400.0, 10900.0])
    # 3600 s and 10900 s strike; at 7300 s the campaign begins, so its offset is still unknown
    np.testing.assert_array_equal(probe_rows(t_s, np.array([0, 0, 0, 0, 1, 1, 1]), 3600.0), [2, 6])


def test_fit_between_probes_is_not_misled_by_offsets_of_campaigns():
    rng = np.random.default_rng(6)
    groups = np.repeat(np.arange(4), 50)
    x = rng.normal(size=(200, 1)).cumsum(axis=0)
    y_um = 3.0 * x[:, 0] + np.array([40.0, -30.0, 20.0, -60.0])[groups]
    probes = np.arange(0, 200, 5)
    model = HistoryRidge({"temperature": ("a",)}, ((BlockUse("temperature", 1.0, "each"),),))
    plain = model.fit(x, y_um, groups).coef_[0]
    between = fit_between_probes(model, x, y_um, groups, probes).coef_[0]
    assert abs(between - 3.0) < 0.5 * abs(plain - 3.0)


def test_bad_gain_and_probe_outside_are_said():
    with pytest.raises(AnalysisError, match="gain"):
        follow_probes(T_S, np.zeros(10), np.array([20.0]), np.array([1.0]), gain=0.0)
    with pytest.raises(AnalysisError, match="probe at 500 s lies outside 0 to 90 s"):
        follow_probes(T_S, np.zeros(10), np.array([500.0]), np.array([1.0]))


def test_between_probes_both_parts_weigh_the_same_and_belong_to_one_campaign():
    """The fit is that of `fit` on the rows and on w times their changes, w² = mean square of errors over changes."""
    rng = np.random.default_rng(8)
    groups, probes = np.repeat(np.arange(3), 30), np.arange(5, 90, 10)
    x = rng.normal(size=(90, 1)).cumsum(axis=0)
    y_um = np.column_stack([4.0 * x[:, 0] + rng.normal(0, 1.0, 90), rng.normal(0, 5.0, 90)])
    y_um[7, 1] = np.nan
    change_x, change_um = since_probe(x, groups, probes), since_probe(y_um, groups, probes)
    weight = np.sqrt(np.nanmean(y_um**2) / np.nanmean(change_um**2))

    def model():
        return HistoryRidge({"temperature": ("a",)}, ((BlockUse("temperature", 1.0, "each"),),))

    for columns in (slice(0, 1), slice(None)):
        weight = np.sqrt(np.nanmean(y_um[:, columns] ** 2) / np.nanmean(change_um[:, columns] ** 2))
        expected = model().fit(
            np.vstack([x, weight * change_x]),
            np.vstack([y_um[:, columns], weight * change_um[:, columns]]),
            np.tile(groups, 2),
        )
        found = fit_between_probes(model(), x, y_um[:, columns], groups, probes)
        np.testing.assert_allclose(found.coef_, expected.coef_)


def test_errors_that_are_zero_throughout_give_a_model_of_nothing():
    groups = np.repeat([0, 1, 2], 10)
    x = np.random.default_rng(9).normal(size=(30, 1))
    model = HistoryRidge({"temperature": ("a",)}, ((BlockUse("temperature", 1.0, "each"),),))
    np.testing.assert_array_equal(fit_between_probes(model, x, np.zeros(30), groups, np.array([3, 13])).coef_, 0.0)


def test_a_row_is_no_probe_of_itself_and_several_columns_are_counted_each():
    groups, values = np.zeros(4, int), np.array([[1.0, 10.0], [2.0, 30.0], [4.0, 70.0], [9.0, 20.0]])
    np.testing.assert_array_equal(
        since_probe(values, groups, np.array([1, 2])), [[1.0, 10.0], [2.0, 30.0], [2.0, 40.0], [5.0, -50.0]]
    )


def test_probes_at_the_ends_are_inside_and_one_between_rows_meets_the_line_between_them():
    ends = follow_probes(T_S, np.zeros(10), np.array([0.0, 90.0]), np.array([4.0, 7.0]))
    np.testing.assert_array_equal(ends, [0, 4, 4, 4, 4, 4, 4, 4, 4, 4])
    # at 25 s the prediction stands at 2.5, so 4.5 are missing
    np.testing.assert_array_equal(
        follow_probes(T_S, T_S / 10.0, np.array([25.0]), np.array([7.0])),
        [0, 1, 2, 7.5, 8.5, 9.5, 10.5, 11.5, 12.5, 13.5],
    )
    with pytest.raises(AnalysisError, match="the probe at -1 s lies outside 0 to 90 s"):
        follow_probes(T_S, np.zeros(10), np.array([-1.0, 20.0]), np.array([1.0, 1.0]))

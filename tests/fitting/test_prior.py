"""The physical prior against its formula, and what campaigns weigh in it."""

from __future__ import annotations

import numpy as np
import pytest

from thetacomp.arrays import Floats
from thetacomp.fitting.prior import STRENGTH, fit_prior


def by_hand(rise_K: Floats, error_um: Floats, weight: Floats) -> Floats:
    """Coefficients of `min Σ w (e - c u - x d)² + STRENGTH mean(x²) |d|²`, as one least-squares problem (sensors,)."""
    sensors = rise_K.shape[1]
    mean_K = rise_K.mean(axis=1)
    c = np.sum(weight * mean_K * error_um) / np.sum(weight * mean_K**2)
    mean_square = np.sum(weight[:, None] * rise_K**2) / sensors
    rows = np.vstack([rise_K * np.sqrt(weight)[:, None], np.sqrt(STRENGTH * mean_square) * np.eye(sensors)])
    target = np.concatenate([(error_um - c * mean_K) * np.sqrt(weight), np.zeros(sensors)])
    return c / sensors + np.linalg.lstsq(rows, target, rcond=None)[0]


def drawn(seed: int) -> tuple[Floats, Floats, Floats]:
    """Rises of three sensors (40, 3), errors (40,), and three campaigns of 5, 15 and 20 rows."""
    rng = np.random.default_rng(seed)
    rise_K = rng.uniform(0.0, 10.0, (40, 3))
    return rise_K, rise_K @ [5.0, -2.0, 1.0] + rng.normal(0.0, 3.0, 40), np.repeat([7, 3, 5], [5, 15, 20])


@pytest.mark.parametrize("seed", range(3))
def test_prior_is_the_ridge_of_its_formula_in_which_campaigns_weigh_the_same(seed: int) -> None:
    rise_K, error_um, campaign = drawn(seed)
    prior = fit_prior(("a", "b", "c"), rise_K, error_um, campaign)
    weight = 1.0 / (3.0 * np.repeat([5.0, 15.0, 20.0], [5, 15, 20]))
    assert prior.coefficients_um_per_K == pytest.approx(by_hand(rise_K, error_um, weight).tolist())
    assert prior.error_um(rise_K) == pytest.approx(rise_K @ by_hand(rise_K, error_um, weight))


def test_a_campaign_that_was_written_down_twice_as_densely_weighs_no_more() -> None:
    rise_K, error_um, campaign = drawn(4)
    twice = np.concatenate([np.arange(40), np.flatnonzero(campaign == 5)])
    once = fit_prior(("a", "b", "c"), rise_K, error_um, campaign)
    again = fit_prior(("a", "b", "c"), rise_K[twice], error_um[twice], campaign[twice])
    assert again.coefficients_um_per_K == pytest.approx(once.coefficients_um_per_K)


def test_rows_that_lack_a_rise_or_the_error_are_passed_over() -> None:
    rise_K, error_um, campaign = drawn(5)
    rise_K[3, 1], error_um[9] = np.nan, np.nan
    kept = np.delete(np.arange(40), [3, 9])
    found = fit_prior(("a", "b", "c"), rise_K, error_um, campaign)
    assert found == fit_prior(("a", "b", "c"), rise_K[kept], error_um[kept], campaign[kept])


@pytest.mark.parametrize("error_um", [0.0, 5.0])
def test_a_machine_that_never_warmed_has_a_prior_of_nothing(error_um: float) -> None:
    prior = fit_prior(("a", "b"), np.zeros((6, 2)), np.full(6, error_um), np.repeat([0, 1], 3))
    assert (prior.um_per_K, prior.coefficients_um_per_K) == (0.0, (0.0, 0.0))

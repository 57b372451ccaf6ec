"""The band and the leverage against their formulas, worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thetacomp.model.band import Band
from thetacomp.model.leverage import Leverage

# half width = quantile × √(scatter(u) × (states + growth h / (h + knee) × (1 + h / far)))
BAND = Band(quantile=2.0, sd=(3.0, 4.0), correlation=0.5, growth=2.0, knee=3.0, far=5.0)
H = np.array([0.0, 3.0])
GROWN = [0.0, 2.0 * 3.0 / 6.0 * (1.0 + 3.0 / 5.0)]  # 0 and 1.6


def test_a_band_that_says_no_more_is_that_of_a_regression() -> None:
    """Knee and far of 1 make g = h: half width = t × s √(1 + h), of one state, at P0."""
    band = Band(quantile=2.0, sd=(3.0,))
    np.testing.assert_allclose(band.grown(H), H)
    np.testing.assert_allclose(band.half_width_um(H), 2.0 * 3.0 * np.sqrt([1.0, 4.0]))
    np.testing.assert_allclose(band.half_width_um(H, 7.0), band.half_width_um(H))
    assert (band.noise_sd_um, band.level) == (0.0, 0.95)


@pytest.mark.parametrize("states", [1.0, 2.0])
@pytest.mark.parametrize(("u_m", "scatter"), [(0.0, 9.0), (0.5, 9.0 + 6.0 + 4.0), (-0.5, 9.0 - 6.0 + 4.0)])
def test_half_width_by_hand(states: float, u_m: float, scatter: float) -> None:
    """Scatter 3² + 2 · 0.5 · 3 · 4 u + (4 u)²."""
    expected = 2.0 * np.sqrt(scatter * (states + np.array(GROWN)))
    np.testing.assert_allclose(BAND.half_width_um(H, u_m, states), expected)


def test_terms_that_cancel_leave_no_scatter_and_no_root_of_less_than_nothing() -> None:
    """Fully opposed, (3 - 4 u)²: zero at 0.75 m; a correlation just past -1 is still no complaint."""
    for correlation in (-1.0, -1.0 - 1e-9):
        half_um = replace(BAND, correlation=correlation).half_width_um(H, 0.75)
        np.testing.assert_allclose(half_um, 0.0, atol=1e-6)


def test_half_width_of_a_term_by_hand() -> None:
    for power, sd in enumerate((3.0, 4.0, 0.0)):
        expected = 2.0 * sd * np.sqrt(2.0 + np.array(GROWN))
        np.testing.assert_allclose(BAND.half_width_of_term(power, H, 2.0), expected)


def test_without_a_quantile_no_band_is_known() -> None:
    unknown = replace(BAND, quantile=None)
    assert unknown.half_width_um(H).tolist() == [np.inf, np.inf]
    assert unknown.half_width_of_term(1, H, 1.0).tolist() == [np.inf, np.inf]


def test_leverage_by_hand() -> None:
    """z = (x - centre) / scale; along² / (moment + floor), the rest over the floor, and what the centre has itself."""
    shape = Leverage((1.0, 2.0, 7.0), (2.0, 1.0, 0.0), ((1.0, 0.0, 0.0),), (4.0,), floor=0.5, at_centre=0.1)
    x = np.array([[5.0, 5.0, 99.0], [1.0, 2.0, 0.0], [5.0, np.nan, 0.0]])
    # z = (2, 3, left out): 4 / 4.5 along, 9 / 0.5 outside.
    np.testing.assert_allclose(shape.at(x), [4.0 / 4.5 + 18.0 + 0.1, 0.1, np.nan])
    # From zero z = (2.5, 5) and (0.5, 2); the centre brings nothing.
    np.testing.assert_allclose(shape.at(x, from_centre=False), [6.25 / 4.5 + 50.0, 0.25 / 4.5 + 8.0, np.nan])
    # Without a floor what lies outside the directions does not count.
    np.testing.assert_allclose(replace(shape, floor=None).at(x[:2]), [1.0 + 0.1, 0.1])
    np.testing.assert_allclose(shape.of_inputs([1, 0]).at(x[:1, [1, 0]]), shape.at(x[:1]))

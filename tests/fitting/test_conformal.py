"""Bands that hold what they say: coverage on unseen campaigns, and what few campaigns can give."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from pydantic import TypeAdapter
from synthetic_campaigns import LAYOUT, WINTER, inputs_of, synthetic_machine

from thetacomp.arrays import Floats
from thetacomp.errors import AnalysisError
from thetacomp.fitting.conformal import (
    FLOOR,
    CampaignShapes,
    HeldOut,
    attainable_level,
    calibrate_band,
    campaigns_needed,
    conformal_quantile,
    crossed_quantile,
    held_out_leverage,
)
from thetacomp.fitting.ridge import HistoryRidge, history_candidates
from thetacomp.model.band import Band
from thetacomp.model.leverage import Leverage

MACHINES = 6
CALIBRATION = 40
UNSEEN = 100


@dataclass(frozen=True)
class Calibrated:
    """A band on campaigns that neither the model nor the band has seen: errors and half widths (n,) in µm."""

    band: Band
    leverage: Leverage
    error_um: Floats
    half_um: Floats

    @property
    def coverage(self) -> float:
        return float(np.mean(np.abs(self.error_um) <= self.half_um))


def calibrated(seed: int, campaigns: int) -> Calibrated:
    rng = np.random.default_rng(seed)
    machine = synthetic_machine(rng)
    known, unseen = machine.record(rng, campaigns, WINTER), machine.record(rng, UNSEEN, WINTER)
    inputs, new = inputs_of(known), inputs_of(unseen)
    model = HistoryRidge(LAYOUT.blocks, history_candidates(LAYOUT, 3))
    model.fit(inputs, known.displacement_um, known.campaign)
    left_out = model.left_out_coef_[np.searchsorted(model.groups_, known.campaign)]
    residual_um = known.displacement_um - np.einsum("ij,ij->i", inputs, left_out)
    rows = HeldOut(residual_um, held_out_leverage(inputs, known.campaign), known.campaign)
    band, leverage = calibrate_band(rows), CampaignShapes.of(inputs, known.campaign).leverage()
    error_um = unseen.displacement_um - model.predict(new)
    return Calibrated(band, leverage, error_um, band.half_width_um(leverage.at(new)))


@pytest.fixture(scope="module")
def bands() -> list[Calibrated]:
    return [calibrated(seed, CALIBRATION) for seed in range(MACHINES)]


def test_forty_campaigns_give_a_band_that_holds_95_percent(bands: list[Calibrated]) -> None:
    shares = [one.coverage for one in bands]
    # 93 to 97 %: what is asked of the pool of unseen points
    assert 0.93 <= np.mean(shares) <= 0.97
    # one machine's band rests on 40 campaigns: its own share scatters
    assert min(shares) > 0.90
    for one in bands:
        assert one.band.level == 0.95
        assert 0.9 < one.band.guaranteed_level < 0.95
        assert one.band.sentence.startswith(
            "The band holds 95% of the points of a new campaign like the 40 calibration"
        )


def test_the_band_is_worth_having(bands: list[Calibrated]) -> None:
    # a normal error needs 1.96 standard deviations for 95 %: the band may not buy its coverage with width
    for one in bands:
        assert np.sqrt(np.mean(one.half_um**2)) < 2.5 * np.sqrt(np.mean(one.error_um**2))


@pytest.mark.parametrize("campaigns", [3, 6, 10])
def test_few_campaigns_say_what_they_can_guarantee(campaigns: int) -> None:
    made = [calibrated(seed, campaigns) for seed in range(2 * MACHINES)]
    for one in made:
        # m / (m + 1), closed form
        assert one.band.attainable_level == pytest.approx(campaigns / (campaigns + 1))
        assert one.band.guaranteed_level <= one.band.attainable_level + 1e-12
        assert one.band.level == 0.95
        assert f"{campaigns} calibration campaigns can guarantee no more than" in one.band.sentence
        assert "95% needs 19 campaigns" in one.band.sentence
    # the assumption of normal campaigns is what holds the rest: a few points less than 95 % on these machines
    assert 0.90 <= np.mean([one.coverage for one in made]) <= 0.98


def test_degrees_of_freedom_follow_the_scatter_between_campaigns() -> None:
    rng = np.random.default_rng(8)
    campaign = np.repeat(np.arange(6), 500)
    independent = rng.normal(size=3000)
    together = np.repeat(rng.normal(size=6), 500)

    def factor(residual_um: Floats) -> float:
        band = calibrate_band(HeldOut(residual_um, np.full(3000, 1e-6), campaign))
        scores = np.abs(residual_um) / replace(band, quantile=1.0).half_width_um(np.full(3000, 1e-6))
        return band.quantile / float(np.sqrt(np.mean(scores**2)))

    # 3000 independent residuals: nearly the normal quantile; six errors: Student's t of about six
    assert factor(independent) == pytest.approx(1.96, abs=0.15)
    assert factor(together) > 2.2


def test_attainable_levels_in_closed_form() -> None:
    assert attainable_level(9) == pytest.approx(0.9)
    assert [campaigns_needed(level) for level in (0.8, 0.9, 0.95, 0.99)] == [4, 9, 19, 99]


def test_quantile_is_the_textbook_one_where_a_campaign_is_one_point() -> None:
    # split conformal prediction: the ceil((m + 1) (1 - α))-th smallest score (Vovk and others, 2005)
    scores = np.random.default_rng(1).permutation(np.arange(1.0, 31.0))
    for level in (0.5, 0.8, 0.9, 0.95):
        assert conformal_quantile(scores, np.arange(30), level) == np.ceil(31 * level)
    assert conformal_quantile(scores, np.arange(30), 0.97) == np.inf


def test_a_campaign_has_one_vote_however_long_it_is() -> None:
    # campaign 0 is long and bad; with equal votes for rows it would set the quantile at 80 % to 9
    scores = np.concatenate([np.full(1000, 9.0), np.ones(90)])
    campaign = np.concatenate([np.zeros(1000, dtype=np.int64), np.repeat(np.arange(1, 10), 10)])
    assert conformal_quantile(scores, campaign, 0.8) == 1.0
    assert crossed_quantile(scores, campaign, 0.8) == 1.0


def test_crossed_quantile_lies_between_the_plain_and_the_worst_case() -> None:
    rng = np.random.default_rng(2)
    campaign = np.repeat(np.arange(40), 50)
    independent = np.abs(rng.normal(size=2000))
    together = np.repeat(np.abs(rng.normal(size=40)), 50)
    plain = np.quantile(independent, 0.95)
    assert (
        plain * 0.98 < crossed_quantile(independent, campaign, 0.95) < conformal_quantile(independent, campaign, 0.95)
    )
    # where a campaign is wholly inside or outside, nothing less than the worst case will do
    assert crossed_quantile(together, campaign, 0.95) == conformal_quantile(together, campaign, 0.95)


def test_band_is_narrow_at_the_reference_and_widens_with_distance(bands: list[Calibrated]) -> None:
    band, leverage = bands[1].band, bands[1].leverage
    half_um = band.half_width_um(leverage.at(np.outer([0.0, 1.0, 10.0, 100.0], leverage.scale)))
    assert half_um[0] == pytest.approx(band.quantile * band.sd[0])
    assert np.all(np.diff(half_um) > 0)
    # far out the half width grows in proportion to the distance
    assert half_um[3] == pytest.approx(10 * half_um[2], rel=0.25)


def test_leverage_is_the_textbook_one_without_the_floor() -> None:
    rng = np.random.default_rng(5)
    inputs = rng.normal(size=(200, 3)) @ rng.normal(size=(3, 3))
    leverage = replace(CampaignShapes.of(inputs, np.repeat(np.arange(4), 50)).leverage(), floor=1e-9)
    expected = np.einsum("ij,jk,ik->i", inputs, np.linalg.inv(inputs.T @ inputs / 200), inputs)
    np.testing.assert_allclose(leverage.at(inputs), expected, rtol=1e-5)


def test_band_goes_through_json_unchanged(bands: list[Calibrated]) -> None:
    band = bands[0].band
    stored = TypeAdapter(Band)
    assert stored.validate_json(stored.dump_json(band)) == band


@pytest.mark.parametrize(("campaigns", "is_a_score"), [(19, True), (18, False)])
def test_as_many_campaigns_as_the_level_needs_give_a_quantile_of_the_scores(campaigns: int, is_a_score: bool) -> None:
    """m / (m + 1) = 0.95 at m = 19; with fewer the quantile is that of an assumed distribution."""
    rng = np.random.default_rng(11)
    campaign = np.repeat(np.arange(campaigns), 20)
    rows = HeldOut(rng.normal(size=len(campaign)), rng.uniform(0.0, 2.0, len(campaign)), campaign)
    band = calibrate_band(rows)
    scores = np.abs(rows.residual_um) / replace(band, quantile=1.0).half_width_um(rows.leverage, 0.0)
    assert bool(np.isclose(scores, band.quantile or 0.0, rtol=1e-9).any()) == is_a_score


def test_left_out_coefficients_have_not_seen_their_campaign() -> None:
    rng = np.random.default_rng(4)
    known = synthetic_machine(rng).record(rng, 4, WINTER)
    inputs = inputs_of(known)
    # one candidate, one strength: then nothing is chosen
    one = {"candidates": history_candidates(LAYOUT, 4)[:1], "strengths": (0.01,)}
    model = HistoryRidge(LAYOUT.blocks, **one).fit(inputs, known.displacement_um, known.campaign)
    for row, label in enumerate(model.groups_):
        poisoned_um = np.where(known.campaign == label, 1e4, known.displacement_um)
        poisoned = HistoryRidge(LAYOUT.blocks, **one).fit(inputs, poisoned_um, known.campaign)
        np.testing.assert_allclose(model.left_out_coef_[row], poisoned.left_out_coef_[row], atol=1e-3)
        assert np.abs(model.left_out_coef_ - poisoned.left_out_coef_).max() > 1e3


def test_held_out_leverage_is_that_of_the_other_campaigns() -> None:
    rng = np.random.default_rng(6)
    inputs, campaign = rng.normal(size=(60, 3)), np.repeat(np.arange(3), 20)
    expected = CampaignShapes.of(inputs[20:], campaign[20:]).leverage().at(inputs[:20])
    np.testing.assert_allclose(held_out_leverage(inputs, campaign)[:20], expected)


def test_a_band_from_nothing_is_refused() -> None:
    with pytest.raises(AnalysisError, match="at least 2"):
        held_out_leverage(np.ones((5, 1)), np.zeros(5, dtype=int))
    nothing = HeldOut(np.full(3, np.nan), np.ones(3), np.zeros(3))
    with pytest.raises(AnalysisError, match="no held-out residual"):
        calibrate_band(nothing)
    with pytest.raises(AnalysisError, match="between 0 and 1"):
        calibrate_band(nothing, level=95.0)


@pytest.mark.parametrize("m", [9, 19, 99])
def test_quantiles_at_the_highest_level_are_the_largest_score_and_beyond_there_is_none(m: int) -> None:
    """One score a campaign, 1 to m: level k / (m + 1) is the k-th smallest; m / (m + 1) is the last that is proven."""
    scores, campaign = np.arange(1.0, m + 1.0), np.arange(m)
    assert conformal_quantile(scores, campaign, m / (m + 1)) == m
    assert conformal_quantile(scores, campaign, (m - 2) / (m + 1)) == m - 2
    assert conformal_quantile(scores, campaign, (m + 0.01) / (m + 1)) == np.inf
    assert crossed_quantile(scores, campaign, m / (m + 1)) <= m
    assert crossed_quantile(scores, campaign, (m + 0.01) / (m + 1)) == np.inf


def test_an_input_that_never_moved_does_not_count() -> None:
    """Two campaigns that weigh the same: scale √(½ · 1² + ½ · 3²) in the first input, none in the second."""
    inputs, campaign = np.array([[1.0, 0.0], [-1.0, 0.0], [3.0, 1e-10]]), np.array([0, 0, 1])
    shape = CampaignShapes.of(inputs, campaign).leverage()
    assert shape.scale == pytest.approx((np.sqrt(5.0), 0.0))
    # z = 2 / √5 along a direction of moment 1; the second input is left out however far it goes.
    np.testing.assert_allclose(shape.at(np.array([[2.0, 0.0], [2.0, 50.0]])), 0.8 / (1.0 + FLOOR))

"""The border of validity: quiet at home, on before the error doubles in an unseen season; the fade beyond it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from pydantic import TypeAdapter
from synthetic_campaigns import LAYOUT, SENSORS, SUMMER, WINTER, Recording, inputs_of, synthetic_machine

from thetacomp.arrays import Floats
from thetacomp.errors import AnalysisError
from thetacomp.fitting.border import calibrate_validity
from thetacomp.fitting.prior import fit_prior
from thetacomp.fitting.ridge import HistoryRidge, history_candidates
from thetacomp.model.border import Validity
from thetacomp.model.fade import FADE_START, faded_um, model_weight
from thetacomp.model.filters import InputLayout

MACHINES = 10
YEAR = 40  # campaigns on the way from winter to summer
HOUR = 12  # samples


def domain_inputs(recording: Recording) -> Floats:
    """The model's inputs and the absolute temperatures, which tell the season."""
    return np.hstack([inputs_of(recording), recording.temperature_degC])


# a summer that spoils the model on most machines, else the test of the flag on the way there says nothing
HEAT = replace(SUMMER, mean_degC=34.0, sun_K_per_h=12.0)


@dataclass(frozen=True)
class Season:
    """One machine: distances and errors smoothed over an hour, (campaigns, samples), against the training p95."""

    validity: Validity
    home_distance: Floats
    year_distance: Floats
    year_error_um: Floats
    summer_distance: Floats
    summer_error_um: Floats
    training_p95_um: float


def smoothed(error_um: Floats) -> Floats:
    rows = np.abs(error_um).reshape(-1, 96)
    return np.array([np.convolve(row, np.full(HOUR, 1 / HOUR))[: len(row)] for row in rows])


def season(seed: int) -> Season:
    rng = np.random.default_rng(seed)
    machine = synthetic_machine(rng)
    known, home = machine.record(rng, 40, WINTER), machine.record(rng, 40, WINTER)
    year, summer = machine.record(rng, YEAR, WINTER, ramp_to=HEAT), machine.record(rng, 20, SUMMER)
    inputs = inputs_of(known)
    model = HistoryRidge(LAYOUT.blocks, history_candidates(LAYOUT, 3)).fit(
        inputs, known.displacement_um, known.campaign
    )
    validity = calibrate_validity(domain_inputs(known), known.campaign)

    def distance(recording: Recording) -> Floats:
        return validity.distance(domain_inputs(recording)).reshape(-1, 96)

    def error_um(recording: Recording) -> Floats:
        return smoothed(recording.displacement_um - model.predict(inputs_of(recording)))

    p95_um = float(np.quantile(np.abs(known.displacement_um - model.predict(inputs)), 0.95))
    return Season(validity, distance(home), distance(year), error_um(year), distance(summer), error_um(summer), p95_um)


@pytest.fixture(scope="module")
def seasons() -> list[Season]:
    return [season(seed) for seed in range(100, 100 + MACHINES)]


def test_flag_is_on_before_the_error_doubles_on_the_way_into_summer(seasons: list[Season]) -> None:
    doubled = 0
    for one in seasons:
        beyond = np.flatnonzero(one.year_error_um.ravel() > 2 * one.training_p95_um)
        if len(beyond):
            doubled += 1
            assert one.year_distance.ravel()[beyond[0]] > 1.0
    # the season must really spoil the model, else the test says nothing
    assert doubled >= 0.8 * MACHINES


def test_flag_is_on_before_the_error_doubles_in_summer(seasons: list[Season]) -> None:
    doubled = 0
    for one in seasons:
        for distance, error_um in zip(one.summer_distance, one.summer_error_um, strict=True):
            beyond = np.flatnonzero(error_um > 2 * one.training_p95_um)
            if len(beyond):
                doubled += 1
                assert distance[beyond[0]] > 1.0
    assert doubled >= 50


def test_flag_is_quiet_in_the_season_of_training(seasons: list[Season]) -> None:
    # 10 % of the campaigns may see the flag by design (quiet level 90 %); the scatter over 10 machines is about 3 %
    loud = np.mean([one.home_distance.max(axis=1) > 1.0 for one in seasons])
    assert loud < 0.19
    assert np.mean([one.home_distance > 1.0 for one in seasons]) < 0.02
    assert "40 of training stays inside the border with a probability of about 90%" in seasons[0].validity.sentence


def test_few_campaigns_say_how_quiet_the_flag_can_be() -> None:
    rng = np.random.default_rng(0)
    validity = calibrate_validity(rng.normal(size=(30, 2)), np.repeat(np.arange(3), 10))
    # m / (m + 1), closed form
    assert validity.quiet_level == pytest.approx(0.75)
    assert "90% was wanted" in validity.sentence
    with pytest.raises(AnalysisError, match="at least 2"):
        calibrate_validity(rng.normal(size=(30, 2)), np.zeros(30))


def test_a_range_left_and_a_pattern_never_seen_both_raise_the_flag() -> None:
    rng = np.random.default_rng(0)
    rise_K = rng.uniform(0, 10, (800, 1)) + rng.normal(0, 0.1, (800, 2))
    validity = calibrate_validity(rise_K, np.repeat(np.arange(20), 40))
    at = np.array([[5.0, 5.0], [14.0, 14.0], [3.0, 7.0], [np.nan, 5.0]])
    # both sensors at 14 K: never so warm; 3 K beside 7 K: each was seen, but never together; a lost sensor
    np.testing.assert_array_equal(validity.inside(at), [True, False, False, False])


def test_border_goes_through_json_unchanged(seasons: list[Season]) -> None:
    validity = seasons[0].validity
    stored = TypeAdapter(Validity)
    assert stored.validate_json(stored.dump_json(validity)) == validity


def test_fade_is_continuous_and_bounded() -> None:
    distance = np.linspace(0.0, 50.0, 5001)
    weight = model_weight(distance)
    assert np.all(weight[distance <= FADE_START] == 1.0)
    assert np.all(np.diff(weight) <= 0.0)
    assert np.max(np.abs(np.diff(weight))) <= 0.01 + 1e-9  # |d weight / d distance| is at most 1
    # a linear model that runs away in proportion to the distance is held at what it says where the fade starts
    assert np.max(np.abs(faded_um(30.0 * distance, np.zeros(5001), weight))) == pytest.approx(30.0 * FADE_START)


def rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize("seed", [100, 102, 103])
def test_fade_catches_a_model_that_runs_away_and_costs_little_where_it_does_not(seed: int) -> None:
    rng = np.random.default_rng(seed)
    machine = synthetic_machine(rng)
    known, summer = machine.record(rng, 6, WINTER), machine.record(rng, 20, SUMMER)
    taus_s = (480.0, 900.0, 1800.0, 3600.0, 7200.0, 14400.0, 28800.0)
    long = InputLayout(sensors=SENSORS, time_constants_s=taus_s, speed_powers=(), base_degC=20.0)
    inputs, new = inputs_of(known, long), inputs_of(summer, long)
    prior = fit_prior(SENSORS, inputs[:, :8], known.displacement_um, known.campaign)
    validity = calibrate_validity(np.hstack([inputs, known.temperature_degC]), known.campaign)
    distance = validity.distance(np.hstack([new, summer.temperature_degC]))
    nothing_um, far = rms(summer.displacement_um), distance > FADE_START

    def left_um(coefficients: Floats) -> tuple[Floats, Floats]:
        blind = new @ coefficients
        faded = faded_um(blind, prior.error_um(new[:, :8]), model_weight(distance))
        return summer.displacement_um - blind, summer.displacement_um - faded

    # plain least squares on seven lags: 64 inputs from six campaigns
    blind_um, faded = left_um(np.linalg.lstsq(inputs, known.displacement_um, rcond=None)[0])
    assert rms(faded[far]) < 0.95 * rms(blind_um[far])
    np.testing.assert_array_equal(faded[~far], blind_um[~far])
    # the shrunk model extrapolates well on a machine that is linear: there the fade is an insurance premium
    ridge = HistoryRidge(long.blocks, history_candidates(long, 3))
    ridge.fit(inputs, known.displacement_um, known.campaign)
    blind_um, faded = left_um(ridge.coef_)
    assert rms(faded) < min(0.15 * nothing_um, rms(blind_um) + 1.5)


def test_prior_is_close_to_the_truth_and_never_wild() -> None:
    rng = np.random.default_rng(1)
    common = rng.uniform(0, 10, (400, 1))
    rise_K = common + rng.normal(0, 0.05, (400, 3))
    # +40 and -38 µm/K on two sensors that move together: least squares would find them, a prior must not
    error_um = rise_K @ np.array([40.0, -38.0, 0.0])
    prior = fit_prior(("a", "b", "c"), rise_K, error_um, np.repeat(np.arange(4), 100))
    assert prior.um_per_K == pytest.approx(2.0, abs=0.1)
    assert np.max(np.abs(prior.coefficients_um_per_K)) < 2.0
    assert prior.error_um(np.full((1, 3), 5.0))[0] == pytest.approx(10.0, rel=0.05)

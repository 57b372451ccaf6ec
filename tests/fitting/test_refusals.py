"""What a fit cannot be made from is refused in words, at the place where it is asked; what just suffices is not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from slow_column import folder

from thetacomp.axis_states import AxisStates, axis_states
from thetacomp.errors import AnalysisError
from thetacomp.fitting.border import calibrate_validity
from thetacomp.fitting.calibrated import calibrated_history
from thetacomp.fitting.conformal import HeldOut, calibrate_band, held_out_leverage
from thetacomp.fitting.fallbacks import accuracy_of
from thetacomp.fitting.history_model import history_procedure
from thetacomp.fitting.key_point_law import fit_axis
from thetacomp.fitting.linear import ThermalRegression
from thetacomp.fitting.prior import fit_prior
from thetacomp.fitting.probe import follow_probes
from thetacomp.fitting.training import train
from thetacomp.preparation import prepare
from thetacomp.separation import separate_folder

NAN = float("nan")
ONE = np.ones(3)


@pytest.fixture(scope="module")
def states() -> AxisStates:
    given = folder(1, 2)
    (one,) = axis_states(given, separate_folder(given), [campaign.name for campaign in given.campaigns])
    return one


@pytest.mark.parametrize(
    ("work", "words"),
    [
        (lambda: fit_prior(["a"], np.full((3, 1), NAN), ONE, ONE), "no complete row: a prior needs"),
        (lambda: fit_prior(["a"], np.ones((3, 1)), NAN * ONE, ONE), "no complete row: a prior needs"),
        (lambda: calibrate_validity(np.ones((3, 1)), ONE), "1 campaign: the border of validity needs at least 2"),
        (lambda: held_out_leverage(np.ones((3, 1)), ONE), "1 campaign: a band needs at least 2"),
        (lambda: calibrate_band(HeldOut(ONE, ONE, ONE), 0.0), "between 0 and 1, found 0"),
        (lambda: calibrate_band(HeldOut(ONE, ONE, ONE), 1.0), "between 0 and 1, found 1"),
        (lambda: accuracy_of(ONE, NAN * ONE, ONE), "no held-out sample is predicted with and without"),
        (lambda: follow_probes(ONE, ONE, ONE[:1], ONE[:1], gain=0.0), "above 0 and at most 1, found 0"),
        (lambda: follow_probes(ONE, ONE, ONE[:1], ONE[:1], gain=1.1), "above 0 and at most 1, found 1.1"),
    ],
)
def test_numbers_that_carry_no_fit(work: Callable[[], object], words: str) -> None:
    with pytest.raises(AnalysisError, match=words):
        work()


@pytest.mark.parametrize(
    ("work", "words"),
    [
        (lambda model: model.fit(np.ones(5), np.ones(5)), r"two-dimensional with at least one row, found shape \(5,\)"),
        (lambda model: model.fit(np.ones((0, 1)), np.ones(0)), r"at least one row, found shape \(0, 1\)"),
        (lambda model: model.fit(np.ones((5, 1)), np.ones(4)), "y must have 5 finite rows"),
        (lambda model: model.fit(np.ones((2, 1)), np.array([1.0, NAN])), "y must have 2 finite rows"),
        (lambda model: model.fit(np.ones((5, 1)), np.ones(5)).predict(np.ones((1, 2))), "X has 2 features, but"),
    ],
)
def test_tables_that_are_no_regression(work: Callable[[ThermalRegression], object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        work(ThermalRegression())


def test_states_that_carry_no_law(states: AxisStates) -> None:
    with pytest.raises(AnalysisError, match="axis Y: no sensor was read in all campaigns"):
        history_procedure(replace(states, layout=None))
    with pytest.raises(AnalysisError, match="axis Y: heat history needs 2 training campaigns"):
        history_procedure(states.take(np.flatnonzero(states.campaign == 0)))
    heated = np.flatnonzero(~states.cold)
    # Through zero one more state than inputs is the least.
    assert fit_axis(states.take(heated[:2]), ("a",)).inputs == ("a",)
    with pytest.raises(AnalysisError, match="EYY: 1 complete heated states cannot determine a model with 1 inputs"):
        fit_axis(states.take(heated[:1]), ("a",))
    cold = tuple(replace(one, history=np.full_like(one.history, NAN)) for one in states.samples)
    with pytest.raises(AnalysisError, match="EYY: no sample of a heated state"):
        calibrated_history(replace(states, samples=cold))


def test_one_row_and_one_sample_suffice() -> None:
    """E = 6 µm at a rise of 2 K: 3 µm/K; errors of (3, 4), known without the sensor in the second alone."""
    prior = fit_prior(["a"], np.array([[2.0], [NAN]]), np.array([6.0, 1.0]), np.array([0, 0]))
    assert (prior.um_per_K, *prior.coefficients_um_per_K) == pytest.approx((3.0, 3.0))
    found = accuracy_of(np.array([3.0, 4.0]), np.array([0.0, 3.0]), np.array([NAN, 2.0]))
    assert (found.full_rms_um, found.without_rms_um, found.nothing_rms_um) == (1.0, 2.0, 4.0)


@pytest.mark.parametrize(("lost", "more"), [((), ""), (None, ", and a fallback for every sensor")])
def test_training_tells_its_steps(lost: tuple[str, ...] | None, more: str) -> None:
    told: list[str] = []
    train(prepare(folder(1, 2)), lost=lost, progress=told.append)
    assert told == ["choosing key points and fitting", f"fitting heat history{more}"]

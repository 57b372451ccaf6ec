"""What the stored heat history belongs to: its reference, its travel, and the samples behind its band."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from slow_column import MACHINE, campaign, folder

from thetacomp.arrays import Bools
from thetacomp.axis_states import AxisStates
from thetacomp.campaign import CampaignSettings, MachineFolder
from thetacomp.fitting.calibrated import calibrated_history
from thetacomp.model.document import Component
from thetacomp.preparation import prepare


@pytest.fixture(scope="module")
def states() -> AxisStates:
    (one,) = prepare(folder(1, 2, 3), faults="ignore").training
    return one


def test_the_reference_is_that_of_the_first_training_campaign() -> None:
    """The cold block ends at 1800 s in one campaign and at 3000 s in the other; its middle is the moment of zero."""
    later = replace(campaign(2), settings=CampaignSettings(instrument="laser", reference_s=3000.0))
    found = []
    for campaigns in ((campaign(1), later), (later, campaign(1))):
        (one,) = prepare(MachineFolder(MACHINE, campaigns), faults="ignore").training
        reference = calibrated_history(one).document.reference
        assert reference.t_s == one.reference_s[0] != one.reference_s[-1]
        assert reference.inputs == pytest.approx(one.reference_history[0].tolist())
        found.append(reference)
    assert [one.campaign for one in found] == ["c1", "c2"]
    assert found[0].t_s < found[1].t_s


def test_the_reference_is_that_campaigns_own_even_where_one_state_of_it_is_left(states: AxisStates) -> None:
    one = states.take(np.concatenate([[1], np.flatnonzero(states.campaign > 0)]))
    moved = replace(one, reference_s=one.reference_s + 7.0 * one.campaign)
    assert calibrated_history(moved).document.reference.t_s == states.reference_s[0]


def test_the_travel_is_that_of_the_states(states: AxisStates) -> None:
    document = calibrated_history(states).document
    assert (document.axis, document.p0_mm) == ("Y", states.p0_mm)
    assert (document.p_min_mm, document.p_max_mm) == (states.p_min_mm, states.p_max_mm)
    assert document.layout == states.layout
    assert (document.candidates or 0) > 1


def eyy(states: AxisStates, rows: Bools, added_um: float) -> Component:
    """The stored component where `added_um` was read into the samples of some states."""
    (samples,) = states.samples
    read_um = samples.value_um + np.where(rows[samples.state], added_um, 0.0)
    return calibrated_history(replace(states, samples=(replace(samples, value_um=read_um),))).components["EYY"]


def test_a_band_is_calibrated_on_heated_states_where_zero_holds_by_definition(states: AxisStates) -> None:
    assert states.exact_zero
    plain = eyy(states, states.cold, 0.0)
    assert eyy(states, states.cold, 500.0).band == plain.band
    centre = np.zeros(1)
    assert eyy(states, ~states.cold, 50.0).band.half_width_um(centre) > 5.0 * plain.band.half_width_um(centre)


def test_a_band_is_calibrated_on_all_states_where_the_zero_is_a_measurement(states: AxisStates) -> None:
    measured = replace(states, exact_zero=False)
    assert eyy(measured, states.cold, 500.0).band != eyy(measured, states.cold, 0.0).band


def test_residuals_are_those_of_the_samples_whose_inputs_are_all_there(states: AxisStates) -> None:
    (samples,) = states.samples
    history = samples.history.copy()
    history[5] = np.nan
    read_um = samples.value_um.copy()
    read_um[5] += 1e4
    holed = replace(states, samples=(replace(samples, history=history, value_um=read_um),))
    found = calibrated_history(holed)
    whole = calibrated_history(states)
    assert found.components["EYY"].residual_um[1] < 50.0
    assert np.flatnonzero(np.isnan(found.left_out_um["EYY"])).tolist() == [5]
    assert np.isfinite(whole.left_out_um["EYY"]).all()
    value_um, half_um = found.predict("EYY", holed, holed.samples[0])
    assert np.flatnonzero(np.isnan(value_um)).tolist() == [5]
    left_um = np.delete(read_um - value_um, 5)
    expected = (np.sqrt(np.mean(left_um**2)), np.abs(left_um).max())
    assert found.components["EYY"].residual_um == pytest.approx(expected, rel=1e-6)
    assert (half_um[np.isfinite(half_um)] > 0.0).all()

"""Rows at negative times are what the loggers recorded before the campaign: history for filters, no part of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thetacomp.campaign import Campaign, CampaignSettings, Drift, LeadIn
from thetacomp.model.filters import InputLayout, history_inputs
from thetacomp.model.temperatures import Duty, Temperatures
from thetacomp.reading.lead_in import with_lead_in
from thetacomp.standards.environment import unsettled
from thetacomp.temperature.history_track import history_track


def campaign(t_s: np.ndarray, duty_s: np.ndarray | None = None, **changes: object) -> Campaign:
    heat = Temperatures(t_s, ("a", "b"), np.column_stack([20.0 + t_s / 1e4, 21.0 - t_s / 2e4]))
    duty = None if duty_s is None else Duty(duty_s, {"spindle_rpm": 1000.0 + duty_s / 10.0})
    return replace(Campaign("c", CampaignSettings(), heat, duty=duty), **changes)  # type: ignore[arg-type]


def test_rows_before_zero_become_the_lead_in() -> None:
    read = with_lead_in(campaign(np.arange(-7200.0, 7201.0, 600.0), np.arange(-7200.0, 7201.0, 300.0)))
    assert read.temperatures.t_s.tolist() == np.arange(0.0, 7201.0, 600.0).tolist()
    assert read.duty is not None
    assert read.duty.t_s[0] == 0.0
    assert read.before is not None
    assert read.before.duty is not None
    assert read.before.temperatures.t_s.tolist() == np.arange(-7200.0, 0.0, 600.0).tolist()
    assert read.before.duty.columns["spindle_rpm"][-1] == pytest.approx(970.0)  # the entry at -300 s


def test_the_last_sample_up_to_the_start_stays_with_the_campaign() -> None:
    """Samples at -100 s and 500 s: the first points, at 0 s, lie between them."""
    read = with_lead_in(campaign(np.arange(-6700.0, 7200.0, 600.0), np.array([-6000.0, -400.0, 900.0])))
    assert read.temperatures.t_s[0] == -100.0
    assert read.temperatures.at(np.array([0.0]))[0, 0] == pytest.approx(20.0)
    assert read.duty is not None
    assert read.duty.t_s.tolist() == [-400.0, 900.0]  # the entry that holds at the start


@pytest.mark.parametrize("what", ["drift", "reference"])
def test_a_campaign_that_measures_at_negative_times_starts_there(what: str) -> None:
    t_s = np.arange(-7200.0, 7201.0, 600.0)
    drift = Drift(np.array([-1800.0, 3600.0]), np.zeros((2, 3)))
    changed = {"drift": drift} if what == "drift" else {"settings": CampaignSettings(reference_s=-1800.0)}
    read = with_lead_in(campaign(t_s, **changed))
    assert read.temperatures.t_s[0] == -1800.0


@pytest.mark.parametrize("t_s", [np.arange(0.0, 7201.0, 600.0), np.arange(-7200.0, 0.0, 600.0)])
def test_without_rows_on_both_sides_nothing_is_parted(t_s: np.ndarray) -> None:
    whole = campaign(t_s, t_s)
    assert with_lead_in(whole) is whole


@pytest.mark.parametrize("logged", [True, False])
def test_filters_run_through_lead_in_and_campaign_as_one_recording(logged: bool) -> None:
    """Parting changes no input of a model; with `recording` a prediction sees what the training saw."""
    t_s = np.arange(-7200.0, 7201.0, 600.0)
    read = with_lead_in(campaign(t_s, t_s if logged else t_s[t_s >= 0]))
    layout = InputLayout(sensors=("a", "b"), time_constants_s=(3600.0,), base_degC=20.0)
    heat, duty = read.recording()
    assert heat.t_s.tolist() == t_s.tolist()
    assert duty is not None
    row = np.searchsorted(duty.t_s, t_s, side="right") - 1
    speed = duty.columns["spindle_rpm"][row]
    if not logged:
        assert not speed[t_s < 0].any()
    expected = history_inputs(layout, t_s, heat.value_degC, speed)[t_s >= 0]
    np.testing.assert_allclose(history_track(read, layout, np.zeros(1)).inputs, expected, rtol=1e-12)


def test_a_campaign_without_lead_in_is_one_recording_already() -> None:
    whole = campaign(np.arange(0.0, 7201.0, 600.0))
    assert whole.recording() == (whole.temperatures, None)


def test_columns_of_the_lead_in_go_by_name() -> None:
    t_s = np.arange(-7200.0, 7201.0, 600.0)
    read = with_lead_in(campaign(t_s))
    assert read.before is not None
    turned = replace(read, before=LeadIn(read.before.temperatures.select(("b", "a"))))
    np.testing.assert_array_equal(turned.recording()[0].value_degC, campaign(t_s).temperatures.value_degC)
    assert unsettled(turned, 0.0) == unsettled(read, 0.0)


def test_the_first_entry_of_a_campaign_counts_from_its_start_with_or_without_a_lead_in() -> None:
    """The duty begins 900 s late; nobody logged it before."""
    t_s, duty_s = np.arange(-7200.0, 7201.0, 600.0), np.array([900.0, 3000.0])
    _, duty = with_lead_in(campaign(t_s, duty_s)).recording()
    assert duty is not None
    assert duty.t_s.tolist() == [-7200.0, 0.0, 3000.0]
    assert duty.columns["spindle_rpm"].tolist() == [0.0, 1090.0, 1300.0]


def test_a_sample_missing_at_the_seam_is_bridged_from_both_sides() -> None:
    t_s = np.arange(-7200.0, 7201.0, 600.0)
    whole = campaign(t_s)
    whole.temperatures.value_degC[t_s == -600.0, 0] = np.nan
    layout = InputLayout(sensors=("a",), time_constants_s=(3600.0,), speed_powers=(), base_degC=20.0)
    expected = history_inputs(layout, t_s, 20.0 + t_s[:, None] / 1e4)[t_s >= 0]
    found = history_track(with_lead_in(whole), layout, np.zeros(1)).inputs
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_a_sensor_that_counts_as_never_read_is_gone_from_the_lead_in_too() -> None:
    read = with_lead_in(campaign(np.arange(-7200.0, 7201.0, 600.0)))
    rest = read.without_sensors({"a"})
    assert rest.before is not None
    assert rest.before.temperatures.sensor_ids == rest.temperatures.sensor_ids == ("b",)
    assert rest.recording()[0].value_degC.shape == (25, 1)

"""Sensors of one table with samplings of their own: none of them costs states, history or predictions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic_campaigns import SENSORS, WINTER, synthetic_machine

from thetacomp.campaign import Campaign, CampaignSettings, Drift, MachineFolder
from thetacomp.machine import Machine, Sensor
from thetacomp.model.filters import recorded_inputs
from thetacomp.model.temperatures import Temperatures
from thetacomp.preparation import prepare
from thetacomp.temperature.history_track import history_layout

NAN = float("nan")


def campaigns() -> list[Campaign]:
    """Three campaigns; drift and temperatures every five minutes."""
    recording = synthetic_machine(np.random.default_rng(2)).record(np.random.default_rng(2), 3, WINTER)
    out = []
    for k in range(3):
        rows = recording.take(recording.campaign == k)
        error_um = np.full((len(rows.t_s), 3), NAN)
        error_um[:, 2] = rows.displacement_um
        heat = Temperatures(rows.t_s, SENSORS, rows.temperature_degC)
        out.append(Campaign(f"c{k}", CampaignSettings(), heat, drift=Drift(rows.t_s, error_um)))
    return out


def with_slow_sensor(campaign: Campaign, every: int, first: int) -> Campaign:
    """The last sensor is read at every `every`-th row only, beginning with row `first`."""
    value = campaign.temperatures.value_degC.copy()
    value[np.arange(len(value)) % every != first, -1] = NAN
    return replace(campaign, temperatures=replace(campaign.temperatures, value_degC=value))


@pytest.mark.parametrize(("every", "first"), [(6, 0), (6, 2), (3, 1)])
def test_a_slow_sensor_costs_no_state_and_keeps_its_history(every: int, first: int) -> None:
    slow = [with_slow_sensor(c, every, first) for c in campaigns()]
    machine = Machine(name="hall", sensors=tuple(Sensor(id=name, role="structure") for name in SENSORS))
    (states,) = prepare(MachineFolder(machine, tuple(slow)), faults="ignore").everything
    assert np.isfinite(states.rise_K).all()
    assert len(states) == sum(len(c.temperatures.t_s) for c in slow)
    layout = history_layout(slow)
    assert layout is not None
    assert layout.sensors == SENSORS
    for campaign in slow:
        assert np.isfinite(recorded_inputs(replace_lags(layout), *campaign.recording())[1]).all()


def replace_lags(layout):
    return layout.model_copy(update={"time_constants_s": (1800.0,)})


def test_a_slow_sensor_is_filled_in_between_its_own_readings_and_a_gap_stays_one() -> None:
    t_s = 60.0 * np.arange(120)
    value = np.column_stack([20.0 + t_s / 600.0, 30.0 + t_s / 600.0])
    read = value.copy()
    read[np.arange(120) % 10 != 0, 0] = NAN
    read[30, 1] = NAN
    table = Temperatures(t_s, ("slow", "fast"), read)
    filled = table.evenly_sampled().value_degC
    np.testing.assert_allclose(filled[:111, 0], value[:111, 0])
    np.testing.assert_array_equal(filled[:, 1], read[:, 1])
    read[35:75, 0] = NAN
    filled = Temperatures(t_s, ("slow", "fast"), read).evenly_sampled().value_degC
    assert np.isnan(filled[31:80, 0]).all()
    whole = Temperatures(t_s, ("slow", "fast"), value)
    assert whole.evenly_sampled() is whole

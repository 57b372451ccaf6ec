"""Screening on machines that nobody tuned it to: healthy ones are left alone, planted faults are found.

The machines are those of `bench/screening_machines.py`, which scores many more; what was put in is what is expected.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from screening_folder import column, folder, with_temperatures

from thetacomp.campaign import Campaign, CampaignSettings, Drift, MachineFolder
from thetacomp.machine import Machine, Sensor
from thetacomp.model.temperatures import Temperatures
from thetacomp.screening import Finding, with_fault
from thetacomp.screening.campaigns import screened

sys.path.insert(0, str(Path(__file__).parents[2] / "bench"))

from screening_machines import lumped, planted

NAMES = ("c0", "c1", "c2", "c3")
HOUR_S = 3600.0


def found(made: MachineFolder) -> list[tuple[str, Finding]]:
    """What was changed."""
    return [(n, f) for n, f in screened(made, [c.name for c in made.campaigns]).findings if f.repair != "none"]


@pytest.mark.parametrize("seed", [0, 5, 6, 11, 13])
def test_a_healthy_machine_is_left_alone(seed: int) -> None:
    """Several campaigns with other feeds, warm starts, doors, coolant, sampling from 10 s to 5 min."""
    made = lumped(seed)
    out = screened(made, [c.name for c in made.campaigns])
    assert found(made) == []
    for before, after in zip(made.campaigns, out.folder.campaigns, strict=True):
        assert after.temperatures is before.temperatures


@pytest.mark.parametrize("kind", ["step", "frozen"])
def test_a_planted_fault_is_found_and_nothing_else(kind: str) -> None:
    kinds = {"step": "jump", "frozen": "stuck"}
    for seed in (0, 2, 12):
        made, known = planted(lumped(seed), kind, np.random.default_rng([seed, 5]))
        assert [(n, f.sensor, f.kind) for n, f in found(made)] == [(known.campaign, known.sensor, kinds[kind])]


def shifted(name: str, sensor: str, size_K: float, made: MachineFolder) -> MachineFolder:
    table = made.campaign(name).temperatures
    value = table.value_degC.copy()
    value[:, table.sensor_ids.index(sensor)] += size_K
    return with_temperatures(made, name, replace(table, value_degC=value))


@pytest.mark.parametrize("size_K", [-3.0, 4.0])
def test_an_offset_that_stands_from_the_start_is_taken_off(size_K: float) -> None:
    made = shifted("c2", "theta_11", size_K, folder())
    ((name, offset),) = found(made)
    assert (name, offset.sensor, offset.kind, offset.repair) == ("c2", "theta_11", "offset", "shifted back")
    assert offset.size_K == pytest.approx(size_K, abs=0.3)
    used = screened(made, NAMES).folder.campaign("c2").temperatures
    off_K = column(used, "theta_11") - column(folder().campaign("c2").temperatures, "theta_11")
    assert np.abs(off_K).max() < 0.3


@pytest.mark.parametrize("partner", ["theta_1", "theta_5", "theta_9", "theta_14"])
def test_two_sensors_swapped_for_a_whole_campaign_are_named_and_put_right(partner: str) -> None:
    table = with_fault(folder().campaign("c2").temperatures, "theta_11", "swapped", -1.0, partner=partner)
    made = with_temperatures(folder(), "c2", table)
    ((name, swap),) = found(made)
    assert (name, swap.kind, {swap.sensor, swap.partner}) == ("c2", "swapped", {"theta_11", partner})
    used = screened(made, NAMES).folder.campaign("c2").temperatures
    np.testing.assert_array_equal(used.value_degC, folder().campaign("c2").temperatures.value_degC)


@pytest.mark.parametrize("kind", ["jump", "offset", "stuck"])
def test_the_same_fault_in_two_of_four_campaigns_does_not_hide_itself(kind: str) -> None:
    made = folder()
    for name in ("c1", "c2"):
        if kind == "offset":
            made = shifted(name, "theta_11", 4.0, made)
        else:
            table = made.campaign(name).temperatures
            table = with_fault(table, "theta_11", kind, 4.0 * HOUR_S, size_K=3.0)  # type: ignore[arg-type]
            made = with_temperatures(made, name, table)
    assert [(n, f.sensor, f.kind) for n, f in found(made)] == [(n, "theta_11", kind) for n in ("c1", "c2")]


def test_a_feed_that_only_one_campaign_has_is_no_drift() -> None:
    """A drive sensor warms in one campaign and cools with it: the others do not know it, and it is no fault."""
    table = folder().campaign("c1").temperatures
    hours = table.t_s / HOUR_S
    warm = 8.0 * np.where(hours < 5.0, 1.0 - np.exp(-hours / 2.0), np.exp(-(hours - 5.0) / 2.0) * 0.918)
    value = table.value_degC.copy()
    value[:, 6] += warm
    assert found(with_temperatures(folder(), "c1", replace(table, value_degC=value))) == []


@pytest.mark.parametrize("word", [85.0, 0.0])
def test_words_for_no_reading_are_not_temperatures(word: float) -> None:
    """85 °C after power-on and 0 from an open channel lie within what a thermometer can read."""
    table = folder().campaign("c1").temperatures
    value = table.value_degC.copy()
    value[:4, 3] = word
    value[200:206, 5] = word
    made = with_temperatures(folder(), "c1", replace(table, value_degC=value))
    assert {(n, f.sensor, f.kind) for n, f in found(made)} == {
        ("c1", "theta_4", "missing"),
        ("c1", "theta_6", "missing"),
    }
    used = screened(made, NAMES).folder.campaign("c1").temperatures
    off_K = column(used, "theta_6") - column(table, "theta_6")
    assert np.nanmax(np.abs(off_K)) < 0.3


def test_a_log_that_ends_before_the_measurements_is_told() -> None:
    campaign = folder().campaign("c1")
    short = campaign.temperatures.take(campaign.temperatures.t_s <= 6.0 * HOUR_S)
    notes = screened(with_temperatures(folder(), "c1", short), NAMES).notes
    assert any("temperatures end at 6.00 h, the measurements go on to 10.00 h" in note for note in notes)


def test_a_pump_may_make_a_step() -> None:
    """The same step in a coolant and in a casting: the first can be the machine's doing."""
    table = folder().campaign("c1").temperatures
    made = with_temperatures(folder(), "c1", with_fault(table, "theta_11", "jump", 4.0 * HOUR_S, size_K=4.0))
    wet = tuple(s.model_copy(update={"role": "fluid"}) if s.id == "theta_11" else s for s in made.machine.sensors)
    assert [f.kind for _, f in found(made)] == ["jump"]
    assert found(replace(made, machine=made.machine.model_copy(update={"sensors": wet}))) == []


def test_a_door_that_shuts_again_is_told_only() -> None:
    """Air falls within a minute and comes back slowly: sharp as a fault, but it does not stay."""
    t_s = 10.0 * np.arange(2000.0)
    rng = np.random.default_rng(1)
    campaigns = []
    for k in range(3):
        slow = 20.0 + 0.4 * k + 3.0 * (1.0 - np.exp(-t_s / 7200.0))
        value = slow[:, None] * np.linspace(0.9, 1.1, 6) + rng.normal(0.0, 0.02, (len(t_s), 6))
        if k == 1:
            value[:, 2] -= 4.0 * np.where(t_s > 9000.0, np.exp(-np.maximum(t_s - 9000.0, 0.0) / 700.0), 0.0)
        table = Temperatures(t_s, tuple("abcdef"), value)
        error_um = np.full((5, 3), np.nan)
        error_um[:, 0] = np.arange(5.0)
        campaigns.append(Campaign(f"c{k}", CampaignSettings(), table, drift=Drift(t_s[::400], error_um)))
    made = MachineFolder(
        Machine(name="door", sensors=tuple(Sensor(id=s, role="structure") for s in "abcdef")), tuple(campaigns)
    )
    for names in (("c0", "c1", "c2"), ("c1",)):
        told = [f for _, f in screened(made, names).findings]
        assert [(f.sensor, f.kind, f.repair) for f in told] == [("c", "unexplained", "none")]

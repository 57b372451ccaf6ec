"""Held labels: a displacement frozen for longer than its instrument stands still is left out; quiet tables stay.

The frozen stretches are put in, so the expected rows are known.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from known_machine import MACHINE, measured_campaign
from screening_folder import HOUR_S, folder, standing

from thetacomp.arrays import Floats
from thetacomp.campaign import Campaign, CampaignSettings, Drift, SweepPoints
from thetacomp.instrument import frozen as frozen_rows
from thetacomp.model.temperatures import Duty, Temperatures
from thetacomp.screening.campaign_labels import labels_note, without_held_labels
from thetacomp.separation import separate_campaign

DATA = "caiviac_fl_thermal/data.xlsx"
BEGIN, END = 30, 66  # rows of the drift record, five minutes apart: 2.5 to 5.5 h


def cooling(moves_K: float = 8.0, noise_um: float = 0.3, resolution_um: float = 0.0) -> Campaign:
    """A machine that runs, stands for three hours while it cools by `moves_K`, and runs again; probe read all along."""
    rng = np.random.default_rng(1)
    t_s = 300.0 * np.arange(100)
    cold = np.where((t_s >= t_s[BEGIN]) & (t_s < t_s[END]), 1.0 - np.exp(-(t_s - t_s[BEGIN]) / HOUR_S), 0.0)
    temperatures = Temperatures(t_s, ("t1",), 30.0 - moves_K * cold[:, None])
    moved_um = 5.0 * (temperatures.value_degC - 30.0) + rng.normal(0.0, noise_um, (100, 3))
    if resolution_um:
        moved_um = np.round(moved_um / resolution_um) * resolution_um
    return Campaign(
        "c", CampaignSettings(), temperatures, drift=Drift(t_s, moved_um), duty=standing(t_s[BEGIN], t_s[END])
    )


def frozen(campaign: Campaign, begin: int = BEGIN, end: int = END, columns: tuple[int, ...] = (0,)) -> Campaign:
    assert campaign.drift is not None
    error_um = campaign.drift.error_um.copy()
    error_um[begin:end, columns] = error_um[begin, columns]
    return replace(campaign, drift=replace(campaign.drift, error_um=error_um))


def drift_um(campaign: Campaign) -> Floats:
    assert campaign.drift is not None
    return campaign.drift.error_um


def test_a_displacement_frozen_while_the_machine_cools_is_left_out_and_counted() -> None:
    out, (entry,) = without_held_labels(frozen(cooling()))
    assert np.flatnonzero(np.isnan(drift_um(out)[:, 0])).tolist() == list(range(BEGIN + 1, END))
    assert np.isfinite(drift_um(out)[:, 1:]).all()
    assert out.drift is not None
    assert out.drift.rotation_urad is None
    assert (entry.table, entry.column, entry.count) == ("drift", "dX_um", END - BEGIN - 1)
    assert labels_note(entry, True) == (
        "campaign c, drift: 35 values of dX_um are frozen (2.58 to 5.42 h) for longer than the instrument ever stands"
        " still: no measurement. Left out"
    )
    told, entries = without_held_labels(frozen(cooling()), apply=False)
    assert np.isfinite(drift_um(told)).all()
    assert labels_note(entries[0], False).endswith("Used as read, because repair is switched off")


def turned(campaign: Campaign) -> Campaign:
    """The campaign with tilts of its own in drift and sweeps: each value is the negative of a displacement."""
    drift, sweeps = campaign.drift, campaign.sweeps
    return replace(
        campaign,
        drift=None if drift is None else replace(drift, rotation_urad=-drift.error_um[:, ::-1]),
        sweeps=None if sweeps is None else replace(sweeps, rotation_urad=-sweeps.error_um[:, ::-1]),
    )


@pytest.mark.parametrize("column", [0, 2, 3, 5])
def test_displacements_and_tilts_of_a_drift_stay_apart(column: int) -> None:
    """Six columns side by side: what is frozen in one leaves the five others as they were, and where they were."""
    whole = turned(cooling())
    assert whole.drift is not None
    assert whole.drift.rotation_urad is not None
    values = np.hstack([whole.drift.error_um, whole.drift.rotation_urad])
    values[BEGIN:END, column] = values[BEGIN, column]
    spoilt = replace(whole, drift=replace(whole.drift, error_um=values[:, :3], rotation_urad=values[:, 3:]))
    out, (entry,) = without_held_labels(spoilt)
    assert entry.column == ("dX_um", "dY_um", "dZ_um", "rA_urad", "rB_urad", "rC_urad")[column]
    assert out.drift is not None
    assert out.drift.rotation_urad is not None
    expected = values.copy()
    expected[BEGIN + 1 : END, column] = np.nan
    np.testing.assert_array_equal(out.drift.error_um, expected[:, :3])
    np.testing.assert_array_equal(out.drift.rotation_urad, expected[:, 3:])


def test_displacements_and_tilts_of_sweeps_stay_apart() -> None:
    measured = turned(measured_campaign(np.random.default_rng(5))[0])
    sweeps = sweeps_of(measured)
    assert sweeps.rotation_urad is not None
    error_um, rotation_urad = sweeps.error_um.copy(), sweeps.rotation_urad.copy()
    error_um[100:110], rotation_urad[100:110] = error_um[100], rotation_urad[100]
    out, entries = without_held_labels(
        replace(measured, sweeps=replace(sweeps, error_um=error_um, rotation_urad=rotation_urad))
    )
    assert len(entries) == 6
    after = sweeps_of(out)
    assert after.rotation_urad is not None
    error_um[101:110] = rotation_urad[101:110] = np.nan
    np.testing.assert_array_equal(after.error_um, error_um)
    np.testing.assert_array_equal(after.rotation_urad, rotation_urad)


def test_what_is_left_is_separated_without_the_held_rows() -> None:
    out, _ = without_held_labels(frozen(cooling()))
    parts = {s.component: s for s in separate_campaign(MACHINE, out)}
    assert len(parts["DX"].t_s) == 100 - (END - BEGIN - 1)
    assert len(parts["DY"].t_s) == 100


@pytest.mark.parametrize(
    "campaign",
    [
        pytest.param(frozen(cooling(), BEGIN, BEGIN + 4), id="too short"),
        pytest.param(cooling(noise_um=0.0), id="free of noise, cools"),
        pytest.param(cooling(moves_K=0.0, noise_um=0.0), id="free of noise, rests"),
    ],
)
def test_what_may_be_a_measurement_stays(campaign: Campaign) -> None:
    out, entries = without_held_labels(campaign)
    assert out is campaign
    assert entries == []


@pytest.mark.parametrize(
    "campaign",
    [
        pytest.param(frozen(cooling(moves_K=0.3)), id="at rest too a probe that scatters does not repeat itself"),
        pytest.param(replace(frozen(cooling()), duty=None), id="nobody knows when the machine stood"),
        pytest.param(
            replace(frozen(cooling()), duty=Duty(np.zeros(1), {"spindle_rpm": np.full(1, 900.0)})), id="it runs"
        ),
    ],
)
def test_the_length_of_the_run_tells_whatever_the_machine_did(campaign: Campaign) -> None:
    out, (entry,) = without_held_labels(campaign)
    assert np.flatnonzero(np.isnan(drift_um(out)[:, 0])).tolist() == list(range(BEGIN + 1, END))
    assert entry.count == END - BEGIN - 1


T_S = 10.0 * np.arange(2160)  # six hours
WARM_UM = 60.0 * (1.0 - np.exp(-T_S / 5400.0))


def held_rows(value: Floats) -> list[int]:
    return np.flatnonzero(frozen_rows(T_S, value)).tolist()


def test_labels_frozen_for_five_minutes_and_more_are_found_however_many_there_are() -> None:
    """Eight stretches of 5 to 14 minutes, 20 % of the record; between them a tenth of the readings repeat."""
    value = np.round(WARM_UM + np.random.default_rng(4).normal(0.0, 0.4, len(T_S)), 1)
    expected: list[int] = []
    for k in range(8):
        begin, length = 150 + 240 * k, 31 + 8 * k
        value[begin : begin + length] = value[begin]
        expected += range(begin + 1, begin + length)
    found = set(held_rows(value))
    assert found >= set(expected)
    assert len(found) <= len(expected) + 4  # the reading behind a stretch may equal it
    assert len(expected) > 0.2 * len(T_S)


def test_a_coarse_probe_and_a_table_without_scatter_stand_still_until_they_catch_up() -> None:
    """At half a µm a division the reading stays for minutes, at the end for long, as where nothing scatters."""
    for value in (0.5 * np.round(WARM_UM / 0.5), np.where(T_S < 3600.0, 0.0, WARM_UM - WARM_UM[360])):
        assert held_rows(value) == []
    coarse = 0.5 * np.round(WARM_UM / 0.5)
    coarse[60:420] = coarse[60]  # an hour; 26 µm at once afterwards
    assert held_rows(coarse) == list(range(61, 420))


def test_a_logger_that_is_faster_than_its_probe_is_no_frozen_probe() -> None:
    """A reading every ten minutes, logged every ten seconds: every run is as long."""
    slow = (WARM_UM + np.random.default_rng(5).normal(0.0, 0.5, len(T_S)))[(np.arange(len(T_S)) // 60) * 60]
    assert held_rows(slow) == []
    assert held_rows(np.zeros(len(T_S))) == []
    assert held_rows(np.full(len(T_S), np.nan)) == []
    assert not len(frozen_rows(np.zeros(0), np.zeros(0)))


def sweeps_of(campaign: Campaign) -> SweepPoints:
    assert campaign.sweeps is not None
    return campaign.sweeps


def hung(campaign: Campaign, begin: int, end: int, directions: tuple[int, ...] = (0, 1, 2)) -> Campaign:
    """The instrument repeats its last reading from one row of the sweeps to another."""
    error_um = sweeps_of(campaign).error_um.copy()
    error_um[begin:end, directions] = error_um[begin, directions]
    return replace(campaign, sweeps=replace(sweeps_of(campaign), error_um=error_um))


def test_an_instrument_that_hangs_within_a_sweep_is_left_out() -> None:
    measured, _ = measured_campaign(np.random.default_rng(5))
    out, entries = without_held_labels(hung(measured, 100, 110))
    assert np.flatnonzero(np.isnan(sweeps_of(out).error_um).all(axis=1)).tolist() == list(range(101, 110))
    assert {(e.table, e.column, e.count) for e in entries} == {("sweeps", f"d{d}_um", 9) for d in "XYZ"}
    assert "while the axis goes from point to point: no measurement. Left out" in labels_note(entries[0], True)
    assert len(separate_campaign(MACHINE, out)) == 3


def test_a_sweep_with_too_few_points_left_goes_as_a_whole() -> None:
    """Sweeps have 42 points; a hang from the second point of the third sweep on leaves it two."""
    measured, _ = measured_campaign(np.random.default_rng(5))
    out, entries = without_held_labels(hung(measured, 85, 126))
    assert 2 not in sweeps_of(out).sweep
    assert len(sweeps_of(out).t_s) == len(sweeps_of(measured).t_s) - 42
    assert "and 42 points of sweeps that keep too few for a line" in labels_note(entries[0], True)
    assert len(separate_campaign(MACHINE, out)) == 3


def test_healthy_sweeps_one_constant_direction_and_tables_without_noise_stay() -> None:
    measured, _ = measured_campaign(np.random.default_rng(5))
    for campaign in (measured, hung(measured, 100, 110, (1,))):
        out, entries = without_held_labels(campaign)
        assert out is campaign
        assert entries == []
    # The axis waits at one place: a reading that repeats there is no sign of a hang.
    waiting = hung(measured, 100, 110)
    position_mm = sweeps_of(waiting).position_mm.copy()
    position_mm[99:110] = position_mm[99]
    waiting = replace(waiting, sweeps=replace(sweeps_of(waiting), position_mm=position_mm))
    assert without_held_labels(waiting) == (waiting, [])
    # A whole sweep without any change, as a cold sweep in a published table: told, and believed.
    cold = hung(measured, 0, 42)
    out, entries = without_held_labels(cold)
    assert out is cold
    assert len(entries) == 3
    assert "the whole sweep is constant" in labels_note(entries[0], True)


@pytest.mark.shared_data(DATA)
def test_the_spindle_recording(shared_data: Path) -> None:
    """As recorded no probe is ever frozen. With a probe held over a standstill, exactly those rows go."""
    import pandas as pd

    data = pd.read_excel(shared_data, engine="calamine").to_numpy(float)
    counted = 0
    for begin, end in pairwise((0, 1951, 3871, 5791, 7711, 9631, 11115)):
        t_s = data[begin:end, 0] - data[begin, 0]
        temperatures = Temperatures(t_s, tuple(f"t{i}" for i in range(1, 17)), data[begin:end, 7:])
        campaign = Campaign(
            "c", CampaignSettings(), temperatures, drift=Drift(t_s, data[begin:end, [2, 4, 6]]),
            duty=Duty(t_s, {"spindle_rpm": data[begin:end, 1]}),
        )  # fmt: skip
        assert without_held_labels(campaign) == (campaign, [])
        stands = np.flatnonzero(data[begin:end, 1] == 0)
        if len(stands) < 900:
            continue
        first, last = int(stands[100]), int(stands[100]) + 400  # 100 min
        out, entries = without_held_labels(frozen(campaign, first, last, (2,)))
        assert [(e.column, e.count) for e in entries] == [("dZ_um", 399)]
        assert np.flatnonzero(np.isnan(drift_um(out)[:, 2])).tolist() == list(range(first + 1, last))
        counted += 1
    assert counted == 5


def test_the_analysis_counts_held_labels_in_its_notes() -> None:
    from thetacomp.analysis import analyze_folder

    whole = folder()
    campaign = whole.campaign("c1")
    t_s = campaign.temperatures.t_s
    spoilt = frozen(replace(campaign, duty=standing(4.0 * HOUR_S, 7.0 * HOUR_S)), 48, 84)
    result = analyze_folder(replace(whole, campaigns=tuple(spoilt if c.name == "c1" else c for c in whole.campaigns)))
    (note,) = (n for n in result.model.notes if "frozen" in n)
    assert note.startswith("campaign c1, drift: 35 values of dX_um")
    (row,) = (r for r in result.validation if (r.campaign, r.model, r.split) == ("c1", "default", "campaign"))
    assert row.n == len(t_s[::5]) - 35

"""Gross readings of a drift record are left out and told; what the machine really does is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from known_machine import MACHINE as KNOWN
from known_machine import measured_campaign
from rigid_machine import MACHINE, P0_MM, ROUND_S, STAND_MM, draw_rigid, measure

from thetacomp.campaign import Campaign, CampaignSettings, Drift
from thetacomp.model.temperatures import Temperatures
from thetacomp.separation.drift_nodes import drift_means
from thetacomp.separation.drift_outliers import gross_means, gross_readings
from thetacomp.separation.joint_form import separate_joint
from thetacomp.separation.separate import separate_campaign

HOUR_S = 3600.0


def _gross(t_s: np.ndarray, value: np.ndarray, least: float = 1.0) -> list[int]:
    return np.flatnonzero(gross_readings(t_s, value[:, None], {}, least)).tolist()


def _warm_up(t_s: np.ndarray) -> np.ndarray:
    """150 µm with a time constant of 30 minutes."""
    return 150.0 * (1.0 - np.exp(-t_s / 1800.0))


def _log(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Five hours of a warm-up, each minute, with a scatter of 2 µm."""
    t_s = np.arange(0.0, 5.0 * HOUR_S, 60.0)
    return t_s, _warm_up(t_s) + np.random.default_rng(seed).normal(0.0, 2.0, len(t_s))


@pytest.mark.parametrize("where", [[0], [1], [150], [298], [299], [40, 41], [40, 42, 200]])
def test_gross_readings_of_a_log_are_found_wherever_they_stand(where: list[int]) -> None:
    t_s, value = _log()
    value[where] += np.linspace(100.0, 200.0, len(where))
    assert _gross(t_s, value) == where


@pytest.mark.parametrize("row", [2, 100, 270, 297, 298])
def test_a_jump_that_stays_is_kept(row: int) -> None:
    """The machine moves by 80 µm, or comes back, and two readings at least agree."""
    t_s, value = _log()
    value[row:] += 80.0
    assert _gross(t_s, value) == []
    assert _gross(t_s, value[::-1]) == []


def test_a_fast_warm_up_and_its_turn_to_cooling_are_kept() -> None:
    """Hourly readings of a time constant of an hour: steps of 95 µm at the onset and at the turn, scatter 1 µm."""
    t_s = HOUR_S * np.arange(24.0)
    warm = 150.0 * (1.0 - np.exp(-t_s / HOUR_S))
    turned = np.where(t_s > 12 * HOUR_S, warm[12] * np.exp(-(t_s - 12 * HOUR_S) / HOUR_S), warm)
    early = np.where(t_s > 2 * HOUR_S, warm[2] * np.exp(-(t_s - 2 * HOUR_S) / HOUR_S), warm)
    for seed in range(20):
        noise = np.random.default_rng(seed).normal(0.0, 1.0, len(t_s))
        for drift in (warm, turned, -turned, early):
            assert _gross(t_s, drift + noise) == []


def test_a_lone_reading_behind_a_gap_is_not_judged_by_the_scatter_of_minutes() -> None:
    """An hour of readings each minute, three hours without, one reading; the drift went on by 120 µm."""
    t_s, value = _log()
    keep = np.r_[0:60, 240]
    assert _gross(t_s[keep], value[keep]) == []
    both = np.r_[0:60, 150, 240:300]
    assert _gross(t_s[both], value[both]) == []
    spoilt = value.copy()
    spoilt[150] += 500.0
    # Nothing else in this record was seen over a gap of 90 minutes: nobody can tell, so the reading stays.
    assert _gross(t_s[both], spoilt[both]) == []
    spoilt[30] += 100.0
    assert _gross(t_s[both], spoilt[both]) == [30]


def test_white_noise_loses_no_reading_in_99_records_of_100() -> None:
    """Measured 1 record in 600 with 20 readings, 3 in 600 with 9."""
    rng = np.random.default_rng(1)
    for count in (9, 20, 100):
        t_s = HOUR_S * np.arange(count)
        lost = sum(bool(_gross(t_s, rng.normal(0.0, 4.0, count))) for _ in range(300))
        assert lost <= 3


def test_among_twelve_readings_a_gross_one_does_not_excuse_itself() -> None:
    """White scatter of 4 µm, one reading off by 60 µm: measured 89 of 100 found, 62 if it counted in the scatter."""
    rng = np.random.default_rng(2)
    found = 0
    for row in rng.integers(1, 11, 100):
        value = rng.normal(0.0, 4.0, 12)
        value[row] += 60.0
        found += _gross(HOUR_S * np.arange(12), value) == [row]
    assert found >= 85


def test_few_readings_cannot_tell_and_a_small_departure_is_not_gross() -> None:
    t_s = HOUR_S * np.arange(8.0)
    value = np.zeros(8)
    value[4] = 300.0
    assert _gross(t_s, value) == []
    t_s, flat = HOUR_S * np.arange(30.0), np.zeros(30)
    flat[10] = 30.0
    assert _gross(t_s, flat) == [10]
    # The instrument is stated to scatter by 7.5 µm: 4.5 times that is 33.75 µm.
    assert _gross(t_s, flat, 7.5) == []


def test_readings_at_another_position_are_not_compared() -> None:
    """Every seventh reading is taken a metre on, where geometry adds 60 µm."""
    t_s = 60.0 * np.arange(200.0)
    away = np.arange(200) % 7 == 0
    value = 60.0 * away + np.random.default_rng(0).normal(0.0, 2.0, 200)
    at_mm = {"X": np.where(away, 1000.0, 0.0)}
    assert not gross_readings(t_s, value[:, None], at_mm, 1.0).any()
    assert np.count_nonzero(gross_readings(t_s, value[:, None], {}, 1.0)) > 10
    value[70] += 90.0
    assert np.flatnonzero(gross_readings(t_s, value[:, None], at_mm, 1.0)).tolist() == [70]


def _drift_means(value: np.ndarray, mean_s: np.ndarray, sweep_s: np.ndarray, sweep_drift: np.ndarray) -> list[int]:
    """Gross means where the sweeps scatter by 4 µm and their drift is taken along a line."""
    expected = np.interp(mean_s, sweep_s, sweep_drift)
    return np.flatnonzero(gross_means(mean_s, value, sweep_s, sweep_drift, expected, 1.0, 4.0)).tolist()


@pytest.mark.parametrize("count", [3, 4, 5, 6])
def test_the_sweeps_tell_where_readings_are_few(count: int) -> None:
    """One mean an hour in a warm-up, beside the sweeps, with a constant of 40 µm of its own."""
    sweep_s = HOUR_S * np.arange(count + 1.0)
    sweep_drift, mean_s = _warm_up(sweep_s), sweep_s[1:] + 60.0
    for row in range(count):
        rng = np.random.default_rng(row)
        value = _warm_up(mean_s) + 40.0 + rng.normal(0.0, 4.0, count)
        assert _drift_means(value, mean_s, sweep_s, sweep_drift) == []
        value[row] += 300.0
        assert _drift_means(value, mean_s, sweep_s, sweep_drift) == [row]


def test_a_jump_between_sweeps_is_kept_and_so_is_a_look_within_a_long_gap() -> None:
    sweep_s = np.array([0.0, 600.0, 1200.0, 4800.0, 5400.0, 6000.0, 20400.0])
    jumped = np.where(sweep_s > 1300.0, 100.0, 0.0)
    mean_s = np.array([300.0, 900.0, 1350.0, 4700.0, 5100.0, 5700.0, 13000.0])
    # The mean at 1350 s sees the jump at once, the line between the sweeps at 1200 and 4800 s hardly yet.
    value = np.where(mean_s > 1300.0, 100.0, 0.0)
    assert _drift_means(value, mean_s, sweep_s, jumped) == []
    value[-1] += 300.0
    assert _drift_means(value, mean_s, sweep_s, jumped) == [6]


def _drift_errors(campaign: Campaign, rigid) -> tuple[float, tuple[str, ...]]:
    """Largest deviation of the joint drift from the transforms in µm, and what is told of the record."""
    found = [s for s in separate_joint(MACHINE, campaign).components if s.axis is None]
    worst = max(
        abs(s.intercept_um[i] - rigid.thermal(P0_MM, s.t_s[i])["XYZ".index(s.direction)])
        for s in found
        for i in np.flatnonzero(~s.cold)
    )
    notes = tuple(f"{s.component}: {n}" for s in found for n in s.notes if n.startswith("drift.csv"))
    return float(worst), notes


def test_a_gross_reading_does_not_move_the_joint_drift_and_is_named() -> None:
    """21 readings, three a round; the eighth is off by 400 µm in X and the last by 300 µm in Z."""
    rng = np.random.default_rng(11)
    rigid = draw_rigid(rng)
    clean = measure(rigid, rng, drift_zero_um=50.0)
    error = clean.drift.error_um.copy()
    error[7, 0] += 400.0
    error[20, 2] -= 300.0
    best, nothing = _drift_errors(clean, rigid)
    found, notes = _drift_errors(replace(clean, drift=replace(clean.drift, error_um=error)), rigid)
    assert nothing == ()
    assert found == pytest.approx(best, abs=2.0)
    assert [n.split(",")[0] for n in notes] == [
        "DX: drift.csv: gross readings at 1 moment are left out",
        "DZ: drift.csv: gross readings at 1 moment are left out",
    ]
    assert notes[0].endswith(f"t_s = {clean.drift.t_s[7]:.0f}")
    assert "the readings beside them and the sweeps" in notes[0]


def test_one_reading_a_round_is_told_by_the_sweeps_of_a_campaign() -> None:
    rng = np.random.default_rng(12)
    rigid = draw_rigid(rng)
    clean = measure(rigid, rng, drift_zero_um=0.0, rounds=6)
    rows = np.arange(0, 18, 3)
    few = Drift(
        clean.drift.t_s[rows], clean.drift.error_um[rows], None, {n: p[rows] for n, p in clean.drift.at_mm.items()}
    )
    error = few.error_um.copy()
    error[3] += 300.0
    best, nothing = _drift_errors(replace(clean, drift=few), rigid)
    found, notes = _drift_errors(replace(clean, drift=replace(few, error_um=error)), rigid)
    assert nothing == ()
    assert len(notes) == 3
    assert found == pytest.approx(best, abs=2.0)
    # One of five readings is gross: four are left, and the sweeps stand alone.
    five = Drift(few.t_s[:5], error[:5], None, {n: p[:5] for n, p in few.at_mm.items()})
    _, notes = _drift_errors(replace(clean, drift=five), rigid)
    assert "DX: drift.csv is left out: 4 good readings are left, at least 5 are needed" in notes


def test_a_gross_reading_inside_a_burst_does_not_spoil_the_burst() -> None:
    """Five readings within a minute after each round; the second of the third burst is off by 300 µm."""
    rng = np.random.default_rng(13)
    rigid = draw_rigid(rng)
    clean = measure(rigid, rng, rounds=6)
    t_s = (ROUND_S * np.arange(6.0)[:, None] + 2100.0 + 15.0 * np.arange(5.0)).ravel()
    true = np.array([rigid.tool(STAND_MM, w)[:3] for w in rigid.warmth(t_s)])
    error = true + rng.normal(0.0, 4.0, true.shape)
    at_mm = {n: np.full(len(t_s), p) for n, p in STAND_MM.items()}
    best, nothing = _drift_errors(replace(clean, drift=Drift(t_s, error, None, at_mm)), rigid)
    spoilt = error.copy()
    spoilt[11] += 300.0
    found, notes = _drift_errors(replace(clean, drift=Drift(t_s, spoilt, None, at_mm)), rigid)
    assert nothing == ()
    assert len(notes) == 3
    assert all(n.endswith(f"t_s = {t_s[11]:.0f}") for n in notes)
    assert found == pytest.approx(best, abs=1.0)


def test_the_separate_form_leaves_gross_readings_out_and_says_so() -> None:
    """A gross reading inside the five minutes of the zero would move the whole component by a fifth of it."""
    t_s, value = _log()
    error = np.column_stack([value, value, np.zeros(len(t_s))])
    error[3, 0] += 250.0
    error[100, 0] -= 250.0
    clock = Temperatures(np.array([0.0, t_s[-1]]), ("t1",), np.array([[20.0], [30.0]]))
    campaign = Campaign("c", CampaignSettings(reference_s=240.0), clock, drift=Drift(t_s, error))
    dx, dy, dz = separate_campaign(MACHINE, campaign)
    assert len(dx.t_s) == len(t_s) - 2
    assert 3 not in dx.sweep
    assert 100 not in dx.sweep
    # The mean of the four good readings of the first five minutes, not of five.
    assert dx.cold_intercept_um == pytest.approx(value[[0, 1, 2, 4]].mean())
    assert dx.notes == (
        "drift.csv: gross readings at 2 moments are left out, more than 4.5 robust standard deviations beyond all that"
        " the readings beside them say: t_s = 180, 6000",
    )
    assert len(dy.t_s) == len(t_s)
    assert dy.notes == ()
    assert dz.notes == ()


def test_a_departure_within_the_stated_uncertainty_is_not_gross() -> None:
    """30 µm in a flat record; the instrument is stated to ±15 µm (expanded), so a reading scatters by 7.5 µm."""
    t_s = HOUR_S * np.arange(30.0)
    error = np.zeros((30, 3))
    error[10] = 30.0
    clock = Temperatures(np.array([0.0, t_s[-1]]), ("t1",), np.array([[20.0], [30.0]]))
    for stated_um, kept in ((None, 29), (15.0, 30)):
        campaign = Campaign("c", CampaignSettings(instrument_u_um=stated_um), clock, drift=Drift(t_s, error))
        assert [len(s.t_s) for s in separate_campaign(MACHINE, campaign)] == [kept] * 3


def test_a_look_is_the_mean_of_the_readings_it_has() -> None:
    error = np.array([[1.0, 5.0, np.nan], [np.nan, 7.0, np.nan], [3.0, 9.0, np.nan]])
    means = drift_means(Drift(np.array([0.0, 10.0, 20.0]), error), error, {})
    np.testing.assert_array_equal(means.error, [[2.0, 7.0, np.nan]])


def test_a_long_list_of_moments_is_cut() -> None:
    t_s, value = _log()
    value[10:290:10] += 200.0
    clock = Temperatures(np.array([0.0, t_s[-1]]), ("t1",), np.array([[20.0], [30.0]]))
    campaign = Campaign("c", CampaignSettings(), clock, drift=Drift(t_s, np.column_stack([value] * 3)))
    (note,) = separate_campaign(MACHINE, campaign)[0].notes
    assert "at 28 moments" in note
    assert note.endswith("7200 and 16 more")


@pytest.mark.parametrize("division_um", [5.0, 10.0, 25.0])
@pytest.mark.parametrize("scatter", [0.0, 0.2, 0.5])
def test_the_division_of_a_gauge_is_no_outlier_rule(division_um: float, scatter: float) -> None:
    """1203 readings of a warm-up of 150 µm, rounded to the division; `scatter` in divisions. One off by 12 is gross."""
    t_s = 15.0 * np.arange(1203)
    value = _warm_up(t_s) + np.random.default_rng(3).normal(0.0, scatter * division_um, len(t_s))
    value = division_um * np.round(value / division_um)
    assert _gross(t_s, value) == []
    value[700] += 12.0 * division_um
    assert _gross(t_s, value) == [700]


def test_sweeps_read_in_coarse_divisions_keep_every_point() -> None:
    """Sweeps that hardly scatter, read to 40 µm: most points repeat exactly, the rest are one division away."""
    measured, _ = measured_campaign(
        np.random.default_rng(0), sweeps=4, point_u_um=1.0, angle_u_um_per_m=0.5, outlier_share=0.0
    )
    assert measured.sweeps is not None
    coarse = replace(measured.sweeps, error_um=40.0 * np.round(measured.sweeps.error_um / 40.0))
    for component in separate_campaign(KNOWN, replace(measured, sweeps=coarse)):
        assert component.points is not None
        assert not component.points.outlier.any()

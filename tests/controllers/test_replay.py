"""Replay through the limits of a control: closed forms of every limit, and a campaign through a whole SINUMERIK."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from small_models import component, document, term
from typer.testing import CliRunner
from verification_runs import Run, true_model, write_folder

from thetacomp.cli.main import app
from thetacomp.controllers.replay import (
    TOGETHER,
    Register,
    Stage,
    clip,
    hold_gaps,
    moving_average,
    outcome,
    quantise,
    rate_limit,
    replay,
    sample_and_hold,
)
from thetacomp.controllers.sinumerik_replay import (
    CLAMP,
    ENTRY,
    FILTER,
    RAMP,
    STEP,
    UPDATE,
    CampaignReplay,
    replay_campaign,
)
from thetacomp.controllers.sinumerik_settings import ReplaySettings, SinumerikSettings
from thetacomp.errors import AnalysisError
from thetacomp.model.document import ModelDocument

T_S = np.arange(0.0, 3601.0)
RAMP_PER_S = 0.01  # µm/s: 36 µm in an hour
WANTED = RAMP_PER_S * T_S


def test_a_writer_that_updates_each_minute_is_behind_a_ramp_by_up_to_a_minute():
    lost = WANTED - sample_and_hold(T_S, WANTED, 60.0)
    # Just before the next update the value is 59 s old on a grid of 1 s; on average (0 + 59) / 2 s.
    assert lost.max() == pytest.approx(59 * RAMP_PER_S)
    assert lost[:3600].mean() == pytest.approx(29.5 * RAMP_PER_S)
    assert (lost >= 0).all()
    assert np.array_equal(sample_and_hold(T_S, WANTED, 0.0), WANTED)


def test_the_first_of_equal_losses_is_named_whatever_rounding_says():
    """Every second second the stage takes 3 µm, at 2501 s by a hair more."""
    taken = np.where(T_S % 2 == 1, 3.0, 0.0)
    taken[2501] += 1e-12
    (alone, _) = replay(T_S, [Register("Y", "K0", WANTED, 1.0, (Stage("takes", lambda t_s, value: value - taken),))])
    assert (alone.largest_at_s, alone.largest_um) == (1.0, pytest.approx(3.0))


def test_a_rate_limit_falls_behind_by_the_difference_of_the_rates():
    limited = rate_limit(T_S, WANTED, 0.4 * RAMP_PER_S)
    assert WANTED - limited == pytest.approx(0.6 * RAMP_PER_S * T_S)
    assert rate_limit(T_S, WANTED, 1.01 * RAMP_PER_S) == pytest.approx(WANTED)


def test_a_step_is_worked_off_at_the_limited_rate_in_both_directions():
    step = np.where(T_S < 100, 0.0, np.where(T_S < 200, 10.0, 0.0))
    limited = rate_limit(T_S, step, 0.5)
    assert limited[100 + 9] == pytest.approx(5.0)  # ten steps of 0.5
    assert limited[100 + 19] == pytest.approx(10.0)
    assert limited[200 + 9] == pytest.approx(5.0)
    assert limited[-1] == 0.0


@pytest.mark.parametrize(("cycles", "cycle_s"), [(20, 1.0), (5, 2.0), (1, 1.0)])
def test_a_moving_average_is_behind_a_ramp_by_half_of_its_cycles_less_one(cycles, cycle_s):
    filtered = moving_average(T_S, WANTED, cycles, cycle_s)
    settled = cycles * cycle_s < T_S
    lag_s = (cycles - 1) / 2 * cycle_s
    assert (WANTED - filtered)[settled] == pytest.approx(lag_s * RAMP_PER_S)


def test_clamp_and_rounding_take_what_they_say():
    assert np.max(WANTED - clip(T_S, WANTED, 30.0)) == pytest.approx(6.0)
    assert clip(T_S, -WANTED, 30.0).min() == -30.0
    assert np.abs(quantise(T_S, WANTED, 0.5) - WANTED).max() <= 0.25 + 1e-12


def test_a_missing_temperature_freezes_the_value():
    value = np.array([np.nan, 1.0, np.nan, np.nan, 4.0])
    assert hold_gaps(value).tolist() == [0.0, 1.0, 1.0, 1.0, 4.0]


def test_losses_are_told_by_cause_and_together():
    stages = (
        Stage("late", lambda t, v: sample_and_hold(t, v, 60.0)),
        Stage("clamped", lambda t, v: clip(t, v, 0.03)),
    )
    register = Register("Y1", "K0", WANTED / 1000.0, 1000.0, stages)
    late, clamped, together = replay(T_S, [register])
    assert (late.cause, clamped.cause, together.cause) == ("late", "clamped", TOGETHER)
    assert late.largest_um == pytest.approx(0.59)
    assert clamped.largest_um == pytest.approx(6.0)
    assert clamped.largest_at_s == 3600.0
    # Above 31 µm wanted, that is after 3100 s, more than 1 µm is lost.
    assert clamped.share_of_time == pytest.approx(500 / 3601, abs=1e-3)
    assert clamped.largest_um <= together.largest_um <= clamped.largest_um + late.largest_um
    assert outcome(T_S, register)[-1] == pytest.approx(0.03)


def one_axis() -> ModelDocument:
    """K0 = 10 µm/K and tanβ = 20 µm/m per K of one sensor; P0 = 0, travel 1 m."""
    part = component("EXX", term(0.0, 10.0, sd=0.0), term(0.0, 20.0, sd=0.0), {"tx": 20.0})
    return document({"X": "+X"}, {"EXX": part}, {"tx": (0.0, 10.0)})


def ramp_of_heat(settings: SinumerikSettings, rise_K: float = 10.0, hours: float = 1.0) -> CampaignReplay:
    t_s = np.arange(0.0, 3600.0 * hours + 1.0)
    return replay_campaign(one_axis(), settings, "A", t_s, {"tx": 21.5 + rise_K * t_s / t_s[-1]})


def loss(one: CampaignReplay, register: str, cause: str) -> float:
    return next(x.largest_um for x in one.losses if (x.register, x.cause) == (register, cause))


def test_a_warm_up_through_a_sinumerik_in_closed_form():
    one = ramp_of_heat(SinumerikSettings(replay=ReplaySettings(entry_step_um=0.0)))
    # 10 K in 3600 s: K0 rises by 100 µm, tanβ at 1 m by 200 µm; 59 s late on a grid of 1 s.
    assert loss(one, "K0", UPDATE) == pytest.approx(100 * 59 / 3600)
    assert loss(one, "tanβ", UPDATE) == pytest.approx(200 * 59 / 3600)
    # Reserve 1.25 on the range of the training: nothing is clipped, and 1 µm/s is enough.
    assert loss(one, "K0", CLAMP) == loss(one, "K0", RAMP) == loss(one, "K0", STEP) == 0.0
    assert one.wanted_um[0, -1] == pytest.approx(100.0)
    assert one.wanted_um[1, -1] == pytest.approx(200.0)


def test_limits_that_are_too_small_are_told_in_micrometres():
    own = ReplaySettings(update_s=0.0, entry_step_um=0.0, largest_entry_um=80.0, filter_cycles=601, filter_cycle_s=1.0)
    one = ramp_of_heat(SinumerikSettings(rate_limit_um_per_s=0.02, replay=own))
    assert loss(one, "K0", ENTRY) == pytest.approx(20.0)
    assert loss(one, "tanβ", ENTRY) == pytest.approx(120.0)
    assert loss(one, "K0", RAMP) == pytest.approx(100.0 - 0.02 * 3600)
    assert loss(one, "K0", FILTER) == pytest.approx(100.0 * 300 / 3600)
    hot = ramp_of_heat(SinumerikSettings(replay=own), rise_K=20.0)
    assert loss(hot, "K0", CLAMP) == pytest.approx(200.0 - 125.0)


def test_an_axis_that_moves_too_fast_for_the_control_is_told():
    (check,) = ramp_of_heat(SinumerikSettings()).motion
    # 200 µm/m at 10 m/min are 33 µm/s; MD32760 = 0.01 of 10 m/min are 1667 µm/s.
    assert check.needed_um_per_s == pytest.approx(200 / 6)
    assert check.allowed_um_per_s == pytest.approx(10000 / 6)
    assert check.holds
    (slow,) = ramp_of_heat(SinumerikSettings(md32760_comp_add_velo_factor=1e-4)).motion
    assert not slow.holds


def test_a_sensor_without_a_value_at_the_reference_is_refused():
    with pytest.raises(AnalysisError, match="tx has no value at the reference"):
        replay_campaign(one_axis(), SinumerikSettings(), "A", T_S, {"ty": T_S})


def test_the_command_replays_a_machine_folder(tmp_path: Path):
    folder = write_folder(tmp_path / "machine", [Run("a"), Run("b", heat=0.5)])
    true_model().save(tmp_path / "model.json")
    (tmp_path / "export.toml").write_text("[replay]\nlargest_entry_um = 60.0\n", encoding="utf-8")
    arguments = ["export", str(tmp_path / "model.json"), "--target", "sinumerik", "--out", str(tmp_path / "out")]
    arguments += ["--replay", str(folder), "--settings", str(tmp_path / "export.toml")]
    result = CliRunner().invoke(app, [*arguments, "--json"])
    assert result.exit_code == 0, result.output
    data = json.loads(result.stdout)
    assert [one["campaign"] for one in data["replay"]] == ["a", "b"]
    with (tmp_path / "out" / "replay.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    worst = {
        name: max(float(r["largest_um"]) for r in rows if r["campaign"] == name and r["cause"] == ENTRY)
        for name in ("a", "b")
    }
    # EXY: 12 µm/m/K, 1.5 m from P0, 6.05 K at the end of the warm-up: 109 µm wanted where 60 fit.
    assert worst["a"] == pytest.approx(12 * 1.5 * 7 * (1 - np.exp(-6 / 3)) - 60, abs=2.0)
    assert worst["b"] == 0.0
    assert (tmp_path / "out" / "replay.png").read_bytes().startswith(b"\x89PNG")
    text = CliRunner().invoke(app, arguments).stdout
    assert "replay of 2 campaigns through the limits" in text
    assert "largest entry" in text

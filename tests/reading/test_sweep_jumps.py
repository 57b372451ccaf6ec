"""A jump inside a sweep is told with place and size; noise, single gross points and heat are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from known_machine import MACHINE, measured_campaign

from thetacomp.campaign import Campaign
from thetacomp.errors import Problem
from thetacomp.reading.problems import ProblemList
from thetacomp.reading.sweep_jumps import check_sweep_jumps
from thetacomp.separation import separate_campaign
from thetacomp.standards.iso230_2 import Readings, positioning


def jumping(first: int, last: int, um: float, seed: int = 0) -> Campaign:
    """Nine sweeps of 42 points, scatter 7.5 µm; the error in Y jumps from one row to another."""
    campaign, _ = measured_campaign(np.random.default_rng(seed))
    assert campaign.sweeps is not None
    error_um = campaign.sweeps.error_um.copy()
    error_um[first:last, 1] += um
    return replace(campaign, sweeps=replace(campaign.sweeps, error_um=error_um))


def found(campaign: Campaign) -> list[Problem]:
    problems = ProblemList()
    check_sweep_jumps([campaign], False, problems)
    return list(problems.collected())


def test_a_jump_of_200_um_is_told_and_a_healthy_campaign_with_gross_points_is_not() -> None:
    """Measured over 60 seeds and rows: 51 found; a gross point beside the jump, or three before the end, hide it."""
    told = 0
    for seed in range(10):
        assert found(jumping(0, 0, 0.0, seed)) == []
        campaign = jumping(100, 126, 200.0, seed)
        assert campaign.sweeps is not None
        for problem in found(campaign):
            told += 1
            assert (problem.code, problem.severity, problem.file) == ("error-jump", "warning", "campaigns/warm-up")
            assert problem.message.startswith("EYY: the error jumps by +")
            assert f"at t_s = {campaign.sweeps.t_s[100]:g}, and stays" in problem.message
    assert told >= 8


def test_what_the_separation_leaves_out_in_a_row_is_said() -> None:
    component = separate_campaign(MACHINE, jumping(100, 126, 200.0))[1]
    (note,) = (n for n in component.notes if "in a row" in n)
    assert note.startswith("sweep at 2.17 h: ")
    assert not any("in a row" in n for n in separate_campaign(MACHINE, jumping(0, 0, 0.0))[1].notes)


def test_positioning_says_in_which_run_it_jumped() -> None:
    """Five runs in both directions at eleven targets; in the third run back the deviation jumps at 400 mm."""
    rng = np.random.default_rng(1)
    target = np.linspace(0.0, 1000.0, 11)
    rows = [(p, f"{k}", d) for k in range(1, 6) for d in (1, -1) for p in target[::d]]
    position = np.array([p for p, _, _ in rows])
    deviation = 0.02 * position + rng.normal(0.0, 1.0, len(rows))
    direction = np.array([d for *_, d in rows])
    readings = Readings("X", position, tuple(k for _, k, _ in rows), direction, deviation)
    assert not any("jump" in remark for remark in positioning(readings).remarks)
    spoilt = deviation.copy()
    spoilt[(np.array([k for _, k, _ in rows]) == "3") & (direction < 0) & (position <= 400.0)] += 200.0
    (remark,) = (r for r in positioning(replace(readings, deviation_um=spoilt)).remarks if "jump" in r)
    assert remark.startswith("Run 3, direction -: the deviation jumps by +")
    assert "at 400 mm and stays there" in remark

"""States, axis models and their judgement on sweeps whose truth is known, in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from known_machine import MACHINE, measured_campaign
from scipy import stats

from thetacomp.analysis import analyze_folder
from thetacomp.axis_states import AxisStates, axis_states
from thetacomp.campaign import Campaign, CampaignSettings, MachineFolder, Parameters
from thetacomp.fitting.build import build_document
from thetacomp.fitting.key_point_law import clock, fit_axis
from thetacomp.folds import hold_out
from thetacomp.model.temperatures import Temperatures
from thetacomp.separation import separate_folder
from thetacomp.validation.acceptance import acceptance_checks
from thetacomp.validation.validate import Residuals, held_out_residuals


def _sweeps(count: int) -> MachineFolder:
    rng = np.random.default_rng(21)
    parts = [measured_campaign(rng, sweeps=6, outlier_share=0.0)[0] for _ in range(count)]
    return MachineFolder(MACHINE, tuple(replace(c, name=f"c{k}") for k, c in enumerate(parts)))


def _states(folder: MachineFolder) -> AxisStates:
    (states,) = axis_states(folder, separate_folder(folder), [c.name for c in folder.campaigns])
    return states


def _lines(p0_mm: float, name: str, **settings: object) -> Campaign:
    """EXY = (10 + 4 (p - 500)/1000) µm/K times a rise of 0, 2, 5, 6 K, written with another P0."""
    rise = np.array([0.0, 2.0, 5.0, 6.0])
    t_s = 1000.0 + 3600.0 * np.arange(4)
    return Campaign(
        name,
        CampaignSettings.model_validate(settings),
        Temperatures(t_s, ("t1",), 20.0 + rise[:, None]),
        parameters=Parameters(
            t_s=t_s,
            component=("EXY",) * 4,
            intercept_um=(10.0 + 4.0 * (p0_mm - 500.0) / 1000.0) * rise,
            slope_um_per_m=4.0 * rise,
            p0_mm=np.full(4, p0_mm),
            p_min_mm=np.zeros(4),
            p_max_mm=np.full(4, 3000.0),
        ),
    )


def test_campaigns_with_different_p0_are_brought_to_one() -> None:
    states = _states(MachineFolder(MACHINE, (_lines(500.0, "a"), _lines(2500.0, "b"))))
    assert states.p0_mm == 500.0
    assert states.intercept_um[:4, 0] == pytest.approx([0.0, 20.0, 50.0, 60.0])
    assert states.intercept_um[4:, 0] == pytest.approx([0.0, 20.0, 50.0, 60.0])


def test_elapsed_time_counts_from_the_reference() -> None:
    states = _states(MachineFolder(MACHINE, (_lines(500.0, "a"),)))
    assert states.elapsed_h == pytest.approx([0.0, 1.0, 2.0, 3.0])
    assert states.samples[0].elapsed_h.min() == 0.0
    sweeps = _states(_sweeps(1))
    assert sweeps.elapsed_h[1] == pytest.approx(1.0)  # middle of a sweep after an hour, middle of the cold sweep


def test_zero_is_exact_for_sweeps_alone() -> None:
    assert _states(_sweeps(1)).exact_zero
    assert not _states(MachineFolder(MACHINE, (_lines(500.0, "a"),))).exact_zero
    assert not _states(MachineFolder(MACHINE, (_lines(500.0, "a", datum="common"),))).exact_zero


def test_a_fit_through_zero_counts_only_the_heated_states() -> None:
    folder = _sweeps(2)
    states = _states(folder)
    model = fit_axis(states, ("t1",))
    regression = model.regressions["EXY"]
    assert regression.intercept_ == pytest.approx([0.0, 0.0])
    assert regression.dof_ == np.count_nonzero(~states.cold) - 1
    document = build_document(folder, [(states, model)], "test", ["c0", "c1"])
    assert document.components["EXY"].through_zero
    lines = MachineFolder(MACHINE, (_lines(500.0, "a"), _lines(500.0, "b")))
    free = _states(lines)
    again = build_document(lines, [(free, fit_axis(free, ("t1",)))], "test", ["a", "b"])
    assert not again.components["EXY"].through_zero


def test_the_clock_has_a_constant_even_where_the_zero_is_exact() -> None:
    assert np.abs(clock(_states(_sweeps(2))).regressions["EXY"].intercept_).max() > 0


def test_the_interval_is_the_textbook_one_with_the_noise_of_the_instrument() -> None:
    """t * sqrt(b' Σ b (1 + x' (X'X)^-1 x) + noise²) with b = (1, lever): prediction interval of a linear model."""
    states = _states(_sweeps(2))
    model = fit_axis(states, ("t1",))
    samples = states.samples[0]
    _, half_width = model.predict("EXY", states, samples)
    regression = model.regressions["EXY"]
    hot = ~states.cold
    x = samples.rise_K[:, 0]
    leverage = x**2 / np.sum(states.rise_K[hot, 0] ** 2)
    sigma = regression.residual_covariance_
    u = samples.lever_m
    scatter = sigma[0, 0] + 2 * u * sigma[0, 1] + u**2 * sigma[1, 1]
    expected = stats.t.ppf(0.975, regression.dof_) * np.sqrt(scatter * (1 + leverage) + samples.noise_sd_um**2)
    assert samples.noise_sd_um.min() > 5.0
    assert half_width == pytest.approx(expected)


def test_no_fold_sees_what_it_is_judged_by() -> None:
    states = _states(_sweeps(3))
    split, folds = hold_out(states)
    seen: list[set[int]] = []

    def spy(training: AxisStates):  # type: ignore[no-untyped-def]
        seen.append(set(training.campaign.tolist()))
        return fit_axis(training, ("t1",))

    residuals = held_out_residuals(states, split, folds, {"default": spy})
    assert seen == [{1, 2}, {0, 2}, {0, 1}, {0, 1, 2}]  # the folds, then the whole for the in-sample figure
    default = next(r for r in residuals if r.model == "default" and r.component == "EXY")
    assert not states.cold[default.state].any()  # zero by definition proves nothing
    fold = folds[0]
    model = fit_axis(states.take(fold.train), ("t1",))
    samples = states.samples[0]
    rows = np.isin(samples.state, fold.test) & ~states.cold[samples.state]
    value, _ = model.predict("EXY", states, samples.take(rows))
    assert default.after_um[default.campaign == 0] == pytest.approx(samples.value_um[rows] - value)


def test_acceptance_judges_the_default_model() -> None:
    analysis = analyze_folder(_sweeps(3))
    n = 40
    value = np.linspace(10.0, 100.0, n)

    def residuals(model: str, left: float) -> Residuals:
        campaign = np.repeat([0, 1], n // 2)
        nan = np.full(n, np.nan)
        return Residuals("EXY", model, "campaign", np.arange(n), campaign, nan, value, left * value, nan, left * value)

    def first(default: float, other: float) -> bool:
        parts = [residuals("nothing", 1.0), residuals("default", default), residuals("all_sensors", other)]
        return acceptance_checks(parts, (), (), analysis.model)[0].passed

    assert first(0.1, 2.0)
    assert not first(2.0, 0.1)


def test_components_that_were_never_tested_fail() -> None:
    folder = _sweeps(3)
    last = folder.campaigns[2]
    assert last.sweeps is not None
    error = last.sweeps.error_um.copy()
    error[:, 2] = np.nan
    half = replace(last, sweeps=replace(last.sweeps, error_um=error))
    folder = MachineFolder(MACHINE, (*folder.campaigns[:2], half))
    analysis = analyze_folder(folder, train=["c0", "c1"], test=["c2"])
    (check,) = (c for c in analysis.acceptance if c.name == "components of the model without held-out data")
    assert not check.passed
    assert "EZY" in check.meaning
    dropped = analyze_folder(folder)
    assert "EZY" not in dropped.model.components
    assert any(note.startswith("EZY was measured in c0, c1 only") for note in dropped.notes)

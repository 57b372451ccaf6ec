"""Families of models for comparison: same folds and budget, no look at the tested campaign, closed forms."""

from __future__ import annotations

import csv
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from slow_column import folder as slow_column
from typer.testing import CliRunner

from thetacomp.analysis import analyze_folder
from thetacomp.arrays import Floats
from thetacomp.axis_states import AxisStates, axis_states
from thetacomp.cli.main import app
from thetacomp.errors import AnalysisError
from thetacomp.files import write_files
from thetacomp.folds import hold_out, training_states
from thetacomp.report.analysis_files import table_files
from thetacomp.report.analysis_page import report_files
from thetacomp.separation import separate_all
from thetacomp.validation.families import families
from thetacomp.validation.families.choice import FamilyModel, family_procedure, inner_errors, training_table
from thetacomp.validation.families.compare import compare_families
from thetacomp.validation.families.comparison_row import COMPARISON_ONLY
from thetacomp.validation.families.dynamic import SLOWEST, Arx, Course, Grey, fit_arx, fit_grey, on_grid, step_h
from thetacomp.validation.families.families import FAMILIES
from thetacomp.validation.families.family import BUDGET, Family, Rows, Table, linear, one_by_one
from thetacomp.validation.families.linear import step_path
from thetacomp.validation.families.shrinkage import group_lasso_path
from thetacomp.validation.validate import AxisTask

BY_NAME = {family.name: family for family in FAMILIES}
NAMES = list(BY_NAME)


@cache
def states_of(*seeds: int) -> AxisStates:
    """The slow column: the error follows sensor a by an hour, so rises alone explain most of it."""
    folder = slow_column(*seeds)
    separations = separate_all(folder.machine, folder.campaigns).components
    (states,) = axis_states(folder, separations, [c.name for c in folder.campaigns])
    return states


def spoiled(states: AxisStates, campaign: int) -> AxisStates:
    """The same states with nonsense for everything that was measured in one campaign, temperatures untouched."""
    own = states.campaign == campaign
    noise = np.random.default_rng(3).normal(0, 1000.0, states.intercept_um.shape)
    samples = tuple(
        replace(s, value_um=np.where(own[s.state], 1e4 * np.sin(np.arange(len(s.state))), s.value_um))
        for s in states.samples
    )
    return replace(
        states,
        intercept_um=np.where(own[:, None], noise, states.intercept_um),
        slope_um_per_m=np.where(own[:, None], -noise, states.slope_um_per_m),
        samples=samples,
    )


def small(family: Family) -> Family:
    """The family with three of its settings, to be quick."""
    return replace(family, settings=family.settings[::4])


def test_every_family_has_the_same_budget_of_different_settings() -> None:
    assert [len(set(family.settings)) for family in FAMILIES] == [BUDGET] * len(FAMILIES)
    assert len(set(NAMES)) == len(NAMES) == 12


@pytest.mark.parametrize("name", NAMES)
def test_every_family_beats_nothing_on_a_machine_it_can_represent(name: str) -> None:
    states = states_of(1, 2, 3)
    split, folds = hold_out(states)
    task = AxisTask(states, split, folds, "Y")
    rows, notes = compare_families([task], [states], {}, {}, [], lambda message: None, [small(BY_NAME[name])])
    (row,) = (r for r in rows if r.family == name)
    assert (row.component, row.campaign, row.use) == ("EYY", "all", COMPARISON_ONLY)
    assert row.configurations is not None
    assert 1 <= row.configurations <= 3
    # the uncompensated RMS is 30 µm; least squares on the rises leaves 11 µm, the truth is linear in the lags
    assert row.rms_after_um < 0.5 * row.rms_before_um
    assert row.max_after_um < row.max_before_um
    assert row.fit_s > 0.0
    assert notes == ()


@pytest.mark.parametrize("name", NAMES)
def test_no_family_looks_at_what_was_measured_in_the_tested_campaign(name: str) -> None:
    """Training without a campaign and predicting it must not change when its measured errors become nonsense."""
    states = states_of(1, 2, 3)
    procedure = family_procedure(small(BY_NAME[name]))
    fold = hold_out(states)[1][1]
    tested = states.samples[0].take(np.isin(states.samples[0].state, fold.test))
    told = procedure(training_states(states, fold)).predict("EYY", states, tested)[0]
    other = spoiled(states, 1)
    blind = replace(tested, value_um=np.full(len(tested.value_um), np.nan))
    again = procedure(training_states(other, fold)).predict("EYY", other, blind)[0]
    assert np.isfinite(told).all()
    np.testing.assert_array_equal(told, again)


def test_the_check_above_catches_a_family_that_peeks() -> None:
    states = states_of(1, 2, 3)

    class Peeking(FamilyModel):
        def predict(self, component, states, samples):  # type: ignore[no-untyped-def]
            return states.intercept_um[samples.state, 0], samples.lever_m

    model = Peeking(BY_NAME["lasso"], ("EYY",), np.zeros(0, dtype=int), (), (), 0)
    samples = states.samples[0]
    told = model.predict("EYY", states, samples)[0]
    assert not np.array_equal(told, model.predict("EYY", spoiled(states, 1), samples)[0])


def test_settings_are_judged_on_campaigns_that_did_not_train_them() -> None:
    """A setting that repeats what it was fitted on looks perfect in-sample and must lose inside."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(30, 2))
    y = x @ np.array([[1.0], [2.0]]) + rng.normal(0, 0.3, (30, 1))
    table = Table(Rows(x, np.repeat([0, 1, 2], 10), np.tile(np.arange(10.0), 3)), y, np.arange(2))

    def fit(data: Table, setting: str):  # type: ignore[no-untyped-def]
        if setting == "broken":
            raise AnalysisError("never")
        if setting == "honest":
            return linear(np.linalg.lstsq(data.rows.x, data.y, rcond=None)[0])
        known = {tuple(row): value for row, value in zip(data.rows.x, data.y, strict=True)}
        return lambda rows: np.array([known.get(tuple(row), np.zeros(1)) for row in rows.x])

    family = Family("test", "rises", ("by heart", "honest", "broken"), one_by_one(fit))
    errors = inner_errors(family, table)[:, 0]
    by_heart = float(np.mean(y**2))  # it says zero for rows that it has not seen
    assert errors[0] == pytest.approx(by_heart)
    assert errors[1] < 0.2
    assert np.isinf(errors[2])


def test_two_campaigns_cannot_be_compared_and_the_note_says_so() -> None:
    states = states_of(1, 2)
    task = AxisTask(states, *hold_out(states), "Y")
    rows, notes = compare_families([task], [states], {}, {}, [], lambda m: None, [small(BY_NAME["lasso"])])
    assert rows == ()
    assert "lasso left out" in notes[0]


def test_slow_families_train_on_thinned_rows_of_every_campaign() -> None:
    states = states_of(1, 2, 3)
    family = replace(BY_NAME["Gaussian process"], max_rows=7)
    _, table = training_table(states, family)
    assert np.bincount(table.rows.campaign).tolist() == [7, 7, 7]
    assert BY_NAME["Gaussian process"].max_rows < BY_NAME["lasso"].max_rows


def orthonormal(n: int, k: int) -> Floats:
    return np.linalg.qr(np.random.default_rng(1).normal(size=(n, k)))[0] * np.sqrt(n)


def test_group_lasso_on_an_orthonormal_design_is_the_block_soft_threshold() -> None:
    """X'X/n = 1: b_g = (1 - penalty sqrt(k_g) / |c_g|)+ c_g with c = X'y/n (Yuan, Lin 2006, equation 2.4)."""
    group = np.array([0, 0, 1, 2, 2, 2])
    x = orthonormal(50, 6)
    y = x @ np.array([3.0, -1.0, 0.4, 1.0, 0.2, -2.0]) + np.random.default_rng(2).normal(0, 0.5, 50)
    c = x.T @ y / 50
    length = np.array([np.linalg.norm(c[group == g]) for g in range(3)])
    weight = np.sqrt(np.bincount(group))
    largest = np.max(length / weight)
    for share in (0.9, 0.4, 0.1):
        found = group_lasso_path(x.T @ x / 50, c[:, None], group, [share])[0, :, 0]
        shrink = np.maximum(1.0 - share * largest * weight / length, 0.0)
        np.testing.assert_allclose(found, c * shrink[group], atol=1e-6)
    np.testing.assert_allclose(group_lasso_path(x.T @ x / 50, c[:, None], group, [1.0]), 0.0, atol=1e-12)


def test_group_lasso_meets_its_optimality_conditions_on_a_correlated_design() -> None:
    """At the optimum the gradient of a group in use is -limit b_g/|b_g|, of another no longer than its limit."""
    rng = np.random.default_rng(4)
    x = rng.normal(size=(80, 9)) + 1.5 * rng.normal(size=(80, 1))
    y = x[:, :3] @ np.array([1.0, -2.0, 0.5]) + rng.normal(0, 0.3, 80)
    group = np.repeat([0, 1, 2], 3)
    gram, c = x.T @ x / 80, (x.T @ y / 80)[:, None]
    largest = max(np.linalg.norm(c[group == g]) / np.sqrt(3) for g in range(3))
    b = group_lasso_path(gram, c, group, [0.3, 0.05], steps=20000)[1, :, 0]
    gradient, limit = gram @ b - c[:, 0], 0.05 * largest * np.sqrt(3)
    for g in range(3):
        own = group == g
        size = np.linalg.norm(b[own])
        if size > 0.0:
            np.testing.assert_allclose(gradient[own], -limit * b[own] / size, atol=1e-3 * limit)
        else:
            assert np.linalg.norm(gradient[own]) <= limit * (1 + 1e-3)


def courses_of(model: Arx | Grey, seeds: tuple[int, ...], steps: int = 40) -> list[Course]:
    out = []
    for seed in seeds:
        x = np.cumsum(np.random.default_rng(seed).normal(0, 1, (steps, 2)), axis=0)
        x -= x[0]
        out.append(Course(np.arange(steps) * 0.5, x, model.run(x)[:, None]))
    return out


def test_arx_finds_the_recursion_that_made_the_data_and_runs_it_without_them() -> None:
    truth = Arx(past=np.array([1.2, -0.35]), drive=np.array([[0.5, -0.2], [0.1, 0.3]]))
    courses = courses_of(truth, (1, 2))
    found = fit_arx(courses, 0, 2, 2, 1e-12)
    np.testing.assert_allclose(found.past, truth.past, atol=1e-5)
    np.testing.assert_allclose(found.drive, truth.drive, atol=1e-5)
    fresh = courses_of(truth, (9,))[0]
    np.testing.assert_allclose(found.run(fresh.x), fresh.y[:, 0], atol=1e-3)


def test_arx_open_loop_drifts_away_from_a_measured_value_that_jumps() -> None:
    """A one-step predictor would follow a jump of the measured displacement; open loop cannot know of it."""
    states = states_of(1, 2, 3)
    family = small(BY_NAME["ARX, open loop"])
    model = family_procedure(family)(training_states(states, hold_out(states)[1][2]))
    samples = states.samples[0].take(states.campaign[states.samples[0].state] == 2)
    jumped = replace(states, intercept_um=states.intercept_um + 500.0 * (np.arange(len(states)) % 3 == 0)[:, None])
    np.testing.assert_array_equal(model.predict("EYY", states, samples)[0], model.predict("EYY", jumped, samples)[0])


def test_arx_starts_at_rest_under_its_first_inputs() -> None:
    model = Arx(past=np.array([0.8]), drive=np.array([[2.0]]))
    # at rest y = 0.8 y + 2 x, so y = 10 x; a constant input keeps it there
    np.testing.assert_allclose(model.run(np.full((20, 1), 3.0)), 30.0)


def test_an_unstable_arx_is_refused_and_a_grey_model_held_stable() -> None:
    growing = 1.3 ** np.arange(30.0)
    course = Course(np.arange(30.0), np.random.default_rng(0).normal(size=(30, 1)), growing[:, None])
    with pytest.raises(AnalysisError, match="not stable"):
        fit_arx([course], 0, 1, 1, 1e-12)
    assert fit_grey([course], 0, (0,), 0.5).a == SLOWEST  # and never a running sum that grows without end


def test_grey_model_in_closed_form_under_a_constant_input() -> None:
    """GM(1,2) with x = 1: Y_k (1 + a/2) = Y_{k-1} (1 - a/2) + b k.

    Its solution is Y_k = b k / a - b / a² (1 + a/2) + C q^k with q = (1 - a/2) / (1 + a/2) and Y_0 = 0; y is the
    difference of Y.
    """
    a, b, k = 0.4, 2.0, np.arange(26)
    q = (1 - a / 2) / (1 + a / 2)
    # Y_k = b k/a + d: (d)(a) = -(b/a)(1 - a/2) ... inserted into the equation above
    d = -(b / a) * (1 - a / 2) / a
    total = b * k / a + d * (1 - q**k)
    grey = Grey((0,), a, np.array([b]), 0.5)
    np.testing.assert_allclose(grey.run(np.ones((25, 1))), np.diff(total), rtol=1e-12)


def test_grey_model_finds_the_coefficients_that_made_the_data() -> None:
    truth = Grey((0, 1), 0.3, np.array([1.5, -0.4]), 0.5)
    found = fit_grey(courses_of(truth, (1, 2, 3)), 0, (0, 1), 0.5)
    assert found.a == pytest.approx(0.3, rel=1e-8)
    np.testing.assert_allclose(found.b, truth.b, rtol=1e-8)


def test_grid_is_even_and_holds_at_most_sixty_steps() -> None:
    t_h = np.concatenate([np.linspace(0, 12, 500), np.linspace(0, 6, 250)])
    rows = Rows(t_h[:, None] * 2.0, np.repeat([0, 1], [500, 250]), t_h)
    step = step_h(rows)
    assert step == pytest.approx(0.2)
    course = on_grid(rows, t_h[:, None] * 3.0, 0, step)
    assert len(course.t_h) == 61
    np.testing.assert_allclose(course.y[:, 0], 3.0 * course.t_h)


def test_steps_forward_and_backward_find_the_two_columns_that_matter() -> None:
    x = orthonormal(60, 5)
    y = x[:, 1] * 3.0 - x[:, 4]
    gram, mixed, power = x.T @ x, x.T @ y, float(y @ y)
    for forward in (True, False):
        path = step_path(gram, mixed, power, forward, 3)
        assert sorted(path[2]) == [1, 4]
        assert path[1] == [1]
        assert sorted(path) == [1, 2, 3]


def test_analyze_compare_writes_the_table_and_keeps_the_families_out_of_the_model(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = tuple(small(BY_NAME[name]) for name in ("lasso", "ARX, open loop", "Gaussian process"))
    monkeypatch.setattr(families, "FAMILIES", few)
    analysis = analyze_folder(slow_column(1, 2, 3), compare=True)
    write_files(tmp_path, table_files(analysis))
    with (tmp_path / "comparison.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    column = [row for row in rows if row["component"] == "EYY"]
    assert [row["family"] for row in column] == ["default", "key_points", "clock", *(f.name for f in few)]
    assert [row["use"] for row in column[3:]] == [COMPARISON_ONLY] * 3
    (default,) = (r for r in analysis.validation if (r.model, r.campaign, r.split) == ("default", "all", "campaign"))
    assert float(column[0]["rms_after_um"]) == pytest.approx(default.rms_after_um, rel=1e-5)
    assert {row["n"] for row in column} == {str(default.n)}  # all are judged on the same points
    stored = (tmp_path / "model.json").read_text(encoding="utf-8")
    assert not any(family.name in stored for family in few)
    write_files(tmp_path, report_files(analysis))
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Families of models, for comparison only" in page
    assert "Gaussian process: at most 60 rows of a campaign train" in page


def test_help_names_the_option() -> None:
    assert "--compare" in CliRunner().invoke(app, ["analyze", "--help"]).output

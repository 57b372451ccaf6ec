"""The joint form through the whole analysis: validation judges axis and drift together, files say the form."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from rigid_machine import MACHINE, draw_rigid, measure

from thetacomp.analysis import analyze_folder
from thetacomp.analysis_result import AnalysisResult
from thetacomp.axis_states import AxisStates, axis_states
from thetacomp.campaign import MachineFolder
from thetacomp.files import write_files
from thetacomp.fitting.key_point_law import AxisModel, fit_axis
from thetacomp.report.analysis_files import table_files
from thetacomp.report.figures_fit import fit_over_temperature
from thetacomp.separation import separate_all
from thetacomp.validation.joint_view import with_drift


def folder(*, at: bool = True) -> MachineFolder:
    rng = np.random.default_rng(21)
    rigid = draw_rigid(rng)
    taus = {"a": (4000.0, 16000.0), "b": (9000.0, 11000.0)}
    campaigns = [measure(replace(rigid, tau_s=tau), rng, name, angle_sd_urad=1.0, at=at) for name, tau in taus.items()]
    return MachineFolder(MACHINE, tuple(campaigns))


@pytest.fixture(scope="module")
def joint() -> AnalysisResult:
    return analyze_folder(folder())


def test_the_model_is_joint_and_its_notes_say_what_was_assumed(joint: AnalysisResult, tmp_path: Path) -> None:
    assert joint.model.form == "joint"
    assert set(joint.model.control[""].components) == {"DX", "DY", "DZ"}
    for axis in "XYW":
        for part in joint.model.control[axis].components.values():
            assert not any(part.terms[0].coefficients)
            assert part.band.sd[0] == 0.0
            assert part.equation.endswith(f"/1000   [µm; {axis} in mm, temperatures in °C]")
    assert any("X, Y, W, as the order from the workpiece to the tool" in note for note in joint.notes)
    assert any("naive sum" in note for note in joint.notes)
    assert "[µrad; X in mm" in joint.model.rotations["X"].components["EAX"].equation
    write_files(tmp_path, table_files(joint))
    rows = list(csv.DictReader((tmp_path / "angles.csv").read_text(encoding="utf-8").splitlines()))
    assert {row["component"] for row in rows} >= {"EAX", "ECW", "DA"}
    assert "slope_urad_per_m" in rows[0]


def test_held_out_rows_hold_the_whole_error_of_the_point(joint: AnalysisResult) -> None:
    """The same points as in the separate form: the errors before differ only by the shares of the other axes."""
    rows = [r for r in joint.validation if r.component == "EXY" and r.split == "campaign" and r.campaign == "a"]
    nothing = next(r for r in rows if r.model == "nothing")
    default = next(r for r in rows if r.model == "default")
    drift = next(s for s in joint.separations if s.campaign == "a" and s.component == "DX")
    # The line alone would leave the drift out of "before".
    assert nothing.max_before_um > 0.9 * np.abs(drift.intercept_um).max()
    assert default.rms_after_um < 0.2 * nothing.rms_before_um
    assert default.coverage_percent > 85.0
    assert {r.component for r in joint.validation} >= {"column_X", "column_Z"}


def test_the_fit_of_an_axis_is_drawn_without_an_empty_intercept(joint: AnalysisResult) -> None:
    figures = {figure.name: figure for figure in fit_over_temperature(joint)}
    assert figures["fit_X"].title == "Slope against temperature, axis X" or "prediction" in figures["fit_X"].title
    assert [axes.get_title(loc="left").split(" ·")[0] for axes in figures["fit_X"].figure.axes[:3]] == [
        f"E{d}X slope" for d in "XYZ"
    ]
    assert figures["fit_drift"].title.startswith("Drift against")
    plt.close("all")


def test_the_drift_is_fitted_without_the_held_out_states() -> None:
    whole = folder()
    separated = separate_all(MACHINE, whole.campaigns)
    everything = axis_states(whole, separated.components, ["a", "b"])
    seen: list[tuple[str, np.ndarray, np.ndarray]] = []

    def procedure(states: AxisStates) -> AxisModel:
        seen.append((states.axis, states.campaign, states.t_s))
        return fit_axis(states, ("t1", "t2"))

    x = everything[0]
    view, procedures = with_drift(x, everything, {"p": procedure})
    for own, total in zip(x.samples, view.samples, strict=True):
        np.testing.assert_allclose(total.value_um, own.value_um + own.drift_um)
    model = procedures["p"](view.take(np.flatnonzero(view.campaign == 0)))
    assert [axis for axis, _, _ in seen] == ["X", ""]
    assert set(seen[1][1]) == {0}
    # One held-out state takes the drift of its own round with it, of all three axes.
    late = int(np.flatnonzero(view.campaign == 0)[4])
    procedures["p"](view.take(np.delete(np.arange(len(view.t_s)), late)))
    gone = set(everything[-1].t_s[everything[-1].campaign == 0]) - set(seen[3][2][seen[3][1] == 0])
    assert view.t_s[late] in gone
    assert len(gone) == 3
    value, half = model.predict("EXX", view, view.samples[0])
    alone, _ = fit_axis(x.take(np.flatnonzero(x.campaign == 0)), ("t1", "t2")).predict("EXX", x, x.samples[0])
    assert np.abs(value - alone).max() > 10.0
    assert (half > 0).all()


def test_an_axis_is_fitted_on_what_it_adds_itself() -> None:
    """A band is calibrated on the samples that a procedure gets: with the drift in them it would hold the drift."""
    whole = folder()
    everything = axis_states(whole, separate_all(MACHINE, whole.campaigns).components, ["a", "b"])
    seen: list[AxisStates] = []

    def procedure(states: AxisStates) -> AxisModel:
        seen.append(states)
        return fit_axis(states, ("t1",))

    x = everything[0]
    view, procedures = with_drift(x, everything, {"p": procedure})
    rows = np.arange(2, len(x))
    unread = view.take(rows).rise_K.copy()
    unread[:, 1] = np.nan  # as for a sensor that the tested campaign does not have
    procedures["p"](replace(view.take(rows), rise_K=unread))
    for own, trained in zip(x.take(rows).samples, seen[0].samples, strict=True):
        np.testing.assert_array_equal(trained.value_um, own.value_um)
        np.testing.assert_array_equal(trained.state, own.state)
    np.testing.assert_array_equal(seen[0].rise_K, unread)


def test_drift_of_a_campaign_that_lacks_the_axis_trains_always() -> None:
    """Campaign b measured no X: nothing of X is held out there, so all of its drift may train, and of a its own."""
    whole = folder()
    separated = [s for s in separate_all(MACHINE, whole.campaigns).components if s.campaign == "a" or s.axis != "X"]
    everything = axis_states(whole, separated, ["b", "a"])
    seen: list[AxisStates] = []

    def procedure(states: AxisStates) -> AxisModel:
        seen.append(states)
        return fit_axis(states, ("t1",))

    x, drift = everything[0], everything[-1]
    assert (x.campaigns, drift.campaigns) == (("a",), ("b", "a"))
    view, procedures = with_drift(x, everything, {"p": procedure})
    kept = np.arange(len(x.t_s) - 2)
    procedures["p"](view.take(kept))
    trained = seen[1]
    names = np.array(drift.campaigns)[trained.campaign]
    assert np.count_nonzero(names == "b") == np.count_nonzero(drift.campaign == 0)
    # Of campaign a: those whose nearest state of X is one that was kept.
    own_s = drift.t_s[drift.campaign == 1]
    nearest = np.abs(own_s[:, None] - x.t_s[None, :]).argmin(axis=1)
    assert trained.t_s[names == "a"].tolist() == own_s[np.isin(nearest, kept)].tolist()


def test_the_separate_form_is_untouched() -> None:
    whole = folder(at=False)
    separated = separate_all(MACHINE, whole.campaigns)
    everything = axis_states(whole, separated.components, ["a", "b"])
    view, procedures = with_drift(everything[0], everything, {"p": fit_axis})  # type: ignore[dict-item]
    assert view is everything[0]
    assert procedures == {"p": fit_axis}

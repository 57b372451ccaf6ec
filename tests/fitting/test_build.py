"""The stored document of laws on key temperatures against least squares, and what it says of its training."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from thetacomp.arrays import Floats
from thetacomp.axis_states import AxisStates, axis_states
from thetacomp.campaign import Campaign, CampaignSettings, Drift, MachineFolder, Parameters
from thetacomp.fitting.build import build_document, key_point_law, training_ranges
from thetacomp.fitting.fallbacks import axis_fallbacks
from thetacomp.fitting.key_point_law import AxisModel, fit_axis
from thetacomp.folds import hold_out
from thetacomp.machine import Axis, Machine, Sensor
from thetacomp.model.check import problems
from thetacomp.model.document import ModelDocument
from thetacomp.model.temperatures import Temperatures
from thetacomp.separation import separate_folder

MACHINE = Machine(
    name="two axes",
    axes=tuple(Axis(name=name, direction=f"+{name}", travel_mm=(0.0, 2000.0)) for name in "XY"),
    sensors=tuple(Sensor(id=name, role="drive") for name in ("a", "b")),
)
RISE_K = np.array([0.0, 2.0, 5.0, 6.0, 3.0, 1.0])


def campaign(
    name: str, start_degC: float, *, axes: str = "XY", factor: float = 1.0, drift: bool = False, **settings: str
) -> Campaign:
    """Six states of E.X and E.Y of each axis, known but for noise; `a` and `b` differ in shape."""
    rng = np.random.default_rng(int(10 * start_degC))
    t_s, n = 1000.0 + 3600.0 * np.arange(6), 6
    rises = factor * np.column_stack([RISE_K, np.sqrt(RISE_K)])
    names = [f"E{direction}{axis}" for axis in axes for direction in "XY"]
    at_zero = np.arange(n) > 0
    error_um = np.column_stack([rises @ [3.0, 7.0], rises @ [-2.0, 1.0]])
    return Campaign(
        name,
        CampaignSettings.model_validate(settings),
        Temperatures(t_s, ("a", "b"), start_degC + rises),
        parameters=Parameters(
            t_s=np.tile(t_s, len(names)),
            component=tuple(np.repeat(names, n)),
            intercept_um=np.concatenate([error_um[:, 0] + at_zero * rng.normal(0, 2.0, n) for _ in names]),
            slope_um_per_m=np.concatenate([error_um[:, 1] + at_zero * rng.normal(0, 1.0, n) for _ in names]),
            p0_mm=np.full(n * len(names), 500.0),
            p_min_mm=np.full(n * len(names), 100.0),
            p_max_mm=np.full(n * len(names), 1900.0),
        ),
        drift=Drift(t_s, np.column_stack([error_um[:, 0] + rng.normal(0, 2.0, n), np.full((n, 2), np.nan)]))
        if drift
        else None,
    )


def trained(
    *campaigns: Campaign, inputs: tuple[str, ...] = ("a", "b")
) -> tuple[MachineFolder, list[tuple[AxisStates, AxisModel]]]:
    folder = MachineFolder(MACHINE, campaigns)
    names = [one.name for one in campaigns]
    return folder, [(s, fit_axis(s, inputs)) for s in axis_states(folder, separate_folder(folder), names)]


def stored(*campaigns: Campaign) -> ModelDocument:
    folder, fitted = trained(*campaigns)
    return build_document(folder, fitted, "test", [one.name for one in campaigns])


def test_a_document_says_what_it_was_trained_on() -> None:
    first = campaign("p", 20.0, mode="wet", instrument="laser")
    others = [
        campaign("q", 21.0, mode="", instrument="tracker"),
        campaign("r", 22.0, mode="dry", instrument="laser"),
        campaign("s", 23.0, mode="wet", instrument=""),
    ]
    model = stored(first, *others)
    assert (model.training.mode, model.training.instrument) == ("wet; dry", "laser; tracker")
    assert model.training.campaigns == ("p", "q", "r", "s")
    assert (model.sign, model.training.datum, model.machine) == ("stated", "campaign", "two axes")
    folder, fitted = trained(first, *others)
    some = build_document(folder, fitted, "test", ["q", "r"], notes=["one", "two"])
    assert (some.training.campaigns, some.training.mode, some.notes) == (("q", "r"), "dry", ("one", "two"))


@pytest.mark.parametrize("datum", ["campaign", "common"])
def test_one_campaign_suffices_and_its_datum_is_that_of_the_model(datum: str) -> None:
    model = stored(campaign("p", 20.0, datum=datum))
    assert model.training.datum == datum
    assert all(law.border.rise_counts is (datum == "campaign") for law in model.control.values())


@pytest.mark.parametrize("place", [0, 1, 2])
def test_one_campaign_of_unproven_sign_makes_the_sign_unproven(place: int) -> None:
    campaigns = [campaign(f"c{k}", 20.0 + k, sign="unproven" if k == place else "stated") for k in range(3)]
    assert stored(*campaigns).sign == "unproven"


def test_one_box_of_temperatures_serves_all_axes() -> None:
    """X was measured from 20 °C up to 6 K, Y in another campaign from 23 °C up to 9 K: both laws know 20 to 32 °C."""
    model = stored(campaign("p", 20.0, axes="X"), campaign("q", 23.0, axes="Y", factor=1.5))
    for law in model.control.values():
        assert law.border.temperature_degC["a"] == pytest.approx((20.0, 32.0))
        assert law.border.rise_K["a"] == pytest.approx((0.0, 9.0))
        assert law.border.rise_K["b"] == pytest.approx((0.0, 1.5 * np.sqrt(6.0)))
    assert {axis: law.reference.campaign for axis, law in model.control.items()} == {"X": "p", "Y": "q"}
    assert model.control["Y"].reference.inputs == pytest.approx((23.0, 23.0))


def test_a_missing_temperature_does_not_spoil_the_box_and_unused_sensors_are_not_in_it() -> None:
    _, fitted = trained(campaign("p", 20.0), inputs=("a",))
    states, model = fitted[0]
    gap = states.rise_K.copy()
    gap[2, 0] = np.nan
    ranges = training_ranges([(replace(states, rise_K=gap), model)])
    assert ranges.temperature_degC == {"a": pytest.approx((20.0, 26.0))}
    assert ranges.rise_K == {"a": pytest.approx((0.0, 6.0))}


def test_the_box_holds_what_the_states_of_the_fallbacks_have_seen() -> None:
    """The law stands on `a`; its fallback on `b`, whose range must come from its own states."""

    def procedure(states: AxisStates) -> AxisModel:
        return fit_axis(states, states.sensors[:1])

    campaigns = [campaign(f"c{k}", 20.0 + k, axes="X") for k in range(3)]
    folder, fitted = trained(*campaigns, inputs=("a",))
    (states, model), *_ = fitted
    ready = axis_fallbacks(states, model, procedure, [(fold.train, fold.test) for fold in hold_out(states)[1]])
    document = build_document(folder, fitted, "test", ["c0", "c1", "c2"], fallbacks=ready)
    (fallback,) = document.control["X"].fallbacks
    assert (fallback.lost, fallback.layout.sensors) == ("a", ("b",))
    assert fallback.border is not None
    assert fallback.border.temperature_degC == {"b": pytest.approx((20.0, 22.0 + np.sqrt(6.0)))}
    assert problems(document) == []


def least_squares(states: AxisStates, k: int, rows: Floats) -> tuple[Floats, Floats, int]:
    """Coefficients (3, 2), covariance of the residuals (2, 2) and degrees of freedom of intercept and slope."""
    design = np.column_stack([np.ones(len(rows)), states.rise_K[rows]])
    target = np.column_stack([states.intercept_um[rows, k], states.slope_um_per_m[rows, k]])
    beta = np.linalg.lstsq(design, target, rcond=None)[0]
    residual, dof = target - design @ beta, len(rows) - 3
    return beta, residual.T @ residual / dof, dof


def test_a_stored_component_is_the_regression_of_its_states() -> None:
    campaigns = [campaign("p", 20.0), campaign("q", 21.0)]
    _, fitted = trained(*campaigns)
    model = stored(*campaigns)
    for states, _ in fitted:
        law = model.control[states.axis]
        assert (law.p0_mm, law.p_min_mm, law.p_max_mm) == (500.0, 100.0, 1900.0)
        assert (law.reference.campaign, law.reference.t_s) == ("p", 1000.0)
        for k, name in enumerate(states.components):
            one = law.components[name]
            beta, covariance, dof = least_squares(states, k, np.arange(12))
            assert [term.constant for term in one.terms] == pytest.approx(beta[0].tolist())
            assert np.array([term.coefficients for term in one.terms]) == pytest.approx(beta[1:].T)
            assert one.band.sd == pytest.approx(np.sqrt(np.diag(covariance)).tolist())
            assert one.band.correlation == pytest.approx(covariance[0, 1] / np.prod(one.band.sd))
            assert one.band.quantile == pytest.approx(stats.t.ppf(0.975, dof), rel=1e-4)
            assert (one.dof, one.states, one.through_zero, one.leverage) == (dof, 12, False, None)
            assert (one.direction, one.held_out_um) == (name[1], None)
            samples = states.samples[k]
            design = np.column_stack([np.ones(len(samples.value_um)), samples.rise_K])
            left = samples.value_um - np.sum(design @ beta * np.column_stack([design[:, 0], samples.lever_m]), axis=1)
            assert one.residual_um == pytest.approx((np.sqrt(np.mean(left**2)), np.abs(left).max()))
            spread = np.sum((states.intercept_um[:, k] - states.intercept_um[:, k].mean()) ** 2)
            assert one.terms[0].r_squared == pytest.approx(1.0 - covariance[0, 0] * dof / spread)


def test_the_reference_is_that_of_the_first_state_even_where_its_campaign_has_one() -> None:
    _, ((states, _),) = trained(campaign("p", 20.0, axes="X"), campaign("q", 21.0, axes="X"))
    rest = states.take(np.concatenate([[3], np.flatnonzero(states.campaign == 1)]))
    later = replace(rest, reference_s=rest.reference_s + 7.0 * rest.campaign)
    law = key_point_law(later, fit_axis(later, ("a",)), training_ranges([(later, fit_axis(later, ("a",)))]), "campaign")
    assert (law.reference.campaign, law.reference.t_s, law.reference.inputs) == ("p", 1000.0, pytest.approx((20.0,)))


def test_components_share_a_leverage_unless_a_value_is_missing_in_one() -> None:
    """The leverage of least squares, x (X'X)^-1 x', of the states that a component has."""
    one = campaign("p", 20.0, axes="X")
    assert one.parameters is not None
    lacking = one.parameters.slope_um_per_m.copy()
    lacking[7] = np.nan  # a state of EYX
    short = replace(one, parameters=replace(one.parameters, slope_um_per_m=lacking))
    _, ((states, _),) = trained(short, campaign("q", 21.0, axes="X"))
    law = stored(short, campaign("q", 21.0, axes="X")).control["X"]
    assert law.components["EXX"].leverage is None
    own = law.components["EYX"].leverage
    assert own is not None
    at = np.array([[1.0, 4.0], [0.0, 0.0]])
    design = np.column_stack([np.ones(12), states.rise_K])
    known = np.isfinite(states.slope_um_per_m[:, 1])
    assert known.sum() == 11
    for leverage, rows in ((law.leverage, np.ones(12, bool)), (own, known)):
        x = np.column_stack([np.ones(2), at])
        expected = np.einsum("ij,jk,ik->i", x, np.linalg.inv(design[rows].T @ design[rows]), x)
        assert leverage.at(at) == pytest.approx(expected)
    assert (law.components["EXX"].dof, law.components["EYX"].dof) == (9, 8)


def test_a_drift_has_no_positions_and_a_correlation_of_nothing() -> None:
    model = stored(campaign("p", 20.0, drift=True), campaign("q", 21.0, drift=True))
    law = model.control[""]
    assert (law.p0_mm, law.p_min_mm, law.p_max_mm) == (None, None, None)
    assert list(law.components) == ["DX"]
    assert (len(law.components["DX"].terms), law.components["DX"].band.correlation) == (1, 0.0)
    assert law.components["DX"].equation.startswith("DX = ")
    assert problems(model) == []

"""The law of one error: values, 95 % interval, domain, and the t quantile without scipy."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from scipy import stats
from small_models import Part, component, document, nothing_predicts, term

from thetacomp.arrays import Bools, Floats
from thetacomp.model.check import problems
from thetacomp.model.document import ModelDocument, Term
from thetacomp.model.law import ComponentLaw, Law, box_degC, component_laws, inputs_of, joined
from thetacomp.model.load import load_model
from thetacomp.model.student import t_quantile

DATA = Path(__file__).parent / "data"


def one_error(datum: Literal["campaign", "common"] = "campaign", **overrides: object) -> ModelDocument:
    reference = {"a": 20.0, "b": 22.0}
    exy = component("EXY", term(3.0, 10.0, -2.0), term(1.0, 4.0, 0.5), reference, p=(500.0, 0.0, 2000.0))
    return document(
        {"X": "+X", "Y": "+Y"},
        {"EXY": exy | overrides},
        {"a": (0.0, 10.0), "b": (-1.0, 4.0)},
        datum=datum,
    )


def law_of(model: ModelDocument, reference_degC: dict[str, float] | None = None) -> ComponentLaw:
    return component_laws(model.control, reference_degC)["EXY"]


def in_domain(law: ComponentLaw, temperature_degC: Floats, position_mm: Floats) -> Bools:
    values = law.law.at(temperature_degC - law.law.zero, temperature_degC)
    return np.all([limit.inside for limit in values.limits(position_mm)], axis=0)


@pytest.mark.parametrize("dof", [*range(1, 31), 50, 100, 1000, 10**6])
@pytest.mark.parametrize("probability", [0.95, 0.975, 0.995, 0.9999, 1.0 - 1e-7])
def test_t_quantile_against_scipy(dof: int, probability: float) -> None:
    assert t_quantile(probability, dof) == pytest.approx(stats.t.ppf(probability, dof), rel=1e-4)


def test_t_quantile_without_degrees_of_freedom_is_infinite() -> None:
    assert math.isinf(t_quantile(0.975, 0))


@pytest.mark.parametrize("probability", [0.5, 0.2, 1.0, 2.5])
def test_t_quantile_of_what_is_no_upper_share_is_refused(probability: float) -> None:
    with pytest.raises(ValueError, match=f"between 0.5 and 1, not at {probability}"):
        t_quantile(probability, 5)


def test_line_and_error_by_hand() -> None:
    model = one_error()
    theta = np.array([[20.0, 22.0], [23.0, 21.0]])
    law = law_of(model)
    intercept_um, slope_um_per_m = law.terms(law.rises_K(theta))
    # Rises (0, 0) and (3, -1): I = 3 + 10*3 + 2 = 35, S = 1 + 12 - 0.5 = 12.5; at p = 1500, (p - P0) = 1 m.
    assert intercept_um == pytest.approx([3.0, 35.0])
    assert slope_um_per_m == pytest.approx([1.0, 12.5])
    assert law.error_um(law.rises_K(theta), np.array([1500.0, 1500.0])) == pytest.approx([4.0, 47.5])


def test_another_reference_drops_the_constant() -> None:
    law = law_of(one_error(), {"a": 23.0, "b": 21.0})
    theta = np.array([[23.0, 21.0], [24.0, 21.0]])
    # Exactly zero at the reference; one kelvin of `a` is 10 µm and 4 µm/m.
    assert law.error_um(law.rises_K(theta), np.array([1500.0, 1500.0])).tolist() == [0.0, 14.0]


def least_squares(states: int, seed: int) -> tuple[Part, Part, float, np.ndarray, np.ndarray]:
    """Two terms fitted by least squares on the same states, as the analysis stores them, and the truth's errors."""
    rng = np.random.default_rng(seed)
    rises_K = rng.uniform(0, 10, states)
    noise = rng.multivariate_normal([0, 0], [[9.0, 2.4], [2.4, 1.0]], size=states)
    y = np.column_stack([2 + 5 * rises_K, 1 + 3 * rises_K]) + noise
    x = np.column_stack([np.ones(states), rises_K])
    inverse = np.linalg.inv(x.T @ x)
    beta = inverse @ x.T @ y
    residual = y - x @ beta
    variance = residual.T @ residual / (states - 2)
    made = [
        {
            "constant": beta[0, k],
            "coefficients_per_K": (beta[1, k],),
            "covariance": (inverse * variance[k, k]).tolist(),
            "residual_sd": math.sqrt(variance[k, k]),
            "r_squared": 1.0,
        }
        for k in (0, 1)
    ]
    rho = variance[0, 1] / math.sqrt(variance[0, 0] * variance[1, 1])
    return made[0], made[1], rho, rng.uniform(0, 10, 2), rng.multivariate_normal([0, 0], [[9.0, 2.4], [2.4, 1.0]], 2)


@pytest.mark.parametrize("kept", [True, False])
def test_interval_covers_95_percent_of_new_states(kept: bool) -> None:
    """New states from the known law and noise, at 1.7 m from P0; 2000 random fits of 8 states.

    With the constant the new state is compared; without it, the difference of two new states (this one and the
    reference). 95 % of 2000 has a standard error of 0.5 %.
    """
    inside = 0
    for seed in range(2000):
        intercept, slope, rho, rises_K, noise = least_squares(8, seed)
        one = component("EXX", intercept, slope, {"a": 0.0}, p=(0.0, 0.0, 2000.0), correlation=rho, dof=6)
        axis = document({"X": "+X"}, {"EXX": one}, {"a": (0.0, 10.0)}).control["X"]
        law = ComponentLaw("EXX", Law(axis, np.array([0.0 if kept else rises_K[1]]), keeps_constant=kept))
        theta, p = np.array([[rises_K[0]]]), np.array([1700.0])
        truth = (np.array([2.0, 1.0]) + np.outer(rises_K, [5.0, 3.0]) + noise) @ np.array([1.0, 1.7])
        wanted = truth[0] if kept else truth[0] - truth[1]
        half_um = law.half_width_um(law.rises_K(theta), p)[0]
        inside += abs(law.error_um(law.rises_K(theta), p)[0] - wanted) <= half_um
    assert inside / 2000 == pytest.approx(0.95, abs=0.015)


def test_interval_without_degrees_of_freedom_is_infinite() -> None:
    law = law_of(one_error(dof=0, intercept=term(0.0, 1.0, 1.0, sd=1.0)))
    assert np.isinf(law.half_width_um(np.zeros((1, 2)), np.array([0.0]))).all()


@pytest.mark.parametrize(
    ("a", "b", "p", "inside"),
    [
        (25.0, 22.0, 1000.0, True),
        (30.49, 22.0, 1000.0, True),  # 5 % of a span of 10 K is 0.5 K
        (30.51, 22.0, 1000.0, False),
        (19.49, 22.0, 1000.0, False),
        (25.0, 26.26, 1000.0, False),
        (25.0, 22.0, -1.0, True),
        (25.0, 22.0, -1.01, False),
        (25.0, 22.0, 2001.01, False),
        (float("nan"), 22.0, 1000.0, False),
    ],
)
def test_domain(a: float, b: float, p: float, inside: bool) -> None:
    theta = np.array([[a, b]])
    assert in_domain(law_of(one_error()), theta, np.array([p])).tolist() == [inside]


def test_rise_counts_for_the_domain_only_where_the_datum_is_the_campaign() -> None:
    theta, p = np.array([[24.0, 22.0]]), np.array([0.0])
    warm_start = {"a": 26.0, "b": 22.0}  # 24 °C is in range, a rise of -2 K is not
    assert not in_domain(law_of(one_error(), warm_start), theta, p)[0]
    assert in_domain(law_of(one_error("common"), warm_start), theta, p)[0]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_largest_value_is_at_a_corner_of_the_training_box(sign: float) -> None:
    model = one_error(slope=term(sign * 1.0, sign * 4.0, sign * -0.5, sd=2.0), dof=4)
    law = law_of(model)
    box = box_degC({"EXY": law})
    assert box == {"a": (20.0, 30.0), "b": (21.0, 26.0)}
    # a = +10 K, b = -1 K: 1 + 40 + 0.5, and 2 times the quantile of t for 4 degrees of freedom.
    assert law.largest(1, box) == pytest.approx(41.5 + 2 * stats.t.ppf(0.975, 4), rel=1e-4)


def test_largest_value_without_a_band_and_without_a_sensor() -> None:
    """Intercept 3 + 10 a - 2 b at +10 and -1 K; where no sensor predicts, the constant and its bound."""
    law = law_of(one_error(dof=0))
    assert law.largest(0, box_degC({"EXY": law})) == pytest.approx(105.0)
    alone = document({"Y": "+Y"}, {"EXY": nothing_predicts("EXY", -7.0)}, {})
    still = law_of(alone)
    assert still.largest(0, {}) == pytest.approx(7.0 + 2.0 * stats.t.ppf(0.975, 8), rel=1e-4)


def test_the_box_holds_what_every_law_has_seen_of_a_sensor() -> None:
    """Seen from references of 20 and 24 °C, a rise of 0 to 10 K is 20 to 30 and 24 to 34 °C."""
    laws = {"one": law_of(one_error(), {"a": 20.0, "b": 22.0}), "two": law_of(one_error(), {"a": 24.0, "b": 21.0})}
    assert box_degC(laws) == {"a": (20.0, 34.0), "b": (20.0, 26.0)}
    assert inputs_of(laws) == ("a", "b")


def test_travel_is_that_of_the_measurement_and_a_drift_has_none() -> None:
    assert law_of(one_error()).travel_mm == (500.0, 0.0, 2000.0)
    drift = document({}, {"DX": component("DX", term(0.0, 1.0), None, {"a": 20.0})}, {"a": (0.0, 10.0)})
    with pytest.raises(ValueError, match="DX is drift at a fixed position: it has no travel"):
        _ = component_laws(drift.control)["DX"].travel_mm


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ({"intercept": term(0.0, 1.0)}, "intercept has 1 coefficients for 2 inputs"),
        ({"inputs": ("a", "c")}, "no reference temperature for c"),
        ({"p0_mm": None}, "an axis without a slope, P0"),
        ({"axis": "V"}, "the axis V is not among"),
    ],
)
def test_document_that_contradicts_itself_is_refused(overrides: dict[str, object], words: str) -> None:
    try:
        found = problems(one_error(**overrides))
    except ValueError as exc:
        found = [str(exc)]
    assert words in " ".join(found)


def test_a_fit_through_zero_has_one_residual_not_two() -> None:
    """Closed form: no constant, no covariance, residual standard deviation 2 µm: half width t(0.975, 8) * 2 µm."""
    free = component("DX", term(0.0, 3.0, sd=2.0), None, {"t1": 20.0})
    zero = free | {"through_zero": True}
    rises, position = np.array([[4.0]]), np.zeros(1)
    for c, states in ((free, 2.0), (zero, 1.0)):
        axis = document({}, {"DX": c}, {"t1": (0.0, 10.0)}).control[""]
        law = ComponentLaw("DX", Law(axis, np.array([20.0]), keeps_constant=False))
        expected = stats.t.ppf(0.975, 8) * 2.0 * np.sqrt(states)
        assert law.half_width_um(rises, position) == pytest.approx([expected], rel=1e-4)


def test_slope_at_a_position_is_the_derivative() -> None:
    """E = 3 + 5 u + 7 u² at a rise of zero: 5 + 14 u; a drift has no slope."""
    axis = one_error().control["Y"]
    terms = tuple(Term(constant=value, coefficients=(0.0, 0.0)) for value in (3.0, 5.0, 7.0))
    for count, expected in ((3, [5.0 - 7.0, 5.0, 5.0 + 28.0]), (2, [5.0, 5.0, 5.0]), (1, [0.0, 0.0, 0.0])):
        exy = axis.components["EXY"].model_copy(update={"terms": terms[:count]})
        law = Law.of_model(axis.model_copy(update={"components": {"EXY": exy}}))
        values = law.at(np.zeros((3, 2)), np.zeros((3, 2)))
        u_m = np.array([-0.5, 0.0, 2.0])
        np.testing.assert_allclose(values.slope_um_per_m("EXY", u_m), expected)
        powers = (3.0, 5.0, 7.0)[:count]
        np.testing.assert_allclose(values.error_um("EXY", u_m), sum(c * u_m**k for k, c in enumerate(powers)))
        np.testing.assert_allclose([values.term(k)[0, 0] for k in range(3)], [*powers, *[0.0] * (3 - count)])


def test_a_law_with_a_distance_is_inside_up_to_one_and_its_box_is_not_asked() -> None:
    """Distances of 1, just beyond it, and unknown; as `distance` of its axis, or of the drift."""
    history = load_model(DATA / "heat_history.json").prediction["Y"]
    values = Law.of_model(history).at(np.zeros((3, len(history.reference.inputs))), np.full((3, 2), 20.0))
    values = replace(values, distance=np.array([1.0, 1.001, np.inf]))
    distance, travel = values.limits(np.array([0.0, 2000.0, 2002.0]))
    assert (distance.kind, distance.name, distance.trained) == ("distance", "Y", (0.0, 1.0))
    np.testing.assert_array_equal(distance.value, [1.0, 1.001, np.nan])
    assert distance.inside.tolist() == [True, False, False]
    assert (travel.kind, travel.inside.tolist()) == ("position", [True, True, False])
    drift = Law.of_model(history.model_copy(update={"axis": "", "p0_mm": None, "p_min_mm": None, "p_max_mm": None}))
    (alone,) = replace(values, law=drift).limits(np.zeros(3))
    assert (alone.kind, alone.name) == ("distance", "drift")


def test_a_law_seen_in_parts_is_the_law_seen_whole() -> None:
    """More moments than are worked on at once: 2500, of a law with and one without a distance from training."""
    for kind, room in (("heat_history", "prediction"), ("key_points", "control")):
        axis = getattr(load_model(DATA / f"{kind}.json"), room)["Y"]
        law, n = Law.of_model(axis), 2500
        rng = np.random.default_rng(3)
        moved = rng.normal(0.0, 3.0, (n, len(axis.reference.inputs)))
        degC = rng.normal(22.0, 3.0, (n, len(axis.layout.sensors)))
        moved[1700, 0] = np.nan
        whole = law.at(moved, degC)
        parts = joined([law.at(moved[start : start + 1024], degC[start : start + 1024]) for start in (0, 1024, 2048)])
        for name in ("temperature_degC", "rise_K", "missing"):
            np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))
        if whole.distance is not None:
            np.testing.assert_allclose(parts.distance, whole.distance)  # type: ignore[arg-type]
        np.testing.assert_allclose(parts.terms["EYY"], whole.terms["EYY"], atol=1e-9)
        np.testing.assert_allclose(parts.leverage["EYY"], whole.leverage["EYY"])
        assert np.flatnonzero(parts.missing).tolist() == [1700]
        assert (parts.distance is None) is (kind == "key_points")

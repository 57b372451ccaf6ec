"""The error along one axis of the volume against the volume itself, and rows in which one law lacks a reading."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import component, document, term

from thetacomp.errors import AnalysisError
from thetacomp.machine import Axis
from thetacomp.model.axis_chain import chain_of, turned_um
from thetacomp.model.document import ModelDocument
from thetacomp.model.prediction import Reference, law_values, predict
from thetacomp.model.temperatures import Temperatures
from thetacomp.model.volume import Part, ThermalParts, volume_error, volume_slope
from thetacomp.model.volumetric import predict_volume, volume_along

CHAIN = chain_of(
    (
        Axis(name="X", direction="-X", travel_mm=(0.0, 2000.0)),
        Axis(name="Y", direction="+Y", travel_mm=(0.0, 1600.0)),
        Axis(name="W", direction="+Z", travel_mm=(0.0, 800.0)),
    )
)
NAMES = tuple(axis.name for axis in CHAIN)
STEP_MM = 50.0


def random_parts(rng: np.random.Generator, n: int, bent: tuple[str, ...], twisted: tuple[str, ...]) -> ThermalParts:
    """Errors, slopes and angles of n moments, with bends on some axes and twists on some."""

    def part() -> Part:
        return Part(rng.normal(0.0, 50.0, (n, 3)), np.ones((n, 3)))

    return ThermalParts(
        drift=part(),
        slopes={name: part() for name in NAMES},
        angle=part(),
        angle_slopes={name: part() for name in twisted},
        bends_um_per_m2={name: rng.normal(0.0, 50.0, (n, 3)) for name in bent},
    )


@pytest.mark.parametrize("moving", NAMES)
@pytest.mark.parametrize(("bent", "twisted"), [((), ()), (NAMES, NAMES), (("Y",), ("X", "W")), (("X", "W"), ("Y",))])
def test_slope_along_an_axis_is_the_derivative_of_the_error(
    moving: str, bent: tuple[str, ...], twisted: tuple[str, ...]
) -> None:
    """The error is at most of second order in a position, so the central difference is exact."""
    rng, n = np.random.default_rng(5), 4
    parts = random_parts(rng, n, bent, twisted)
    places = {name: rng.uniform(0.0, 1500.0, n) for name in NAMES}
    ends = [
        volume_error(CHAIN, parts, places | {moving: places[moving] + side * STEP_MM}, np.zeros(n))[0]
        for side in (1.0, -1.0)
    ]
    expected_um_per_m = (ends[0] - ends[1]) / (2.0 * STEP_MM / 1000.0)
    np.testing.assert_allclose(volume_slope(CHAIN, parts, places, moving), expected_um_per_m, rtol=1e-9, atol=1e-9)


def test_a_small_turn_moves_the_end_of_an_arm_across_both() -> None:
    """r × arm: 10 µrad about X turn 2 m along Y by +20 µm along Z, and 2 m along Z by -20 µm along Y."""
    turned = turned_um(np.array([[10.0, 0.0, 0.0]] * 2), np.array([[0.0, 2.0, 0.0], [0.0, 0.0, 2.0]]))
    np.testing.assert_allclose(turned, [[0.0, 0.0, 20.0], [0.0, -20.0, 0.0]])


def joint(bend: bool = False, sensors: str = "dxw") -> ModelDocument:
    """Drift on `d`, X on `x`, W on `w`, and an angle of the drift on `r`; all sensors stood at 20 °C."""
    made = {f"D{d}": component(f"D{d}", term(0.0, 1.0), None, {sensors[0]: 20.0}, through_zero=True) for d in "XYZ"}
    for axis, sensor in zip("XW", sensors[1:], strict=True):
        for d, value in zip("XYZ", (10.0, -3.0, 5.0), strict=True):
            name = f"E{d}{axis}"
            made[name] = component(name, term(0.0, 0.0), term(0.0, value), {sensor: 20.0}, p=(500.0, 0.0, 1000.0))
    ranges = dict.fromkeys("dxwr", (0.0, 10.0))
    model = document({"X": "+X", "W": "+Z"}, made, ranges)
    drift, w = model.control[""], model.control["W"]
    angles = {name: drift.components[f"D{d}"] for name, d in (("DA", "X"), ("DB", "Y"), ("DC", "Z"))}
    turned = drift.model_copy(update={"layout": drift.layout.plain(("r",)), "components": angles})
    if bend:
        bent = {
            name: one.model_copy(update={"terms": (*one.terms, one.terms[1])}) for name, one in w.components.items()
        }
        model = model.model_copy(update={"control": model.control | {"W": w.model_copy(update={"components": bent})}})
    return model.model_copy(update={"form": "joint", "tool_length_mm": 100.0, "rotations": {"": turned}})


TIMES_S = np.array([0.0, 100.0, 200.0])
PLACES = {"X": np.array([500.0, 700.0, 900.0]), "W": np.array([100.0, 400.0, 800.0])}


def heat(**missing: int) -> Temperatures:
    """Four sensors that rise by 2, 4 K and so on; a named one has no reading in one row."""
    value = 20.0 + np.outer([0.0, 2.0, 4.0], np.ones(4))
    for sensor, row in missing.items():
        value[row, "dxwr".index(sensor)] = np.nan
    return Temperatures(TIMES_S, tuple("dxwr"), value)


@pytest.mark.parametrize("axis", ["X", "W"])
@pytest.mark.parametrize("reference", ["model", "first_row"])
def test_value_slope_and_bend_along_an_axis_give_the_volume_about_it(axis: str, reference: Reference) -> None:
    model = joint(bend=True)
    value_um, slope, bend = volume_along(model, heat(), TIMES_S, PLACES, axis, reference)
    moved_m = np.array([0.3, -0.2, 0.1])
    moved = PLACES | {axis: PLACES[axis] + 1000.0 * moved_m}
    expected = predict_volume(model, heat(), TIMES_S, moved, reference=reference).error_um
    found = value_um + slope * moved_m[:, None] + bend * moved_m[:, None] ** 2
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert np.abs(bend).max() == (40.0 if axis == "W" else 0.0)  # 10 µm/m² per K at 4 K


@pytest.mark.parametrize("sensor", list("dxwr"))
def test_a_row_counts_as_missing_where_any_one_of_its_laws_lacks_a_reading(sensor: str) -> None:
    found = predict_volume(joint(), heat(**{sensor: 1}), TIMES_S, PLACES, np.full(3, 300.0))
    assert found.missing.tolist() == [False, True, False]
    assert np.isfinite(found.error_um).all(axis=1).tolist() == [True, False, True]
    assert np.isfinite(found.upper_um).all(axis=1).tolist() == [True, False, True]


def test_a_joint_model_without_drift_is_told() -> None:
    model = joint()
    control = {name: law for name, law in model.control.items() if name}
    with pytest.raises(AnalysisError, match=r"no drift \(DX, DY, DZ\), without which .* Fix: measure at a fixed"):
        predict_volume(model.model_copy(update={"control": control}), heat(), TIMES_S, PLACES)


def test_what_the_law_of_an_axis_says_is_what_is_predicted_from_it() -> None:
    class Rows:
        t_s, axis, position_mm = TIMES_S, ("X",) * 3, PLACES["X"]

    values = law_values(joint(), "X", heat(), TIMES_S, "first_row")
    expected = predict(joint(), heat(), Rows())
    np.testing.assert_allclose(values.errors_um(values.law.u_m(PLACES["X"])), expected.error_um)
    early = replace(heat(), t_s=TIMES_S + 1.0)
    with pytest.raises(AnalysisError, match=r"data row 1: t_s = 0 lies before the first temperature sample at t_s = 1"):
        law_values(joint(), "X", early, TIMES_S, "first_row")
    with pytest.raises(AnalysisError, match=r"temperatures: the table has no rows\. Fix: "):
        law_values(joint(), "X", heat().take(slice(0)), TIMES_S, "first_row")


@pytest.mark.parametrize("sensors", ["dxw", "dxx", "ddd"])
def test_a_row_that_breaks_one_limit_in_several_laws_counts_once(sensors: str) -> None:
    """Trained from 20 to 30 °C: the last two of three rows are too warm, in every law that has the sensor."""
    table = replace(heat(), value_degC=np.repeat([[20.0], [31.0], [32.0]], 4, axis=1))
    found = predict_volume(joint(sensors=sensors), table, TIMES_S, PLACES, reference="model")
    told = [(one.kind, one.name, one.rows, one.values, one.trained) for one in found.breaches]
    expected = [
        (kind, name, 2, (low, low + 12.0), (low, low + 10.0))
        for name in dict.fromkeys(sensors)
        for kind, low in (("temperature", 20.0), ("rise", 0.0))
    ]
    assert told == expected
    assert found.in_domain.tolist() == [True, False, False]

"""A model file enters through one door: whatever is in it, it is a model that can be used or one clear message."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from thetacomp.arrays import Floats
from thetacomp.controllers.sinumerik import plan_registers
from thetacomp.controllers.sinumerik_settings import SinumerikSettings
from thetacomp.controllers.sinumerik_signtest import sign_tests
from thetacomp.errors import ModelFileError, ThetacompError
from thetacomp.model.document import ModelDocument
from thetacomp.model.load import load_model
from thetacomp.model.prediction import predict
from thetacomp.model.temperatures import Duty, Temperatures
from thetacomp.model.volumetric import predict_volume

DATA = Path(__file__).parent / "data"
MUTATIONS = {"key_points": 1200, "heat_history": 250, "joint_rotations": 350}
HOURS_S = np.linspace(0.0, 7200.0, 13)


@dataclass(frozen=True)
class Rows:
    t_s: Floats
    axis: tuple[str, ...]
    position_mm: Floats


def use(model: ModelDocument) -> Floats:
    """Errors of every axis in a normal warm-up, and of the volume in the joint form; the export must not break."""
    laws = model.in_use
    sensors = sorted({s for law in (*laws.values(), *model.rotations.values()) for s in law.layout.sensors}) or ["a"]
    warm = 20.0 + 5.0 * (1.0 - np.exp(-HOURS_S / 3600.0))
    heat = Temperatures(HOURS_S, tuple(sensors), np.tile(warm[:, None], len(sensors)))
    duty = Duty(HOURS_S, {"spindle_rpm": np.full(13, 1500.0)})
    out = []
    for name, law in laws.items():
        middle_mm = np.nan if law.p_min_mm is None else 0.5 * (law.p_min_mm + (law.p_max_mm or 0.0))
        rows = Rows(HOURS_S, (name,) * 13, np.full(13, middle_mm))
        known = ["XYZ".index(component.direction) for component in law.components.values()]
        for reference in ("first_row", "model"):
            found = predict(model, heat, rows, reference, duty=duty)  # type: ignore[arg-type]
            out += [found.error_um[:, known].ravel()]
    if model.form == "joint":
        positions = {name: np.full(13, law.p0_mm) for name, law in laws.items() if law.p0_mm is not None}
        volume = predict_volume(model, heat, HOURS_S, positions, duty=duty)  # type: ignore[arg-type]
        out.append(volume.error_um[:, ~np.isnan(volume.error_um).all(axis=0)].ravel())
    with suppress(ThetacompError):
        sign_tests(plan_registers(model, SinumerikSettings()))
    return np.concatenate(out or [np.zeros(0)])


def places(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """All places of a JSON document, outer ones first."""
    yield at
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        yield from places(item, (*at, key))


NUMBERS = (0, -1, 1e308, -1e308, 1e-308, 1e6, -273.15, 10**15, float("nan"), float("inf"), "12", None, True, [], {})


def mutated(raw: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """One random change: a number, a dropped or renamed key, a list cut or doubled, a value nested or exchanged."""
    out = copy.deepcopy(raw)
    known = list(places(out))[1:]
    # rows of numbers are most of a file: every second change is made above them
    inner = [place for place in known if not isinstance(place[-1], int)]
    chosen = inner if rng.random() < 0.5 else known
    place = chosen[rng.integers(len(chosen))]
    owner = out
    for key in place[:-1]:
        owner = owner[key]
    key, value = place[-1], owner[place[-1]]
    kind = rng.integers(6)
    if isinstance(value, list) and kind < 3:
        owner[key] = [value[:-1], value + value[-1:], value[::-1]][kind]
    elif isinstance(value, int | float) and kind < 3:
        owner[key] = [-value, value * 10.0 ** float(rng.integers(-12, 13)), value + 1][kind]
    elif kind == 3:
        del owner[key]
    elif kind == 4 and isinstance(owner, dict):
        owner[f"{key}_"] = owner.pop(key)
    else:
        owner[key] = NUMBERS[rng.integers(len(NUMBERS))] if rng.random() < 0.8 else {"nested": [value]}
    return out


@pytest.mark.parametrize("format_", [1, 2])
@pytest.mark.parametrize("kind", MUTATIONS)
def test_a_changed_file_is_refused_or_predicts_finite_numbers(kind: str, format_: int, tmp_path: Path) -> None:
    raw = json.loads((DATA / f"{kind}.json").read_text(encoding="utf-8"))
    if format_ == 2:
        raw = json.loads(load_model(DATA / f"{kind}.json").to_json())
    rng = np.random.default_rng(20120951 + format_)
    path, refused = tmp_path / "model.json", 0
    for _ in range(MUTATIONS[kind]):
        path.write_text(json.dumps(mutated(raw, rng)), encoding="utf-8")
        text = path.read_text(encoding="utf-8")
        try:
            model = load_model(path)
        except ModelFileError:
            refused += 1
            continue
        error_um = use(model)
        assert np.isfinite(error_um).all(), text
        assert np.abs(error_um).max(initial=0.0) < 1e9, text
    assert refused > 0.4 * MUTATIONS[kind]


def changed(raw: dict[str, Any], place: tuple[Any, ...], value: Any) -> dict[str, Any]:
    out = copy.deepcopy(raw)
    owner = out
    for key in place[:-1]:
        owner = owner[key]
    owner[place[-1]] = value
    return out


LAW = ("control", "Y")
COMPONENT = (*LAW, "components", "EYY")


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        ((*COMPONENT, "terms", 0, "constant"), 1e308, "terms.0.constant: 1e+308 is larger than anything"),
        ((*COMPONENT, "terms", 0, "constant"), -1e308, "terms.0.constant: -1e+308 is larger than anything"),
        ((*COMPONENT, "terms", 0, "constant"), 1e9, "control.Y: EYY: intercept: 1e+09 is an error that no machine has"),
        ((*COMPONENT, "terms", 1, "coefficients"), [1e6], "control.Y: EYY: slope: 1e+06 is an error"),
        ((*COMPONENT, "terms", 1, "coefficients"), [], "EYY: some of its terms have no coefficients"),
        ((*COMPONENT, "terms", 1, "constant"), float("nan"), "NaN is not a number that JSON knows"),
        ((*COMPONENT, "band", "sd"), [-1.0, 1.0], "EYY: band: a variance below zero"),
        ((*COMPONENT, "band", "correlation"), 2.0, "EYY: band: a variance below zero"),
        ((*COMPONENT, "direction"), "X", "EYY: the name does not fit direction X and axis Y"),
        ((*LAW, "p_max_mm"), 0.0, "control.Y: the measured travel from 0 to 0 mm has no length"),
        ((*LAW, "p0_mm"), 1e9, "control.Y: a position beyond 1 km"),
        ((*LAW, "reference", "inputs"), [451.0], "control.Y: reference: 451 °C is no temperature of a machine"),
        ((*LAW, "reference", "inputs"), [20.0, 20.0], "the layout has 1 running inputs, the reference has 2"),
        ((*LAW, "leverage", "moments"), [-2.0], "control.Y: leverage: a variance below zero"),
        ((*LAW, "leverage", "directions"), [], "control.Y: leverage: 1 moments for 0 directions"),
        ((*LAW, "border", "temperature_degC"), {"a": [30.0, 20.0]}, "border.temperature_degC: a from 30 to 20"),
        ((*LAW, "border", "temperature_degC"), {}, "neither a box of temperatures nor a distance"),
        ((*LAW, "layout", "time_constants_s"), [60.0], "its inputs are not plain temperatures"),
        ((*LAW, "layout", "sensors"), ["a", "a"], "layout: a sensor is listed twice"),
        ((*LAW, "axis"), "Z", "control.Y: it is the law of axis Z"),
        ((*LAW, "fallbacks", 0, "lost"), "b", "fallback for b: it is not a law without a sensor of the axis"),
        ((*LAW, "fallbacks", 0, "accuracy"), {}, "its components are not those of the axis"),
        (("axes", 0, "travel_mm"), [0.0, 1e10], "axes.Y: a travel beyond 1 km"),
        (("axes", 0, "name"), "Q", "control.Y: the axis Y is not among the axes of the model"),
        (("form",), "joint", "the joint form has no drift"),
        (("notes",), ["x" * 30_000], "notes.0: a text of 30000 characters"),
        (("format",), 3, "model format 3; this version reads formats 1 and 2"),
        (("notes",), 10**60, "a number of 61 digits"),
    ],
)
def test_what_no_machine_has_is_named_with_its_place(
    place: tuple[Any, ...], value: Any, words: str, tmp_path: Path
) -> None:
    raw = json.loads(load_model(DATA / "key_points.json").to_json())
    path = tmp_path / "model.json"
    path.write_text(json.dumps(changed(raw, place, value)), encoding="utf-8")
    with pytest.raises(ModelFileError) as caught:
        load_model(path)
    assert words in str(caught.value)
    assert "Fix: " in str(caught.value)


@pytest.mark.parametrize("opening", ["[" * 100_000, '{"a":' * 100_000])
def test_nesting_without_end_is_one_message(opening: str, tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    path.write_text(opening, encoding="utf-8")
    with pytest.raises(ModelFileError, match="nested too deep"):
        load_model(path)


def test_nesting_inside_a_model_is_named(tmp_path: Path) -> None:
    raw = json.loads((DATA / "key_points.json").read_text(encoding="utf-8"))
    raw["notes"] = json.loads("[" * 40 + "]" * 40)
    path = tmp_path / "model.json"
    path.write_text(json.dumps(raw), encoding="utf-8")
    with pytest.raises(ModelFileError, match="nested deeper than 20 levels"):
        load_model(path)


def test_a_file_beyond_any_model_is_not_even_read(tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    with path.open("wb") as file:
        file.truncate(100_000_000)
    with pytest.raises(ModelFileError, match="larger than 64 MB"):
        load_model(path)


def test_a_damaged_covariance_of_format_1_is_refused(tmp_path: Path) -> None:
    raw = json.loads((DATA / "key_points.json").read_text(encoding="utf-8"))
    raw["components"]["EYY"]["intercept"]["covariance"][1][1] = -1.0
    path = tmp_path / "model.json"
    path.write_text(json.dumps(raw), encoding="utf-8")
    with pytest.raises(ModelFileError, match="a variance is below zero"):
        load_model(path)


@pytest.mark.parametrize("value", ["12", True])
def test_a_text_or_a_truth_value_is_no_number(value: object, tmp_path: Path) -> None:
    raw = json.loads(load_model(DATA / "key_points.json").to_json())
    path = tmp_path / "model.json"
    place = ("control", "Y", "components", "EYY", "terms", 0, "coefficients", 0)
    path.write_text(json.dumps(changed(raw, place, value)), encoding="utf-8")
    with pytest.raises(ModelFileError, match=r"control\.Y\.components\.EYY\.terms\.0\.coefficients\.0"):
        load_model(path)


def test_a_saved_model_has_rows_of_numbers_and_empty_lists_on_one_line() -> None:
    text = load_model(DATA / "key_points.json").to_json()
    for part in ('"speed_powers": [],', '"scale": [1.0],', '"directions": [\n          [1.0]\n        ],'):
        assert part in text
    assert '"prediction": {},' in text

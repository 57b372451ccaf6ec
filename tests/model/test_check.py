"""What a model may hold, up to the limit itself, and what it may not just beyond it."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from thetacomp.errors import ModelFileError
from thetacomp.model.check import problems
from thetacomp.model.document import ModelDocument
from thetacomp.model.load import load_model

DATA = Path(__file__).parent / "data"
Y = ("control", "Y")
LEVERAGE = (*Y, "leverage")
BAND = (*Y, "components", "EYY", "band")
TERM = (*Y, "components", "EYY", "terms", 1)
DISTANCE = ("prediction", "Y", "border", "distance")
FOLLOW = {"wanted": "workpiece", "workpiece_expansion_per_K": 11.5e-6, "workpiece_sensor": "a"}


def found(kind: str, changes: dict[tuple[Any, ...], Any]) -> list[str]:
    """The problems of a stored model after changes at places of its JSON, without those of its fallbacks."""
    raw = copy.deepcopy(json.loads(load_model(DATA / f"{kind}.json").to_json()))
    for room in ("control", "prediction"):
        for law in raw[room].values():
            law["fallbacks"] = []
    for place, value in changes.items():
        owner = raw
        for key in place[:-1]:
            owner = owner[key]
        owner[place[-1]] = value
    return problems(ModelDocument.model_validate(raw))


@pytest.mark.parametrize(
    ("place", "allowed", "refused", "words"),
    [
        # a scale of 0 marks an input that never moved
        ((*LEVERAGE, "scale"), [[0.0], [1e-15]], [[-1.0], [1e-16]], "control.Y: leverage: a scale below zero"),
        ((*LEVERAGE, "floor"), [None, 1e-15, 3.0], [0.0, -1.0, 1e-16], "leverage: a floor that is not above zero"),
        ((*LEVERAGE, "at_centre"), [0.0, 1.0], [-1e-9], "control.Y: leverage: a variance below zero"),
        ((*LEVERAGE, "moments"), [[1e-15], [1e9]], [[0.0], [-1.0]], "control.Y: leverage: a variance below zero"),
        ((*LEVERAGE, "centre"), [[5.0]], [[], [0.0, 0.0]], "control.Y: leverage: not one of 1 inputs"),
        ((*Y, "layout", "base_degC"), [-60.0, 0.0, 250.0], [-60.1, 250.1], "is no temperature of a machine"),
        ((*Y, "reference", "inputs"), [[-60.0], [250.0]], [[-60.1], [250.1]], "is no temperature of a machine"),
        ((*Y, "border", "temperature_degC"), [{"a": [-60.0, -60.0]}], [{"a": [-60.1, 0.0]}], "is no temperature"),
        ((*Y, "border", "rise_K"), [{"a": [1.0, 1.0]}], [{"a": [1.1, 1.0]}], "border.rise_K: a from 1.1 to 1"),
        ((*Y, "border", "rise_K"), [{}], [{"b": [0.0, 1.0]}], "border.rise_K: no training range for a"),
        ((*Y, "p_max_mm"), [1e6], [1.01e6], "control.Y: a position beyond 1 km"),
        ((*Y, "p_min_mm"), [-1e6, 1999.0], [-1.01e6], "control.Y: a position beyond 1 km"),
        # a micrometre of travel carries no slope
        ((*Y, "p_min_mm"), [1999.0, 1999.9989], [1999.9991, 2000.0, 2001.0], "has no length"),
        (
            (*Y, "p0_mm"),
            [-1e5, 0.0, 1.02e5],
            [-1.01e5, 1.021e5, 1e6],
            "lies more than 100 m outside the measured travel",
        ),
        ((*Y, "p0_mm"), [], [-1.01e6, 1.01e6, None], "control.Y: a"),
        (("axes", 0, "travel_mm"), [[-1e6, 0.0], [0.0, 1e6]], [[-1.01e6, 0.0]], "axes.Y: a travel beyond 1 km"),
        (("tool_length_mm",), [-1e6, 1e6], [-1.01e6, 1.01e6], "mm is no tool"),
        ((*TERM, "constant"), [-1e5, 1e5], [-1.01e5, 1.01e5], "slope: "),
        ((*TERM, "beyond"), [None], [[1.0]], "prior of the slope without a border"),
        ((*BAND, "sd"), [[0.0], [0.0, 1e5]], [[], [0.0, 1.0, 1.0], [0.0, 1.01e5], [-0.1, 0.0]], "EYY: band: "),
        ((*BAND, "correlation"), [-1.0, 1.0], [-1.01, 1.01], "EYY: band: a variance below zero"),
        ((*BAND, "growth"), [0.0], [-0.1], "EYY: band: a variance below zero"),
        ((*BAND, "noise_sd_um"), [0.0, 1e5], [-0.1], "EYY: band: a variance below zero"),
        ((*BAND, "noise_sd_um"), [1e5], [1.01e5], "is a scatter that no machine has"),
        ((*BAND, "knee"), [1e-15], [0.0, -1.0], "EYY: band: a quantile, knee or far that is not above zero"),
        ((*BAND, "far"), [1e-15], [0.0, -1.0], "EYY: band: a quantile, knee or far that is not above zero"),
        ((*BAND, "quantile"), [None, 1e-15], [0.0, -1.0], "EYY: band: a quantile, knee or far that is not above zero"),
    ],
)
def test_up_to_the_limit_and_beyond(place: tuple[Any, ...], allowed: list[Any], refused: list[Any], words: str) -> None:
    for value in allowed:
        assert found("key_points", {place: value}) == [], value
    for value in refused:
        assert words in " ".join(found("key_points", {place: value})), value


def test_with_a_floor_a_direction_may_have_no_moment() -> None:
    floor, moments = (*LEVERAGE, "floor"), (*LEVERAGE, "moments")
    assert found("key_points", {floor: 1.0, moments: [0.0]}) == []
    assert "a variance below zero" in " ".join(found("key_points", {floor: 1.0, moments: [-1e-9]}))


@pytest.mark.parametrize(
    ("name", "allowed", "refused", "words"),
    [
        ("leverage_unit", [1e-15], [0.0], "border.distance: a unit or limit that is not above zero"),
        ("range_unit", [1e-15], [-1.0], "border.distance: a unit or limit that is not above zero"),
        ("limit", [1e-15], [0.0], "border.distance: a unit or limit that is not above zero"),
    ],
)
def test_units_of_the_distance(name: str, allowed: list[float], refused: list[float], words: str) -> None:
    for value in allowed:
        assert found("heat_history", {(*DISTANCE, name): value}) == []
    for value in refused:
        assert words in " ".join(found("heat_history", {(*DISTANCE, name): value}))


def test_a_half_span_of_zero_leaves_an_input_out_and_one_below_zero_is_refused() -> None:
    whole = load_model(DATA / "heat_history.json").prediction["Y"].border.distance
    assert whole is not None
    for first, words in ((0.0, ""), (1e-15, ""), (1e-16, "a half span below zero"), (-1.0, "a half span below zero")):
        given = found("heat_history", {(*DISTANCE, "half_span"): [first, *whole.half_span[1:]]})
        assert words in " ".join(given) if words else given == []


@pytest.mark.parametrize("lacking", [("leverage",), ("border",), ("leverage", "border")])
def test_a_fallback_on_other_inputs_brings_its_own_leverage_and_border(lacking: tuple[str, ...]) -> None:
    """It stands on `b`, the law on `a`: nothing of the law can be seen in its inputs."""
    model = load_model(DATA / "key_points.json")
    assert problems(model) == []
    law = model.control["Y"]
    changed = law.fallbacks[0].model_copy(update=dict.fromkeys(lacking))
    broken = model.model_copy(update={"control": {"Y": law.model_copy(update={"fallbacks": (changed,)})}})
    assert problems(broken) == [
        "control.Y: fallback for a: no leverage or border, and its inputs are not those that are left"
    ]


@pytest.mark.parametrize(
    "layout", [{"time_constants_s": (60.0,)}, {"speed_powers": (3,)}, {"sensors": ("somewhere else",)}]
)
def test_a_fallback_that_borrows_has_the_filters_of_the_law(layout: dict[str, Any]) -> None:
    model = load_model(DATA / "heat_history.json")
    law = model.prediction["Y"]
    borrows = next(one for one in law.fallbacks if one.leverage is None and one.border is None)
    changed = borrows.model_copy(update={"layout": borrows.layout.model_copy(update=layout)})
    broken = model.model_copy(update={"prediction": {"Y": law.model_copy(update={"fallbacks": (changed,)})}})
    assert problems(model) == []
    assert "no leverage or border, and its inputs are not those that are left" in " ".join(problems(broken))


def test_the_box_of_training_holds_the_sensors_of_the_fallbacks_too() -> None:
    model = load_model(DATA / "key_points.json")
    law = model.control["Y"]
    ready = law.fallbacks[0].border
    assert ready is not None
    found = model.trained
    assert found.temperature_degC == {**law.border.temperature_degC, **ready.temperature_degC}
    assert found.rise_K == {**law.border.rise_K, **ready.rise_K}
    assert set(found.temperature_degC) == set(found.rise_K) == {"a", "b"}


BAD_NAMES = ("=1+1", "＠x", "a\x07b", "a\u200fb", "a\nb")
FREE = ("- one point less", "+3 K", "=", "")


@pytest.mark.parametrize(
    ("place", "change"),
    [
        ("machine", lambda name: {("machine",): name}),
        ("axes", lambda name: {("axes", 0, "sensor"): name}),
        ("length", lambda name: {("length",): FOLLOW | {"workpiece_sensor": name}}),
        ("length", lambda name: {("length",): FOLLOW | {"zero_mm": {name: 0.0}}}),
        ("training", lambda name: {("training", "mode"): name}),
        ("training", lambda name: {("training", "instrument"): name}),
        ("training", lambda name: {("training", "campaigns"): ["good", name]}),
        ("laws", lambda name: {(*Y, "reference", "campaign"): name}),
        ("laws", lambda name: {(*Y, "border", "rise_K"): {"a": [0.0, 1.0], name: [0.0, 1.0]}}),
        ("laws", lambda name: {(*Y, "border", "temperature_degC"): {"a": [20.0, 21.0], name: [20.0, 21.0]}}),
        ("laws", lambda name: {(*Y, "layout", "sensors"): [name], (*Y, "border", "rise_K"): {},
                               (*Y, "border", "temperature_degC"): {name: [20.0, 21.0]}}),
    ],
)  # fmt: skip
def test_a_name_that_no_machine_file_may_bring_is_refused_in_a_model_too(
    place: str, change: Callable[[str], dict[tuple[Any, ...], Any]]
) -> None:
    for name in BAD_NAMES:
        (told,) = found("key_points", change(name))
        assert told.startswith(f"{place}: {name!r} is no name: it ")


@pytest.mark.parametrize(
    "place",
    [
        ("version",), ("created",), ("method",), ("notes",), ("failed_checks",), ("failed_static_checks",),
        (*Y, "components", "EYY", "equation"), (*BAND, "sentence"), (*DISTANCE, "sentence"),
    ],
)  # fmt: skip
def test_a_text_of_a_model_may_begin_as_it_likes_but_hides_nothing(place: tuple[str, ...]) -> None:
    many = place[0] in ("notes", "failed_checks", "failed_static_checks")
    for text in FREE:
        assert found("heat_history", {place: ["first", text] if many else text}) == []
    for text in ("a\x1b[31mb", "a\u202eb"):
        (told,) = found("heat_history", {place: ["first", text] if many else text})
        assert told.startswith(f"{text!r} is no text: it holds the ")


@pytest.mark.parametrize("room", ["control", "prediction"])
def test_what_a_fallback_names_and_says_is_held_to_the_same_rules(room: str) -> None:
    model = load_model(DATA / "heat_history.json")
    law = getattr(model, room)["Y"]
    first, *others = law.fallbacks
    eyy = first.components["EYY"]
    for change, told in (
        ({"reference": first.reference.model_copy(update={"campaign": "=c"})}, "laws: '=c' is no name: it begins"),
        ({"components": {"EYY": eyy.model_copy(update={"equation": "\x00"})}}, "'\\x00' is no text: it holds"),
    ):
        changed = law.model_copy(update={"fallbacks": (first.model_copy(update=change), *others)})
        (problem,) = problems(model.model_copy(update={room: {"Y": changed}}))
        assert problem.startswith(told)


def test_half_a_letter_in_a_file_is_one_message(tmp_path: Path) -> None:
    raw = json.loads(load_model(DATA / "key_points.json").to_json())
    path = tmp_path / "model.json"
    path.write_text(json.dumps(raw | {"machine": "a\ud800"}), encoding="utf-8")
    with pytest.raises(ModelFileError, match=r"model\.json: .* Fix: do not edit"):
        load_model(path)

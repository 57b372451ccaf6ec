"""Files of format 1 predict for good what the code of their day predicted from them.

One part of heat_history.expected.json is later: the runs without a sensor. The code of that day left its inputs out of
the border of training in a way that put every row outside, so the law faded to its prior.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_models import component, document, term

from thetacomp.arrays import Floats
from thetacomp.model.document import ModelDocument
from thetacomp.model.load import load_model
from thetacomp.model.prediction import Prediction, predict
from thetacomp.model.temperatures import Duty, Temperatures
from thetacomp.model.volumetric import VolumePrediction, predict_volume

DATA = Path(__file__).parent / "data"
KINDS = ("key_points", "heat_history", "joint_rotations")


@dataclass(frozen=True)
class Rows:
    t_s: Floats
    axis: tuple[str, ...]
    position_mm: Floats


def compare(found: Prediction | VolumePrediction, expected: dict[str, Any], *, bounds: float = 1e-9) -> None:
    for name in ("error_um", "lower_um", "upper_um"):
        wanted = np.array(expected[name], dtype=np.float64)
        np.testing.assert_allclose(getattr(found, name), wanted, rtol=bounds, atol=1e-9, err_msg=name)
    assert found.in_domain.tolist() == expected["in_domain"]


@pytest.mark.parametrize("again", [False, True], ids=["read", "written_anew"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_file_of_format_1_predicts_what_it_always_did(kind: str, again: bool, tmp_path: Path) -> None:
    model = load_model(DATA / f"{kind}.json")
    if again:
        model.save(tmp_path / "model.json")
        assert load_model(tmp_path / "model.json") == model
        model = load_model(tmp_path / "model.json")
    stored = json.loads((DATA / f"{kind}.expected.json").read_text(encoding="utf-8"))
    table, rows, volume = stored["temperatures"], stored["rows"], stored["volume"]
    duty = stored["duty"] and Duty(
        np.array(stored["duty"]["t_s"]), {"spindle_rpm": np.array(stored["duty"]["spindle_rpm"])}
    )
    places = Rows(
        np.array([row[0] for row in rows]), tuple(row[1] for row in rows), np.array([row[2] for row in rows], float)
    )
    for run in stored["runs"]:
        kept = [j for j, name in enumerate(table["sensors"]) if name not in run["lost"]]
        heat = Temperatures(
            np.array(table["t_s"]), tuple(table["sensors"][j] for j in kept), np.array(table["value_degC"])[:, kept]
        )
        for answer in run["answers"]:
            found = predict(model, heat, places, answer["reference"], duty=duty)
            compare(found, answer)
            assert sorted(found.replaced) == answer["replaced"]
            if volume:
                positions = {name: np.array(value) for name, value in volume["positions_mm"].items()}
                compare(
                    predict_volume(
                        model, heat, np.array(volume["t_s"]), positions, np.array(volume["tool_length_mm"]),
                        answer["reference"], duty=duty,
                    ),
                    answer["volume"],
                )  # fmt: skip


def test_the_stored_files_are_of_every_kind() -> None:
    points, history, joint = (load_model(DATA / f"{kind}.json") for kind in KINDS)
    assert (set(points.control), points.prediction, points.rotations) == ({"Y"}, {}, {})
    assert len(history.prediction["Y"].fallbacks) == 2
    assert len(history.control["Y"].fallbacks) >= 1
    assert (joint.form, set(joint.rotations)) == ("joint", {"", "X", "Y", "W"})
    for model in (points, history, joint):
        assert isinstance(model, ModelDocument)
        assert model.format == 2


@pytest.mark.parametrize(
    ("intercept", "slope", "expected"),
    [
        ((2.0, 4.0), (1.0, 9.0), 9.0),  # the covariance over the variance of the residuals: 4 / 2² and 9 / 1²
        ((1.0, 9.0), (2.0, 4.0), 9.0),
        ((0.0, 0.0), (2.0, 8.0), 2.0),  # a term without scatter says nothing
        ((2.0, 8.0), (0.0, 0.0), 2.0),
        ((0.0, 0.0), (0.0, 0.0), 0.0),
    ],
)
def test_of_two_terms_the_wider_leverage_is_taken(
    intercept: tuple[float, float], slope: tuple[float, float], expected: float
) -> None:
    """Standard deviation and variance of each term. With a covariance of c times one, h(x) = c (1 + x²)."""
    one, two = (term(0.0, 1.0, sd=sd, variance=variance) for sd, variance in (intercept, slope))
    law = document({"X": "+X"}, {"EXX": component("EXX", one, two, {"a": 20.0})}, {"a": (0.0, 10.0)}).control["X"]
    np.testing.assert_allclose(law.leverage.at(np.array([[0.0], [3.0]])), [expected, 10.0 * expected])

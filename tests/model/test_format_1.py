"""Files of format 1 predict for good what the code of their day predicted from them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

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

"""One road: commands that look at the same folder use the same readings, the same form and the same fit."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rigid_machine import MACHINE, draw_rigid, measure
from screening_folder import folder as network_folder
from screening_folder import with_temperatures, write_folder
from typer.testing import CliRunner

from thetacomp.analysis import analyze_folder
from thetacomp.analysis_result import AnalysisResult
from thetacomp.axis_states import axis_states
from thetacomp.campaign import MachineFolder
from thetacomp.cli.main import app
from thetacomp.errors import AnalysisError
from thetacomp.fitting.training import Trained, train
from thetacomp.preparation import Prepared, prepare
from thetacomp.reading import read_folder
from thetacomp.sensors.selection import key_points
from thetacomp.sensors.sensor_curve import sensor_curve
from thetacomp.separation import separate_folder

BEST = ("theta_11", "theta_13")


def faulty() -> MachineFolder:
    """The two best sensors of a thermal network jump by 31 K, each in the middle of a campaign, and stay there."""
    out = network_folder()
    for name, sensor in zip(("c1", "c2"), BEST, strict=True):
        table = out.campaign(name).temperatures
        value = table.value_degC.copy()
        value[len(value) // 2 :, table.sensor_ids.index(sensor)] += 31.0
        out = with_temperatures(out, name, replace(table, value_degC=value))
    return out


def joint() -> MachineFolder:
    """Three campaigns of a rigid machine that say where the other axes stood."""
    rng = np.random.default_rng(21)
    rigid = draw_rigid(rng)
    taus = {"a": (4000.0, 16000.0), "b": (9000.0, 11000.0), "c": (6000.0, 14000.0)}
    campaigns = [measure(replace(rigid, tau_s=tau), rng, name, angle_sd_urad=1.0) for name, tau in taus.items()]
    return MachineFolder(MACHINE, tuple(campaigns))


FOLDERS = {"faulty": faulty, "joint": joint}


@pytest.fixture(scope="module", autouse=True)
def short_curves() -> Iterator[None]:
    """One and two sensors of the curve tell what is compared here."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("thetacomp.sensors.sensor_curve.MOST_SENSORS", 2)
        yield


@pytest.fixture(scope="module", params=list(FOLDERS))
def roads(request: pytest.FixtureRequest) -> tuple[MachineFolder, Prepared, Trained, AnalysisResult]:
    folder = FOLDERS[request.param]()
    prepared = prepare(folder)
    return folder, prepared, train(prepared, lost=()), analyze_folder(folder)


def test_all_roads_lead_to_the_same_sensors(roads: tuple[MachineFolder, Prepared, Trained, AnalysisResult]) -> None:
    """What `keypoints` and `keypoints --method exact` print comes from the states that `analyze` fits."""
    _, prepared, trained, analysis = roads
    chosen = [key_points(prepared.folder.machine, states) for states in prepared.training]
    assert repr(chosen) == repr(list(analysis.key_points))
    assert [law.inputs for _, law in trained.fitted] == [found.key_points for found in chosen]
    stored = {curve.axis: curve for curve in analysis.sensor_curves}
    assert stored
    for states in prepared.training:
        searched = sensor_curve(states, counts=[1])
        assert searched.points[0].sensors == stored[states.axis].points[0].sensors
        assert searched.points[0].held_out_um == pytest.approx(stored[states.axis].points[0].held_out_um, rel=1e-12)


def test_all_roads_lead_to_the_same_coefficients(
    roads: tuple[MachineFolder, Prepared, Trained, AnalysisResult],
) -> None:
    """Verdict, notes of the validation and the fallbacks are all that `analyze` adds to what `train` fits."""
    _, _, trained, analysis = roads
    told: dict[str, Any] = {"held_out_um": None}
    for made, stored in ((trained.model, analysis.model), (trained.paper_model, analysis.paper_model)):
        assert (made.form, made.rotations) == (stored.form, stored.rotations)
        assert set(made.components) == set(stored.components)
        for name, component in stored.components.items():
            assert made.components[name] == component.model_copy(update=told)
        assert set(made.prediction) == set(stored.prediction)
        for axis, history in stored.prediction.items():
            for name, part in history.components.items():
                assert made.prediction[axis].components[name] == part.model_copy(update=told)
    assert trained.model.prediction


def test_without_the_one_road_they_would_differ() -> None:
    """The folders are such that screening and form matter: raw readings and separate axes give other answers."""
    spoilt, healthy = (prepare(faulty(), faults=faults) for faults in ("tell", "repair"))  # type: ignore[arg-type]
    best = [sensor_curve(p.training[0], counts=[1]).points[0] for p in (spoilt, healthy)]
    assert best[1].sensors[0] in BEST
    assert best[0].sensors[0] not in BEST
    assert prepare(joint()).separated.form == "joint"
    whole = joint()
    alone = axis_states(whole, separate_folder(whole), ["a", "b", "c"])
    assert np.abs(alone[0].intercept_um).max() > 1.0
    assert np.abs(prepare(whole).training[0].intercept_um).max() == 0.0


def run(*arguments: str) -> dict[str, Any]:
    result = CliRunner().invoke(app, [*arguments, "--json"])
    assert result.exit_code in (0, 3), result.output
    return dict(json.loads(result.stdout))


def test_the_commands_name_the_same_sensors(tmp_path: Path) -> None:
    path = str(write_folder(faulty(), tmp_path / "machine"))
    analysis = analyze_folder(read_folder(Path(path)))
    chosen, exact = run("keypoints", path), run("keypoints", path, "--method", "exact", "--sensors", "1")
    assert [axis["key_points"] for axis in chosen["axes"]] == [list(found.key_points) for found in analysis.key_points]
    (curve,) = exact["axes"]
    assert curve["points"][0]["sensors"] == list(analysis.sensor_curves[0].points[0].sensors)
    assert curve["points"][0]["sensors"][0] in BEST
    for told in (chosen, exact):
        assert all(any(name in note and "jump" in note for note in told["notes"]) for name in BEST)


def test_campaigns_that_may_not_share_a_model_do_not_share_key_points(tmp_path: Path) -> None:
    folder = network_folder()
    last = folder.campaigns[-1]
    compensated = replace(last, settings=last.settings.model_copy(update={"compensation": "on"}))
    with pytest.raises(AnalysisError, match="compensation was on in campaign c3"):
        prepare(replace(folder, campaigns=(*folder.campaigns[:-1], compensated)))
    path = write_folder(folder, tmp_path / "machine")
    (path / "campaigns" / "c3" / "campaign.toml").write_text('compensation = "on"\n', encoding="utf-8")
    refused = CliRunner().invoke(app, ["keypoints", str(path)])
    assert refused.exit_code == 1
    assert "leave it out with --train" in refused.stderr
    named = [option for name in ("c0", "c1", "c2") for option in ("--train", name)]
    assert run("keypoints", str(path), *named)["axes"]


def test_results_print_in_a_few_lines(roads: tuple[MachineFolder, Prepared, Trained, AnalysisResult]) -> None:
    folder, prepared, trained, analysis = roads
    for result in (prepared, trained, analysis):
        printed = repr(result)
        assert len(printed) < 1000
        assert len(printed.splitlines()) <= 5
        assert folder.machine.name in printed
    assert all(name in repr(analysis) for name in (*(c.name for c in folder.campaigns), "fit for use", "sensors: "))

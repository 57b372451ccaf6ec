"""Sensor placement on a coarse virtual machine: what is excluded, what a state gives, what the command writes."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from thetacomp.cli.main import app
from thetacomp.errors import AnalysisError, InputError
from thetatwin import picture, sensor_places, snapshots, virtual_machine
from thetatwin.conditions import Conditions
from thetatwin.mesh import mesh_body
from thetatwin.mounting import Mounting, candidates, load_mounting
from thetatwin.picture import Mark, figure_content, machine_figure, sensor_marks, warm_machine
from thetatwin.sensor_places import Placement, place_sensors
from thetatwin.virtual_machine import VirtualMachine

MIDDLE = {"X": 2000.0, "Y": 1500.0, "W": 500.0}


@pytest.fixture(scope="module")
def mounting(coarse: VirtualMachine) -> Mounting:
    return load_mounting("tk6920_mounting", coarse.description)


@pytest.fixture(scope="module")
def meshed(coarse: VirtualMachine) -> VirtualMachine:
    """The meshes of the presets' size; only what candidates need is there, nothing is solved."""
    return replace(coarse, meshes={body.name: mesh_body(body) for body in coarse.description.bodies})


@pytest.fixture
def small_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(picture, "_PIXELS", 160)


@pytest.fixture(scope="module")
def short_work() -> Iterator[None]:
    """Ten days in winter and ten in summer instead of half a year each."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sensor_places, "CHOOSE_DAYS", (20, 10))
        patch.setattr(sensor_places, "JUDGE_DAYS", (200, 10))
        yield


@pytest.fixture(scope="module")
def placed(coarse: VirtualMachine, standard: Conditions, mounting: Mounting, short_work: None) -> Placement:
    return place_sensors(coarse, standard, mounting, 8, seed=3)


# --- where nothing can be mounted -------------------------------------------------------------------------------------


def test_no_candidate_lies_where_nothing_can_be_mounted(meshed: VirtualMachine, mounting: Mounting) -> None:
    free = candidates(meshed, mounting)
    x, y, z = free.at_mm.T
    part = np.array(free.part)
    assert {"bed", "column", "headstock", "ram", "x_motor", "oil"} <= set(part)
    assert not {"spindle_front", "boring_nut", "gearbox", "y_screw", "x_scale"} & set(part)
    assert y[part == "bed"].max() < 800.0  # top and rails of the bed
    assert y[part == "bed"].min() > 0.0  # its feet
    assert z[part == "ram"].max() <= -1899.0  # what slides into the headstock
    assert z[part == "ram"].min() > -2200.0  # the spindle nose
    assert x[part == "headstock"].max() < -430.0  # the side towards the column
    rails = (part == "column") & (x <= -350.0) & (y > 1450.0) & ((np.abs(z) >= 450.0) & (np.abs(z) <= 700.0))
    assert not rails.any()


@pytest.mark.parametrize("bare", [False, True])
def test_every_candidate_is_on_the_outside_of_a_casting(coarse: VirtualMachine, mounting: Mounting, bare: bool) -> None:
    # Without boxes the rims of the bore and of the open ram would be left, were inner faces not looked at.
    free = candidates(coarse, Mounting(format=1, apart_mm=0.0) if bare else mounting)
    for state, part, side, at_mm in zip(free.state, free.part, free.side, free.at_mm, strict=True):
        if part not in coarse.meshes:
            assert side == ""
            continue
        mesh = coarse.meshes[part]
        node = state - coarse.system.offset[part]
        assert mesh.points_m[node] * 1e3 == pytest.approx(at_mm)
        faces = (mesh.faces.corners == node).any(axis=1)
        assert faces.any()
        assert not mesh.faces.inner[faces].any()
        normals = {tuple(n) for n in mesh.faces.normal[faces].astype(int).tolist()}
        assert len(re.findall(r"[+-][XYZ]", side)) == len(normals)


def test_a_hollow_machine_offers_its_inside_only_when_asked(coarse: VirtualMachine, mounting: Mounting) -> None:
    inside = candidates(coarse, mounting.model_copy(update={"inside": True}))
    assert len(inside.state) > 1.3 * len(candidates(coarse, mounting).state)


def test_a_mounting_file_with_unknown_names_is_told_all_of_them(coarse: VirtualMachine, tmp_path: Path) -> None:
    file = tmp_path / "own.toml"
    file.write_text(
        'format = 1\napart_mm = 100.0\nparts = ["z_motor"]\nkeep_off = ["floor"]\n'
        '[[keep_out]]\nname = "box"\nbody = "table"\nfrom_mm = [0.0, 0.0, 0.0]\nto_mm = [1.0, 1.0, 1.0]\n',
        encoding="utf-8",
    )
    with pytest.raises(InputError) as caught:
        load_mounting(file, coarse.description)
    assert [p.message.split(",")[0] for p in caught.value.problems] == [
        "parts names 'z_motor'",
        "keep_off names 'floor'",
        "keep_out box names 'table'",
    ]
    assert "use one of bed, column, headstock, ram." in caught.value.problems[2].fix


def test_boxes_over_everything_leave_no_place(coarse: VirtualMachine) -> None:
    everywhere = {"from_mm": (-9e4, -9e4, -9e4), "to_mm": (9e4, 9e4, 9e4)}
    boxes = [{"name": "all", "body": body, **everywhere} for body in coarse.meshes]
    closed = Mounting.model_validate({"format": 1, "apart_mm": 0.0, "keep_out": tuple(boxes)})
    with pytest.raises(AnalysisError, match="no place is left"):
        candidates(coarse, closed)


# --- states, tool and responses ---------------------------------------------------------------------------------------


def test_outputs_are_the_tool_error_of_the_machine(coarse: VirtualMachine) -> None:
    at = snapshots.positions_mm(coarse)
    assert all(len(p) == 27 for p in at.values())
    state = np.random.default_rng(0).normal(size=len(coarse.reduced.rate_per_s))
    outputs = snapshots.tool_outputs_um(coarse, at, 150.0) @ state
    poses = np.tile(coarse.reduced.rows[coarse.tool_rows] @ state, (27, 1))
    assert outputs == pytest.approx(coarse.tool_error_um(poses, at, 150.0)[:, :3], rel=1e-9, abs=1e-9)


def test_responses_are_those_of_the_stepped_model(coarse: VirtualMachine) -> None:
    states = np.array([coarse.system.offset["y_motor"], coarse.system.offset["oil"], 7])
    response = snapshots.responses_K_per_kW(coarse, states)
    names = [s.name for s in coarse.description.sources]
    inputs = np.zeros((480, len(coarse.reduced.inputs)))
    inputs[:, coarse.reduced.inputs.index("Y feed motor")] = 1000.0
    model = coarse.reduced
    decay, drive = model.step(60.0)
    state = np.zeros(len(decay))
    for u in inputs:
        state = decay * state + drive @ u
    assert response[:, names.index("Y feed motor")] == pytest.approx(model.shapes[states] @ state, rel=1e-6)
    # The hydraulics heat the tank of 1020 kJ/K: without losses 8 h of 1 kW are 28 K.
    assert 1.0 < response[1, names.index("hydraulics")] < 28.2


def test_snapshots_repeat_and_differ_by_season(coarse: VirtualMachine, standard: Conditions) -> None:
    winter, again = (snapshots.working_states(coarse, standard, np.random.default_rng(5), 10, 3) for _ in range(2))
    summer = snapshots.working_states(coarse, standard, np.random.default_rng(5), 200, 3)
    assert np.array_equal(winter, again)
    assert winter.shape == (3 * 24 + 1, len(coarse.reduced.rate_per_s))
    column = coarse.reduced.rows[6]  # theta_7 on the column
    assert np.mean(summer @ column) - np.mean(winter @ column) > 5.0  # 16 to 25 °C in the hall


def test_the_noise_of_a_reading_is_noise_rounding_and_offset(standard: Conditions) -> None:
    # √(0.03² + 0.1² / 12 + 0.08²)
    assert snapshots.sensor_noise_K(standard.pt100) == pytest.approx(0.0902, abs=5e-5)


# --- the choice -------------------------------------------------------------------------------------------------------


def test_more_sensors_are_never_worse_on_the_states_they_were_chosen_on(placed: Placement) -> None:
    for curve in (*(c.curve for c in placed.choices), placed.existing):
        assert np.all(np.diff(curve.promised_um[:, 3]) <= 1e-6)
        assert np.all(curve.judged_um[1:, 3] < curve.judged_um[0, 3])


def test_the_places_for_the_tool_promise_more_than_any_other_strategy(placed: Placement) -> None:
    promised = {c.strategy: c.curve.promised_um[-1, 3] for c in placed.choices}
    assert promised["exchange"] <= promised["displacement"] * (1 + 1e-3)
    assert promised["displacement"] < min(promised["modes"], promised["sensitivity"], promised["linearity"])
    assert promised["displacement"] < placed.existing.promised_um[8, 3]
    best = placed.choice("displacement").curve.judged_um[:, 3]
    assert best[8] < placed.existing.judged_um[8, 3]
    assert best[8] < placed.random_um[8, 3]


def test_places_keep_their_distance_and_none_is_taken_twice(placed: Placement) -> None:
    for choice in placed.choices:
        at = placed.candidates.at_mm[choice.chosen]
        apart = np.linalg.norm(at[:, None] - at[None], axis=2)[np.triu_indices(8, 1)]
        assert apart.min() >= 200.0


def test_thirty_modes_hold_the_displacement_and_greedy_is_near_the_best(placed: Placement) -> None:
    assert placed.modes_um < 0.2
    assert len(placed.checks) == 8
    assert all(1 - 1 / np.e <= check.share <= 1 + 1e-9 for check in placed.checks)
    assert all(1 - 1e-9 <= check.error_ratio < 1.4 for check in placed.checks)


def test_each_existing_sensor_stands_once_and_its_own_place_is_nearest(placed: Placement) -> None:
    assert sorted(placed.existing_ids) == sorted(f"theta_{k}" for k in range(1, 16))
    k = placed.candidates.part.index("x_motor")
    assert (placed.nearest_id[k], placed.nearest_mm[k]) == ("theta_15", 0.0)


# --- pictures and command ---------------------------------------------------------------------------------------------


def test_a_sensor_behind_a_casting_is_half_transparent(coarse: VirtualMachine, placed: Placement) -> None:
    shown = warm_machine(coarse, placed.warm_rise_K, placed.warm_rise_K, MIDDLE, 150.0)
    # High on the front of the column; in the middle of its hollow inside.
    marks = (Mark("front", "column", (-350.0, 6000.0, -290.0)), Mark("inside", "column", (350.0, 3000.0, 0.0)))
    figure = machine_figure(shown, "title", marks)
    dots = [line for line in figure.axes[0].lines if line.get_marker() == "o"]
    assert [dot.get_alpha() for dot in dots] == [1.0, 0.5]
    texts = " ".join(t.get_text() for t in figure.texts)
    assert re.search(r"Displacement since cold × [125]0*(,000)?: largest \d+ µm, at the tool X [+−]\d+", texts)
    assert "isotherms" in texts


def test_sensors_move_with_the_body_they_sit_on(coarse: VirtualMachine) -> None:
    still = np.zeros(coarse.system.states)
    marks = {m.label: m for m in sensor_marks(coarse)}
    low, high = (warm_machine(coarse, still, still, {**MIDDLE, "Y": y}, 0.0) for y in (0.0, 3000.0))
    rise = {name: picture.spot_m(high, m) - picture.spot_m(low, m) for name, m in marks.items()}
    assert rise["θ11"] == pytest.approx([0.0, 3.0, 0.0])  # nut of the headstock
    assert rise["θ1"] == pytest.approx([0.0, 3.0, 0.0])  # on the ram
    assert rise["θ7"] == pytest.approx([0.0, 0.0, 0.0])  # on the column
    assert rise["θ14 oil tank"] == pytest.approx([0.0, 0.0, 0.0])


def test_svg_of_a_picture_repeats(
    coarse: VirtualMachine, placed: Placement, small_pictures: None, tmp_path: Path
) -> None:
    shown = warm_machine(coarse, placed.warm_rise_K, placed.warm_rise_K, MIDDLE, 150.0)
    for name in ("a.svg", "b.svg"):
        (tmp_path / name).write_bytes(figure_content(machine_figure(shown, "title", sensor_marks(coarse)), name))
    text = (tmp_path / "a.svg").read_text(encoding="utf-8")
    assert text == (tmp_path / "b.svg").read_text(encoding="utf-8")
    assert "data:image/png;base64" in text
    assert "θ14 oil tank" in text


@pytest.fixture
def quick(coarse: VirtualMachine, short_work: None, small_pictures: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(virtual_machine, "build", lambda description: coarse)


def run_place(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["place", *arguments])
    return result.exit_code, result.output


def test_the_command_writes_tables_pictures_and_a_page(quick: None, tmp_path: Path) -> None:
    code, text = run_place("--out", str(tmp_path / "a"), "--sensors", "5", "--json")
    data = json.loads(text)
    assert (code, data["exit_code"], data["better_than_existing"]) == (0, 0, True)
    assert all(Path(name).exists() for name in data["files"])
    with (tmp_path / "a" / "places.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["strategy"] == "displacement"]
    assert [row["rank"] for row in rows] == ["1", "2", "3", "4", "5"]
    told = data["strategies"]["displacement"]
    assert [row["part"] for row in rows] == [place["part"] for place in told["places"]]
    assert float(rows[4]["error_um"]) == pytest.approx(told["errors"][5]["vector_um"], abs=0.005)
    with (tmp_path / "a" / "accuracy.csv").open(encoding="utf-8") as file:
        existing = [row for row in csv.DictReader(file) if row["strategy"] == "existing"]
    assert [int(row["sensors"]) for row in existing] == list(range(16))
    page = (tmp_path / "a" / "placement.html").read_text(encoding="utf-8")
    assert page.count("<svg") == 2
    assert not re.search(r"(src|href)=\"https?:", page)

    code, words = run_place("--out", str(tmp_path / "b"), "--sensors", "5")
    assert code == 0
    assert "5 sensors at the chosen places leave" in words
    for name in ("places.csv", "accuracy.csv", "placement.html", "figures/machine.svg", "figures/machine.png"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes(), name


def test_the_command_ends_with_3_where_the_existing_places_are_better(quick: None, tmp_path: Path) -> None:
    file = tmp_path / "poor.toml"
    file.write_text('format = 1\napart_mm = 0.0\nparts = ["x_motor", "oil"]\n', encoding="utf-8")
    everywhere = "from_mm = [-9e4, -9e4, -9e4]\nto_mm = [9e4, 9e4, 9e4]\n"
    with file.open("a", encoding="utf-8") as stream:
        for body in ("bed", "column", "headstock", "ram"):
            stream.write(f'[[keep_out]]\nname = "{body}"\nbody = "{body}"\n{everywhere}')
    code, text = run_place("--out", str(tmp_path / "out"), "--mounting", str(file), "--sensors", "2")
    assert code == 3
    assert "NOT BETTER: keep the existing places." in text
    code, text = run_place("--out", str(tmp_path / "out"), "--mounting", str(file), "--sensors", "3")
    assert code == 1
    assert "only 2 of 3 sensors find a place" in text


def test_the_command_tells_bad_input_in_one_line(tmp_path: Path) -> None:
    code, text = run_place("--out", str(tmp_path / "out"), "--mounting", "nowhere")
    assert code == 1
    assert "neither a file nor one of the bundled tk6920_mounting" in text
    assert run_place("--out", str(tmp_path / "out"), "--sensors", "0")[0] == 2

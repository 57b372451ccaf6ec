"""Sensors at chosen places: from places.csv to a machine that carries exactly these, and on to the paper's method."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from typer.testing import CliRunner

from thetacomp.axis_states import axis_states
from thetacomp.cli.main import app
from thetacomp.errors import InputError
from thetacomp.fitting.procedures import paper_procedure
from thetacomp.machine import Machine
from thetacomp.reading import check_folder, read_folder
from thetacomp.separation import separate_campaign
from thetatwin import picture, virtual_machine
from thetatwin.campaigns import make_twin, plan_campaigns
from thetatwin.conditions import Conditions
from thetatwin.description import Description
from thetatwin.mounting import Candidates, candidates, load_mounting
from thetatwin.picture import sensor_marks
from thetatwin.placement_page import places_table
from thetatwin.sensor_sets import read_places, with_sensors
from thetatwin.thermal import sensor_rows
from thetatwin.virtual_machine import VirtualMachine
from thetatwin.writer import write_twin

COARSE = 0.4  # the refinement of the machine of these tests
HEAD = "strategy,rank,part,side,x_mm,y_mm,z_mm\n"
# Corners of the castings' boxes in tk6920.toml: they are nodes of every mesh.
CORNERS = (
    ("bed", (-1300.0, 0.0, -900.0)),
    ("bed", (5300.0, 0.0, 900.0)),
    ("column", (1050.0, 6130.0, 750.0)),
    ("column", (-1100.0, 1330.0, -900.0)),
    ("headstock", (-1530.0, 2900.0, 900.0)),
    ("headstock", (-1530.0, 1500.0, -1100.0)),
    ("ram", (-1260.0, 2460.0, -2200.0)),
)
PARTS = (
    ("y_nut", (-390.0, 2200.0, 100.0)),
    ("w_nut", (-1000.0, 2500.0, -200.0)),
    ("x_motor", (-800.0, 1600.0, 500.0)),
    ("x_gear", (0.0, 1100.0, 0.0)),
    ("oil", (800.0, 600.0, 1800.0)),
    ("y_motor", (-200.0, 6400.0, 0.0)),
    ("spindle_front", (-1000.0, 2200.0, -1950.0)),
    ("gearbox", (-1000.0, 2200.0, 600.0)),
)


def table(places: tuple[tuple[str, tuple[float, float, float]], ...], strategy: str = "displacement") -> str:
    rows = [f"{strategy},{k},{part},,{x},{y},{z}\n" for k, (part, (x, y, z)) in enumerate(places, start=1)]
    return HEAD + "".join(rows)


def written(folder: Path, text: str) -> Path:
    path = folder / "places.csv"
    path.write_text(text, encoding="utf-8")
    return path


def carrying(machine: VirtualMachine, description: Description) -> VirtualMachine:
    """The same machine with other sensors, without solving it again: only the rows of the sensors are new."""
    own = sensor_rows(description, machine.meshes, machine.system)
    rows = np.concatenate([own, machine.rows[len(machine.description.sensors) :]])
    reduced = replace(machine.reduced, rows=rows @ machine.reduced.shapes)
    return replace(machine, description=description, rows=rows, reduced=reduced)


@pytest.fixture(scope="module")
def placed(coarse: VirtualMachine, tmp_path_factory: pytest.TempPathFactory) -> VirtualMachine:
    path = written(tmp_path_factory.mktemp("places"), table((*CORNERS, *PARTS)))
    return carrying(coarse, with_sensors(coarse.description, read_places(path), COARSE))


# --- from the table to the machine ------------------------------------------------------------------------------------


def test_every_candidate_of_place_comes_back_as_exactly_its_state(coarse: VirtualMachine, tmp_path: Path) -> None:
    free: Candidates = candidates(coarse, load_mounting("tk6920_mounting", coarse.description))
    n = len(free.state)
    choice = SimpleNamespace(
        strategy="displacement", chosen=np.arange(n), curve=SimpleNamespace(judged_um=np.zeros((n + 1, 4)))
    )
    placement = SimpleNamespace(candidates=free, choices=(choice,), nearest_id=("",) * n, nearest_mm=np.zeros(n))
    head, table = places_table(cast(Any, placement))
    text = "\n".join(",".join(row) for row in (head, *table))
    description = with_sensors(coarse.description, read_places(written(tmp_path, text)), COARSE)
    rows = sensor_rows(description, coarse.meshes, coarse.system)
    assert n > 300
    assert np.array_equal(rows.argmax(axis=1), free.state)
    assert np.array_equal(rows.sum(axis=1), np.ones(n))
    assert np.array_equal(rows.max(axis=1), np.ones(n))


def test_ranks_name_the_sensors_and_other_strategies_stay_out(tmp_path: Path) -> None:
    rows = "displacement,2,ram,,1,2,3\nmodes,1,oil,,0,0,0\ndisplacement,1,bed,-Z,4.5,5,-6\n"
    path = written(tmp_path, "\ufeff" + HEAD + rows)  # Excel writes a mark in front
    assert [(s.id, s.place, s.at_mm) for s in read_places(path)] == [
        ("place_1", "bed", (4.5, 5.0, -6.0)),
        ("place_2", "ram", (1.0, 2.0, 3.0)),
    ]
    assert [s.place for s in read_places(path, "modes")] == ["oil"]


def test_a_sensor_on_a_part_inherits_role_axis_and_references(placed: VirtualMachine) -> None:
    description = placed.description
    by_place = {s.place: s for s in description.sensors if s.place not in placed.meshes}
    assert {name: (s.role, s.axis) for name, s in by_place.items()} == {
        "y_nut": ("drive", "Y"),
        "w_nut": ("drive", "W"),
        "x_motor": ("drive", "X"),
        "x_gear": ("drive", "X"),
        "oil": ("fluid", None),
        "y_motor": ("drive", "Y"),  # no sensor sits there in the description: what its heat source says
        "spindle_front": ("bearing", None),
        "gearbox": ("structure", None),
    }
    assert by_place["w_nut"].location == "w_nut (W axis feed screw nut), at X -1000, Y 2500, Z -200 mm"
    named = {s.name: s.sensor for s in description.sources if s.sensor is not None}
    assert named == {
        "X feed motor": by_place["x_motor"].id,
        "X feed gear": by_place["x_gear"].id,
        "Y feed motor": by_place["y_motor"].id,
        "Y feed screw nut": by_place["y_nut"].id,
        "W feed screw nut": by_place["w_nut"].id,
        "hydraulics": by_place["oil"].id,
        "spindle front bearings": by_place["spindle_front"].id,
        "headstock gears": by_place["gearbox"].id,
    }
    assert {a.name: a.sensor for a in description.axes} == {"X": None, "Y": None, "W": by_place["w_nut"].id}
    Machine(
        name="m",
        axes=description.machine_axes(),
        sensors=description.machine_sensors(),
        heat_sources=description.machine_heat_sources(),
    )


def test_a_sensor_on_a_casting_belongs_to_the_structure_and_says_where_it_is(placed: VirtualMachine) -> None:
    on_castings = [s for s in placed.description.sensors if s.place in placed.meshes]
    assert {(s.role, s.axis) for s in on_castings} == {("structure", None)}
    assert on_castings[0].location == "bed, corner between -X, -Y and -Z, at X -1300, Y 0, Z -900 mm"
    assert {s.id for s in placed.description.sensors} == {f"place_{k}" for k in range(1, 16)}
    labels = {mark.label for mark in sensor_marks(placed)}
    assert {"1", "12 oil tank", "15"} <= labels


def test_a_machine_keeps_its_own_sensors_unchanged(coarse: VirtualMachine) -> None:
    assert with_sensors(coarse.description, coarse.description.sensors) == coarse.description


# --- bad tables -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "there is no column strategy, rank, part, x_mm, y_mm, z_mm; the file is empty"),
        ("strategy;rank;part\n", "there is no column strategy, rank, part, x_mm, y_mm, z_mm; found strategy;rank;part"),
        ("strategy,rank,part,x_mm,z_mm\n", "there is no column y_mm; found strategy, rank"),
        (HEAD, "no place of the strategy 'displacement'; the table has no rows"),
        (table(CORNERS, "modes"), "no place of the strategy 'displacement'; found modes"),
        (HEAD + "displacement,1,bed,,one,0,nan\n", "row 2, column 'x_mm': found 'one', expected a number"),
        (HEAD + "displacement,1,bed,,0,0,nan\n", "row 2, column 'z_mm': found 'nan', expected a number"),
        (HEAD + "displacement,0,bed,,0,0,0\n", "column 'rank': found the rank 0, expected 1, 2, 3"),
        (HEAD + "displacement,1,bed,,0,0,0\n\ndisplacement,1,ram,,0,0,0\n", "row 4, column 'rank': found the rank 1"),
        (HEAD + "displacement,1,bed,,2113,3,0,0\n", "row 2: this row has not 7 cells"),
        (HEAD + 'displacement,1,"bed,,0,0,0\n', "this is not a text table"),
    ],
)
def test_a_bad_table_is_told_in_one_message(tmp_path: Path, text: str, told: str) -> None:
    with pytest.raises(InputError) as caught:
        read_places(written(tmp_path, text))
    assert told in str(caught.value)
    assert "Fix: " in str(caught.value)


def test_no_file_a_folder_and_other_bytes(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"there is no such file"):
        read_places(tmp_path / "nowhere.csv")
    with pytest.raises(InputError, match=r"a folder, not a table. Fix: name the file in it: .*places\.csv"):
        read_places(tmp_path)
    (tmp_path / "x.csv").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(InputError, match="not a text table"):
        read_places(tmp_path / "x.csv")


def test_places_that_the_machine_does_not_have_are_all_told(coarse: VirtualMachine, tmp_path: Path) -> None:
    (_, corner), (part, at_mm), *_ = *CORNERS[:1], *PARTS
    places = (
        ("table", corner),
        ("bed", (corner[0], corner[1] + 20.0, corner[2])),
        (part, (at_mm[0] + 500.0, *at_mm[1:])),
        ("bed", corner),
        ("bed", corner),
    )
    with pytest.raises(InputError) as caught:
        with_sensors(coarse.description, read_places(written(tmp_path, table(places))), COARSE)
    told = [str(p) for p in caught.value.problems]
    assert len(told) == 5
    assert (
        "sensor place_1: virtual TK6920 has no part 'table'; known are bed, column, headstock, ram, spindle" in told[0]
    )
    assert (
        "(-1300.0, 20.0, -900.0) mm on bed is 20 mm away from the nearest node of its surface, (-1300.0, 0.0" in told[1]
    )
    assert "y_nut is 500 mm away from the nearest place of that part" in told[2]
    # the third, 20 mm beside it, would sit on the same node as well
    assert "sensor place_4: it sits on bed where place_2 sits." in told[3]
    assert "sensor place_5: it sits on bed where place_2 sits." in told[4]


# --- campaigns, and the paper's method --------------------------------------------------------------------------------


def test_the_papers_method_works_on_chosen_places_and_nothing_else_changes(
    placed: VirtualMachine, coarse: VirtualMachine, standard: Conditions, tmp_path: Path
) -> None:
    twins = [make_twin(machine, standard, seed=5) for machine in (placed, coarse)]
    for name, twin in zip(("placed", "own"), twins, strict=True):
        write_twin(tmp_path / name, twin, plan_campaigns(twin, 1))
    assert check_folder(tmp_path / "placed")[1] == ()
    # Fifteen sensors or fifteen others: heat, work, geometry and tracker are the same.
    for file in ("sweeps.csv", "drift.csv", "duty.csv"):
        own, other = ((tmp_path / n / "campaigns" / "2026-03-02" / file).read_bytes() for n in ("own", "placed"))
        assert own == other, file
    folder = read_folder(tmp_path / "placed")
    assert folder.machine.sensor_ids == tuple(f"place_{k}" for k in range(1, 16))
    campaign = folder.campaigns[0]
    states = axis_states(folder, separate_campaign(folder.machine, campaign), [campaign.name])
    by_axis = {s.axis: paper_procedure(folder.machine)(s) for s in states}
    for axis in "XYW":
        assert len(by_axis[axis].inputs) == 1
        assert by_axis[axis].inputs[0] in folder.machine.sensor_ids


def test_the_command_puts_the_sensors_of_the_table_on_the_machine(
    placed: VirtualMachine, coarse: VirtualMachine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    built: list[Description] = []

    def build(description: Description) -> VirtualMachine:
        built.append(description)
        return carrying(coarse, description)

    monkeypatch.setattr(virtual_machine, "build", build)
    monkeypatch.setattr(picture, "_PIXELS", 160)
    path = written(tmp_path, table((*CORNERS, *PARTS)) + table(CORNERS[:3], "modes").removeprefix(HEAD))
    arguments = ["twin", "--out", str(tmp_path / "m"), "--campaigns", "1", "--places", str(path), "--strategy", "modes"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert f"3 sensors of {path} (modes)" in result.output
    assert [s.id for s in built[0].sensors] == ["place_1", "place_2", "place_3"]
    assert read_folder(tmp_path / "m").machine.sensor_ids == ("place_1", "place_2", "place_3")
    assert (tmp_path / "m-truth" / "machine.png").exists()
    result = CliRunner().invoke(app, [*arguments[:2], str(tmp_path / "n"), "--places", str(tmp_path / "none.csv")])
    assert (result.exit_code, len(built)) == (1, 1)  # told before the long part
    assert "there is no such file" in result.output

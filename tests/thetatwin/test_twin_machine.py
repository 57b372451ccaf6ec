"""The whole virtual machine: signs, kinematics, the reduced model, and the mesh."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve

from thetacomp.errors import AnalysisError, InputError
from thetatwin.description import Description, load_description
from thetatwin.kinematics import rod_growth
from thetatwin.mesh import patch_weights
from thetatwin.thermal import transient
from thetatwin.virtual_machine import VirtualMachine, build

MIDDLE = {"X": 2000.0, "Y": 1500.0, "W": 500.0}


def error_um(
    machine: VirtualMachine, rise_K: np.ndarray, positions: Mapping[str, float] = MIDDLE, tool_mm: float = 0.0
) -> np.ndarray:
    poses = (machine.rows[machine.tool_rows] @ rise_K)[None]
    return np.asarray(machine.tool_error_um(poses, {k: np.array([v]) for k, v in positions.items()}, tool_mm)[0])


def slope_um_per_m(machine: VirtualMachine, rise_K: np.ndarray, axis: str) -> np.ndarray:
    lo, hi = next(a.travel_mm for a in machine.description.axes if a.name == axis)
    ends = [error_um(machine, rise_K, MIDDLE | {axis: p}) for p in (lo, hi)]
    return np.asarray((ends[1] - ends[0]) / ((hi - lo) / 1000.0))


def test_a_machine_warmer_by_one_kelvin_is_too_long_by_its_scales(coarse: VirtualMachine) -> None:
    """E = actual - commanded: a warm scale or screw gives a positive slope, that of its own expansion."""
    rise = np.ones(coarse.system.states)
    # scales 10.0e-6 per K, screw of the ram 11.5e-6 per K (preset); the bed is held a little by its mounts
    assert slope_um_per_m(coarse, rise, "X")[0] == pytest.approx(10.0, abs=0.2)
    assert slope_um_per_m(coarse, rise, "Y")[1] == pytest.approx(10.0, abs=0.05)
    assert slope_um_per_m(coarse, rise, "W")[2] == pytest.approx(11.5, abs=0.05)


def test_the_column_leans_under_a_front_to_rear_gradient_by_elasticity(coarse: VirtualMachine) -> None:
    """2 K/m through the column: it bends with the curvature alpha dT/h, so over 3 m it turns 10.8e-6 x 2 x 3 rad."""
    system = coarse.system
    column = slice(system.offset["column"], system.offset["column"] + system.size["column"])
    rise = np.zeros(system.states)
    rise[column] = 2.0 * coarse.meshes["column"].points_m[:, 2]
    low, high = (error_um(coarse, rise, MIDDLE | {"Y": y}) for y in (0.0, 3000.0))
    # warmer behind (+Z): the head leans to the front (-Z), which is a negative turn about X
    assert (high - low)[3] == pytest.approx(-64.8, rel=1e-2)
    # and the tool with it: -a g (y1² - y0²) / 2 beyond the line of its foot; compare three heights
    middle = error_um(coarse, rise, MIDDLE)
    assert (high - 2 * middle + low)[2] == pytest.approx(-10.8 * 2.0 * 1.5**2, rel=1e-2)


def test_the_lean_needs_the_gradient(coarse: VirtualMachine) -> None:
    rise = np.zeros(coarse.system.states)
    start = coarse.system.offset["column"]
    rise[start : start + coarse.system.size["column"]] = 2.0
    assert slope_um_per_m(coarse, rise, "Y")[[3, 5]] == pytest.approx(0.0, abs=1e-6)


def test_tool_length_and_ram_are_levers(coarse: VirtualMachine) -> None:
    """A rotation about X of r moves the end of a tool of length L along -Z by r L in Y."""
    rise = np.random.default_rng(1).uniform(0, 5, coarse.system.states)
    short, long = error_um(coarse, rise, tool_mm=0.0), error_um(coarse, rise, tool_mm=400.0)
    # u += r x d with d = (0, 0, -0.4 m): (-0.4 ry, +0.4 rx, 0)
    assert long - short == pytest.approx([-0.4 * short[4], 0.4 * short[3], 0, 0, 0, 0], abs=1e-9)


def test_a_machine_warmer_by_one_kelvin_grows_as_its_chain_of_lengths(coarse: VirtualMachine) -> None:
    """From the middle of the bed's feet to the nose, each length in m times its own expansion in µm/(m K)."""
    iron, scale, steel = 10.8, 10.0, 11.5
    error = error_um(coarse, np.ones(coarse.system.states), {"X": 0.0, "Y": 0.0, "W": 0.0})
    # bed from its middle (2.0) to the scale's end (-1.2), scale to the head (0), column to its rail (-0.43),
    # headstock to the spindle (-1.0)
    x = iron * (-1.2 - 2.0) + scale * (0.0 + 1.2) + iron * (-0.43 - 0.0) + iron * (-1.0 + 0.43)
    # bed to its rails (0.88), column to the scale's end (1.55), scale to the head (2.2), spindle at the same height
    y = iron * 0.88 + iron * (1.55 - 0.88) + scale * (2.2 - 1.55)
    # bed to its front rail (-0.65), column to its front rail (-0.575), headstock to the screw's bearing (0.9), screw
    # to the nut (-0.2), ram to the spindle's bearing (-1.975), spindle to the nose (-2.4)
    z = iron * (-0.65 + 0.075 + 1.475 - 1.775) + steel * (-1.1 - 0.425)
    assert error[:3] == pytest.approx([x, y, z], abs=0.6)
    assert error[3:] == pytest.approx(0.0, abs=0.3)


def test_a_guide_that_tilts_moves_the_tool_about_the_reading_head(coarse: VirtualMachine) -> None:
    """Abbe: only the bed warms from above; along X the tool errs by rotation times its distance from the head."""
    start, points = coarse.system.offset["bed"], coarse.meshes["bed"].points_m
    rise = np.zeros(coarse.system.states)
    rise[start : start + len(points)] = 5.0 * points[:, 1] + points[:, 2]
    errors = np.array([error_um(coarse, rise, MIDDLE | {"X": x}) for x in np.linspace(0, 4000, 9)])
    # head at 1.05 m height and -0.9 m depth; nose at 2.2 + 1.5 m and -2.4 + 0.5 m: u + r x lever
    about_head = errors[:, 4] * (-1.9 + 0.9) - errors[:, 5] * (3.7 - 1.05)
    assert np.ptp(about_head) > 50.0
    assert np.ptp(errors[:, 0] - about_head) < 0.01


def test_only_the_free_outside_of_a_body_meets_the_air(coarse: VirtualMachine) -> None:
    system, faces = coarse.system, coarse.meshes["bed"].faces
    area = np.prod(np.where(faces.normal != 0, 1.0, faces.hi_m - faces.lo_m), axis=1)
    bed = slice(system.offset["bed"], system.offset["bed"] + system.size["bed"])
    to_air = system.source[bed, system.inputs.index("air_K")].sum()
    to_ground = system.source[bed, system.inputs.index("ground_K")].sum()
    foot = 6.6 * 1.8
    # 8.5 W/(m² K) to air, 12 to the ground (preset)
    assert to_air == pytest.approx(8.5 * (area[~faces.inner].sum() - foot), rel=1e-6)
    assert to_ground == pytest.approx(12.0 * foot)


def test_the_picture_and_the_tool_map_agree(coarse: VirtualMachine) -> None:
    """The spindle's bearing moved by the displacement field, plus overhang and growth, is the tool error."""
    rise = np.random.default_rng(2).uniform(0, 5, coarse.system.states)
    where = {"X": 700.0, "Y": 2500.0, "W": 150.0}
    description = coarse.description
    seat = patch_weights(coarse.meshes["ram"], next(p for p in description.patches if p.name == description.nose))
    moved = coarse.displacement_m(rise, where)["ram"][seat.nodes]
    mean_um = 1e6 * (seat.weight_m2 @ moved) / seat.area_m2
    rod = next(r for r in description.rods if r.name == description.spindle)
    start = coarse.system.offset[rod.name]
    growth_um = 1e6 * float(rod_growth(description, rod, rod.to_mm[2] * 1e-3) @ rise[start : start + rod.segments])
    tool = error_um(coarse, rise, where)
    overhang = (rod.to_mm[2] - rod.from_mm[2]) * 1e-3
    expected = mean_um + np.array([tool[4] * overhang, -tool[3] * overhang, growth_um])
    assert tool[:3] == pytest.approx(expected, abs=1e-6)


def random_week(machine: VirtualMachine, step_s: float) -> np.ndarray:
    """Inputs that jump every four hours: all sources, all air inputs, the chiller."""
    rng = np.random.default_rng(7)
    names = machine.system.inputs
    blocks = []
    for _ in range(42):
        u = np.zeros(len(names))
        for source in machine.description.sources:
            u[names.index(source.name)] = rng.uniform(0, 800) * rng.integers(0, 2)
        u[names.index("cooling_W")] = 1500.0 * rng.integers(0, 2)
        u[names.index("air_K")] = 4 * rng.normal()
        u[names.index("air_gradient_K_per_m")] = rng.uniform(0, 1)
        u[names.index("air_rear_K_per_m")] = 0.3 * rng.normal()
        u[names.index("draught_K")] = rng.uniform(0, 5) * rng.integers(0, 2)
        u[names.index("ground_K")] = 1.0
        blocks.append(np.tile(u, (round(4 * 3600 / step_s), 1)))
    return np.concatenate(blocks)


def test_the_reduced_model_is_within_one_percent_of_the_full_one_over_a_random_week(coarse: VirtualMachine) -> None:
    step_s = 180.0  # at 300 s the time steps of the full model would err more than the reduction
    u = random_week(coarse, step_s)
    full = transient(coarse.system, u, step_s, coarse.rows)
    reduced = coarse.reduced.run(u, step_s)
    sensors = coarse.sensor_rows
    span = np.ptp(full[:, sensors], axis=0)
    assert (np.abs(full - reduced)[:, sensors].max(axis=0) < 0.01 * span).all()
    for where in ({"X": 0.0, "Y": 3000.0, "W": 0.0}, {"X": 4000.0, "Y": 0.0, "W": 1000.0}):
        at = {name: np.full(len(full), value) for name, value in where.items()}
        one = coarse.tool_error_um(full[:, coarse.tool_rows], at, 300.0)
        two = coarse.tool_error_um(reduced[:, coarse.tool_rows], at, 300.0)
        assert (np.abs(one - two).max(axis=0) < 0.01 * np.ptp(one, axis=0)).all()


def test_steady_states_of_the_reduced_model_are_exact(coarse: VirtualMachine) -> None:
    u = random_week(coarse, 4 * 3600.0)[5]
    full = coarse.rows @ spsolve(coarse.system.conductance, coarse.system.source @ u)
    reduced = coarse.reduced.rows @ coarse.reduced.steady(u)
    assert reduced == pytest.approx(full, rel=1e-6, abs=1e-6 * np.abs(full).max())


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_a_finer_mesh_changes_the_tool_by_less_than_two_percent() -> None:
    description = load_description("tk6920")
    watts = {s.name: 500.0 for s in description.sources}
    tools = []
    for refinement in (1.0, 1.5):
        machine = build(description, refinement)
        u = np.array([watts.get(name, 0.0) for name in machine.system.inputs])
        poses = machine.reduced.run(np.tile(u, (90, 1)), 300.0)[[24, 90]][:, machine.tool_rows]
        for where in ((0.0, 0.0, 0.0), (2000.0, 3000.0, 500.0), (4000.0, 1500.0, 1000.0)):
            at = {name: np.full(2, value) for name, value in zip("XYW", where, strict=True)}
            tools.append(machine.tool_error_um(poses, at, 300.0)[:, :3])
    coarse, fine = np.array(tools[:3]), np.array(tools[3:])
    change = np.linalg.norm(fine - coarse, axis=-1) / np.linalg.norm(fine, axis=-1)
    assert change.max() < 0.02


def changed(text: str, replacement: str) -> Description:
    source = resources.files("thetatwin").joinpath("presets", "tk6920.toml").read_text(encoding="utf-8")
    assert text in source
    return Description.model_validate(tomllib.loads(source.replace(text, replacement, 1)))


def test_a_scale_that_is_too_short_is_refused_by_name() -> None:
    short = changed("to_mm = [-380.0, 5300.0, -290.0]", "to_mm = [-380.0, 4300.0, -290.0]")
    with pytest.raises(AnalysisError, match=r"rod y_scale: the head reaches \d+ mm, beyond the rod"):
        build(short, refinement=0.4)


def test_pads_that_leave_a_motion_open_are_refused() -> None:
    loose = changed(
        'lower_pads = ["bed_front_rail", "bed_rear_rail", "bed_rail_outside", "bed_rail_inside"]',
        'lower_pads = ["bed_front_rail", "bed_rear_rail"]',
    )
    with pytest.raises(AnalysisError, match="axis X: its pads do not hold"):
        build(loose, refinement=0.4)


def test_a_wrong_name_in_a_machine_file_is_told_with_the_known_ones(tmp_path: Path) -> None:
    source = resources.files("thetatwin").joinpath("presets", "tk6920.toml").read_text(encoding="utf-8")
    path = tmp_path / "machine.toml"
    path.write_text(source.replace('b = "front_bearing_seat"', 'b = "front_seat"', 1), encoding="utf-8")
    with pytest.raises(InputError, match="a contact names 'front_seat', which is not described; known are"):
        load_description(path)


@pytest.mark.parametrize(("content", "message"), [("a = [", "not valid TOML"), ("a = 1", "Extra inputs")])
def test_broken_machine_files_are_told(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "machine.toml"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        load_description(path)


def test_an_unknown_machine_is_told_with_the_bundled_ones() -> None:
    with pytest.raises(InputError, match="neither a file nor one of the bundled tk6920"):
        load_description("tk7000")

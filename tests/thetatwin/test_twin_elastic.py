"""Thermo-elasticity against closed forms, reciprocity, and CalculiX."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp

from thetacomp.arrays import Floats
from thetatwin.description import Block, Body, Material, Patch
from thetatwin.elastic import Supported, assemble, support_on_springs, support_statically
from thetatwin.mesh import mesh_body

COLUMN = Block(from_mm=(0, 0, 0), to_mm=(600, 2400, 500), wall_mm=(30, 30, 30), ribs_Y_mm=(800.0, 1600.0), rib_mm=25.0)


def supported(block: Block, iron: Material, element_mm: float = 300.0) -> Supported:
    body = Body(
        name="part",
        material="iron",
        element_mm=element_mm,
        to_air_W_per_m2_K=8.0,
        to_cavity_W_per_m2_K=4.0,
        blocks=(block,),
    )
    return support_statically(assemble(mesh_body(body), iron))


def without_rigid_motion(points_m: Floats, moved_m: Floats) -> Floats:
    """Displacement less the rigid motion that fits it best."""
    x, y, z = (points_m - points_m.mean(axis=0)).T
    zero, one = np.zeros_like(x), np.ones_like(x)
    design = np.stack(
        [
            np.stack([one, zero, zero, zero, z, -y], axis=1),
            np.stack([zero, one, zero, -z, zero, x], axis=1),
            np.stack([zero, zero, one, y, -x, zero], axis=1),
        ],
        axis=1,
    ).reshape(-1, 6)
    flat = moved_m.ravel()
    return np.asarray(flat - design @ np.linalg.lstsq(design, flat, rcond=None)[0]).reshape(-1, 3)


def test_a_heated_bar_grows_by_alpha_length_rise(iron: Material) -> None:
    bar = supported(Block(from_mm=(0, 0, 0), to_mm=(100, 2000, 100)), iron)
    moved = bar.displacement(np.full(len(bar.body.mesh.points_m), 10.0))
    # 11e-6 per K x 2 m x 10 K = 220 µm, and 11 µm across
    assert np.ptp(moved[:, 1]) * 1e6 == pytest.approx(220.0, rel=1e-8)
    assert np.ptp(moved[:, 0]) * 1e6 == pytest.approx(11.0, rel=1e-8)


def test_a_hollow_column_under_a_linear_gradient_bends_by_alpha_gradient(iron: Material) -> None:
    column = supported(COLUMN, iron)
    points = column.body.mesh.points_m
    gradient = 4.0  # K/m from front to rear
    moved = column.displacement(gradient * points[:, 2])
    # A linear field leaves a free body without stress (Boley and Weiner, Theory of Thermal Stresses, ch. 3):
    # uz = a g (z² - x² - y²) / 2, ux = a g x z, uy = a g y z: curvature alpha dT/h along the column.
    x, y, z = points.T
    exact = 11e-6 * gradient * np.stack([x * z, y * z, 0.5 * (z**2 - x**2 - y**2)], axis=1)
    difference = without_rigid_motion(points, moved - exact)
    assert np.abs(difference).max() < 1e-7 * np.abs(without_rigid_motion(points, exact)).max()
    # The lean itself: the foot to the head of 2.4 m turn by 11e-6 x 4 x 2.4 rad = 105.6 µrad.
    edge = (np.abs(x) < 1e-9) & (np.abs(z) < 1e-9)
    order = np.argsort(y[edge])
    slope = np.gradient(moved[edge, 2][order], y[edge][order], edge_order=2)
    assert (slope[-1] - slope[0]) * 1e6 == pytest.approx(-105.6, rel=1e-6)


def test_a_held_bar_is_under_the_stress_of_hookes_law(iron: Material) -> None:
    """Springs far stiffer than the bar at both ends: the force on them is E A alpha T, less what Poisson adds."""
    bar = supported(Block(from_mm=(0, 0, 0), to_mm=(100, 4000, 100)), iron, element_mm=200.0)
    mesh = bar.body.mesh
    ends = [
        Patch(name="foot", body="part", normal="-Y", from_mm=(0, 0, 0), to_mm=(100, 0, 100)),
        Patch(name="head", body="part", normal="+Y", from_mm=(0, 4000, 0), to_mm=(100, 4000, 100)),
    ]
    held = support_on_springs(bar.body, ends, 1e16, 1.0)
    moved = held.under_force(held.body.load @ np.full(len(mesh.points_m), 10.0))
    # What the springs push: internal force of the bar less the load of the heat, summed over one end.
    reaction = held.body.stiffness @ moved - held.body.load @ np.full(len(mesh.points_m), 10.0)
    count = held.body.dofs_per_direction
    far = held.body.spaces.quadratic.doflocs[1] > 4.0 - 1e-9
    force_N = -float(reaction[count : 2 * count][far].sum())
    # 120 GPa x 0.01 m² x 11e-6 x 10 = 132 kN
    assert force_N == pytest.approx(132e3, rel=1e-3)


def test_reciprocity_of_forces(iron: Material) -> None:
    """Maxwell and Betti: what a force at i does at j, a force at j does at i."""
    column = supported(COLUMN, iron)
    rng = np.random.default_rng(1)
    pair = rng.choice(column.free, size=2, replace=False)
    force = np.zeros((column.body.stiffness.shape[0], 2))
    force[pair, [0, 1]] = 1000.0
    moved = column.under_force(force)
    assert moved[pair[1], 0] == pytest.approx(moved[pair[0], 1], rel=1e-6)
    assert moved[pair[1], 0] != 0.0


def test_reciprocity_of_heat_and_displacement(iron: Material) -> None:
    """An output solved by its own force pattern equals the displacement solved from the temperatures."""
    column = supported(COLUMN, iron)
    rng = np.random.default_rng(2)
    form = np.zeros((2, column.body.stiffness.shape[0]))
    form[:, rng.choice(column.free, size=40, replace=False)] = rng.normal(size=(2, 40))
    rise = rng.normal(size=len(column.body.mesh.points_m))
    direct = form @ column.under_force(column.body.load @ rise)
    assert column.outputs(sp.csr_matrix(form)) @ rise == pytest.approx(direct, rel=1e-8)


def write_calculix(path: Path, column: Supported, iron: Material, rise_K: Floats) -> Floats:
    """Write the same mesh as CalculiX C3D20 elements; returns the nodes (n, 3) in CalculiX' numbering."""
    space = column.body.spaces.quadratic
    nodes, element = np.asarray(space.doflocs.T), np.asarray(space.element_dofs.T)
    corner_bits = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    pairs = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)]
    places = np.array([*corner_bits, *(np.add(corner_bits[a], corner_bits[b]) / 2 for a, b in pairs)])
    lines = ["*NODE, NSET=ALL", *(f"{i + 1}, {p[0]:.9g}, {p[1]:.9g}, {p[2]:.9g}" for i, p in enumerate(nodes))]
    lines.append("*ELEMENT, TYPE=C3D20, ELSET=BODY")
    for number, own in enumerate(element):
        lo, hi = nodes[own].min(axis=0), nodes[own].max(axis=0)
        unit = (nodes[own] - lo) / (hi - lo)
        order = [int(own[np.argmin(np.linalg.norm(unit - place, axis=1))]) + 1 for place in places]
        lines += [f"{number + 1}, {', '.join(map(str, order[:15]))},", ", ".join(map(str, order[15:]))]
    held = np.setdiff1d(np.arange(column.body.stiffness.shape[0]), column.free)
    count = column.body.dofs_per_direction
    temperature = linear_to_quadratic(column, rise_K)
    lines += [
        "*MATERIAL, NAME=IRON\n*ELASTIC",
        f"{iron.young_GPa * 1e9:.6g}, {iron.poisson}\n*EXPANSION, ZERO=0\n{iron.expansion_per_K}",
        "*SOLID SECTION, ELSET=BODY, MATERIAL=IRON\n*BOUNDARY",
        *(f"{d % count + 1}, {d // count + 1}, {d // count + 1}" for d in held),
        "*INITIAL CONDITIONS, TYPE=TEMPERATURE\nALL, 0\n*STEP\n*STATIC\n*TEMPERATURE",
        *(f"{i + 1}, {t:.9g}" for i, t in enumerate(temperature)),
        "*NODE PRINT, NSET=ALL\nU\n*END STEP",
    ]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return nodes


def linear_to_quadratic(column: Supported, rise_K: Floats) -> Floats:
    """Temperatures at all nodes of the quadratic mesh: means of the two ends on edges."""
    space, mesh = column.body.spaces.quadratic, column.body.mesh
    out = np.full(space.N, np.nan)
    out[column.body.spaces.vertex] = rise_K
    ends = mesh.points_m[np.asarray(space.mesh.edges)]
    assert np.allclose(ends.mean(axis=0 if ends.shape[0] == 2 else 1), space.doflocs.T[space.edge_dofs[0]])
    out[space.edge_dofs[0]] = rise_K[np.asarray(space.mesh.edges)].mean(axis=0)
    return out


@pytest.mark.needs("calculix-ccx")
def test_calculix_finds_the_same_displacement(iron: Material, tmp_path: Path) -> None:
    column = supported(COLUMN, iron)
    points = column.body.mesh.points_m
    # A warm wall that fades with height: nothing that a closed form covers.
    rise = 10.0 * np.exp(-points[:, 2] / 0.2) * (1 + 0.5 * np.cos(2 * points[:, 1])) + 3 * points[:, 0] ** 2
    write_calculix(tmp_path / "column.inp", column, iron, rise)
    subprocess.run(["ccx", "column"], cwd=tmp_path, check=True, capture_output=True, timeout=100)
    rows = [line.split() for line in (tmp_path / "column.dat").read_text(encoding="ascii").splitlines()]
    table = np.array([[float(v) for v in row] for row in rows if len(row) == 4 and row[0].isdigit()])
    theirs = table[np.argsort(table[:, 0])][column.body.spaces.vertex, 1:]
    ours = column.displacement(rise)
    assert np.abs(ours).max() > 50e-6
    assert np.abs(ours - theirs).max() < 1e-4 * np.abs(ours).max()

"""Meshes of boxes against volumes, areas and moments that can be worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from thetacomp.errors import AnalysisError
from thetatwin.description import Block, Body, Patch
from thetatwin.mesh import face_weights, mesh_body, patch_weights


def body(blocks: tuple[Block, ...], cuts: tuple[Block, ...] = (), element_mm: float = 200.0) -> Body:
    return Body(
        name="part",
        material="iron",
        element_mm=element_mm,
        to_air_W_per_m2_K=8.0,
        to_cavity_W_per_m2_K=4.0,
        blocks=blocks,
        cuts=cuts,
    )


HOLLOW = Block(from_mm=(0, 0, 0), to_mm=(1000, 2000, 800), wall_mm=(50, 50, 50), ribs_Y_mm=(700.0, 1300.0), rib_mm=40.0)


def volume_m3(mesh_cells: np.ndarray, points_m: np.ndarray) -> float:
    size = points_m[mesh_cells[:, 7]] - points_m[mesh_cells[:, 0]]
    return float(np.prod(size, axis=1).sum())


def test_volume_of_a_ribbed_box_is_that_of_its_walls_and_ribs() -> None:
    mesh = mesh_body(body((HOLLOW,)))
    # outer box less the cavity, plus two ribs across the cavity of 0.9 m x 0.7 m
    assert volume_m3(mesh.cells, mesh.points_m) == pytest.approx(1.6 - 0.9 * 1.9 * 0.7 + 2 * 0.04 * 0.9 * 0.7)


def test_outer_faces_have_the_area_of_the_box_and_inner_ones_that_of_the_cavities() -> None:
    faces = mesh_body(body((HOLLOW,))).faces
    area = np.prod(np.where(faces.normal != 0, 1.0, faces.hi_m - faces.lo_m), axis=1)
    assert area[~faces.inner].sum() == pytest.approx(2 * (1.0 * 2.0 + 2.0 * 0.8 + 1.0 * 0.8))
    # three cavities 0.9 x 0.7 m across and 0.63, 0.56, 0.63 m high
    assert area[faces.inner].sum() == pytest.approx(6 * 0.9 * 0.7 + 2 * (0.9 + 0.7) * (0.63 + 0.56 + 0.63))


def test_a_bore_counts_as_inner_faces() -> None:
    block = Block(from_mm=(0, 0, 0), to_mm=(600, 600, 1000))
    bore = Block(from_mm=(200, 200, 0), to_mm=(400, 400, 1000))
    mesh = mesh_body(body((block,), (bore,)))
    area = np.prod(np.where(mesh.faces.normal != 0, 1.0, mesh.faces.hi_m - mesh.faces.lo_m), axis=1)
    assert area[mesh.faces.inner].sum() == pytest.approx(4 * 0.2 * 1.0)


@pytest.mark.parametrize("element_mm", [90.0, 333.0])
def test_weights_over_a_rectangle_are_exact_on_any_mesh(element_mm: float) -> None:
    mesh = mesh_body(body((Block(from_mm=(0, 0, 0), to_mm=(1000, 2000, 800)),), element_mm=element_mm))
    weights = face_weights(mesh, np.array([1.0, 0.37, 0.11]), np.array([1.0, 1.61, 0.5]), "+X")
    points = mesh.points_m[weights.nodes]
    assert weights.area_m2 == pytest.approx(1.24 * 0.39)
    # the shape functions carry linear functions exactly, so the centroid is that of the rectangle
    assert weights.weight_m2 @ points / weights.area_m2 == pytest.approx([1.0, 0.99, 0.305])


def test_a_patch_beside_the_body_is_refused_with_its_name() -> None:
    mesh = mesh_body(body((HOLLOW,)))
    patch = Patch(name="pad", body="part", normal="+X", from_mm=(2000, 0, 0), to_mm=(2000, 100, 100))
    with pytest.raises(AnalysisError, match="patch pad: body part has no face"):
        patch_weights(mesh, patch)


def test_a_body_without_material_is_refused() -> None:
    block = Block(from_mm=(0, 0, 0), to_mm=(100, 100, 100))
    with pytest.raises(AnalysisError, match="no material is left"):
        mesh_body(body((block,), (block,)))

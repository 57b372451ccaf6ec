"""The depth buffer, isotherms and labels behind the machine pictures, by hand on small figures."""

from __future__ import annotations

import numpy as np
import pytest

from thetatwin.label_placement import Label, place_labels
from thetatwin.picture import isotherm_step
from thetatwin.raster import Canvas, contour_lines, paint, smaller


def square(left: float, low: float, size: float, depth: float) -> list[list[float]]:
    return [
        [left, low, depth],
        [left + size, low, depth],
        [left + size, low + size, depth],
        [left, low + size, depth],
    ]


def at(canvas: Canvas, x: float, y: float) -> float:
    row, column = int((y - canvas.low_m) / canvas.step_m), int((x - canvas.left_m) / canvas.step_m)
    return float(canvas.value[row, column])


def test_the_nearer_face_hides_the_one_behind_in_any_order():
    near, far = square(0.0, 0.0, 1.0, depth=2.0), square(0.5, 0.5, 1.0, depth=1.0)
    for faces, values in (([near, far], [10.0, 20.0]), ([far, near], [20.0, 10.0])):
        canvas = paint(np.array(faces), np.array(values)[:, None] * np.ones((2, 4)), np.ones(2), 150)
        assert at(canvas, 0.75, 0.75) == 10.0
        assert at(canvas, 1.25, 1.25) == 20.0
        assert np.isnan(at(canvas, 1.25, 0.25))
        seen = canvas.sees(np.array([[0.75, 0.75, 1.0], [0.75, 0.75, 2.0], [1.25, 1.25, 1.0]]))
        assert seen.tolist() == [False, True, True]


def test_values_are_bilinear_and_leave_no_gap_between_the_triangles():
    canvas = paint(np.array([square(0.0, 0.0, 1.0, 0.0)]), np.array([[0.0, 10.0, 30.0, 4.0]]), np.ones(1), 101)
    assert np.isfinite(canvas.value[:, :101]).all()
    # Bilinear in the middle of the square: the mean of the corners, whichever triangle the pixel belongs to.
    assert canvas.value[50, 50] == pytest.approx(44.0 / 4, abs=1e-6)
    assert at(canvas, 0.25, 0.75) == pytest.approx(0.1875 * 4 * 0.0 + 0.0625 * 10 + 0.1875 * 30 + 0.5625 * 4, abs=0.2)


def test_isotherms_run_where_the_value_passes_a_step_and_not_along_edges():
    values = np.array([[20.0, 24.0, 24.0, 20.0], [41.0, 41.0, 41.0, 41.0]])
    faces = np.array([square(0.0, 0.0, 1.0, 0.0), square(1.0, 0.0, 1.0, 0.0)])
    canvas = paint(faces, values, np.ones(2), 100)
    marked = np.flatnonzero(contour_lines(canvas, 2.0)[50])
    # 22 °C lies in the middle of the first square; the jump from 24 to 41 °C between the squares is no isotherm.
    assert set(marked) == {49, 50}


def test_steps_of_isotherms_are_round_and_few():
    assert isotherm_step(18.0) == 2.0
    assert isotherm_step(6.5) == 0.5
    assert isotherm_step(0.0) == 1.0
    for span in (0.3, 3.0, 7.7, 55.0):
        assert 5 <= span / isotherm_step(span) <= 14


def test_a_half_covered_block_is_half_transparent_and_keeps_its_colour():
    image = np.zeros((2, 2, 4))
    image[0] = [1.0, 0.5, 0.0, 1.0]
    assert smaller(image, 2)[0, 0] == pytest.approx([1.0, 0.5, 0.0, 0.5])


def test_labels_of_neighbours_do_not_cover_each_other_or_the_dots():
    labels = [Label(f"θ{k}", (100.0 + 12.0 * k, 100.0 + 3.0 * (k % 2))) for k in range(6)]
    offsets = place_labels(labels, 10.0)
    middles = np.array([label.point for label in labels]) + np.array(offsets)
    half = np.array([(0.68 * 2 + 0.5) * 5.0, 7.5])
    for a in range(6):
        for b in range(a):
            assert np.any(np.abs(middles[a] - middles[b]) >= 2 * half - 1e-6)
        for label in labels:
            assert np.any(np.abs(middles[a] - np.array(label.point)) >= half)
    assert place_labels([], 10.0) == []

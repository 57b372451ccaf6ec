"""Where a sweep ends and from which side a point was approached, by hand-made motions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from thetacomp.reading.sweeps import segment

OUT, BACK = [0, 100, 200, 300], [300, 200, 100, 0]


def parted(
    position: Sequence[float], run: list[str] | None = None, direction: list[int] | None = None, axis: str | None = None
) -> tuple[list[int], list[int]]:
    names = list(axis) if axis is not None else ["X"] * len(position)
    given = None if direction is None else np.array(direction)
    sweep, approach = segment(names, np.array(position, dtype=float), run, given)
    return sweep.tolist(), approach.tolist()


@pytest.mark.parametrize(
    ("name", "position", "sweep", "approach"),
    [
        ("one way", OUT, [0] * 4, [1] * 4),
        ("one way, falling", BACK, [0] * 4, [-1] * 4),
        ("out and back, turning point once", [*OUT, *BACK[1:]], [0] * 7, [1] * 4 + [-1] * 3),
        ("out and back, turning point read on both ways", OUT + BACK, [0] * 8, [1] * 4 + [-1] * 4),
        ("twice out and back", 2 * (OUT + BACK), [0] * 8 + [1] * 8, 2 * ([1] * 4 + [-1] * 4)),
        (
            "twice out and back, each turning point once",
            [*OUT, *BACK[1:], *OUT[1:], *BACK[1:]],
            [0] * 7 + [1] * 6,
            [1] * 4 + [-1] * 3 + [1] * 3 + [-1] * 3,
        ),
        ("one way three times", 3 * OUT, [0] * 4 + [1] * 4 + [2] * 4, [1] * 12),
        ("falling twice", 2 * BACK, [0] * 4 + [1] * 4, [-1] * 8),
        (
            "two readings at each position, with scatter",
            [0, 0.02, 100, 100.01, 200, 199.99, 100.01, 100, 0.01, 0],
            [0] * 10,
            [1] * 6 + [-1] * 4,
        ),
        (
            "two readings at each position of both ways",
            [0, 0.02, 100, 100.01, 200, 199.99, 200, 200.01, 100.01, 100, 0.01, 0],
            [0] * 12,
            [1] * 6 + [-1] * 6,
        ),
        ("a single position", [50, 50], [0, 0], [0, 0]),
    ],
)
def test_parted_by_motion(name: str, position: list[float], sweep: list[int], approach: list[int]) -> None:
    assert parted(position) == (sweep, approach), name


def test_a_change_of_axis_ends_a_sweep() -> None:
    assert parted(OUT + OUT, axis="XXXXYYYY")[0] == [0] * 4 + [1] * 4
    assert parted(OUT + BACK, axis="XXXXYYYY")[1] == [1] * 4 + [-1] * 4


def test_run_decides_where_it_is_given() -> None:
    runs = ["1"] * 8 + ["2"] * 8
    sweep, approach = parted(2 * (OUT + BACK), run=runs)
    assert sweep == [0] * 8 + [1] * 8
    assert approach == 2 * ([1] * 4 + [-1] * 4)
    assert parted(OUT + OUT + OUT, run=["1"] * 12)[0] == [0] * 12
    assert parted(OUT + OUT, run=["1"] * 8, axis="XXXXYYYY")[0] == [0] * 4 + [1] * 4


def test_given_directions_are_kept_and_part_the_sweeps() -> None:
    given = 2 * ([1] * 4 + [-1] * 4)
    assert parted(2 * (OUT + BACK), direction=given) == ([0] * 8 + [1] * 8, given)
    assert parted(OUT + OUT, direction=[1] * 8) == ([0] * 4 + [1] * 4, [1] * 8)
    # Where some are not known, the motion says them.
    assert parted(OUT, direction=[0, -1, 0, 0])[1] == [1, -1, 1, 1]


def test_uneven_and_fine_steps() -> None:
    """Steps of 2 mm beside a return of 3000 mm: still moves, not scatter."""
    fine = [float(p) for p in range(0, 3001, 2)]
    sweep, approach = parted(fine + fine)
    assert sweep == [0] * len(fine) + [1] * len(fine)
    assert set(approach) == {1}

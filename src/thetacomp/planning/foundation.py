"""Targets on the foundation: where to put them, and how well they tie a round to the cold block."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import CARTESIAN, Floats
from thetacomp.planning.setup import Setup
from thetacomp.planning.steps import TARGETS

# Half a metre beyond the reach of the tool, so that the warm machine does not stand on them.
BEYOND_MM, BELOW_MM, LEAST_SPAN_MM = 500.0, 300.0, 2000.0
READINGS_A_ROUND = 2  # at its begin and at its end


@dataclass(frozen=True)
class FoundationTarget:
    """A proposed place in the frame of the tool point, `at_mm` (3,)."""

    name: str
    at_mm: Floats


def propose_targets(setup: Setup) -> tuple[FoundationTarget, ...]:
    """The four corners of the machine's footprint: three fix the frame, the fourth checks them."""
    reach_low, reach_high = tool_reach_mm(setup)
    low, high = reach_low - BEYOND_MM, reach_high + BEYOND_MM
    short = high - low < LEAST_SPAN_MM
    middle = 0.5 * (low + high)
    low = np.where(short, middle - LEAST_SPAN_MM / 2, low)
    high = np.where(short, middle + LEAST_SPAN_MM / 2, high)
    up = CARTESIAN.index(setup.options.vertical)
    first, second = (k for k in range(3) if k != up)
    floor_mm = float(reach_low[up]) - BELOW_MM
    places = []
    # Around the footprint, so that neighbours in number are neighbours on the floor.
    for a, b in ((low, low), (high, low), (high, high), (low, high)):
        place = np.full(3, floor_mm)
        place[first], place[second] = a[first], b[second]
        places.append(place)
    return tuple(FoundationTarget(name, place) for name, place in zip(TARGETS, places, strict=True))


def tool_reach_mm(setup: Setup) -> tuple[Floats, Floats]:
    """Lowest and highest place of the tool point, (3,) each, with all axes free within their turns."""
    names = [axis.name for axis in setup.axes]
    corners = itertools.product(*(axis.turn_mm for axis in setup.axes))
    places = np.array([setup.tool_mm(dict(zip(names, corner, strict=True))) for corner in corners])
    return places.min(axis=0), places.max(axis=0)


def rigid_rows(point_mm: Floats, centre_mm: Floats) -> Floats:
    """Displacement (3, 6) of a point in µm by a small motion about a centre: translations in µm, rotations in µrad."""
    x, y, z = (point_mm - centre_mm) / 1000.0
    rotation = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
    return np.hstack([np.eye(3), rotation])


def tie_covariance(setup: Setup, targets: tuple[FoundationTarget, ...], centre_mm: Floats) -> Floats:
    """Covariance (6, 6) of the motion of the station in one round, from the targets' readings, about a centre.

    Least squares for six unknowns without scale: `(Σ JᵀJ / u²)⁻¹` over all readings of all targets.
    """
    normal = np.zeros((6, 6))
    for target in targets:
        rows = rigid_rows(target.at_mm, centre_mm)
        sd_um = standard_um(setup, setup.distance_mm(target.at_mm))
        normal += READINGS_A_ROUND * rows.T @ rows / sd_um**2
    return np.asarray(np.linalg.inv(normal))


def standard_um(setup: Setup, distance_mm: float) -> float:
    """Standard uncertainty (k = 1) of a coordinate: half the stated expanded one."""
    return (setup.options.tracker_u_um + setup.options.tracker_u_um_per_m * distance_mm / 1000.0) / 2.0

"""What a plan can see: standard errors of slope, intercept and drift, in closed form from the planned points.

A round is compared with the mean of the `c` cold rounds at the same positions, so the geometry drops out and the
covariance of the fitted line (I, S) of a heated round is

    (1 + 1/c) [ (XᵀX)⁻¹ XᵀVX (XᵀX)⁻¹ + diag(0, (b/2)²) ],     X = [1, (p - P0)/1000],  V = diag(u_i²),  u = (a + b d)/2

with the expanded uncertainty (k = 2) `a + b d` of a point at the distance d. The second term is an angle error of the
instrument that is common to a sweep: `thetacomp analyze` takes it into its standard errors in the same way. What the
foundation targets leave open about the station is added where the drift of the tool against the floor is evaluated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import CARTESIAN, Floats
from thetacomp.planning.foundation import FoundationTarget, rigid_rows, standard_um, tie_covariance
from thetacomp.planning.setup import AxisPlan, Setup
from thetacomp.planning.timetable import COLD_ROUNDS

TWO_SIDED_95 = 1.96
STEEL_UM_PER_M_K = 11.5


@dataclass(frozen=True)
class VisibleChange:
    """What one heated round shows of one component, as standard errors (k = 1) unless the name says otherwise.

    `end_*` belong to the end of the travel that is known worse; `points`, `angle` and `tie` are its three parts.
    `visible_um` is the smallest change there that is significant at 95 % confidence.
    """

    component: str
    axis: str
    direction: str
    p0_mm: float
    end_mm: float
    distance_mm: float
    intercept_se_um: float
    slope_se_um_per_m: float
    drift_se_um: float
    end_points_um: float
    end_angle_um: float
    end_tie_um: float

    @property
    def end_se_um(self) -> float:
        """Standard error of the thermal error at the end of the travel."""
        return float(np.sqrt(self.end_points_um**2 + self.end_angle_um**2 + self.end_tie_um**2))

    @property
    def visible_um(self) -> float:
        """Smallest change at the end of the travel that is significant in one round (95 %)."""
        return TWO_SIDED_95 * self.end_se_um


def visible_changes(setup: Setup, targets: tuple[FoundationTarget, ...]) -> tuple[VisibleChange, ...]:
    """Every axis and direction of a plan."""
    return tuple(_component(setup, targets, axis, index) for axis in setup.axes for index in range(3))


def line_covariance(position_mm: Floats, sd_um: Floats, p0_mm: float) -> Floats:
    """Covariance (2, 2) of intercept (µm) and slope (µm/m) of an unweighted line through points of known `sd_um`."""
    design = np.column_stack([np.ones(len(position_mm)), (position_mm - p0_mm) / 1000.0])
    inverse = np.linalg.inv(design.T @ design)
    return np.asarray(inverse @ (design.T * sd_um**2) @ design @ inverse)


def _component(setup: Setup, targets: tuple[FoundationTarget, ...], axis: AxisPlan, index: int) -> VisibleChange:
    places = np.array([_tool_mm(setup, axis, position) for position in axis.target_mm])
    distance = np.array([setup.distance_mm(place) for place in places])
    sd_um = np.array([standard_um(setup, one) for one in distance])
    position = np.array(axis.target_mm)
    p0_mm = float(np.mean(axis.axis.travel_mm))
    contrast = 1.0 + 1.0 / COLD_ROUNDS
    # Out and back: every position is read twice.
    points = contrast * line_covariance(np.repeat(position, 2), np.repeat(sd_um, 2), p0_mm)
    angle_urad = np.sqrt(contrast) * setup.options.tracker_u_um_per_m / 2.0
    middle = _tool_mm(setup, axis, p0_mm)
    tie = contrast * tie_covariance(setup, targets, middle)
    ends = []
    for k in (0, -1):
        lever_m = (position[k] - p0_mm) / 1000.0
        row = rigid_rows(places[k], middle)[index]
        line = np.array([1.0, lever_m])
        ends.append(
            (
                float(position[k]),
                float(np.sqrt(line @ points @ line)),
                float(angle_urad * abs(lever_m)),
                float(np.sqrt(row @ tie @ row)),
            )
        )
    end_mm, end_points, end_angle, end_tie = max(ends, key=lambda end: sum(part**2 for part in end[1:]))
    return VisibleChange(
        component=f"E{CARTESIAN[index]}{axis.name}",
        axis=axis.name,
        direction=CARTESIAN[index],
        p0_mm=p0_mm,
        end_mm=end_mm,
        distance_mm=float(distance.mean()),
        intercept_se_um=float(np.sqrt(points[0, 0])),
        slope_se_um_per_m=float(np.hypot(np.sqrt(points[1, 1]), angle_urad)),
        drift_se_um=float(np.sqrt(points[0, 0] + tie[index, index])),
        end_points_um=end_points,
        end_angle_um=end_angle,
        end_tie_um=end_tie,
    )


def _tool_mm(setup: Setup, axis: AxisPlan, position_mm: float) -> Floats:
    return setup.tool_mm({**setup.park_mm, axis.name: position_mm})

"""The chain of axes from the workpiece to the tool: which positions are levers of which rotation.

The order of `[[axes]]` in machine.toml is the order of the chain. A rotation at an axis turns everything between that
axis and the tool: the arm is made of the positions of the axes behind it, counted from their P0. Rotations that do not
change with a position are seen as slopes of those axes already; only what changes along an axis needs an arm.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import CARTESIAN, Floats
from thetacomp.machine import Axis

# ISO 841: Z runs along the spindle, away from the workpiece, so the tool sticks out along -Z.
TOOL = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True)
class ChainAxis:
    """An axis in the chain: `direction` (3,) is the unit vector of positive travel."""

    name: str
    direction: Floats
    p0_mm: float

    def arm_m(self, position_mm: Floats) -> Floats:
        """Distance from P0 in metres, (n,)."""
        return (np.asarray(position_mm, dtype=np.float64) - self.p0_mm) / 1000.0


def chain_of(axes: Sequence[Axis]) -> tuple[ChainAxis, ...]:
    """The chain in the order of the axes; P0 is the middle of the travel."""
    return tuple(
        ChainAxis(axis.name, axis.sign * np.eye(3)[CARTESIAN.index(axis.cartesian)], float(np.mean(axis.travel_mm)))
        for axis in axes
    )


def arms_behind_m(chain: Sequence[ChainAxis], positions_mm: Mapping[str, Floats]) -> dict[str, Floats]:
    """For every axis the arm (n, 3) in metres that the axes behind it make, towards the tool."""
    arms: dict[str, Floats] = {}
    arm = np.zeros((len(next(iter(positions_mm.values()))), 3))
    for axis in reversed(chain):
        arms[axis.name] = arm
        arm = arm + axis.arm_m(positions_mm[axis.name])[:, None] * axis.direction
    return arms


def turned_um(rotation_urad: Floats, arm_m: Floats) -> Floats:
    """Displacement (n, 3) in µm of the end of an arm (n, 3) that turns by a small rotation (n, 3): r × arm."""
    return np.cross(rotation_urad, arm_m)

"""Geometric errors of the virtual machine: what it does wrong cold, a function of position and approach alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.machine import Axis
from thetatwin.conditions import Geometry
from thetatwin.kinematics import ToolMap, carry_pose
from thetatwin.mesh import AXES

_WAVES = 4  # half waves over the travel that make straightness and positioning curves


@dataclass(frozen=True)
class AxisGeometry:
    """Errors of one axis. `wave` (6, _WAVES) and `phase` make displacement (µm) and rotation (µrad) curves."""

    axis: Axis
    wave: Floats
    phase: Floats
    periodic_um: float
    periodic_mm: float
    periodic_phase: float
    reversal_um: Floats

    def pose(self, position_mm: Floats, direction: Floats) -> Floats:
        """Pose (n, 6) at the axis' reference point: µm along X, Y, Z and µrad about them."""
        lo, hi = self.axis.travel_mm
        s = (position_mm - lo) / (hi - lo)
        k = np.arange(1, _WAVES + 1)
        curve = np.sin(np.pi * s[:, None, None] * k + self.phase) - np.sin(self.phase)
        out = np.einsum("nik,ik->ni", curve, self.wave)
        along = AXES.index(self.axis.cartesian)
        screw = np.sin(2 * np.pi * position_mm / self.periodic_mm + self.periodic_phase)
        out[:, along] += self.periodic_um * screw
        out[:, :3] += 0.5 * direction[:, None] * self.reversal_um
        return np.asarray(out)


@dataclass(frozen=True)
class MachineGeometry:
    """Geometric errors of all axes and three squareness angles (µrad: XY, YZ, ZX)."""

    axes: tuple[AxisGeometry, ...]
    squareness_urad: Floats

    def error_um(
        self, tool: ToolMap, positions_mm: Mapping[str, Floats], direction: Mapping[str, Floats], tool_length_mm: float
    ) -> Floats:
        """Error of the tool (n, 6): µm along and µrad about X, Y, Z. `direction` is the last approach of each axis."""
        where, levers, _ = tool.levers_m(positions_mm, tool_length_mm)
        out = np.zeros((len(where), 6))
        for item in self.axes:
            name = item.axis.name
            pose = item.pose(positions_mm[name], direction[name])
            # µrad times m is µm, so poses in these units are carried like poses in rad and m.
            out += np.einsum("nij,nj->ni", carry_pose(levers[name]), pose)
        xy, yz, zx = self.squareness_urad
        out[:, 0] += xy * (where[:, 1] - tool.nose_m[1]) + zx * (where[:, 2] - tool.nose_m[2])
        out[:, 1] += yz * (where[:, 2] - tool.nose_m[2])
        return out


def draw_geometry(rng: np.random.Generator, axes: tuple[Axis, ...], settings: Geometry) -> MachineGeometry:
    """Draw the geometric errors of one machine."""
    items = []
    for axis in axes:
        length = (axis.travel_mm[1] - axis.travel_mm[0]) / 4000.0
        size = np.array([settings.linear_um] * 3 + [settings.angular_urad] * 3)
        # Long waves are the large ones, and a short axis is straighter than a long one.
        wave = rng.normal(size=(6, _WAVES)) * (size * length**0.7)[:, None] / np.arange(1, _WAVES + 1) ** 1.5
        reversal = rng.normal(size=3) * settings.reversal_um * 0.25
        reversal[AXES.index(axis.cartesian)] = settings.reversal_um * rng.uniform(0.5, 1.5)
        items.append(
            AxisGeometry(
                axis,
                wave,
                rng.uniform(0, 2 * np.pi, (6, _WAVES)),
                settings.periodic_um * rng.uniform(0.5, 1.5),
                settings.periodic_mm[axis.name],
                rng.uniform(0, 2 * np.pi),
                reversal,
            )
        )
    return MachineGeometry(tuple(items), rng.normal(size=3) * settings.squareness_urad)

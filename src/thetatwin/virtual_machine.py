"""The virtual machine, built once from its description: full model, reduced model, sensors and tool."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.errors import AnalysisError
from thetatwin.description import Description
from thetatwin.mesh import BodyMesh, mesh_body

try:
    from thetatwin.elastic import Supported, assemble, scalar_spaces
except ImportError:
    raise AnalysisError(
        "the virtual machine needs scikit-fem, which is not installed. Fix: pip install scikit-fem"
    ) from None
from thetatwin.kinematics import ToolMap, carry_pose, support_bodies, tool_rows
from thetatwin.reduced_model import ReducedModel, reduce_system
from thetatwin.thermal import ThermalSystem, assemble_machine, sensor_rows


@dataclass(frozen=True)
class VirtualMachine:
    """Everything that simulation needs. Rows of `rows` (full) and of the reduced model: sensors, feedback, tool.

    `sensor_rows`, `feedback_rows` and `tool_rows` are the slices; feedback are the lumps whose temperature acts back
    on heat: bearing films and the chiller's oil.
    """

    description: Description
    meshes: Mapping[str, BodyMesh]
    bodies: Mapping[str, Supported]
    system: ThermalSystem
    tool: ToolMap
    rows: Floats
    reduced: ReducedModel
    feedback: tuple[str, ...]

    @property
    def sensor_rows(self) -> slice:
        """Temperatures under the sensors."""
        return slice(0, len(self.description.sensors))

    @property
    def feedback_rows(self) -> slice:
        """Temperatures of the lumps in `feedback`."""
        return slice(self.sensor_rows.stop, self.sensor_rows.stop + len(self.feedback))

    @property
    def tool_rows(self) -> slice:
        """Poses that make the tool error."""
        return slice(self.feedback_rows.stop, len(self.rows))

    def tool_error_um(
        self, poses: Floats, positions_mm: Mapping[str, Floats], tool_length_mm: Floats | float
    ) -> Floats:
        """Thermal error of the tool (n, 6): X, Y, Z in µm, rotations about X, Y, Z in µrad.

        `poses` (n, tool rows) are the outputs at the n moments, `positions_mm` the commanded positions of each axis.
        """
        weights = self.tool.weights(positions_mm, tool_length_mm)
        return np.asarray(np.einsum("nij,nj->ni", weights, poses) * 1e6)

    def displacement_m(self, rise_K: Floats, positions_mm: Mapping[str, float]) -> dict[str, Floats]:
        """Displacement of every node of every body, (nodes, 3), for all temperatures (states,) at one position.

        The bodies' own deformation by elasticity, each carried by the guides below it.
        """
        at = {name: np.array([value]) for name, value in positions_mm.items()}
        poses = self.rows[self.tool_rows] @ rise_K
        rigid, point = np.zeros(6), np.zeros(3)  # motion so far, about the machine's origin
        first = self.description.axes[0].lower
        out = {first: self.bodies[first].displacement(self._own(first, rise_K))}
        travelled = np.zeros(3)
        for station, axis in zip(self.tool.stations, self.description.axes, strict=True):
            shift = station.direction * positions_mm[axis.name] * 1e-3
            point = station.point_m + travelled + (shift if station.point_moves else 0.0)
            travelled = travelled + shift
            here = station.interpolate(poses[None, station.rows : station.end], at[axis.name])[0]
            rigid = rigid + carry_pose(-point[None])[0] @ here
            where = self.meshes[axis.upper].points_m + travelled
            carried = (carry_pose(where) @ rigid)[:, :3]
            out[axis.upper] = self.bodies[axis.upper].displacement(self._own(axis.upper, rise_K)) + carried
        return out

    def _own(self, body: str, rise_K: Floats) -> Floats:
        start = self.system.offset[body]
        return rise_K[start : start + self.system.size[body]]


def build(description: Description, refinement: float = 1.0) -> VirtualMachine:
    """Mesh, assemble, solve and reduce. About 15 s on one core for the presets.

    Raises AnalysisError where the description cannot be built or scikit-fem is not installed.
    """
    meshes = {body.name: mesh_body(body, refinement) for body in description.bodies}
    spaces = {name: scalar_spaces(mesh) for name, mesh in meshes.items()}
    elastic = {
        b.name: assemble(meshes[b.name], description.materials[b.material], spaces[b.name]) for b in description.bodies
    }
    system = assemble_machine(description, meshes, spaces)
    bodies = support_bodies(description, elastic)
    tool, poses = tool_rows(description, bodies, system)
    films = dict.fromkeys(s.bearing.film for s in description.sources if s.bearing is not None)
    feedback = tuple(dict.fromkeys([*films, description.cooling.lump]))
    acting = np.zeros((len(feedback), system.states))
    for row, name in zip(acting, feedback, strict=True):
        row[system.offset[name]] = 1.0
    rows = np.concatenate([sensor_rows(description, meshes, system), acting, poses])
    return VirtualMachine(description, meshes, bodies, system, tool, rows, reduce_system(system, rows), feedback)

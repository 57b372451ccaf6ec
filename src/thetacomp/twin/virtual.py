"""The virtual machine, built once from its description: full model, reduced model, sensors and tool."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from thetacomp.errors import AnalysisError
from thetacomp.twin.description import Description
from thetacomp.twin.mesh import BodyMesh, Floats, mesh_body

try:
    from thetacomp.twin.elastic import ElasticBody, assemble, scalar_spaces
except ImportError:
    raise AnalysisError(
        "the virtual machine needs scikit-fem, which is not installed. Fix: pip install 'thetacomp[twin]'"
    ) from None
from thetacomp.twin.kinematics import ToolMap, tool_rows
from thetacomp.twin.reduced import ReducedModel, reduce_system
from thetacomp.twin.thermal import ThermalSystem, assemble_machine, sensor_rows


@dataclass(frozen=True)
class VirtualMachine:
    """Everything that simulation needs. Rows of `rows` (full) and of the reduced model: sensors, feedback, tool.

    `sensor_rows`, `feedback_rows` and `tool_rows` are the slices; feedback are the lumps whose temperature acts back
    on heat: bearing films and the chiller's oil.
    """

    description: Description
    meshes: Mapping[str, BodyMesh]
    elastic: Mapping[str, ElasticBody]
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

    def tool_error_um(self, poses: Floats, positions_mm: Mapping[str, Floats], tool_length_mm: Floats | float) -> Floats:
        """Thermal error of the tool (n, 6): X, Y, Z in µm, rotations about X, Y, Z in µrad.

        `poses` (n, tool rows) are the outputs at the n moments, `positions_mm` the commanded positions of each axis.
        """
        weights = self.tool.weights(positions_mm, tool_length_mm)
        return np.asarray(np.einsum("nij,nj->ni", weights, poses) * 1e6)


def build(description: Description, refinement: float = 1.0) -> VirtualMachine:
    """Mesh, assemble, solve and reduce. About 15 s on one core for the presets.

    Raises AnalysisError where the description cannot be built or scikit-fem is not installed.
    """
    meshes = {body.name: mesh_body(body, refinement) for body in description.bodies}
    spaces = {name: scalar_spaces(mesh) for name, mesh in meshes.items()}
    elastic = {b.name: assemble(meshes[b.name], description.materials[b.material], spaces[b.name])
               for b in description.bodies}  # fmt: skip
    system = assemble_machine(description, meshes, spaces)
    tool, poses = tool_rows(description, elastic, system)
    films = dict.fromkeys(s.bearing.film for s in description.sources if s.bearing is not None)
    feedback = tuple(dict.fromkeys([*films, description.cooling.lump]))
    acting = np.zeros((len(feedback), system.states))
    for row, name in zip(acting, feedback, strict=True):
        row[system.offset[name]] = 1.0
    rows = np.concatenate([sensor_rows(description, meshes, system), acting, poses])
    return VirtualMachine(description, meshes, elastic, system, tool, rows, reduce_system(system, rows), feedback)

"""The two ways to a law on key temperatures: ours, and the paper's. Each is repeated whole inside every fold."""

from __future__ import annotations

from thetacomp.axis_states import AxisStates
from thetacomp.errors import AnalysisError
from thetacomp.fitting.key_point_law import AxisModel, Procedure, fit_axis
from thetacomp.machine import Machine
from thetacomp.sensors.selection import key_points


def key_point_procedure(machine: Machine) -> Procedure:
    """Key points weighted by their µm over the travel, as few as the hold-out error asks for, then least squares."""

    def procedure(states: AxisStates) -> AxisModel:
        chosen = key_points(machine, states)
        return fit_axis(states, chosen.key_points, chosen)

    return procedure


def paper_procedure(machine: Machine) -> Procedure:
    """The paper's way: main factors by correlation, one representative on the drive, least squares on that one."""

    def procedure(states: AxisStates) -> AxisModel:
        chosen = key_points(machine, states, "paper")
        if not chosen.key_points:
            raise AnalysisError(f"axis {states.axis or 'drift'}: no sensor correlates with any parameter.")
        return fit_axis(states, chosen.key_points[:1], chosen)

    return procedure

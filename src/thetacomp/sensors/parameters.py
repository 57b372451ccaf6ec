"""The states of one axis as the strategies see them: one column a parameter, one column a sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats, Ints
from thetacomp.axis_states import AxisStates
from thetacomp.campaign import CorrelationTable
from thetacomp.sensors.correlation import correlations

INTERCEPT, SLOPE = "intercept", "slope"


@dataclass(frozen=True)
class Parameter:
    """One separated parameter. `start_m` and `end_m` are the ends of the travel less P0; both 0 for a drift."""

    component: str
    kind: str
    start_m: float
    end_m: float

    @property
    def name(self) -> str:
        """Such as `EYX slope`."""
        return f"{self.component} {self.kind}"

    @property
    def um_per_unit(self) -> float:
        """What one unit of the parameter weighs in µm: 1 for an intercept, half the travel in m for a slope."""
        return 1.0 if self.kind == INTERCEPT else (self.end_m - self.start_m) / 2.0


@dataclass(frozen=True)
class ParameterTable:
    """All states of one moving axis ("" for drift at a fixed position), n states in order of campaign and time.

    `value` (n, m) holds the parameters in µm and µm/m, `rise_K` (n, p) the temperature rises since the reference of
    each campaign, `campaign` (n,) the number of the campaign of each state. A missing value is NaN.
    """

    axis: str
    parameters: tuple[Parameter, ...]
    value: Floats
    sensors: tuple[str, ...]
    rise_K: Floats
    campaign: Ints

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, such as `EYX slope`."""
        return tuple(p.name for p in self.parameters)


def parameter_table(states: AxisStates) -> ParameterTable:
    """All intercepts and slopes of an axis as one table."""
    start_m, end_m = (states.p_min_mm - states.p0_mm) / 1000.0, (states.p_max_mm - states.p0_mm) / 1000.0
    parameters = [Parameter(c, INTERCEPT, start_m, end_m) for c in states.components]
    value = [states.line_intercept_um]
    if not states.is_drift:
        parameters += [Parameter(c, SLOPE, start_m, end_m) for c in states.components]
        value.append(states.slope_um_per_m)
    return ParameterTable(
        states.axis, tuple(parameters), np.hstack(value), states.sensors, states.rise_K, states.campaign
    )


def correlation_tables(tables: Sequence[ParameterTable]) -> tuple[CorrelationTable, CorrelationTable]:
    """Measured correlations: parameters of all axes against sensors, and sensors against each other.

    The second is taken over the states of all axes together. All tables have the same sensors; those without any
    correlation are left out of both.
    """
    if not tables:
        empty = CorrelationTable((), (), np.empty((0, 0)))
        return empty, empty
    value = np.vstack([correlations(table.value, table.rise_K)[0] for table in tables])
    rises = np.vstack([table.rise_K for table in tables])
    known = np.flatnonzero(np.isfinite(value).any(axis=0))
    sensors = tuple(tables[0].sensors[j] for j in known)
    rows = tuple(name for table in tables for name in table.names)
    between = correlations(rises[:, known], rises[:, known])[0]
    return CorrelationTable(rows, sensors, value[:, known]), CorrelationTable(sensors, sensors, between)

"""Which tests of ISO 230-2 and ISO 230-3 a campaign allows, and for the others the reason why not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import CARTESIAN
from thetacomp.campaign import Campaign
from thetacomp.errors import AnalysisError
from thetacomp.machine import Axis, Machine
from thetacomp.standards.instrument import Instrument
from thetacomp.standards.iso230_2 import Positioning, Readings, positioning
from thetacomp.standards.iso230_3 import ThermalTest, axis_distortion, environmental_variation, spindle_distortion

ETVE = "ISO 230-3, environmental temperature variation error"
SPINDLE = "ISO 230-3, thermal distortion by the spindle"
AXIS = "ISO 230-3, thermal distortion of axis {}"
POSITIONING = "ISO 230-2, positioning of axis {}"


@dataclass(frozen=True)
class Refused:
    """A test that the data do not allow, with the reason."""

    campaign: str
    test: str
    reason: str


@dataclass(frozen=True)
class Evaluated:
    """One test of one campaign. `campaign` is None for a single table."""

    title: str
    result: Positioning | ThermalTest
    instrument: Instrument
    campaign: Campaign | None = None


def campaign_tests(machine: Machine, campaign: Campaign) -> tuple[tuple[Evaluated, ...], tuple[Refused, ...]]:
    """All tests that this campaign allows, and those that were refused with the reason."""
    done: list[Evaluated] = []
    refused: list[Refused] = []
    instrument = Instrument.of(campaign.settings)
    ambient = [sensor.id for sensor in machine.sensors if sensor.role == "ambient"]

    def attempt(title: str, work: Callable[[], Positioning | ThermalTest]) -> None:
        try:
            done.append(Evaluated(title, work(), instrument, campaign))
        except AnalysisError as reason:
            refused.append(Refused(campaign.name, title, str(reason)))

    swept = [a for a in machine.axes if campaign.sweeps is not None and a.name in campaign.sweeps.axis]
    unswept = [axis.name for axis in machine.axes if axis not in swept]
    if unswept:
        reason = f"there are no sweeps of axis {', '.join(unswept)} (sweeps.csv)."
        refused.append(Refused(campaign.name, "ISO 230-2 and the test of linear axes", reason))
    for axis in swept:
        attempt(POSITIONING.format(axis.name), lambda a=axis: campaign_positioning(campaign, a))  # type: ignore[misc]
    attempt(ETVE, lambda: environmental_variation(campaign, ambient))
    attempt(SPINDLE, lambda: spindle_distortion(campaign, ambient))
    for axis in swept:
        attempt(AXIS.format(axis.name), lambda a=axis: axis_distortion(campaign, a, ambient))  # type: ignore[misc]
    return tuple(done), tuple(refused)


def campaign_positioning(campaign: Campaign, axis: Axis) -> Positioning:
    """ISO 230-2 from the sweeps of one axis. Raises AnalysisError with what is missing."""
    points = campaign.sweeps
    if points is None or axis.name not in points.axis:
        raise AnalysisError(f"there are no sweeps of axis {axis.name}.")
    if points.run is None or not points.direction_given:
        lacking = "run" if points.run is None else "direction"
        raise AnalysisError(
            f"axis {axis.name}: sweeps.csv does not state the {lacking} of every point, and it is not guessed here."
            " Fix: fill in the columns `run` and `direction`."
        )
    along = CARTESIAN.index(axis.cartesian)
    rows = np.flatnonzero(np.array(points.axis) == axis.name)
    deviation = axis.sign * points.error_um[rows, along]
    if not np.isfinite(deviation).any():
        raise AnalysisError(
            f"axis {axis.name} moves along {axis.cartesian}, but sweeps.csv has no d{axis.cartesian}_um for it."
        )
    readings = Readings(
        axis=axis.name,
        target_mm=points.position_mm[rows],
        run=tuple(points.run[i] for i in rows),
        direction=points.direction[rows],
        deviation_um=deviation,
        t_s=points.t_s[rows],
    )
    return positioning(readings, axis.travel_mm[1] - axis.travel_mm[0])

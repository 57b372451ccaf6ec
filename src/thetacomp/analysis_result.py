"""Everything one analysis produced: what the report draws and the files are written from."""

from __future__ import annotations

from dataclasses import dataclass

from thetacomp.campaign import CorrelationTable, MachineFolder
from thetacomp.model.document import ModelDocument
from thetacomp.screening.campaigns import ScreenedFolder
from thetacomp.sensors.key_points import AxisKeyPoints
from thetacomp.sensors.sensor_curve import SensorCurve
from thetacomp.separation.component import ComponentSeparation
from thetacomp.temperature.rises import LayoutCheck, SensorRise
from thetacomp.validation.families.comparison_row import ComparisonRow
from thetacomp.validation.outcome import AcceptanceCheck, HeldOutStates, PermutationTest, ValidationRow


@dataclass(frozen=True, repr=False)
class AnalysisResult:
    """Result of one run of the analysis wing.

    `folder` holds the measurements as they were used, `screening` what was found faulty in them and what was done.
    `parameter_correlations` has rows such as `EYX intercept` and the sensors as columns; `sensor_correlations` is
    sensors by sensors. `held_out` is the default model on states that it has not seen. `permutations` are absent where
    too few states exist to shuffle. `angles` are the separated angles of the joint form, in µrad and µrad/m.
    `comparison` holds other families of models, where they were requested; `sensor_curves` the proven
    best sensors of the axes that have enough campaigns.
    """

    folder: MachineFolder
    rises: tuple[SensorRise, ...]
    layout: tuple[LayoutCheck, ...]
    separations: tuple[ComponentSeparation, ...]
    parameter_correlations: CorrelationTable
    sensor_correlations: CorrelationTable
    key_points: tuple[AxisKeyPoints, ...]
    model: ModelDocument
    paper_model: ModelDocument
    validation: tuple[ValidationRow, ...]
    permutations: tuple[PermutationTest, ...]
    acceptance: tuple[AcceptanceCheck, ...]
    notes: tuple[str, ...]
    held_out: tuple[HeldOutStates, ...] = ()
    angles: tuple[ComponentSeparation, ...] = ()
    screening: ScreenedFolder | None = None
    comparison: tuple[ComparisonRow, ...] = ()
    sensor_curves: tuple[SensorCurve, ...] = ()

    def __repr__(self) -> str:
        axes = ", ".join(axis.name for axis in self.folder.machine.axes) or "none"
        failed = sum(not check.passed for check in self.acceptance)
        verdict = "fit for use" if not failed else f"not fit for use: {failed} of {len(self.acceptance)} checks failed"
        return (
            f"Analysis: {self.model.machine or 'machine'}, {verdict}\n"
            f"campaigns: {', '.join(c.name for c in self.folder.campaigns)}\n"
            f"axes: {axes}; {len(self.model.components)} error components, {self.model.form} form\n"
            f"sensors: {len(self.folder.machine.sensors)}; key points: {self._key_points()}"
        )

    def _key_points(self) -> str:
        return "; ".join(
            f"{found.axis or 'drift'}: {', '.join(found.key_points) or 'none'}" for found in self.key_points
        )

"""The files of an export: those that the control reads, and the page that a person follows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from thetacomp.controllers.base import Export, ExportFile
from thetacomp.controllers.sinumerik import RegisterPlan
from thetacomp.controllers.targets import TARGETS
from thetacomp.model.document import ModelDocument
from thetacomp.report.commissioning import SHEET_FILE, commissioning_sheet

OWN = (SHEET_FILE, "sinumerik_temperature_compensation.spf", "sinumerik_values.csv", "replay.*")
SHEETS: Mapping[str, Callable[[RegisterPlan], str]] = {"sinumerik": commissioning_sheet}


def export_files(model: ModelDocument, target: str, settings: Path | None) -> Export:
    """All files for one target. Raises InputError for bad settings, AnalysisError where nothing can be exported."""
    made = TARGETS[target](model, settings)
    return replace(made, files=(*made.files, ExportFile(SHEET_FILE, SHEETS[target](made.plan))))

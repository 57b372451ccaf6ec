"""Every picture of the report, once. Each is a pure function of the analysis and draws under one common style."""

from __future__ import annotations

from collections.abc import Callable

from thetacomp.analysis_result import AnalysisResult
from thetacomp.report.figures_error import drift_over_time, error_over_position, geometry_curves
from thetacomp.report.figures_fit import fit_over_temperature
from thetacomp.report.figures_screening import screened_channels
from thetacomp.report.figures_sensors import accuracy_over_sensors
from thetacomp.report.figures_temperature import correlation_maps, temperatures_over_time
from thetacomp.report.figures_validation import before_and_after, error_over_time
from thetacomp.report.sketch import machine_sketch
from thetacomp.report.style import NamedFigure

FIGURES: tuple[Callable[[AnalysisResult], list[NamedFigure]], ...] = (
    machine_sketch,
    temperatures_over_time,
    screened_channels,
    error_over_position,
    geometry_curves,
    drift_over_time,
    correlation_maps,
    accuracy_over_sensors,
    fit_over_temperature,
    before_and_after,
    error_over_time,
)


def all_figures(analysis: AnalysisResult) -> list[NamedFigure]:
    """All pictures that the data allow, in the order of the report. File names are unique."""
    figures = [figure for draw in FIGURES for figure in draw(analysis)]
    seen: dict[str, int] = {}
    unique = []
    for figure in figures:
        seen[figure.name] = seen.get(figure.name, 0) + 1
        name = figure.name if seen[figure.name] == 1 else f"{figure.name}-{seen[figure.name]}"
        unique.append(NamedFigure(name, figure.section, figure.title, figure.caption, figure.figure))
    return unique

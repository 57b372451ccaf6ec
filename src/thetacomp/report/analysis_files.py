"""The files that an analysis leaves behind: model, tables, and with them the report."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import astuple, fields

import numpy as np

from thetacomp.analysis_result import AnalysisResult
from thetacomp.report.analysis_page import report_files
from thetacomp.separation import ComponentSeparation
from thetacomp.table_file import csv_text, plain
from thetacomp.validation.families.comparison_row import ComparisonRow
from thetacomp.validation.outcome import ValidationRow

OWN = (
    "model.json",
    "report.html",
    *(f"{name}.csv" for name in (
        "separation", "angles", "geometry", "keypoints", "validation", "validation_forward", "acceptance", "screening",
        "sensor_curve", "comparison",
    )),
    *(f"figures/{name}*.{ending}" for ending in ("svg", "png") for name in (
        "machine_sketch", "temperatures", "correlation", "error_over_", "geometry", "drift", "fit_", "before_after_",
        "screening", "sensor_curve",
    )),
)  # fmt: skip
"""What an analysis writes: older files of these names do not survive a new one in the same folder."""


def analysis_files(analysis: AnalysisResult) -> dict[str, str | bytes]:
    """Everything that an analysis leaves behind, by file name: model, tables, report and figures."""
    return {**table_files(analysis), **report_files(analysis)}


def table_files(analysis: AnalysisResult) -> dict[str, str | bytes]:
    """model.json and the tables of separation, key points, validation, acceptance, screening, by file name.

    `angles.csv` is there where angles were measured, `sensor_curve.csv` where campaigns suffice to search the best
    sensors, `comparison.csv` where families of models were compared.
    Numbers have a decimal point and six significant digits, a missing value is an empty cell, the text is UTF-8.
    """
    forward = [row for row in analysis.validation if row.split == "forward"]
    held_out = [row for row in analysis.validation if row.split != "forward"]
    validation = _names(ValidationRow)
    checks = ("name", "statistic", "operator", "threshold", "passed", "meaning")
    files: dict[str, str | bytes] = {
        "model.json": analysis.model.to_json(),
        "separation.csv": _table(SEPARATION_COLUMNS, _separation_rows(analysis.separations)),
    }
    if analysis.angles:
        files["angles.csv"] = _table(ANGLE_COLUMNS, _separation_rows(analysis.angles))
    files |= {
        "geometry.csv": _table(GEOMETRY_COLUMNS, _geometry_rows(analysis)),
        "keypoints.csv": _table(KEYPOINT_COLUMNS, _keypoint_rows(analysis)),
        "validation.csv": _table(validation, map(astuple, held_out)),
        "validation_forward.csv": _table(validation, map(astuple, forward)),
        "acceptance.csv": _table(checks, map(astuple, analysis.acceptance)),
        "screening.csv": _table(SCREENING_COLUMNS, _screening_rows(analysis)),
    }
    if analysis.sensor_curves:
        files["sensor_curve.csv"] = _table(CURVE_COLUMNS, _curve_rows(analysis))
    if analysis.comparison:
        files["comparison.csv"] = _table(_names(ComparisonRow), map(astuple, analysis.comparison))
    return files


SEPARATION_COLUMNS = (
    "campaign",
    "sweep",
    "t_s",
    "component",
    "intercept_um",
    "intercept_se_um",
    "slope_um_per_m",
    "slope_se_um_per_m",
    "rms_um",
    "p0_mm",
    "cold",
    "bend_um_per_m2",
    "bend_se_um_per_m2",
)
ANGLE_COLUMNS = tuple(name.replace("_um", "_urad") for name in SEPARATION_COLUMNS)
GEOMETRY_COLUMNS = ("campaign", "component", "direction", "position_mm", "geometry_um", "geometry_se_um", "model")
KEYPOINT_COLUMNS = ("axis", "method", "strategy", "sensor", "stays", "figure", "figure_name", "reason")
SCREENING_COLUMNS = (
    "campaign",
    "sensor",
    "fault",
    "partner",
    "start_s",
    "detected_s",
    "end_s",
    "size_K",
    "statistic",
    "threshold",
    "done",
    "u_K",
    "repaired_from",
)


def _screening_rows(analysis: AnalysisResult) -> Iterable[Sequence[object]]:
    """One row a fault; `done` is `none` where repair is switched off."""
    found = analysis.screening
    for campaign, f in found.findings if found is not None else ():
        end_s = math.nan if f.end_s is None else f.end_s
        done = f.repair if found is not None and found.repair else "none"
        evidence = (f.start_s, f.detected_s, end_s, f.size_K, f.statistic, f.threshold)
        yield campaign, f.sensor, f.kind, f.partner, *evidence, done, f.repair_u_K, " ".join(f.repaired_from)


def _separation_rows(separations: Iterable[ComponentSeparation]) -> Iterable[Sequence[object]]:
    for s in separations:
        straight = np.full(len(s.t_s), np.nan)
        bend = straight if s.bend_um_per_m2 is None else s.bend_um_per_m2
        bend_se = straight if s.bend_se_um_per_m2 is None else s.bend_se_um_per_m2
        for k in range(len(s.t_s)):
            yield (
                s.campaign,
                int(s.sweep[k]),
                s.t_s[k],
                s.component,
                s.intercept_um[k],
                s.intercept_se_um[k],
                s.slope_um_per_m[k],
                s.slope_se_um_per_m[k],
                s.rms_um[k],
                s.p0_mm,
                int(s.cold[k]),
                bend[k],
                bend_se[k],
            )


def _geometry_rows(analysis: AnalysisResult) -> Iterable[Sequence[object]]:
    sign = {1: "+", -1: "-", 0: ""}
    for s in analysis.separations:
        for curve in s.geometry:
            for p, value, se in zip(curve.position_mm, curve.value_um, curve.se_um, strict=True):
                yield s.campaign, s.component, sign[curve.direction], p, value, se, s.geometry_model


def _keypoint_rows(analysis: AnalysisResult) -> Iterable[Sequence[object]]:
    for chosen in analysis.key_points:
        for table in chosen.tables:
            for v in table.decisions:
                yield (
                    chosen.axis,
                    chosen.method,
                    table.strategy,
                    v.sensor,
                    int(v.stays),
                    v.figure,
                    table.figure_name,
                    v.reason,
                )
        for parameter, reason in chosen.left_out:
            yield chosen.axis, chosen.method, "parameters left out", parameter, 0, math.nan, "", reason
        for sensor in chosen.key_points:
            yield chosen.axis, chosen.method, "key points", sensor, 1, math.nan, "", "input of the model"


CURVE_COLUMNS = (
    "axis",
    "score",
    "count",
    "sensors",
    "residual_um",
    "held_out_um",
    "bound_um",
    "proven",
    "sensor",
    "share_percent",
    "draws",
)


def _curve_rows(analysis: AnalysisResult) -> Iterable[Sequence[object]]:
    """A row for each number of sensors, then a row for each sensor with its share among the resampled choices."""
    for curve in analysis.sensor_curves:
        for point in curve.points:
            figures = (point.residual_um, point.held_out_um, point.bound_um, int(point.proven))
            yield curve.axis, curve.score, point.count, " ".join(point.sensors), *figures, "", math.nan, ""
        if curve.shares is not None:
            for sensor, share in zip(curve.shares.sensors, curve.shares.share, strict=True):
                empty = ("", math.nan, math.nan, math.nan, "")
                yield curve.axis, curve.score, curve.best, *empty, sensor, 100.0 * float(share), curve.shares.draws


def _names(row: type[ValidationRow] | type[ComparisonRow]) -> tuple[str, ...]:
    return tuple(field.name for field in fields(row))


def _table(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    return csv_text(columns, ([plain(value) for value in row] for row in rows), "\r\n")

"""Pictures of the errors themselves: over position at each state, geometry, drift at a fixed position."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from thetacomp.analysis_result import AnalysisResult
from thetacomp.report import style
from thetacomp.report.predicted_states import drawn_law, predict_states
from thetacomp.report.style import HOUR_S, TIME_COLORS
from thetacomp.separation.component import ComponentSeparation, GeometryCurve

_MOST_POINTS = 800
_MOST_LINES = 40


def groups_of_campaigns(analysis: AnalysisResult) -> list[tuple[str, int, list[ComponentSeparation]]]:
    """Separations of moving axes to be drawn together: label, number, parts.

    Campaigns that measured one axis each belong in one picture; campaigns that repeat an axis get one each.
    """
    moving = [s for s in in_order_of_axes(analysis) if s.axis is not None]
    if len({(s.component, s.axis) for s in moving}) == len(moving):
        return [("", 0, moving)] if moving else []
    names = [campaign.name for campaign in analysis.folder.campaigns]
    groups = [(name, k, [s for s in moving if s.campaign == name]) for k, name in enumerate(names, start=1)]
    return [group for group in groups if group[2]]


def in_order_of_axes(analysis: AnalysisResult) -> list[ComponentSeparation]:
    """All separations, sorted as the machine file lists the axes; drift comes last."""
    order: list[str | None] = [axis.name for axis in analysis.folder.machine.axes]
    return sorted(analysis.separations, key=lambda s: order.index(s.axis) if s.axis in order else len(order))


def _panels(parts: Sequence[ComponentSeparation], row_in: float) -> tuple[Figure, dict[tuple[str, str], Axes]]:
    """Small multiples: one column for each moving axis, one row for each direction of the error."""
    axes_names = list(dict.fromkeys(str(s.axis) for s in parts))
    directions = sorted({s.direction for s in parts})
    figure = style.new_figure(0.7 + row_in * len(directions))
    grid = style.grid_of_axes(figure, len(directions), len(axes_names))
    places = {(d, a): grid[i][j] for i, d in enumerate(directions) for j, a in enumerate(axes_names)}
    filled = {(s.direction, str(s.axis)) for s in parts}
    for (direction, axis), axes in places.items():
        if (direction, axis) not in filled:
            axes.set_axis_off()
        if direction == directions[-1]:
            axes.set_xlabel(f"position of {style.short(axis, 12)} (mm)")
    return figure, places


def _heading(part: ComponentSeparation, with_campaign: bool) -> str:
    extra = f" (campaign {style.short(part.campaign, 16)})" if with_campaign else ""
    return f"{part.component}{extra}"


@style.styled
def error_over_position(analysis: AnalysisResult) -> list[style.NamedFigure]:
    """Error against position at each state, coloured by time: measured points and lines, or the lines alone."""
    figures = []
    for label, number, parts in groups_of_campaigns(analysis):
        figure, places = _panels(parts, 2.05)
        norm = style.time_norm([s.t_s for s in parts])
        for part in parts:
            axes = places[part.direction, str(part.axis)]
            _draw_states(axes, part, norm)
            several = not label and len(analysis.folder.campaigns) > 1
            axes.set_title(_heading(part, several and part.direction == parts[0].direction))
            axes.set_ylabel(f"error ({style.unit_of(part.direction)})")
        style.time_bar(figure, places.values(), norm)
        measured = any(s.points is not None for s in parts)
        caption = (
            "Dots: measured points (a cross is an outlier without weight; one beyond the frame is drawn at its edge)."
            " Lines: geometry plus the separated thermal line of each state."
            if measured
            else "Thermal lines S (p - P0) + I of each state, less the cold state; points and geometry are not part of"
            " the data. A state with a missing value is left out."
        )
        name = "error_over_position" + (f"_{style.file_label(label, number)}" if label else "")
        title = "Error over position at each state" + (f", campaign {label}" if label else "")
        figures.append(style.NamedFigure(name, "position", title, caption, figure))
    return figures


def _draw_states(axes: Axes, part: ComponentSeparation, norm: Normalize) -> None:
    axes.axhline(0.0, color=style.FAINT, lw=0.8)
    points = part.points
    curves: Sequence[GeometryCurve | None] = part.geometry or (None,)
    for state in range(len(part.t_s))[style.stride(len(part.t_s), _MOST_LINES)]:
        color = TIME_COLORS(norm(part.t_s[state] / HOUR_S))
        for curve in curves:
            if curve is None:
                position = np.array([part.p_min_mm, part.p_max_mm])
                value = part.line_um(state, position)
                axes.plot(position, value, color=color, lw=1.3)
                axes.plot(position, value, "o", color=color, ms=2.5)
            else:
                value = curve.value_um + part.line_um(state, curve.position_mm)
                axes.plot(curve.position_mm, value, color=color, lw=0.9, ls=style.DIRECTION_MARKS[curve.direction][1])
    if points is None:
        return
    # A gross outlier must not flatten the picture: one beyond the frame is drawn at its edge.
    good = points.error_um[~points.outlier]
    margin = 0.12 * (np.ptp(good) or 1.0)
    low, high = good.min() - margin, good.max() + margin
    axes.set_ylim(low, high)
    for bad, mark, size in ((False, "o", 5.0), (True, "x", 18.0)):
        rows = np.flatnonzero(points.outlier == bad)
        rows = rows[style.stride(len(rows), _MOST_POINTS)]
        color = TIME_COLORS(norm(points.t_s[rows] / HOUR_S))
        value = np.clip(points.error_um[rows], low, high)
        axes.scatter(points.position_mm[rows], value, s=size, c=color, marker=mark, lw=bad, clip_on=False)


@style.styled
def geometry_curves(analysis: AnalysisResult) -> list[style.NamedFigure]:
    """Geometry G(p) in both approach directions with its 95 % band, where it was separated from sweeps."""
    figures = []
    for label, number, parts in groups_of_campaigns(analysis):
        with_curves = [s for s in parts if s.geometry]
        if not with_curves:
            continue
        figure, places = _panels(with_curves, 1.75)
        for part in with_curves:
            axes = places[part.direction, str(part.axis)]
            _draw_geometry(axes, part)
            reversal = (
                ""
                if part.reversal_um is None
                else f" · reversal {part.reversal_um:.1f} {style.unit_of(part.direction)}"
            )
            axes.set_title(_heading(part, False) + reversal)
            axes.set_ylabel(f"G ({style.unit_of(part.direction)})")
        handles, texts = next(iter(places.values())).get_legend_handles_labels()
        figure.legend(handles, texts, loc="outside upper right", ncols=4)
        caption = (
            "Geometry contains all of the cold state; the band is the 95 % interval of the curve. Reversal is the mean"
            " of G(+) \N{MINUS SIGN} G(\N{MINUS SIGN}), with its sign."
        )
        name = "geometry" + (f"_{style.file_label(label, number)}" if label else "")
        title = "Geometry G(p)" + (f", campaign {label}" if label else "")
        figures.append(style.NamedFigure(name, "geometry", title, caption, figure))
    return figures


def _draw_geometry(axes: Axes, part: ComponentSeparation) -> None:
    axes.axhline(0.0, color=style.FAINT, lw=0.8)
    names = {1: "approach +", -1: "approach \N{MINUS SIGN}", 0: "all points"}
    for curve in part.geometry:
        color = style.VERMILLION if curve.direction < 0 else style.BLUE
        band = 1.96 * curve.se_um
        axes.fill_between(
            curve.position_mm, curve.value_um - band, curve.value_um + band, color=color, alpha=0.15, lw=0
        )
        axes.plot(
            curve.position_mm, curve.value_um, color=color, ls=style.DIRECTION_MARKS[curve.direction][1],
            label=names[curve.direction],
        )  # fmt: skip


@style.styled
def drift_over_time(analysis: AnalysisResult) -> list[style.NamedFigure]:
    """Drift at a fixed position over time with the stored model, one picture for each campaign."""
    figures = []
    for number, campaign in enumerate(analysis.folder.campaigns, start=1):
        parts = [s for s in analysis.separations if s.campaign == campaign.name and s.axis is None]
        if not parts:
            continue
        figure = style.new_figure(0.8 + 1.5 * len(parts))
        grid = style.grid_of_axes(figure, len(parts), 1)
        for row, part in zip(grid, parts, strict=True):
            _draw_drift(row[0], analysis, part)
        grid[-1][0].set_xlabel("time since the start of the campaign (h)")
        handles, texts = grid[0][0].get_legend_handles_labels()
        figure.legend(handles, texts, loc="outside upper right", ncols=3)
        caption = (
            f"Displacement at a fixed position and what {drawn_law(analysis)} says. It was trained on these data too:"
            " section 5 has the held-out figures."
        )
        name = f"drift_{style.file_label(campaign.name, number)}"
        figures.append(style.NamedFigure(name, "drift", f"Drift in campaign {campaign.name}", caption, figure))
    return figures


def _draw_drift(axes: Axes, analysis: AnalysisResult, part: ComponentSeparation) -> None:
    hours = part.t_s / HOUR_S
    axes.axhline(0.0, color=style.FAINT, lw=0.8)
    axes.plot(*style.thin(hours, part.intercept_um), color=style.BEFORE, lw=1.0, label="measured")
    predicted = predict_states(analysis, part)
    if predicted is not None:
        axes.plot(*style.thin(hours, predicted.intercept_um), color=style.BLUE, lw=1.2, label="model")
        rest = part.intercept_um - predicted.intercept_um
        axes.plot(*style.thin(hours, rest), color=style.SKY, lw=0.8, label="measured less model")
    axes.set_title(part.component)
    axes.set_ylabel(f"displacement ({style.unit_of(part.direction)})")

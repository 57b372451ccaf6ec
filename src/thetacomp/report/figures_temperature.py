"""Pictures of the temperature field: temperatures over time, correlation heat maps."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from thetacomp.analysis_result import AnalysisResult
from thetacomp.arrays import Floats
from thetacomp.campaign import Campaign, CorrelationTable
from thetacomp.report import style
from thetacomp.report.sketch import key_colors

_HEIGHT_IN = 3.7
_FEW_SENSORS = 3
_MOST_SPANS = 40
_MOST_NUMBERED = 40
_ROWS = "Each row is an intercept or a slope of one error component, each column a sensor."
_ALIKE = "Sensors that hardly differ from each other carry the same information."
# Red and blue without their darkest ends, on which numbers are hard to read.
_CORRELATION_COLORS = LinearSegmentedColormap.from_list(
    "thetacomp_r", matplotlib.colormaps["RdBu_r"](np.linspace(0.08, 0.92, 65))
)


@style.styled
def temperatures_over_time(analysis: AnalysisResult) -> list[style.NamedFigure]:
    """All sensors over time, key points in colour, heat and reference marked.

    One picture for each campaign; campaigns with a few sensors each share one.
    """
    campaigns = analysis.folder.campaigns
    if len(campaigns) > 1 and max(len(c.temperatures.sensor_ids) for c in campaigns) <= _FEW_SENSORS:
        columns = min(3, len(campaigns))
        lines = -(-len(campaigns) // columns)
        figure = style.new_figure(0.3 + 2.5 * lines)
        grid = figure.subplots(lines, columns, squeeze=False).ravel()
        marks = [_draw_campaign(axes, analysis, c, 2.5) for axes, c in zip(grid, campaigns, strict=False)]
        for axes, campaign in zip(grid, campaigns, strict=False):
            axes.set_title(f"campaign {style.short(campaign.name, 24)}")
        for axes in grid[len(campaigns) :]:
            axes.set_axis_off()
        caption = _caption(any(heat for heat, _ in marks), any(reference for _, reference in marks))
        caption += _repaired_words(analysis, campaigns)
        return [style.NamedFigure("temperatures", "temperatures", "Temperatures of every campaign", caption, figure)]
    figures = []
    for number, campaign in enumerate(campaigns, start=1):
        figure = style.new_figure(_HEIGHT_IN)
        caption = _caption(*_draw_campaign(figure.subplots(), analysis, campaign, _HEIGHT_IN))
        caption += _repaired_words(analysis, [campaign])
        name = f"temperatures_{style.file_label(campaign.name, number)}"
        title = f"Temperatures in campaign {campaign.name}"
        figures.append(style.NamedFigure(name, "temperatures", title, caption, figure))
    return figures


def _caption(heated: bool, reference: bool) -> str:
    caption = "Key points in colour, the other sensors grey."
    if heated:
        caption += " Shaded: the machine was running (from duty.csv)."
    if reference:
        caption += " Dashed: the reference, where the thermal error counts as zero."
    return caption


def _repaired_words(analysis: AnalysisResult, campaigns: Sequence[Campaign]) -> str:
    """Which sensors are not drawn as they were read."""
    found = analysis.screening
    if found is None or not found.repair:
        return ""
    names = {campaign.name for campaign in campaigns}
    sensors = dict.fromkeys(channel.sensor for channel in found.channels if channel.campaign in names)
    return f" As the analysis uses them, repaired or left out: {', '.join(sensors)}." if sensors else ""


def _draw_campaign(axes: Axes, analysis: AnalysisResult, campaign: Campaign, height_in: float) -> tuple[bool, bool]:
    """Temperatures of one campaign; returns whether heat and reference could be marked."""
    draw_temperatures(axes, campaign, key_colors(analysis), height_in)
    heated = mark_heat(axes, campaign)
    reference_s = _reference_s(analysis, campaign)
    if reference_s is not None:
        _mark_reference(axes, reference_s / style.HOUR_S)
    axes.set_xlabel("time since the start of the campaign (h)")
    axes.set_ylabel("temperature (°C)")
    return heated, reference_s is not None


def draw_temperatures(axes: Axes, campaign: Campaign, colors: dict[str, str], height_in: float) -> None:
    """All sensors of a campaign over hours, those with a colour in front, their ids at the right ends."""
    measured = campaign.temperatures
    hours = measured.t_s / style.HOUR_S
    names, ends = [], []
    marker = "o" if len(hours) < 25 else ""
    for j, sensor in sorted(enumerate(measured.sensor_ids), key=lambda pair: pair[1] in colors):
        value = measured.value_degC[:, j]
        good = np.isfinite(value)
        if not good.any():
            continue
        key = sensor in colors
        axes.plot(
            *style.thin(hours[good], value[good]), color=colors.get(sensor, style.FAINT), lw=2.2 if key else 0.8,
            marker=marker, ms=3.5, zorder=3 if key else 2,
        )  # fmt: skip
        names.append(sensor)
        ends.append(float(value[good][-1]))
    if len(hours) > 1:
        axes.set_xlim(hours[0], hours[-1])
    _end_labels(axes, names, np.array(ends), colors, height_in)


def _end_labels(axes: Axes, names: list[str], ends: Floats, colors: dict[str, str], height_in: float) -> None:
    """Sensor ids at the right ends of their lines; key points alone where there is no room for all."""
    low, high = axes.get_ylim()
    gap = (high - low) * 9.0 / (height_in * 72.0 * 0.8)
    if len(names) * gap > (high - low):
        keep = [k for k, name in enumerate(names) if name in colors]
        names, ends = [names[k] for k in keep], ends[keep]
    right = axes.get_xlim()[1]
    span = right - axes.get_xlim()[0]
    for name, end, v in zip(names, ends, style.spread(ends, gap, low, high), strict=True):
        color = colors.get(name, "#7b8794")
        axes.plot([right, right + 0.015 * span], [end, v], color=color, lw=0.6, clip_on=False, solid_capstyle="butt")
        axes.annotate(
            style.short(name, 18), (right + 0.02 * span, v), va="center", fontsize=7.5, color=color,
            fontweight="bold" if name in colors else "normal", annotation_clip=False,
        )  # fmt: skip
    axes.set_xlim(right - span, right)


def mark_heat(axes: Axes, campaign: Campaign) -> bool:
    """Shade the time in which the spindle or a feed ran; False where duty.csv does not say."""
    if campaign.duty is None or not campaign.duty.columns:
        return False
    running = np.any([np.nan_to_num(column) > 0.0 for column in campaign.duty.columns.values()], axis=0)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], running.astype(int), [0]])))
    starts, stops = edges[::2], edges[1::2]
    if len(starts) == 0:
        return False
    hours = campaign.duty.t_s / style.HOUR_S
    for start, stop in list(zip(starts, stops, strict=True))[:_MOST_SPANS]:
        axes.axvspan(hours[start], hours[min(stop, len(hours) - 1)], color=style.AMBER, alpha=0.09, lw=0, zorder=0)
    axes.annotate(
        "heat on", (float(hours[starts[0]]), 1.0), xycoords=("data", "axes fraction"), xytext=(3, 2),
        textcoords="offset points", va="bottom", fontsize=7.5,
    )  # fmt: skip
    return True


def _mark_reference(axes: Axes, hour: float) -> None:
    axes.axvline(hour, color=style.INK, lw=0.9, ls=(0, (4, 3)))
    low, high = axes.get_xlim()
    room = hour - low > 0.03 * (high - low)
    axes.annotate(
        "reference", (hour, 0.99), xycoords=("data", "axes fraction"), xytext=(-3 if room else 4, 0), rotation=90,
        textcoords="offset points", ha="right" if room else "left", va="top", fontsize=7.5,
    )  # fmt: skip


def _reference_s(analysis: AnalysisResult, campaign: Campaign) -> float | None:
    """The campaign's moment of zero; None where its components do not share one."""
    if campaign.settings.reference_s is not None:
        return campaign.settings.reference_s
    moments = {s.reference_s for s in analysis.separations if s.campaign == campaign.name}
    return float(np.median(list(moments))) if moments else None


@style.styled
def correlation_maps(analysis: AnalysisResult) -> list[style.NamedFigure]:
    """Correlation tables as heat maps with numbers; what is missing is hatched. Published tables come first."""
    folder = analysis.folder
    parameters, sensors = analysis.parameter_correlations, analysis.sensor_correlations
    maps = (
        (
            "correlation_parameters_given",
            "parameters with temperatures, as given",
            _ROWS,
            folder.parameter_correlations,
        ),
        ("correlation_sensors_given", "temperatures with each other, as given", _ALIKE, folder.sensor_correlations),
        ("correlation_parameters", "parameters with temperatures, from these campaigns", _ROWS, parameters),
        ("correlation_sensors", "temperatures with each other, from these campaigns", _ALIKE, sensors),
    )
    return [
        style.NamedFigure(
            name, "correlations", f"Correlation of {title}",
            f"{what} Pearson's r from -1 (blue) to +1 (red). Hatched: not available.", _heat_map(analysis, table),
        )
        for name, title, what, table in maps
        if table is not None and _tells_something(table)
    ]  # fmt: skip


def _tells_something(table: CorrelationTable) -> bool:
    """True where a cell other than a sensor with itself holds a number."""
    return any(
        np.isfinite(table.value[i, j]) and table.rows[i] != table.columns[j] for i, j in np.ndindex(table.value.shape)
    )


def _heat_map(analysis: AnalysisResult, table: CorrelationTable) -> Figure:
    rows, columns = table.value.shape
    numbered = columns <= _MOST_NUMBERED and rows <= 2 * _MOST_NUMBERED
    width = max(3.6, 2.7 + 0.42 * columns) if numbered else style.WIDTH_IN
    figure = style.new_figure(max(1.7, 1.3 + (0.235 if numbered else 0.1) * rows), width)
    axes = figure.subplots()
    axes.set_facecolor("#f1f3f5")
    axes.patch.set_hatch("////")
    axes.patch.set_edgecolor("#c3cad2")
    image = axes.pcolormesh(
        np.ma.masked_invalid(table.value), cmap=_CORRELATION_COLORS, vmin=-1.0, vmax=1.0, edgecolors="white", lw=0.6
    )
    axes.invert_yaxis()
    axes.grid(False)
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    colors = key_colors(analysis)
    _name_ticks(axes, table, colors, numbered)
    if numbered:
        for i, j in np.ndindex(rows, columns):
            r = float(table.value[i, j])
            if np.isfinite(r):
                ink = "white" if abs(r) > 0.64 else style.INK
                axes.text(j + 0.5, i + 0.5, f"{r:.2f}", ha="center", va="center", fontsize=7.2, color=ink)
    bar = figure.colorbar(image, ax=axes, pad=0.015, aspect=30, shrink=min(1.0, 3.0 / (0.235 * rows + 1e-9)))
    bar.set_label("correlation r (-)")
    bar.outline.set_visible(False)
    return figure


def _name_ticks(axes: Axes, table: CorrelationTable, colors: dict[str, str], numbered: bool) -> None:
    size = 8.0 if numbered else 6.0
    rows, columns = table.value.shape
    step = max(1, columns // 60)
    axes.xaxis.tick_top()
    axes.set_xticks(
        np.arange(columns)[::step] + 0.5, [style.short(c, 16) for c in table.columns[::step]], fontsize=size
    )
    axes.tick_params(axis="x", rotation=45 if max(len(c) for c in table.columns) > 4 else 0)
    for label in axes.get_xticklabels():
        label.set_horizontalalignment("left" if label.get_rotation() else "center")
        label.set_rotation_mode("anchor")
    step = max(1, rows // 80)
    axes.set_yticks(np.arange(rows)[::step] + 0.5, [style.short(r, 22) for r in table.rows[::step]], fontsize=size)
    for label in (*axes.get_xticklabels(), *axes.get_yticklabels()):
        if label.get_text() in colors:
            label.set_color(colors[label.get_text()])
            label.set_fontweight("bold")

"""Pictures of the validation: before and after with the baselines, and the error over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from thetacomp.analysis_result import AnalysisResult
from thetacomp.report import style
from thetacomp.report.figures_error import in_order_of_axes
from thetacomp.report.style import CAMPAIGN_LINES, CAMPAIGN_MARKS, HOUR_S
from thetacomp.report.tables import component_name, split_words
from thetacomp.validation.outcome import HeldOutStates, ValidationRow
from thetacomp.validation.validate import ALL_CAMPAIGNS, pooled

_MOST_TIME_PANELS = 24
_DRAWN_MODELS = ("default", "clock", "one_sensor", "paper")
_STATISTICS = ("max", "p95", "rms")
# Beyond this ratio of the largest to the smallest figure a linear scale squeezes the small components together.
_LOG_RATIO = 8.0
# Less than any instrument sees; a residual of rounding errors alone must not stretch the scale by ten decades.
_LEAST_UM = 0.05


@style.styled
def before_and_after(analysis: AnalysisResult) -> list[style.NamedFigure]:
    """Held-out maximum, p95 and RMS before and after, with the baselines, one picture for each kind of hold-out."""
    figures = []
    for split in dict.fromkeys(row.split for row in analysis.validation):
        rows = pooled([row for row in analysis.validation if row.split == split])
        components = list(dict.fromkeys(row.component for row in rows))
        models = [m for m in _DRAWN_MODELS if any(row.model == m for row in rows)]
        figure = style.new_figure(1.15 + 0.42 * len(components))
        grid = figure.subplots(1, 3, sharey=True)
        shown = [
            _draw_statistic(axes, rows, components, models, statistic)
            for axes, statistic in zip(grid, _STATISTICS, strict=True)
        ]
        logarithmic = any(_squeezes(values) for values in shown)
        for axes, values in zip(grid, shown, strict=True):
            _scale(axes, values, logarithmic)
        grid[0].set_yticks(range(len(components)), [component_name(c) for c in components])
        grid[0].set_ylim(len(components) - 0.5, -0.5)
        figure.legend(handles=_before_after_legend(models, _any_worse(rows)), loc="outside upper center", ncols=3)
        caption = (
            f"Residual errors {split_words(split)}; the bar reaches from the uncompensated error to the model's"
            " residual: grey where the model helps, red where it makes the error worse. The open ring is the flattering"
            " in-sample RMS of the same model."
        )
        if logarithmic:
            caption += " The scale is logarithmic: equal distances are equal ratios."
        if any(min(values, default=1.0) <= _LEAST_UM for values in shown):
            caption += f" Figures below {_LEAST_UM:g} µm are drawn at {_LEAST_UM:g} µm."
        if any(row.campaign == ALL_CAMPAIGNS for row in rows):
            caption += " All campaigns together."
        title = f"Before and after, {split_words(split)}"
        figures.append(style.NamedFigure(f"before_after_{split}", "before_after", title, caption, figure))
    return figures


def _largest(rows: Sequence[ValidationRow], component: str, model: str, field: str) -> float:
    """A figure of one component and model; the largest where there are rows of several campaigns."""
    values = [float(getattr(r, field)) for r in rows if r.component == component and r.model == model]
    good = [v for v in values if np.isfinite(v)]
    return max(*good, _LEAST_UM) if good else float("nan")


def _any_worse(rows: Sequence[ValidationRow]) -> bool:
    return any(
        getattr(row, f"{statistic}_after_um") > getattr(row, f"{statistic}_before_um")
        for row in rows
        if row.model == "default"
        for statistic in _STATISTICS
    )


def _draw_statistic(
    axes: Axes, rows: Sequence[ValidationRow], components: Sequence[str], models: Sequence[str], statistic: str
) -> list[float]:
    """Draw one panel; returns the figures in it, in µm."""
    shown: list[float] = []
    for k, component in enumerate(components):
        before = _largest(rows, component, "default", f"{statistic}_before_um")
        after = _largest(rows, component, "default", f"{statistic}_after_um")
        color = style.WORSE if after > before else "#cbd2d9"
        axes.plot([after, before], [k, k], color=color, lw=5, alpha=0.75, solid_capstyle="butt", zorder=1)
        shown += [before, after]
        axes.plot(before, k, "|", color=style.BEFORE, ms=13, mew=2.2, zorder=2)
        # Slightly offset, so that models that are equally good do not hide each other.
        offsets = np.linspace(-0.24, 0.24, len(models)) if len(models) > 1 else np.zeros(1)
        for model, offset in zip(models, offsets, strict=True):
            value = _largest(rows, component, model, f"{statistic}_after_um")
            shown.append(value)
            axes.plot(
                value, k + offset, style.MODEL_MARKERS.get(model, "x"), color=style.MODEL_COLORS.get(model, style.INK),
                ms=6 if model == "default" else 5, mec="white", mew=0.5, zorder=4 if model == "default" else 3,
            )  # fmt: skip
            if statistic == "rms" and model == "default":
                inside = _largest(rows, component, model, "rms_in_sample_um")
                shown.append(inside)
                axes.plot(inside, k + offset, "o", mfc="none", mec=style.BLUE, ms=9, mew=1.0, zorder=5)
    axes.grid(axis="y", visible=False)
    axes.tick_params(axis="y", length=0)
    axes.set_title({"max": "maximum", "p95": "95th percentile", "rms": "RMS"}[statistic])
    axes.set_xlabel("error (µm)")
    return [value for value in shown if np.isfinite(value)]


def _squeezes(shown_um: Sequence[float]) -> bool:
    """Whether one component would squeeze all others together on a linear scale."""
    return bool(shown_um) and 0.0 < _LOG_RATIO * min(shown_um) < max(shown_um)


def _scale(axes: Axes, shown_um: Sequence[float], logarithmic: bool) -> None:
    if not logarithmic or not shown_um or min(shown_um) <= 0.0:
        axes.set_xlim(left=0.0)
        return
    low, high = min(shown_um) / 1.3, max(shown_um) * 1.3
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    decades = np.log10(high / low)
    axes.xaxis.set_major_locator(
        LogLocator(subs=(1.0, 2.0, 5.0) if decades < 2.0 else (1.0, 3.0) if decades < 4.0 else (1.0,))
    )
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _before_after_legend(models: Sequence[str], worse: bool) -> list[Line2D]:
    handles = [
        Line2D([], [], ls="", marker="|", color=style.BEFORE, ms=11, mew=2.2, label=style.MODEL_NAMES["nothing"])
    ]
    for model in models:
        handles.append(
            Line2D(
                [], [], ls="", marker=style.MODEL_MARKERS.get(model, "x"), ms=7,
                color=style.MODEL_COLORS.get(model, style.INK),
                label=style.MODEL_NAMES.get(model, model) + (", held out" if model == "default" else ""),
            )
        )  # fmt: skip
    if worse:
        handles.append(Line2D([], [], color=style.WORSE, lw=5, alpha=0.75, label="made worse"))
    handles.append(
        Line2D([], [], ls="", marker="o", mfc="none", mec=style.BLUE, ms=9, label="model, in-sample (RMS only)")
    )
    return handles


@style.styled
def error_over_time(analysis: AnalysisResult) -> list[style.NamedFigure]:
    """Largest error over the travel at each held-out state, before and after the default model."""
    known = {item.component for item in analysis.held_out}
    ordered = dict.fromkeys(s.component for s in in_order_of_axes(analysis))
    names = [component for component in ordered if component in known][:_MOST_TIME_PANELS]
    if not names:
        return []
    columns = min(3, len(names))
    lines = -(-len(names) // columns)
    figure = style.new_figure(0.9 + 1.75 * lines)
    grid = figure.subplots(lines, columns, squeeze=False, sharex=True)
    order = [campaign.name for campaign in analysis.folder.campaigns]
    campaigns = [name for name in order if any(item.campaign == name for item in analysis.held_out)]
    for k, axes in enumerate(grid.ravel()):
        if k >= len(names):
            axes.set_axis_off()
            continue
        for item in (i for i in analysis.held_out if i.component == names[k]):
            _draw_over_time(axes, item, campaigns.index(item.campaign), len(campaigns))
        axes.set_title(names[k])
        axes.set_ylim(bottom=0.0)
        axes.set_ylabel("largest |error| (µm)")
        if k + columns >= len(names):
            axes.set_xlabel("time (h)")
            axes.tick_params(labelbottom=True)
    handles = [
        Line2D([], [], color=style.BEFORE, lw=2.5, label="before"),
        Line2D([], [], color=style.BLUE, lw=2.5, label="after, held out"),
    ]
    if len(campaigns) > 1:
        handles += [
            Line2D([], [], color=style.INK, lw=1.2, ms=4.0, label=style.short(name, 18), **_campaign_look(k, 2))
            for k, name in enumerate(campaigns)
        ]
    figure.legend(handles=handles, loc="outside upper right", ncols=6)
    caption = (
        "Largest error over the travel at each state, before and after compensation by models that have not seen the"
        " state (or its campaign)."
    )
    return [style.NamedFigure("error_over_time", "over_time", "Error over time, before and after", caption, figure)]


def _campaign_look(k: int, count: int) -> dict[str, Any]:
    """Marker and line style of the k-th campaign; every pair is used once for the first 32."""
    if count == 1:
        return {"marker": "o", "ls": "-"}
    marks, lines = len(CAMPAIGN_MARKS), len(CAMPAIGN_LINES)
    return {"marker": CAMPAIGN_MARKS[k % marks], "ls": CAMPAIGN_LINES[(k + k // marks) % lines]}


def _draw_over_time(axes: Axes, item: HeldOutStates, k: int, count: int) -> None:
    hours = item.t_s / HOUR_S
    look = _campaign_look(k, count)
    for value_um, color in ((item.before_um, style.BEFORE), (item.after_um, style.BLUE)):
        # A long record is drawn as the largest value of each stretch of time, with a marker here and there.
        t_h, largest_um = style.highest(hours, value_um)
        every = 1 if len(t_h) <= 40 else len(t_h) // 6
        axes.plot(t_h, largest_um, color=color, ms=3.5, lw=1.2, alpha=0.8, markevery=every, **look)

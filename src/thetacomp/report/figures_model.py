"""Pictures of the model: slope and intercept against the key temperature, before and after."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from thetacomp.analysis_result import Analysis
from thetacomp.campaign import Floats
from thetacomp.models.document import Component, LinearTerm
from thetacomp.report import style
from thetacomp.report.figures_error import in_order_of_axes
from thetacomp.report.prediction import half_band, predict_states, reference_degC, term_at
from thetacomp.report.style import HOUR_S, TIME_COLORS
from thetacomp.report.tables import POOLED, component_name, pooled, split_words
from thetacomp.separation.result import ComponentSeparation
from thetacomp.validation.result import HeldOutStates, ValidationRow

_CAMPAIGN_MARKS = ("o", "s", "D", "^", "v", "P", "X", "*")
_MOST_POINTS = 1200
_MOST_LABELS = 12
_MOST_TIME_PANELS = 24
_DRAWN_MODELS = ("default", "clock", "one_sensor", "paper")


@style.styled
def fit_over_temperature(analysis: Analysis) -> list[style.NamedFigure]:
    """Intercept and slope against the key temperature with the stored model and its 95 % band, one picture an axis."""
    figures = []
    for axis in dict.fromkeys(c.axis for c in analysis.model.components.values()):
        names = [n for n, c in analysis.model.components.items() if c.axis == axis and _parts(analysis, n)]
        if not names:
            continue
        columns = 2 if axis is not None else 1
        figure = style.new_figure(0.8 + 2.15 * len(names))
        one_input = len({analysis.model.components[name].inputs for name in names}) == 1 and columns == 2
        one_input = one_input and len(analysis.model.components[names[0]].inputs) == 1
        grid = figure.subplots(len(names), columns, squeeze=False, sharex="col" if one_input else False)
        norm = style.time_norm([s.t_s for name in names for s in _parts(analysis, name)])
        for row, name in zip(grid, names, strict=True):
            component = analysis.model.components[name]
            for axes, term, what in zip(
                row, (component.intercept, component.slope), ("intercept", "slope"), strict=False
            ):
                if term is not None:
                    _draw_fit(axes, analysis, name, term, what, norm)
        if one_input:
            for axes in grid[:-1].ravel():
                axes.set_xlabel("")
        style.time_bar(figure, grid.ravel(), norm)
        handles = _fit_legend(analysis, [s for name in names for s in _parts(analysis, name)])
        figure.legend(handles=handles, loc="outside upper right", ncols=5)
        label = style.file_label(axis, 0) if axis else "drift"
        title = f"Slope and intercept against temperature, axis {axis}" if axis else "Drift against temperature"
        caption = (
            "Dots: separated states with their 95 % interval, coloured by time. Line and band: the stored model and the"
            " 95 % interval of a new state. A ring marks a state outside the band."
        )
        figures.append(style.NamedFigure(f"fit_{label}", "fit", title, caption, figure))
    return figures


def _parts(analysis: Analysis, component: str) -> list[ComponentSeparation]:
    """Separations of a component whose campaign has the model's inputs."""
    mine = [s for s in analysis.separations if s.component == component]
    return [s for s in mine if predict_states(analysis, s) is not None]


def _fit_legend(analysis: Analysis, parts: Sequence[ComponentSeparation]) -> list[Line2D]:
    handles = [Line2D([], [], color=style.BLUE, lw=1.6, label="model and 95 % band")]
    names = list(dict.fromkeys(s.campaign for s in parts))
    if 1 < len(names) <= len(_CAMPAIGN_MARKS):
        handles += [
            Line2D([], [], ls="", marker=_CAMPAIGN_MARKS[k], color=style.BEFORE, ms=5, label=style.short(name, 16))
            for k, name in enumerate(names)
        ]
    return handles


def _draw_fit(axes: Axes, analysis: Analysis, name: str, term: LinearTerm, what: str, norm: object) -> None:
    component = analysis.model.components[name]
    parts = _parts(analysis, name)
    strongest = _strongest_input(analysis, component, term)
    shift_degC = _shift_degC(analysis, parts, component, strongest)
    several = len(component.inputs) > 1
    campaigns = list(dict.fromkeys(s.campaign for s in parts))
    labels: list[tuple[float, float, str, bool]] = []
    span: list[Floats] = []
    for part in parts:
        predicted = predict_states(analysis, part)
        assert predicted is not None
        value, se = _measured(part, component, what)
        fitted, half = term_at(term, predicted.rise_K), half_band(term, component.dof, predicted.rise_K)
        x = predicted.rise_K[:, strongest] + shift_degC
        span.append(predicted.rise_K)
        outside = np.abs(value - fitted) > half
        rows = np.arange(len(x))[style.stride(len(x), _MOST_POINTS // len(campaigns))]
        mark = _CAMPAIGN_MARKS[campaigns.index(part.campaign) % len(_CAMPAIGN_MARKS)] if len(campaigns) > 1 else "o"
        few = len(x) <= 60
        if several and few:
            axes.errorbar(x[rows], fitted[rows], half[rows], fmt="_", color=style.BLUE, ms=7, lw=0.8, alpha=0.6)
        if few and np.isfinite(se).any():
            axes.errorbar(x, value, 1.96 * se, fmt="none", ecolor=style.FAINT, lw=0.8)
        color = TIME_COLORS(norm(part.t_s[rows] / HOUR_S))  # type: ignore[operator]
        axes.scatter(x[rows], value[rows], c=color, s=22 if few else 4, marker=mark, zorder=3, lw=0)
        if few:
            axes.scatter(x[outside], value[outside], s=75, fc="none", ec=style.OUTLYING, lw=1.2, zorder=4)
            known = [k for k in rows if np.isfinite(x[k]) and np.isfinite(value[k])]
            labels += [(float(x[k]), float(value[k]), f"{part.t_s[k] / HOUR_S:.1f} h", bool(outside[k])) for k in known]
    if not several:
        _draw_band(axes, term, component.dof, np.concatenate(span)[:, 0], shift_degC)
    _label_states(axes, labels, term.coefficients_per_K[strongest] > 0.0 if term.coefficients_per_K else True)
    _name_axes(axes, name, component, term, what, component.inputs[strongest] if component.inputs else "", shift_degC)


def _strongest_input(analysis: Analysis, component: Component, term: LinearTerm) -> int:
    """The input that moves this term most over the training range."""
    ranges = analysis.model.training.range_rise_K
    weight = [
        abs(c) * (ranges[i][1] - ranges[i][0] if i in ranges else 1.0)
        for i, c in zip(component.inputs, term.coefficients_per_K, strict=True)
    ]
    return int(np.argmax(weight)) if weight else 0


def _shift_degC(analysis: Analysis, parts: Sequence[ComponentSeparation], component: Component, column: int) -> float:
    """Reference temperature to add where all parts share one, so that the axis shows °C; else 0: the axis shows K."""
    starts = [reference_degC(analysis, part, component) for part in parts]
    values = [float(np.ravel(start)[column]) for start in starts if start is not None and start.size]
    return values[0] if values and max(values) - min(values) < 1e-6 else 0.0


def _measured(part: ComponentSeparation, component: Component, what: str) -> tuple[Floats, Floats]:
    """Separated values and standard errors, the intercept at the model's P0."""
    if what == "slope":
        return part.slope_um_per_m, part.slope_se_um_per_m
    move_m = 0.0 if component.p0_mm is None else (component.p0_mm - part.p0_mm) / 1000.0
    se = part.intercept_se_um if move_m == 0.0 else np.full(len(part.t_s), np.nan)
    return part.intercept_um + part.slope_um_per_m * move_m, se


def _draw_band(axes: Axes, term: LinearTerm, dof: int, rise_K: Floats, shift_degC: float) -> None:
    low, high = float(np.nanmin(rise_K)), float(np.nanmax(rise_K))
    pad = 0.04 * (high - low) if high > low else 1.0
    grid = np.linspace(low - pad, high + pad, 60)[:, None]
    value, half = term_at(term, grid), half_band(term, dof, grid)
    x = grid[:, 0] + shift_degC
    axes.plot(x, value, color=style.BLUE, zorder=2)
    axes.fill_between(x, value - half, value + half, color=style.BLUE, alpha=0.12, lw=0)
    axes.set_xlim(float(x[0]), float(x[-1]))


def _label_states(axes: Axes, labels: Sequence[tuple[float, float, str, bool]], rising: bool) -> None:
    """Hours at the states: all where there are few and they stand apart, outlying ones always."""
    if not labels:
        return
    wanted = labels if len(labels) <= _MOST_LABELS else [entry for entry in labels if entry[3]]
    (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    placed: list[tuple[float, float]] = []
    for x, y, text, outside in sorted(wanted, key=lambda entry: not entry[3]):
        left = (x - x0) / (x1 - x0) > 0.88
        # Below a rising line and above a falling one there is room on the right, on the left the other way round.
        up = rising == left
        u, v = (x - x0) / (x1 - x0) + (-0.05 if left else 0.05), (y - y0) / (y1 - y0) + (0.05 if up else -0.05)
        if any(abs(u - a) < 0.1 and abs(v - b) < 0.085 for a, b in placed):
            continue
        placed.append((u, v))
        axes.annotate(
            text, (x, y), xytext=(-6 if left else 6, 2 if up else -2), textcoords="offset points", fontsize=7,
            ha="right" if left else "left", va="bottom" if up else "top",
            color=style.OUTLYING if outside else "#52606d", zorder=5,
        )  # fmt: skip


def _name_axes(
    axes: Axes, name: str, component: Component, term: LinearTerm, what: str, sensor: str, shift_degC: float
) -> None:
    unit = style.unit_of(component.direction)
    noun = what if component.axis is not None else "displacement"
    axes.set_ylabel(f"{noun} ({unit}/m)" if what == "slope" else f"{noun} ({unit})")
    axes.set_title(f"{name} {noun} · R² {term.r_squared:.2f}")
    if sensor:
        sensor = style.short(sensor, 18)
        axes.set_xlabel(f"{sensor} (°C)" if shift_degC else f"rise of {sensor} since the reference (K)")


@style.styled
def before_and_after(analysis: Analysis) -> list[style.NamedFigure]:
    """Held-out maximum, p95 and RMS before and after, with the baselines, one picture for each kind of hold-out."""
    figures = []
    for split in dict.fromkeys(row.split for row in analysis.validation):
        rows = pooled([row for row in analysis.validation if row.split == split])
        components = list(dict.fromkeys(row.component for row in rows))
        models = [m for m in _DRAWN_MODELS if any(row.model == m for row in rows)]
        figure = style.new_figure(1.15 + 0.42 * len(components))
        grid = figure.subplots(1, 3, sharey=True)
        for axes, statistic in zip(grid, ("max", "p95", "rms"), strict=True):
            _draw_statistic(axes, rows, components, models, statistic)
        grid[0].set_yticks(range(len(components)), [component_name(c) for c in components])
        grid[0].set_ylim(len(components) - 0.5, -0.5)
        figure.legend(handles=_before_after_legend(models), loc="outside upper center", ncols=3)
        caption = (
            f"Residual errors {split_words(split)}; the grey bar reaches from the uncompensated error to the model's"
            " residual. The open ring is the flattering in-sample RMS of the same model."
        )
        if any(row.campaign == POOLED for row in rows):
            caption += " All campaigns together."
        title = f"Before and after, {split_words(split)}"
        figures.append(style.NamedFigure(f"before_after_{split}", "before_after", title, caption, figure))
    return figures


def _largest(rows: Sequence[ValidationRow], component: str, model: str, field: str) -> float:
    """A figure of one component and model; the largest where rows of several campaigns stand beside each other."""
    values = [float(getattr(r, field)) for r in rows if r.component == component and r.model == model]
    good = [v for v in values if np.isfinite(v)]
    return max(good) if good else float("nan")


def _draw_statistic(
    axes: Axes, rows: Sequence[ValidationRow], components: Sequence[str], models: Sequence[str], statistic: str
) -> None:
    for k, component in enumerate(components):
        before = _largest(rows, component, "default", f"{statistic}_before_um")
        after = _largest(rows, component, "default", f"{statistic}_after_um")
        axes.plot([after, before], [k, k], color="#cbd2d9", lw=5, solid_capstyle="butt", zorder=1)
        axes.plot(before, k, "|", color=style.BEFORE, ms=13, mew=2.2, zorder=2)
        # A little apart, so that models that are equally good do not hide each other.
        offsets = np.linspace(-0.24, 0.24, len(models)) if len(models) > 1 else np.zeros(1)
        for model, offset in zip(models, offsets, strict=True):
            value = _largest(rows, component, model, f"{statistic}_after_um")
            axes.plot(
                value, k + offset, style.MODEL_MARKERS.get(model, "x"), color=style.MODEL_COLORS.get(model, style.INK),
                ms=6 if model == "default" else 5, mec="white", mew=0.5, zorder=4 if model == "default" else 3,
            )  # fmt: skip
            if statistic == "rms" and model == "default":
                inside = _largest(rows, component, model, "rms_in_sample_um")
                axes.plot(inside, k + offset, "o", mfc="none", mec=style.BLUE, ms=9, mew=1.0, zorder=5)
    axes.set_xlim(left=0.0)
    axes.grid(axis="y", visible=False)
    axes.tick_params(axis="y", length=0)
    axes.set_title({"max": "maximum", "p95": "95th percentile", "rms": "RMS"}[statistic])
    axes.set_xlabel("error (µm)")


def _before_after_legend(models: Sequence[str]) -> list[Line2D]:
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
    handles.append(
        Line2D([], [], ls="", marker="o", mfc="none", mec=style.BLUE, ms=9, label="model, in-sample (RMS only)")
    )
    return handles


@style.styled
def error_over_time(analysis: Analysis) -> list[style.NamedFigure]:
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
    faint = len({item.campaign for item in analysis.held_out}) > 1
    for k, axes in enumerate(grid.ravel()):
        if k >= len(names):
            axes.set_axis_off()
            continue
        for item in (i for i in analysis.held_out if i.component == names[k]):
            _draw_over_time(axes, item, faint)
        axes.set_title(names[k])
        axes.set_ylim(bottom=0.0)
        axes.set_ylabel("largest |error| (µm)")
        if k + columns >= len(names):
            axes.set_xlabel("time (h)")
            axes.tick_params(labelbottom=True)
    handles = [
        Line2D([], [], color=style.BEFORE, marker="o", ms=3.5, label="before"),
        Line2D([], [], color=style.BLUE, marker="o", ms=3.5, label="after, held out"),
    ]
    figure.legend(handles=handles, loc="outside upper right", ncols=2)
    caption = (
        "Largest error over the travel at each state, before and after compensation by models that have not seen the"
        " state (or its campaign)."
    )
    return [style.NamedFigure("error_over_time", "over_time", "Error over time, before and after", caption, figure)]


def _draw_over_time(axes: Axes, item: HeldOutStates, faint: bool) -> None:
    hours = item.t_s / HOUR_S
    marker = "o" if len(hours) <= 40 else ""
    # A long record is drawn as the largest value of each stretch of time.
    for value_um, color in ((item.before_um, style.BEFORE), (item.after_um, style.BLUE)):
        axes.plot(
            *style.highest(hours, value_um), color=color, marker=marker, ms=3.5, lw=1.2, alpha=0.75 if faint else 1.0
        )

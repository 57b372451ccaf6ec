"""Pictures of the fit: slope and intercept of every state against what the stored model says, with its 95 % band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.lines import Line2D

from thetacomp.analysis_result import AnalysisResult
from thetacomp.arrays import Floats
from thetacomp.model.check import TERMS
from thetacomp.model.law import ComponentLaw, component_laws
from thetacomp.report import style
from thetacomp.report.predicted_states import drawn_law, explains, half_band, predict_states, reference_degC
from thetacomp.report.style import CAMPAIGN_MARKS, HOUR_S, TIME_COLORS
from thetacomp.separation.component import ComponentSeparation

NOT_PREDICTED = "no sensor predicts this component; nothing is compensated"
_MOST_POINTS = 1200
_MOST_LABELS = 12
_FEW = 60

_CAPTIONS = {
    0: f"A panel over time: {NOT_PREDICTED}.",
    1: "A panel over a temperature: line and band are the stored model and the 95 % interval of a new state.",
    2: "A panel of measured against predicted is drawn where the model has more than one input: on the grey diagonal"
    " both are equal, and the band about it is the 95 % interval of a new state.",
}


@dataclass(frozen=True)
class _States:
    """States of one campaign in one panel, all (n,): place `x`, measured value, model, half its 95 % band."""

    part: ComponentSeparation
    x: Floats
    value: Floats
    se: Floats
    fitted: Floats
    half: Floats


@style.styled
def fit_over_temperature(analysis: AnalysisResult) -> list[style.NamedFigure]:
    """Measured states and the stored model, one picture an axis.

    Over the key temperature where the model has one input, against the prediction where it has more, over time where
    it has none.
    """
    figures = []
    for axis, law in analysis.model.control.items():
        names = [name for name in law.components if _parts(analysis, name)]
        if names:
            figures.append(_figure(analysis, axis, names))
    return figures


def _figure(analysis: AnalysisResult, axis: str, names: Sequence[str]) -> style.NamedFigure:
    laws = component_laws(analysis.model.control)
    components = [laws[name] for name in names]
    # In the joint form the intercept of an axis is zero: the drift has a figure of its own.
    shown = ("slope",) if axis and analysis.model.form == "joint" else ("intercept", "slope")
    columns = len(shown) if axis else 1
    figure = style.new_figure(0.8 + 2.15 * len(names))
    counts = {min(len(c.inputs), 2) for c in components}
    same_x = counts <= {0, 1} and len({c.inputs for c in components}) == 1 and bool(axis)
    grid = figure.subplots(len(names), columns, squeeze=False, sharex="col" if same_x else False)
    norm = style.time_norm([s.t_s for name in names for s in _parts(analysis, name)])
    for row, component in zip(grid, components, strict=True):
        for axes, what in zip(row, shown, strict=False):
            if TERMS.index(what) < len(component.component.terms):
                _draw_fit(axes, analysis, component, what, norm)
    if same_x:
        for axes in grid[:-1].ravel():
            axes.set_xlabel("")
    style.time_bar(figure, grid.ravel(), norm)
    handles = _legend([s for name in names for s in _parts(analysis, name)], counts)
    if handles:
        figure.legend(handles=handles, loc="outside upper right", ncols=5)
    kinds = " and ".join(reversed(shown)).capitalize() if axis else "Drift"
    against = "the prediction" if 2 in counts else "temperature" if 1 in counts else "time"
    title = f"{kinds} against {against}" + (f", axis {axis}" if axis else "")
    caption = f"Dots: separated states with their 95 % interval, coloured by time. Model: {drawn_law(analysis)}. "
    caption += " ".join(_CAPTIONS[count] for count in sorted(counts, reverse=True))
    if counts != {0}:
        caption += " A ring marks a state outside the band. R² is in-sample: on the states of the fit."
    return style.NamedFigure(f"fit_{style.file_label(axis, 0) if axis else 'drift'}", "fit", title, caption, figure)


def _parts(analysis: AnalysisResult, component: str) -> list[ComponentSeparation]:
    """Separations of a component whose campaign has the model's inputs."""
    mine = [s for s in analysis.separations if s.component == component]
    return [s for s in mine if predict_states(analysis, s) is not None]


def _legend(parts: Sequence[ComponentSeparation], counts: set[int]) -> list[Line2D]:
    handles = []
    if 1 in counts:
        handles.append(Line2D([], [], color=style.BLUE, lw=1.6, label="model and 95 % band"))
    elif 2 in counts:
        handles.append(Line2D([], [], color=style.FAINT, lw=1.2, label="measured = predicted, with 95 % band"))
    names = list(dict.fromkeys(s.campaign for s in parts))
    if 1 < len(names) <= len(CAMPAIGN_MARKS):
        handles += [
            Line2D([], [], ls="", marker=CAMPAIGN_MARKS[k], color=style.BEFORE, ms=5, label=style.short(name, 16))
            for k, name in enumerate(names)
        ]
    return handles


def _draw_fit(axes: Axes, analysis: AnalysisResult, component: ComponentLaw, what: str, norm: Normalize) -> None:
    parts = _parts(analysis, component.name)
    shift_degC = _shift_degC(analysis, parts, component) if len(component.inputs) == 1 else 0.0
    drawn = [_states(analysis, part, component, what, shift_degC) for part in parts]
    _draw_states(axes, drawn, bool(component.inputs), norm)
    if not component.inputs:
        axes.axhline(0.0, color=style.FAINT, lw=0.8, zorder=1)
        axes.margins(y=0.45)
        said = NOT_PREDICTED.replace("; ", ";\n")
        axes.text(0.5, 0.965, said, transform=axes.transAxes, ha="center", va="top", fontsize=8.5)
    elif len(component.inputs) == 1:
        _draw_band(axes, component, what, drawn, shift_degC)
    else:
        _draw_diagonal(axes, drawn)
    rising = len(component.inputs) != 1 or component.component.terms[TERMS.index(what)].coefficients[0] > 0.0
    _label_states(axes, drawn, bool(component.inputs), rising)
    _name_axes(axes, component, what, shift_degC)


def _states(
    analysis: AnalysisResult,
    part: ComponentSeparation,
    component: ComponentLaw,
    what: str,
    shift_degC: float,
) -> _States:
    predicted = predict_states(analysis, part)
    assert predicted is not None
    value, se = _measured(part, component, what)
    fitted, half = _term_at(component, what, predicted.rise_K)
    if not component.inputs:
        x = part.t_s / HOUR_S
    elif len(component.inputs) == 1:
        x = predicted.rise_K[:, 0] + shift_degC
    else:
        x = fitted
    return _States(part, x, value, se, fitted, half)


def _outside(states: _States) -> np.ndarray:
    return np.abs(states.value - states.fitted) > states.half


def _draw_states(axes: Axes, drawn: Sequence[_States], modelled: bool, norm: Normalize) -> None:
    campaigns = list(dict.fromkeys(states.part.campaign for states in drawn))
    for states in drawn:
        rows = np.arange(len(states.x))[style.stride(len(states.x), _MOST_POINTS // len(campaigns))]
        k = campaigns.index(states.part.campaign)
        mark = CAMPAIGN_MARKS[k % len(CAMPAIGN_MARKS)] if len(campaigns) > 1 else "o"
        few = len(states.x) <= _FEW
        if few and np.isfinite(states.se).any():
            axes.errorbar(states.x, states.value, 1.96 * states.se, fmt="none", ecolor=style.FAINT, lw=0.8)
        color = TIME_COLORS(norm(states.part.t_s[rows] / HOUR_S))
        axes.scatter(states.x[rows], states.value[rows], c=color, s=22 if few else 4, marker=mark, zorder=3, lw=0)
        if few and modelled:
            out = _outside(states)
            axes.scatter(states.x[out], states.value[out], s=75, fc="none", ec=style.OUTLYING, lw=1.2, zorder=4)


def _shift_degC(analysis: AnalysisResult, parts: Sequence[ComponentSeparation], component: ComponentLaw) -> float:
    """Reference temperature to add where all parts share one, so that the axis shows °C; else 0: the axis shows K."""
    starts = [reference_degC(analysis, part, component) for part in parts]
    values = [float(np.ravel(start)[0]) for start in starts if start is not None and start.size]
    return values[0] if values and max(values) - min(values) < 1e-6 else 0.0


def _measured(part: ComponentSeparation, component: ComponentLaw, what: str) -> tuple[Floats, Floats]:
    """Separated values and standard errors, the intercept at the model's P0."""
    if what == "slope":
        return part.slope_um_per_m, part.slope_se_um_per_m
    move_m = (component.travel_mm[0] - part.p0_mm) / 1000.0 if component.axis else 0.0
    # The standard error belongs to the separated intercept, not to that of another P0 or of a parabola's best line.
    own = move_m == 0.0 and part.bend_um_per_m2 is None
    se = part.intercept_se_um if own else np.full(len(part.t_s), np.nan)
    return part.line_intercept_um + part.slope_um_per_m * move_m, se


def _term_at(component: ComponentLaw, what: str, rise_K: Floats) -> tuple[Floats, Floats]:
    """Value and half of the 95 % band of a term for rises (n, inputs), in the term's unit, both (n,)."""
    power = TERMS.index(what)
    return component.terms(rise_K)[power], half_band(component, power, rise_K)


def _draw_band(axes: Axes, component: ComponentLaw, what: str, drawn: Sequence[_States], shift_degC: float) -> None:
    rise_K = np.concatenate([states.x for states in drawn]) - shift_degC
    low, high = float(np.nanmin(rise_K)), float(np.nanmax(rise_K))
    pad = 0.04 * (high - low) if high > low else 1.0
    grid = np.linspace(low - pad, high + pad, 60)[:, None]
    value, half = _term_at(component, what, grid)
    x = grid[:, 0] + shift_degC
    axes.plot(x, value, color=style.BLUE, zorder=2)
    axes.fill_between(x, value - half, value + half, color=style.BLUE, alpha=0.12, lw=0)
    axes.set_xlim(float(x[0]), float(x[-1]))


def _draw_diagonal(axes: Axes, drawn: Sequence[_States]) -> None:
    """The line of perfect prediction with the band; each state has its own interval, so the band is their envelope."""
    fitted = np.concatenate([states.fitted for states in drawn])
    half = np.concatenate([states.half for states in drawn])
    known = np.isfinite(fitted) & np.isfinite(half)
    if not known.any():
        return
    fitted, half = fitted[known], half[known]
    low, high = float(fitted.min()), float(fitted.max())
    pad = 0.04 * (high - low) if high > low else 1.0
    edges = np.linspace(low - pad, high + pad, 13)
    middle = (edges[1:] + edges[:-1]) / 2.0
    place = np.clip(np.digitize(fitted, edges) - 1, 0, len(middle) - 1)
    filled = np.unique(place)
    widest = np.array([half[place == k].max() for k in filled])
    width = np.interp(edges, middle[filled], widest)
    axes.plot(edges, edges, color=style.FAINT, lw=1.2, zorder=2)
    axes.fill_between(edges, edges - width, edges + width, color=style.BLUE, alpha=0.12, lw=0)
    axes.set_xlim(float(edges[0]), float(edges[-1]))


def _label_states(axes: Axes, drawn: Sequence[_States], modelled: bool, rising: bool) -> None:
    """Hours at the states: all where there are few and they do not overlap, outlying ones always."""
    labels = [
        (float(states.x[k]), float(states.value[k]), f"{states.part.t_s[k] / HOUR_S:.1f} h", bool(out[k]))
        for states in drawn
        if len(states.x) <= _FEW and modelled
        for out in (_outside(states),)
        for k in range(len(states.x))
        if np.isfinite(states.x[k]) and np.isfinite(states.value[k])
    ]
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


def _name_axes(axes: Axes, component: ComponentLaw, what: str, shift_degC: float) -> None:
    name, power = component.name, TERMS.index(what)
    unit = style.unit_of(component.component.direction)
    if what == "slope":
        unit += "/m"
    noun = what if component.axis else "displacement"
    several = len(component.inputs) > 1
    axes.set_ylabel(f"{'measured ' if several else ''}{noun} ({unit})")
    if not component.inputs:
        axes.set_title(f"{name} {noun}")
        axes.set_xlabel("time since the start of the campaign (h)")
        return
    said = (
        f"R² in-sample {component.component.terms[power].r_squared:.2f}"
        if explains(component, power)
        else "not explained"
    )
    axes.set_title(f"{name} {noun} · {said}")
    if several:
        axes.set_xlabel(f"{noun} predicted from {len(component.inputs)} sensors ({unit})")
    else:
        sensor = style.short(component.inputs[0], 18)
        axes.set_xlabel(f"{sensor} (°C)" if shift_degC else f"rise of {sensor} since the reference (K)")

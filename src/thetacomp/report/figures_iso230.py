"""Pictures of the ISO 230 tests: deviations over position, displacements and temperatures over time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes

from thetacomp.campaign import Campaign
from thetacomp.machine import Machine
from thetacomp.report import style
from thetacomp.report.figures_temperature import draw_temperatures, mark_heat
from thetacomp.report.style import HOUR_S
from thetacomp.standards.environment import moving
from thetacomp.standards.iso230_2 import Positioning
from thetacomp.standards.iso230_3 import FIRST_S, Series, ThermalTest

_TEMPERATURE_IN = 2.5
_COLORED = 3
_QUANTITY_COLORS = dict(zip("XYZABC", (style.BLUE, style.VERMILLION, style.GREEN) * 2, strict=True))


@style.styled
def positioning_figure(name: str, result: Positioning) -> style.NamedFigure:
    """Deviations over position as ISO 230-2 shows them: means by approach, ± 2 s, every reading, and A or E."""
    figure = style.new_figure(3.9)
    axes = figure.subplots()
    targets, runs = result.targets, result.runs
    position = targets.target_mm
    axes.axhline(0.0, color=style.FAINT, lw=0.8)
    for mean, s, values, color, mark, word in (
        (targets.mean_up_um, targets.s_up_um, runs.up_um, style.BLUE, "^", "approach + (↑)"),
        (targets.mean_down_um, targets.s_down_um, runs.down_um, style.VERMILLION, "v", "approach \N{MINUS SIGN} (↓)"),
    ):
        if np.isfinite(s).all():
            axes.fill_between(position, mean - 2 * s, mean + 2 * s, color=color, alpha=0.13, lw=0)
            for column in values.T:
                axes.plot(position, column, ".", color=color, ms=2.8, alpha=0.75)
        axes.plot(position, mean, color=color, marker=mark, ms=5, label=word)
    axes.plot(position, targets.mean_um, color=style.INK, lw=1.0, ls=(0, (4, 3)), label="mean of both")
    _mark_range(axes, result)
    axes.set_xlabel(f"target position of axis {runs.axis} (mm)")
    axes.set_ylabel("deviation (µm)")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper right", ncols=3)
    bands = "Bands: mean ± 2 s; points: single readings. " if np.isfinite(targets.s_up_um).all() else ""
    caption = (
        f"Deviation = actual \N{MINUS SIGN} target along the axis. {bands}Dotted: the range that gives the figure."
    )
    return style.NamedFigure(name, "iso230", f"Deviations of axis {runs.axis}", caption, figure)


def _mark_range(axes: Axes, result: Positioning) -> None:
    """The limits of A, or of E where one run was evaluated."""
    t, figures = result.targets, result.figures
    known = np.isfinite(figures.A_um)
    spread = [2 * s if known else 0.0 * m for s, m in ((t.s_up_um, t.mean_up_um), (t.s_down_um, t.mean_down_um))]
    high = max(float((t.mean_up_um + spread[0]).max()), float((t.mean_down_um + spread[1]).max()))
    low = min(float((t.mean_up_um - spread[0]).min()), float((t.mean_down_um - spread[1]).min()))
    right = axes.get_xlim()[1]
    for value in (low, high):
        axes.axhline(value, color=style.INK, lw=0.9, ls=":")
    axes.annotate("", (right, low), (right, high), arrowprops={"arrowstyle": "<->", "lw": 0.9, "color": style.INK})
    symbol, size = ("A", figures.A_um) if known else ("E", figures.E_um)
    axes.annotate(
        f"{symbol} = {size:.4g} µm", (right, (low + high) / 2), xytext=(6, 0), textcoords="offset points",
        va="center", rotation=90, annotation_clip=False,
    )  # fmt: skip
    axes.set_xlim(axes.get_xlim()[0], right)


@style.styled
def thermal_figure(name: str, test: ThermalTest, campaign: Campaign, machine: Machine) -> style.NamedFigure:
    """Displacements above, temperatures below, on one axis of time, with the period of the figures marked."""
    panels = _panels(test)
    height = 0.7 + 1.9 * len(panels) + _TEMPERATURE_IN
    figure = style.new_figure(height)
    grid = figure.subplots(
        len(panels) + 1, 1, sharex=True, squeeze=False, height_ratios=[1.9] * len(panels) + [_TEMPERATURE_IN]
    )[:, 0]
    *upper, lowest = grid
    colors = _sensor_colors(test, campaign, machine)
    draw_temperatures(lowest, campaign, colors, _TEMPERATURE_IN)
    heated = mark_heat(lowest, _with_motion_alone(campaign))
    for axes, (title, series) in zip(upper, panels, strict=True):
        _draw_panel(axes, title, series)
    for axes in grid:
        _mark_period(axes, test)
    _name_period(upper[0], test)
    lowest.set_ylabel("temperature (°C)")
    lowest.set_xlabel("time since the start of the campaign (h)")
    caption = (
        "Displacements less their first reading; dashed: start, first 60 min and end of the period that the figures"
        f" hold for. In colour: {_colored_words(machine, colors)}."
        + (" Shaded: the machine was running." if heated else "")
    )
    return style.NamedFigure(name, "iso230", "Displacements and temperatures", caption, figure)


def _with_motion_alone(campaign: Campaign) -> Campaign:
    """Without columns of duty.csv such as hydraulics or chiller, which run at rest too."""
    if campaign.duty is None:
        return campaign
    columns = {name: column for name, column in campaign.duty.columns.items() if moving(name)}
    return replace(campaign, duty=replace(campaign.duty, columns=columns))


def _panels(test: ThermalTest) -> list[tuple[str, list[Series]]]:
    """Series that share a picture: by unit at a fixed position, by quantity for an axis."""
    groups: dict[str, list[Series]] = {}
    for one in test.series:
        if test.kind == "axis":
            title = "growth of the length" if one.quantity == "length" else f"displacement {one.quantity}"
        else:
            title = "displacement" if one.unit == "µm" else "tilt"
        groups.setdefault(title, []).append(one)
    return list(groups.items())


def _draw_panel(axes: Axes, title: str, series: list[Series]) -> None:
    axes.axhline(0.0, color=style.FAINT, lw=0.8)
    places = list(dict.fromkeys(one.place.split(",")[0] for one in series))
    for one in series:
        dashed = one.place.endswith("-")
        color = (
            _QUANTITY_COLORS[one.quantity]
            if not one.place
            else style.KEY_COLORS[places.index(one.place.split(",")[0]) % len(style.KEY_COLORS)]
        )
        label = (one.place or one.quantity).replace(" -", " \N{MINUS SIGN}")
        axes.plot(
            *style.thin(one.t_s / HOUR_S, one.value), color=color, ls="--" if dashed else "-", lw=1.2,
            marker="o" if len(one.t_s) < 40 else "", ms=3, label=label,
        )  # fmt: skip
    axes.set_title(title, loc="right")  # the left is for the words at the start of the period
    axes.set_ylabel(f"{'tilt' if series[0].unit == 'µrad' else 'displacement'} ({series[0].unit})")
    axes.legend(loc="upper left", bbox_to_anchor=(1.005, 1.0), borderaxespad=0.0)


def _mark_period(axes: Axes, test: ThermalTest) -> None:
    for moment in _moments(test).values():
        axes.axvline(moment / HOUR_S, color=style.INK, lw=0.8, ls=(0, (4, 3)))


def _name_period(axes: Axes, test: ThermalTest) -> None:
    low, high = axes.get_xlim()
    for word, moment in _moments(test).items():
        hour = moment / HOUR_S
        left = hour > low + 0.9 * (high - low)
        axes.annotate(
            word, (hour, 1.0), xycoords=("data", "axes fraction"), xytext=(2 if left else -2, 2),
            textcoords="offset points", ha="right" if left else "left", va="bottom", fontsize=7.5,
        )  # fmt: skip


def _moments(test: ThermalTest) -> dict[str, float]:
    moments = {"start": test.start_s, "end": test.end_s}
    if test.kind != "etve" and test.end_s > test.start_s + FIRST_S:
        moments["60 min"] = test.start_s + FIRST_S
    return moments


def _sensor_colors(test: ThermalTest, campaign: Campaign, machine: Machine) -> dict[str, str]:
    """Ambient sensors and those that moved most during the period."""
    heat = campaign.temperatures
    ambient = [s.id for s in machine.sensors if s.role == "ambient" and s.id in heat.sensor_ids]
    inside = (heat.t_s >= test.start_s) & (heat.t_s <= test.end_s)
    spread = {
        sensor: float(np.ptp(column[np.isfinite(column)]))
        for sensor, column in zip(heat.sensor_ids, heat.value_degC[inside].T, strict=True)
        if np.isfinite(column).any()
    }
    moved = sorted((s for s in spread if s not in ambient), key=lambda s: -spread[s])[:_COLORED]
    chosen = [*ambient[:_COLORED], *moved]
    return dict(zip(chosen, style.KEY_COLORS, strict=False))


def _colored_words(machine: Machine, colors: dict[str, str]) -> str:
    ambient = [sensor for sensor in colors if machine.sensor(sensor).role == "ambient"]
    moved = [sensor for sensor in colors if sensor not in ambient]
    words = [f"{', '.join(ambient)} (ambient)"] if ambient else []
    return "; ".join([*words, f"{', '.join(moved)} (moved most)"] if moved else words)

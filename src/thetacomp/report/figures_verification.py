"""Pictures of a verification: before and after over time, the applied share, harm by position and time."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import TwoSlopeNorm
from matplotlib.lines import Line2D

from thetacomp.arrays import Floats
from thetacomp.report import style
from thetacomp.report.style import HOUR_S
from thetacomp.report.tables import component_name
from thetacomp.verification.outcome import HarmMap, Share, StateLine, VerificationResult

HALF_IN = style.WIDTH_IN / 2
_WORST_MAPS = 3
_SHARE_LINES = ((-1.0, "reversed"), (0.0, "not active"), (1.0, "right"), (2.0, "doubled"))
_SHARE_RANGE = (-2.2, 3.2)


def verification_figures(result: VerificationResult) -> list[style.NamedFigure]:
    """All figures; those with section "page" stand on the page itself, the others are files only."""
    return [over_time(result), *applied_share(result), *harm_maps(result)]


@style.styled
def over_time(result: VerificationResult) -> style.NamedFigure:
    """Largest error over the travel of each sweep: off, on, and what the run with compensation on would have shown."""
    names = _two_to_show(result)
    figure = style.new_figure(2.0, HALF_IN)
    grid = figure.subplots(1, len(names), squeeze=False, sharey=True)[0]
    for axes, name in zip(grid, names, strict=True):
        off, on = (next(s for s in lines if s.component == name) for lines in (result.states_off, result.states_on))
        axes.plot(*_sorted(off, off.largest_um), "o-", color=style.BEFORE, ms=3.0, lw=1.2)
        if np.isfinite(on.expected_um).all():
            axes.plot(*_sorted(on, on.expected_um), "--", color=style.BEFORE, lw=1.2)
        axes.plot(*_sorted(on, on.largest_um), "o-", color=style.BLUE, ms=3.0, lw=1.4)
        axes.set_title(component_name(name))
        axes.set_xlabel("time (h)")
    # After all lines: a limit set earlier holds the shared scale at the first column's, and cuts the second off.
    grid[0].set_ylim(bottom=0.0)
    grid[0].set_ylabel("largest |error| (µm)")
    handles = [
        Line2D([], [], color=style.BEFORE, marker="o", ms=3, label="off, measured"),
        Line2D([], [], color=style.BEFORE, ls="--", label="on, expected without"),
        Line2D([], [], color=style.BLUE, marker="o", ms=3, label="on, measured"),
    ]
    figure.legend(handles=handles, loc="outside upper left", ncols=3, handlelength=1.4, columnspacing=0.9)
    caption = "Largest error of every sweep; dashed: what the heat of that run would have caused without compensation."
    return style.NamedFigure("verification_over_time", "page", "Before and after over time", caption, figure)


def _two_to_show(result: VerificationResult) -> list[str]:
    """The column deviations; without them the two components with the largest uncompensated error."""
    columns = [line.component for line in result.states_off if line.component.startswith("column")]
    largest = sorted(result.states_off, key=lambda line: -float(line.largest_um.max()))
    return (columns or [line.component for line in largest])[:2]


def _sorted(line: StateLine, value_um: Floats) -> tuple[Floats, Floats]:
    """Hours and values in order of time; a break where another campaign starts again at an earlier time."""
    hours, value = line.t_s / HOUR_S, value_um
    back = np.flatnonzero(np.diff(hours) <= 0) + 1
    return np.insert(hours, back, np.nan), np.insert(value, back, np.nan)


@style.styled
def applied_share(result: VerificationResult) -> list[style.NamedFigure]:
    """The applied share of every component with its 95 % interval; nothing where no error could be expected."""
    whole = [share for share in result.shares if share.part == "all"]
    if not whole:
        return []
    figure = style.new_figure(max(2.0, 0.75 + 0.13 * len(whole)), HALF_IN)
    axes = figure.subplots()
    for k, share in enumerate(whole):
        _draw_share(axes, k, share)
    axes.set_yticks(range(len(whole)), [share.component for share in whole])
    axes.set_ylim(len(whole) - 0.4, -0.6)
    axes.set_xlim(*_SHARE_RANGE)
    axes.set_xticks([-2, -1, 0, 1, 2, 3])
    axes.set_xlabel("applied share of the correction (-)")
    axes.grid(axis="y", visible=False)
    for value, label in _SHARE_LINES:
        axes.axvline(value, color=style.GREEN if value == 1.0 else "#7b8794", lw=1.0, zorder=1)
        axes.text(
            value, 1.01, label, transform=axes.get_xaxis_transform(), ha="center", va="bottom", fontsize=7.5,
            color=style.GREEN if value == 1.0 else style.INK,
        )  # fmt: skip
    caption = "Share that reached each component, 95 % interval; pale: too small to judge."
    return [style.NamedFigure("verification_share", "page", "Applied share", caption, figure)]


def _draw_share(axes: Axes, k: int, share: Share) -> None:
    good = share.kind == "applied"
    color = style.FAINT if not share.material else style.BLUE if good or share.kind == "unclear" else style.WORSE
    low, high = _SHARE_RANGE
    axes.plot(np.clip([share.low, share.high], low, high), [k, k], color=color, lw=1.6, zorder=2)
    if low <= share.value <= high:
        axes.plot(share.value, k, "o", color=color, ms=4.5, zorder=3)
    else:
        edge = high if share.value > high else low
        axes.text(
            edge, k - 0.1, f"{share.value:.1f}", ha="right" if edge == high else "left", va="bottom", fontsize=7.5
        )


@style.styled
def harm_maps(result: VerificationResult) -> list[style.NamedFigure]:
    """Residual less uncompensated error at the same heat by position and time: the worst three on the page, and all."""
    if not result.harm:
        return []
    ordered = sorted(result.harm, key=lambda one: one.limit_um - one.largest_um)
    worst = _harm_figure(ordered[:_WORST_MAPS], 1, 1.45)
    caption = (
        "|residual| minus |uncompensated error at equal heat|, in µm: blue is better, red is harm. The components with"
        " the most harm; the cross marks the largest."
    )
    figures = [style.NamedFigure("verification_harm", "page", "Harm by position and time", caption, worst)]
    if len(result.harm) > _WORST_MAPS:
        rows = -(-len(result.harm) // _WORST_MAPS)
        whole = _harm_figure(result.harm, rows, 0.6 + 1.55 * rows)
        figures.append(
            style.NamedFigure("verification_harm_all", "file", "Harm by position and time, all", caption, whole)
        )
    return figures


def _harm_figure(maps: Sequence[HarmMap], rows: int, height_in: float) -> matplotlib.figure.Figure:
    figure = style.new_figure(height_in)
    grid = figure.subplots(rows, min(_WORST_MAPS, len(maps)), squeeze=False).ravel()
    span = max(1.0, *(float(np.nanmax(np.abs(one.harm_um))) for one in maps))
    norm = TwoSlopeNorm(0.0, -span, span)
    for axes in grid[len(maps) :]:
        axes.set_axis_off()
    for axes, one in zip(grid, maps, strict=False):
        axes.grid(visible=False)
        hours, position = one.t_s / HOUR_S, one.position_mm
        order = np.argsort(hours, kind="stable")
        if len(position) > 1 and len(hours) > 1:
            axes.pcolormesh(
                hours[order],
                position,
                one.harm_um[order].T,
                cmap="RdBu_r",
                norm=norm,
                shading="nearest",
                edgecolors="face",
                lw=0.3,
            )
            axes.plot(one.largest_at_s / HOUR_S, one.largest_at_mm, "x", color=style.INK, ms=5, clip_on=False)
            axes.set_ylabel("position (mm)")
        else:
            axes.plot(hours[order], one.harm_um[order, 0], color=style.BLUE)
            axes.set_ylabel("harm (µm)")
        axes.set_title(
            f"{one.component}: worst {round(one.largest_um) + 0:+d} µm, allowed {one.limit_um:.0f} µm", fontsize=8.5
        )
        axes.set_xlabel("time (h)")
    bar = figure.colorbar(ScalarMappable(norm, "RdBu_r"), ax=list(grid), pad=0.012, aspect=16 * rows)
    bar.set_label("change (µm)")
    return figure

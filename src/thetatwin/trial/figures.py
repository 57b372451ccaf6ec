"""Pictures of a trial: month by month, and one week in detail."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import NullFormatter

from thetacomp.arrays import CARTESIAN
from thetacomp.report import style
from thetatwin.hall import DAY_S
from thetatwin.trial.monthly_figures import (
    LEAST_ADAPTIVE_PERCENT,
    LEAST_FROZEN_PERCENT,
    TOOL,
    MonthRow,
    rows_of_month,
    size_um,
)
from thetatwin.trial.run import ADAPTIVE, CLOCK, FROZEN, NOTHING, ONE_SENSOR, PROBES_ALONE, Trial
from thetatwin.year import MONTH_DAYS

COLORS = {
    NOTHING: style.BEFORE,
    FROZEN: style.SKY,
    ADAPTIVE: style.BLUE,
    ONE_SENSOR: style.GREEN,
    CLOCK: style.AMBER,
    PROBES_ALONE: style.PURPLE,
}
MARKERS = {NOTHING: "|", FROZEN: "D", ADAPTIVE: "o", ONE_SENSOR: "s", CLOCK: "^", PROBES_ALONE: "v"}
WEEK_DAYS = 7


@style.styled
def month_by_month(rows: Sequence[MonthRow]) -> style.NamedFigure:
    """95th percentile of the error of every column, and the reduction that the limits ask for."""
    figure = style.new_figure(6.2)
    (above,), (below,) = style.grid_of_axes(figure, 2, 1)
    columns = list(dict.fromkeys(row.column for row in rows))
    for column in columns:
        own = [row for row in rows if row.column == column and row.direction == TOOL]
        months = [row.month for row in own]
        figures = {above: [row.p95_after_um for row in own], below: [row.reduction_percent for row in own]}
        for ax, values in figures.items():
            if ax is above or column != NOTHING:
                ax.plot(
                    months, values, color=COLORS[column], marker=MARKERS[column], markersize=5, label=_label(column)
                )
    above.set_yscale("log")
    above.set_ylabel("95th percentile of the error (µm)")
    above.set_yticks([2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000])
    above.yaxis.set_major_formatter("{x:g}")
    above.yaxis.set_minor_formatter(NullFormatter())
    sizes = [row.p95_after_um for row in rows if row.direction == TOOL]
    above.set_ylim(0.8 * min(sizes), 1.25 * max(sizes))
    below.set_ylabel("reduction of the\n95th percentile (%)")
    below.set_xlabel("month after training (each 30 days)")
    below.set_xticks(range(1, max(row.month for row in rows) + 1))
    lowest = min(row.reduction_percent for row in rows if row.direction == TOOL)
    below.set_ylim(min(0.0, 10.0 * np.floor(lowest / 10.0)), 100.0)
    for limit, column in ((LEAST_ADAPTIVE_PERCENT, ADAPTIVE), (LEAST_FROZEN_PERCENT, FROZEN)):
        below.axhline(limit, color=COLORS[column], linewidth=1.0, linestyle="--")
    figure.legend(*above.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return style.NamedFigure(
        "month_by_month",
        "trial",
        "Month by month",
        "Length of the error vector over all places and moments of a month. Dashed: the limits, adaptive in every month"
        f" {LEAST_ADAPTIVE_PERCENT:g} %, frozen in the median month {LEAST_FROZEN_PERCENT:g} %.",
        figure,
    )


@style.styled
def one_week(trial: Trial) -> style.NamedFigure:
    """The week in the middle of the month with the largest uncompensated error, at the place where it is largest."""
    sizes = [float(np.quantile(_before(trial, month), 0.95)) for month in range(trial.schedule.months)]
    month = int(np.argmax(sizes))
    place = int(np.argmax(np.quantile(_before(trial, month), 0.95, axis=0)))
    middle = trial.schedule.training_days + MONTH_DAYS * month + MONTH_DAYS // 2
    monday = 7 * (middle // 7)  # training begins on a Monday
    rows = np.flatnonzero((trial.t_s > monday * DAY_S) & (trial.t_s <= (monday + WEEK_DAYS) * DAY_S))
    figure = style.new_figure(6.8)
    axes = [line[0] for line in style.grid_of_axes(figure, 3, 1)]
    for d, (direction, ax) in enumerate(zip(CARTESIAN, axes, strict=True)):
        for column in (NOTHING, FROZEN, ADAPTIVE):
            error = trial.residual_um[column][rows, place, d]
            ax.plot(trial.t_s[rows] / DAY_S - monday, error, color=COLORS[column], label=_label(column))
        ax.axhline(0.0, color=style.FAINT, linewidth=0.8)
        ax.set_ylabel(f"error in {direction} (µm)")
    _days(axes[-1])
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3)
    return style.NamedFigure(
        "one_week",
        "trial",
        f"One week of month {month + 1}, {trial.places[place].label}",
        "The month and the place with the largest uncompensated error. The adaptive model is probed once a day.",
        figure,
    )


def _before(trial: Trial, month: int) -> np.ndarray:
    return size_um(trial.residual_um[NOTHING][rows_of_month(trial, month)], TOOL)


def _days(ax: Axes) -> None:
    ax.set_xlim(0.0, WEEK_DAYS)
    ax.set_xticks([day + 0.5 for day in range(WEEK_DAYS)], ["Mon", "Tue", "Wed", "Thu", "Fri", "Sat", "Sun"])
    ax.set_xticks(range(WEEK_DAYS + 1), minor=True)
    ax.tick_params(axis="x", which="major", length=0)
    ax.grid(False, axis="x", which="major")
    ax.grid(True, axis="x", which="minor")


def _label(column: str) -> str:
    return "uncompensated" if column == NOTHING else column

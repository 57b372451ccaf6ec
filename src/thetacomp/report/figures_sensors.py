"""Pictures of the search for the best sensors: µm over their number, and how often each one is chosen."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import PercentFormatter

from thetacomp.analysis_result import AnalysisResult
from thetacomp.report import style
from thetacomp.sensors.sensor_curve import SelectionShares, SensorCurve

_MOST_BARS = 16
_SCORES = {
    "held_out": "the error with each campaign left out in turn",
    "residual": "the residual in-sample",
    "worst_campaign": "the error of the worst campaign that is left out",
}


@style.styled
def accuracy_over_sensors(analysis: AnalysisResult) -> list[style.NamedFigure]:
    """One picture for each axis whose sensors were searched."""
    return [_curve_figure(analysis, curve) for curve in analysis.sensor_curves]


def _curve_figure(analysis: AnalysisResult, curve: SensorCurve) -> style.NamedFigure:
    figure = style.new_figure(3.9)
    if curve.shares is None:
        _draw_curve(figure.subplots(), curve)
    else:
        left, right = figure.subplots(1, 2, width_ratios=[2.4, 1.0])
        _draw_curve(left, curve)
        _draw_shares(right, curve.shares)
    place = f"axis {curve.axis}" if curve.axis else "drift"
    name = f"sensor_curve_{style.file_label(curve.axis, 0)}" if curve.axis else "sensor_curve_drift"
    return style.NamedFigure(
        name, "sensor_curve", f"Accuracy against number of sensors, {place}", _caption(analysis, curve), figure
    )


def _caption(analysis: AnalysisResult, curve: SensorCurve) -> str:
    unproven = [str(point.count) for point in curve.points if not point.proven]
    proof = (
        f"The search for {', '.join(unproven)} sensors was stopped early (open mark): a better set may exist there."
        if unproven
        else "Each set is proven: no other of the same size scores better."
    )
    return (
        f"Below each number are the best sensors, chosen by {_SCORES[curve.score]} over"
        f" {len(curve.campaigns)} campaigns; least squares on their rises, RMS over travel and states of the error"
        f" vector. {proof} The held-out error of a set that was chosen by it flatters a little; the ring marks the"
        " fewest sensors within 5 % of the best. This search serves judgement: the key points of the model are chosen"
        " by the strategies above."
    )


def _draw_curve(axes: Axes, curve: SensorCurve) -> None:
    counts = [point.count for point in curve.points]
    held_out = [point.held_out_um for point in curve.points]
    axes.plot(counts, [p.residual_um for p in curve.points], "s--", color=style.FAINT, ms=5, label="in-sample")
    axes.plot(counts, held_out, "o-", color=style.BLUE, ms=6, label="campaigns left out")
    for point in (p for p in curve.points if not p.proven):
        axes.plot(point.count, point.held_out_um, "o", mfc="white", mec=style.BLUE, ms=6)
    best = next(point for point in curve.points if point.count == curve.best)
    axes.plot(best.count, best.held_out_um, "o", mfc="none", mec=style.VERMILLION, mew=1.6, ms=13, label="enough")
    labels = ["\n".join([str(p.count), *(style.short(name, 13) for name in p.sensors)]) for p in curve.points]
    axes.set_xticks(counts, labels)
    axes.set_xlim(counts[0] - 0.5, counts[-1] + 0.5)
    axes.set_ylim(bottom=0.0)
    axes.grid(axis="x", visible=False)
    axes.set_xlabel("number of sensors, and which")
    axes.set_ylabel("error that remains, RMS (µm)")
    axes.legend(loc="best")


def _draw_shares(axes: Axes, shares: SelectionShares) -> None:
    order = [int(j) for j in np.argsort(-np.asarray(shares.share), kind="stable") if shares.share[int(j)] > 0.0]
    order = order[:_MOST_BARS]
    value = np.array([shares.share[j] for j in order])
    axes.barh(np.arange(len(order)), value, height=0.7, color=style.SKY)
    axes.set_yticks(np.arange(len(order)), [style.short(shares.sensors[j], 16) for j in order])
    axes.set_ylim(max(len(order), 6) - 0.4, -0.6)
    axes.set_xlim(0.0, 1.0)
    axes.xaxis.set_major_formatter(PercentFormatter(1.0))
    axes.grid(axis="y", visible=False)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel(f"chosen among the best {shares.count}")
    axes.set_title(f"campaigns resampled {shares.draws} times")

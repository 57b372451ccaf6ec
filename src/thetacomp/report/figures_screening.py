"""Pictures of faulty temperature channels: as read, as used, and the difference."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from thetacomp.analysis_result import AnalysisResult
from thetacomp.report import style
from thetacomp.screening.campaigns import ScreenedChannel
from thetacomp.screening.faults import Finding

_HEIGHT_IN = 4.0
_MOST_FIGURES = 24
_WORDS = {
    "jump": "jump",
    "offset": "off at rest",
    "drift": "drift",
    "stuck": "stuck",
    "swapped": "exchanged",
    "missing": "no reading",
    "noisy": "noisy",
}


@style.styled
def screened_channels(analysis: AnalysisResult) -> list[style.NamedFigure]:
    """One picture for each faulty channel of a campaign, the largest repairs first where there are very many."""
    if analysis.screening is None:
        return []
    channels = list(analysis.screening.channels)
    if len(channels) > _MOST_FIGURES:
        channels = sorted(channels, key=_largest_change_K, reverse=True)[:_MOST_FIGURES]
    return [_figure(analysis, channel) for channel in channels]


def _figure(analysis: AnalysisResult, channel: ScreenedChannel) -> style.NamedFigure:
    figure = style.new_figure(_HEIGHT_IN)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(5, 3))
    hours = channel.t_s / style.HOUR_S
    _draw_readings(above, channel)
    _draw_difference(below, channel)
    for axes in (above, below):
        axes.set_xlim(hours[0], hours[-1])
        _mark_faults(axes, channel.findings, float(hours[-1]))
    _name_faults(above, channel.findings)
    below.set_xlabel("time since the start of the campaign (h)")
    handles, texts = above.get_legend_handles_labels()
    figure.legend(handles, texts, loc="outside upper right", ncols=3)
    number = [c.name for c in analysis.folder.campaigns].index(channel.campaign) + 1
    name = f"screening_{style.file_label(channel.campaign, number)}_{style.file_label(channel.sensor, 0)}"
    title = f"Sensor {channel.sensor} in campaign {channel.campaign}"
    return style.NamedFigure(name, "screening", title, _caption(analysis, channel), figure)


def _caption(analysis: AnalysisResult, channel: ScreenedChannel) -> str:
    shaded = "Shaded: the fault; dotted: the moment at which it was seen."
    if analysis.screening is not None and not analysis.screening.repair:
        return f"{shaded} Repair was switched off: the analysis used the readings as they are."
    if channel.left_out:
        return f"{shaded} The other sensors cannot rebuild it well enough: no reading of this campaign was used."
    return f"{shaded} The analysis used the repaired values; the band is twice their standard deviation."


def _draw_readings(axes: Axes, channel: ScreenedChannel) -> None:
    hours = channel.t_s / style.HOUR_S
    axes.plot(*style.thin(hours, channel.raw_degC), color=style.VERMILLION, lw=1.0, label="as read")
    mended = channel.repaired_degC
    changed = channel.u_K > 0.0
    if changed.any():
        width = np.where(changed, 2.0 * channel.u_K, np.nan)
        axes.fill_between(hours, mended - width, mended + width, color=style.BLUE, alpha=0.18, lw=0)
    if np.isfinite(mended).any() and not channel.left_out:
        axes.plot(*style.thin(hours, mended), color=style.BLUE, lw=1.3, label="repaired")
    axes.set_ylabel("temperature (°C)")


def _draw_difference(axes: Axes, channel: ScreenedChannel) -> None:
    hours = channel.t_s / style.HOUR_S
    axes.axhline(0.0, color=style.FAINT, lw=0.8)
    difference_K = channel.raw_degC - channel.repaired_degC
    if np.isfinite(difference_K).any():
        axes.plot(*style.thin(hours, difference_K), color=style.INK, lw=1.0)
    axes.set_ylabel("as read less\nrepaired (K)")


def _mark_faults(axes: Axes, findings: tuple[Finding, ...], last_h: float) -> None:
    for f in findings:
        end_h = last_h if f.end_s is None else f.end_s / style.HOUR_S
        axes.axvspan(f.start_s / style.HOUR_S, end_h, color=style.AMBER, alpha=0.12, lw=0, zorder=0)
        axes.axvline(f.detected_s / style.HOUR_S, color=style.INK, lw=0.9, ls=":")


def _name_faults(axes: Axes, findings: tuple[Finding, ...]) -> None:
    for f in findings[:4]:
        axes.annotate(
            _WORDS[f.kind], (max(f.start_s, 0.0) / style.HOUR_S, 1.0), xycoords=("data", "axes fraction"),
            xytext=(3, 2), textcoords="offset points", va="bottom", fontsize=7.5,
        )  # fmt: skip


def _largest_change_K(channel: ScreenedChannel) -> float:
    change_K = np.abs(channel.raw_degC - channel.repaired_degC)
    return float(np.max(change_K[np.isfinite(change_K)], initial=0.0)) + (1e3 if channel.left_out else 0.0)

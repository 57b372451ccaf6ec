"""The replay through a control's limits as words, table and picture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.lines import Line2D

from thetacomp.arrays import Floats
from thetacomp.campaign import Campaign
from thetacomp.controllers.replay import NOTICED_UM, TOGETHER, Loss
from thetacomp.controllers.sinumerik_replay import CampaignReplay
from thetacomp.report import style
from thetacomp.report.rendering import render
from thetacomp.report.style import HOUR_S
from thetacomp.separation.reference import reference_time_s
from thetacomp.table_file import csv_text, fixed

TABLE_FILE = "replay.csv"
FIGURE_NAME = "replay"
GRID_S = 1.0
_MOST_REGISTERS = 8


def series(campaign: Campaign) -> tuple[Floats, dict[str, Floats]]:
    """Every second from the campaign's zero to its last sample, (n,), and the sensors' temperatures then, (n,) each."""
    table = campaign.temperatures
    t_s = np.arange(reference_time_s(campaign), float(table.t_s[-1]) + GRID_S / 2, GRID_S)
    value = table.unbridged_at(t_s)
    return t_s, {sensor: value[:, j] for j, sensor in enumerate(table.sensor_ids)}


def replay_lines(replays: Sequence[CampaignReplay]) -> list[str]:
    """The worst loss of every cause over all campaigns, as lines for the console."""
    losses = [(one.campaign, loss) for one in replays for loss in one.losses]
    lines = [f"replay of {len(replays)} campaign{'s' * (len(replays) != 1)} through the limits (µm, worst position):"]
    causes = dict.fromkeys(loss.cause for _, loss in losses)
    for cause in (*(c for c in causes if c != TOGETHER), TOGETHER):
        campaign, worst = max(((c, x) for c, x in losses if x.cause == cause), key=lambda item: item[1].largest_um)
        lines.append(
            f"  {cause:<26} at most {worst.largest_um:6.1f}, p95 {worst.p95_um:6.1f}"
            + (f"   {worst.register} of {worst.axis}, {_place(campaign, worst)}" if worst.largest_um >= 0.05 else "")
        )
    slow = {check.register: check for one in replays for check in one.motion if not check.holds}
    lines += [
        f"  TOO SLOW: {name} changes by {check.needed_um_per_s:.0f} µm/s while the axis moves at full speed;"
        f" the control allows {check.allowed_um_per_s:.0f} µm/s"
        for name, check in slow.items()
    ]
    return lines


def replay_files(replays: Sequence[CampaignReplay]) -> dict[str, str | bytes]:
    """replay.csv and the picture of the campaign that loses most, by file name."""
    head = ["campaign", "axis", "register", "cause", "largest_um", "p95_um", "largest_at_s", "share_of_time"]
    rows = [
        (one.campaign, x.axis, x.register, x.cause, fixed(x.largest_um, 3), fixed(x.p95_um, 3),
         fixed(x.largest_at_s, 0), fixed(x.share_of_time, 4))
        for one in replays
        for x in one.losses
    ]  # fmt: skip
    worst = max(replays, key=lambda one: max(x.largest_um for x in one.losses if x.cause == TOGETHER))
    drawn = render(replay_figure(worst))
    return {TABLE_FILE: csv_text(head, rows), f"{FIGURE_NAME}.svg": drawn.svg, f"{FIGURE_NAME}.png": drawn.png}


@style.styled
def replay_figure(one: CampaignReplay) -> style.NamedFigure:
    """Wanted and arrived value of the registers that lose most, and below what is lost."""
    lost = np.abs(np.nan_to_num(one.wanted_um) - one.got_um)
    order = np.argsort(-np.max(lost, axis=1), kind="stable")[:_MOST_REGISTERS]
    figure = style.new_figure(5.0)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    hours = one.t_s / HOUR_S
    for k, j in enumerate(order):
        color = style.KEY_COLORS[k % len(style.KEY_COLORS)]
        line = "-" if k < len(style.KEY_COLORS) else "-."
        above.plot(*style.thin(hours, one.wanted_um[j]), ":", color=color, lw=1.0)
        above.plot(*style.thin(hours, one.got_um[j]), line, color=color, label=one.registers[j])
        below.plot(*style.highest(hours, lost[j]), line, color=color)
    above.set_ylabel("at the axis (µm)")
    below.set_ylabel("clipped or late (µm)")
    below.set_xlabel("time (h)")
    below.set_ylim(0.0, max(NOTICED_UM, 1.1 * float(lost.max())))
    handles = [*above.get_legend_handles_labels()[0], Line2D([], [], color=style.INK, ls=":", label="wanted")]
    figure.legend(handles=handles, loc="outside right upper")
    above.set_title(f"campaign {one.campaign}: wanted (dotted) and what arrives, worst position of each register")
    caption = "Wanted register values of a measured campaign and what is left of them behind all limits."
    return style.NamedFigure(FIGURE_NAME, "replay", "Replay through the limits", caption, figure)


def _place(campaign: str, loss: Loss) -> str:
    return f"campaign {campaign}, {loss.largest_at_s / HOUR_S:.1f} h"

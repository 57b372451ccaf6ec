"""Pictures of the sensor placement: the warm machine with its sensors, and accuracy against number of sensors."""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.axes import Axes

from thetacomp.report import style
from thetacomp.report.style import NamedFigure
from thetatwin.picture import BACK, FRONT, Mark, machine_figure, sensor_marks, warm_machine
from thetatwin.sensor_places import STRATEGIES, Placement
from thetatwin.virtual_machine import VirtualMachine

_CHOSEN = "#ffd54a"
_COLORS = {
    "displacement": style.BLUE,
    "exchange": style.SKY,
    "modes": style.GREEN,
    "sensitivity": style.AMBER,
    "linearity": style.PURPLE,
}
_MARKERS = {"displacement": "o", "exchange": "v", "modes": "s", "sensitivity": "^", "linearity": "D"}
_PANELS = ("X", "Y", "Z", "all three directions")


@style.styled
def machine_with_sensors(machine: VirtualMachine, placement: Placement, tool_length_mm: float) -> NamedFigure:
    """The machine after the published run's warm-up, with the chosen places and the existing sensors."""
    positions = {a.name: 0.5 * sum(a.travel_mm) for a in machine.description.axes}
    shown = warm_machine(machine, placement.warm_rise_K, placement.warm_rise_K, positions, tool_length_mm)
    free, best = placement.candidates, placement.choice("displacement")
    chosen = tuple(
        Mark(str(rank), free.part[i], tuple(free.at_mm[i].tolist()), _CHOSEN)
        for rank, i in enumerate(best.chosen, start=1)
    )
    figure = machine_figure(
        shown,
        f"{machine.description.name} after 8 h of work",
        (*chosen, *sensor_marks(machine)),
        (("from the front", FRONT), ("from behind", BACK)),
        (10.2, 6.3),
    )
    caption = (
        f"Yellow numbers: the {len(chosen)} places that say most about the tool, the most useful first. White: the"
        " existing sensors. Each is drawn on the side from which it is seen; those that a casting hides are half"
        " transparent. The machine was at the reference temperature before the published run's work began."
    )
    return NamedFigure("machine", "machine", "Temperature, displacement and sensors", caption, figure)


@style.styled
def accuracy(placement: Placement) -> NamedFigure:
    """Expected error of the tool against the number of sensors, each direction and all together."""
    figure = style.new_figure(5.6)
    grid = figure.subplots(2, 2, sharex=True, sharey=True)
    for panel, (axes, name) in enumerate(zip(grid.ravel(), _PANELS, strict=True)):
        _draw_panel(axes, placement, panel)
        nothing = placement.existing.judged_um[0, panel]
        axes.set_title(f"{name} (no sensor: {nothing:.0f} µm)")
    for axes in grid[1]:
        axes.set_xlabel("number of sensors")
    for axes in grid[:, 0]:
        axes.set_ylabel("error of the tool (µm)")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=2)
    caption = (
        f"Root mean square over {placement.states[1]} hours of work that were not used for choosing, and over the"
        " positions; the noise of the thermometers is included. The scale is logarithmic."
    )
    return NamedFigure("accuracy", "accuracy", "Accuracy against number of sensors", caption, figure)


def _draw_panel(axes: Axes, placement: Placement, panel: int) -> None:
    for choice in placement.choices:
        error = choice.curve.judged_um[1:, panel]
        main = choice.strategy == "displacement"
        axes.plot(
            np.arange(1, len(error) + 1), error, marker=_MARKERS[choice.strategy], ms=4.5 if main else 3.5,
            lw=2.0 if main else 1.2, color=_COLORS[choice.strategy], label=STRATEGIES[choice.strategy],
            zorder=4 if main else 3,
        )  # fmt: skip
    existing = placement.existing.judged_um[1:, panel]
    axes.plot(
        np.arange(1, len(existing) + 1), existing, "--", color=style.INK, marker="x", ms=4,
        label=f"the {len(existing)} existing sensors, best order", zorder=5,
    )  # fmt: skip
    drawn = placement.random_um[1:, panel]
    axes.plot(np.arange(1, len(drawn) + 1), drawn, ":", color=style.BEFORE, label="random places, median of 50 sets")
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(matplotlib.ticker.LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(matplotlib.ticker.FuncFormatter(lambda v, _: f"{v:g}"))
    axes.yaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())
    axes.xaxis.set_major_locator(matplotlib.ticker.MaxNLocator(integer=True))

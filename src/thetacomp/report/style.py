"""One quiet look for all pictures: colours that colour-blind readers can distinguish, fonts, small layout helpers."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ParamSpec, TypeVar

import matplotlib
import numpy as np
from matplotlib import font_manager
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from scipy.optimize import isotonic_regression

from thetacomp.arrays import Floats

HOUR_S = 3600.0
WIDTH_IN = 9.0
"""Width of every full picture: 9 pt letters stay readable on an A4 page."""

INK = "#1f2933"
FAINT = "#9aa5b1"
GRID = "#e4e7eb"
BLUE, VERMILLION, GREEN, AMBER = "#0072B2", "#D55E00", "#009E73", "#E69F00"
PURPLE, SKY = "#CC79A7", "#56B4E9"
KEY_COLORS = (BLUE, VERMILLION, GREEN, PURPLE, AMBER, SKY)
BEFORE = "#5f6670"
OUTLYING = VERMILLION
WORSE = "#c62828"

# One colour, marker and name for each model, the same in every picture.
MODEL_COLORS = {"nothing": BEFORE, "default": BLUE, "clock": AMBER, "one_sensor": GREEN, "paper": PURPLE}
MODEL_MARKERS = {"nothing": "|", "default": "o", "clock": "^", "one_sensor": "s", "paper": "D"}
MODEL_NAMES = {
    "nothing": "uncompensated",
    "default": "model",
    "key_points": "law on key points",
    "clock": "clock alone",
    "one_sensor": "one key sensor",
    "paper": "paper's method",
    "all_sensors": "all sensors",
    "training_mean": "training mean",
}

TIME_COLORS = LinearSegmentedColormap.from_list(
    "thetacomp_time", matplotlib.colormaps["viridis"](np.linspace(0.0, 0.88, 64))
)
CAMPAIGN_MARKS = ("o", "s", "D", "^", "v", "P", "X", "*")
CAMPAIGN_LINES = ("-", "--", ":", "-.")
DIRECTION_MARKS = {1: ("+", "-"), -1: ("\N{MINUS SIGN}", "--"), 0: ("", "-")}

# In this order: the first that is installed draws what DejaVu Sans cannot.
_CJK_FAMILIES = (
    "Noto Sans CJK SC", "Noto Sans SC", "Microsoft YaHei", "SimHei", "Source Han Sans SC", "Source Han Sans",
    "PingFang SC", "WenQuanYi Zen Hei", "WenQuanYi Micro Hei", "Noto Sans CJK JP",
)  # fmt: skip
_CJK_FILES = re.compile(r"NotoSans(CJK|SC)|msyh|simhei|SourceHanSans|PingFang|wqy-", re.IGNORECASE)

P = ParamSpec("P")
R = TypeVar("R")


@dataclass(frozen=True)
class NamedFigure:
    """One picture. `name` is the file's name without ending; `section` the place in the report that shows it."""

    name: str
    section: str
    title: str
    caption: str
    figure: Figure


@functools.cache
def font_families() -> tuple[str, ...]:
    """DejaVu Sans, then the first installed font with Chinese letters.

    Matplotlib keeps a list of fonts from its first start, so files installed later are added here.
    """
    known = {entry.name for entry in font_manager.fontManager.ttflist}
    if not known.intersection(_CJK_FAMILIES):
        for path in sorted(font_manager.findSystemFonts()):
            if _CJK_FILES.search(Path(path).name):
                font_manager.fontManager.addfont(path)
        known = {entry.name for entry in font_manager.fontManager.ttflist}
    return ("DejaVu Sans", *[family for family in _CJK_FAMILIES if family in known][:1])


def settings() -> dict[str, object]:
    """Matplotlib settings of every picture."""
    return {
        "font.family": list(font_families()),
        "font.size": 9.0,
        "axes.titlesize": 9.5,
        "axes.titlelocation": "left",
        "axes.labelsize": 9.0,
        "axes.labelcolor": INK,
        "axes.edgecolor": "#7b8794",
        "axes.linewidth": 0.8,
        "axes.grid": True,
        "axes.axisbelow": True,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.formatter.useoffset": False,
        "grid.color": GRID,
        "grid.linewidth": 0.7,
        "text.color": INK,
        "text.parse_math": False,  # a user's name may hold a dollar sign
        "xtick.color": "#52606d",
        "ytick.color": "#52606d",
        "xtick.labelsize": 8.0,
        "ytick.labelsize": 8.0,
        "legend.frameon": False,
        "legend.fontsize": 8.0,
        "lines.linewidth": 1.4,
        "figure.constrained_layout.h_pad": 0.06,
        "figure.constrained_layout.w_pad": 0.06,
        "svg.fonttype": "none",
        "svg.hashsalt": "thetacomp",
    }


def styled(draw: Callable[P, R]) -> Callable[P, R]:
    """Run a drawing function under the common settings and leave the global ones as they were."""

    @functools.wraps(draw)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        with matplotlib.rc_context(settings()):  # type: ignore[arg-type]
            return draw(*args, **kwargs)

    return wrapped


def new_figure(height_in: float, width_in: float = WIDTH_IN) -> Figure:
    """An empty figure whose parts keep clear of each other."""
    return Figure(figsize=(width_in, height_in), layout="constrained")


def grid_of_axes(figure: Figure, rows: int, columns: int) -> list[list[Axes]]:
    """Axes in `rows` lists of `columns`; the x axis is shared down each column."""
    made = figure.subplots(rows, columns, squeeze=False, sharex="col")
    return [list(row) for row in made]


def time_bar(figure: Figure, axes: Iterable[Axes], norm: Normalize) -> None:
    """A colour bar in hours next to `axes`."""
    bar = figure.colorbar(ScalarMappable(norm, TIME_COLORS), ax=list(axes), pad=0.015, aspect=36)
    bar.set_label("time since the start of the campaign (h)")
    bar.outline.set_visible(False)


def time_norm(times_s: Sequence[Floats]) -> Normalize:
    """Colour scale over all times, in hours; never of zero length."""
    all_s = np.concatenate(times_s)
    low, high = float(np.min(all_s)) / HOUR_S, float(np.max(all_s)) / HOUR_S
    return Normalize(low, high if high > low else low + 1.0)


def unit_of(direction: str) -> str:
    """Unit of an error in a direction: an angle is given in µrad."""
    return "µrad" if direction in ("A", "B", "C") else "µm"


def spread(wanted: Floats, gap: float, low: float, high: float) -> Floats:
    """Places for labels: as near as possible to `wanted` (n,), at least `gap` apart, inside low..high if they fit."""
    if len(wanted) == 0:
        return wanted
    order = np.argsort(wanted, kind="stable")
    steps = gap * np.arange(len(wanted))
    # Equal distances turn "at least gap apart" into "does not fall", which has a closed least-squares answer.
    level = isotonic_regression(wanted[order] - steps).x
    level = np.clip(level, low, max(low, high - steps[-1]))
    placed = np.empty(len(wanted))
    placed[order] = level + steps
    return placed


def thin(t: Floats, value: Floats, buckets: int = 300) -> tuple[Floats, Floats]:
    """Lowest and highest value of each bucket of a long record, so that a drawn line keeps its peaks."""
    if len(t) <= 2 * buckets:
        return t, value
    keep: set[int] = {0, len(t) - 1}
    for part in np.array_split(np.arange(len(t)), buckets):
        good = part[np.isfinite(value[part])]
        if len(good):
            keep.update((int(good[np.argmin(value[good])]), int(good[np.argmax(value[good])])))
    rows = np.array(sorted(keep))
    return t[rows], value[rows]


def highest(t: Floats, value: Floats, buckets: int = 120) -> tuple[Floats, Floats]:
    """Highest value of each bucket of a long record: the envelope of what happened."""
    if len(t) <= buckets:
        return t, value
    parts = np.array_split(np.arange(len(t)), buckets)
    rows = np.array([part[int(np.argmax(np.nan_to_num(value[part], nan=-np.inf)))] for part in parts])
    return t[rows], value[rows]


def stride(n: int, most: int) -> slice:
    """Every k-th of n so that at most about `most` remain."""
    return slice(None, None, max(1, -(-n // most)))


def short(name: str, letters: int) -> str:
    """A name cut to a number of letters; the full one stands in the tables."""
    return name if len(name) <= letters else name[: letters - 1] + "…"


def file_label(name: str, number: int) -> str:
    """A part of a file name for a campaign: plain ASCII; its number where nothing is left."""
    plain = re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip("-.")
    return plain[:40] or f"campaign-{number}"

"""Every figure of an evaluated test as one row with its unit, its period and the instrument's uncertainty."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from thetacomp.standards.campaign_tests import Evaluated
from thetacomp.standards.instrument import Instrument
from thetacomp.standards.iso230_2 import Positioning
from thetacomp.standards.iso230_3 import ThermalTest

KINDS = {"etve": "ETVE", "spindle": "spindle", "axis": "linear axis"}


@dataclass(frozen=True)
class FigureRow:
    """One figure. `value` and `u` (expanded uncertainty of the instrument's share; None: not stated) are in `unit`.

    `place` is a target position or empty; `start_s` and `end_s` are NaN where the readings carry no time.
    """

    campaign: str
    standard: str
    test: str
    axis: str
    symbol: str
    place: str
    value: float
    unit: str
    u: float | None
    start_s: float
    end_s: float


AXIS_SYMBOLS = (
    ("A", "A_um", "bidirectional accuracy"),
    ("A_up", "A_up_um", "accuracy, approach +"),
    ("A_down", "A_down_um", "accuracy, approach -"),
    ("R", "R_um", "bidirectional repeatability"),
    ("R_up", "R_up_um", "repeatability, approach +"),
    ("R_down", "R_down_um", "repeatability, approach -"),
    ("E", "E_um", "bidirectional systematic deviation"),
    ("E_up", "E_up_um", "systematic deviation, approach +"),
    ("E_down", "E_down_um", "systematic deviation, approach -"),
    ("M", "M_um", "mean bidirectional deviation"),
    ("B", "B_um", "reversal"),
    ("B_mean", "B_mean_um", "mean reversal"),
)
TARGET_SYMBOLS = (
    ("x_mean_up", "mean_up_um"),
    ("x_mean_down", "mean_down_um"),
    ("x_mean", "mean_um"),
    ("B_i", "reversal_um"),
    ("s_up", "s_up_um"),
    ("s_down", "s_down_um"),
    ("R_i_up", "repeatability_up_um"),
    ("R_i_down", "repeatability_down_um"),
    ("R_i", "repeatability_um"),
)


def figure_rows(test: Evaluated) -> tuple[FigureRow, ...]:
    """All figures of one test."""
    campaign = test.campaign.name if test.campaign is not None else ""
    if isinstance(test.result, Positioning):
        return tuple(_positioning(test.result, campaign, test.instrument))
    return tuple(_thermal(test.result, campaign))


def axis_u_um(symbol: str, result: Positioning, instrument: Instrument) -> float | None:
    """The instrument's share of a figure: both ends of the measured length for A, E, M; one place for R and B."""
    apart_mm = result.runs.length_mm if symbol[0] in "AEM" else 0.0
    return instrument.difference_u_um(apart_mm)


def _positioning(result: Positioning, campaign: str, instrument: Instrument) -> Iterator[FigureRow]:
    axis = result.runs.axis

    def row(symbol: str, place: str, value: float, u: float | None) -> FigureRow:
        start_s, end_s = result.span_s
        return FigureRow(campaign, "ISO 230-2", "positioning", axis, symbol, place, value, "µm", u, start_s, end_s)

    for symbol, name, _ in AXIS_SYMBOLS:
        yield row(symbol, "", getattr(result.figures, name), axis_u_um(symbol, result, instrument))
    yield row("run_drift", "", result.run_drift_um, None)
    for i, target_mm in enumerate(result.targets.target_mm):
        for symbol, name in TARGET_SYMBOLS:
            yield row(symbol, f"{target_mm:g} mm", float(getattr(result.targets, name)[i]), None)


def _thermal(test: ThermalTest, campaign: str) -> Iterator[FigureRow]:
    start_s = test.start_s
    for line in test.lines:
        figures = [
            ("range_60min", line.first_hour, min(start_s + 3600.0, test.end_s)),
            ("range", line.period, test.end_s),
            ("change", line.change, test.end_s),
        ]
        for word, value, end_s in figures[1 if test.kind == "etve" else 0 :]:
            yield FigureRow(
                campaign,
                "ISO 230-3",
                KINDS[test.kind],
                test.axis,
                f"{line.quantity}_{word}",
                line.place,
                value,
                line.unit,
                line.u,
                start_s,
                end_s,
            )

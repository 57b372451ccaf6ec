"""Pages of the ISO 230 tests: one HTML file a test, its figure as SVG and PNG, and all figures in one CSV."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields

import numpy as np

from thetacomp.campaign import Campaign
from thetacomp.machine import Machine
from thetacomp.report.figures_iso230 import positioning_figure, thermal_figure
from thetacomp.report.page_writer import page
from thetacomp.report.rendering import draw
from thetacomp.report.style import HOUR_S, file_label
from thetacomp.report.tables import NOT_AVAILABLE, number
from thetacomp.standards.campaign_tests import Evaluated
from thetacomp.standards.figure_rows import AXIS_SYMBOLS, TARGET_SYMBOLS, FigureRow, axis_u_um, figure_rows
from thetacomp.standards.instrument import Instrument
from thetacomp.standards.iso230_2 import Positioning
from thetacomp.standards.iso230_3 import ThermalTest
from thetacomp.table_file import csv_text, plain

TABLE = "iso230.csv"
OWN = ("iso230*", "figures/iso230-*")
_ARROWS = {"_up": "↑", "_down": "↓", "_mean": " mean"}


@dataclass(frozen=True)
class Grid:
    """A table of a page: heads (text, unit) and cells, the first `words` columns being words, the others numbers."""

    heads: tuple[tuple[str, str], ...]
    cells: tuple[tuple[str, ...], ...]
    words: int = 1
    title: str = ""


def iso230_files(machine: Machine | None, tests: Sequence[Evaluated]) -> dict[str, str | bytes]:
    """`iso230.csv`, a page for each test and its figure in `figures/`, by file name, the table first.

    `machine` is None for a single table. Letters that no installed font can draw are reported on stderr.
    """
    cells = ([plain(value) for value in astuple(row)] for test in tests for row in figure_rows(test))
    files: dict[str, str | bytes] = {TABLE: csv_text([field.name for field in fields(FigureRow)], cells)}
    for name, test in zip(_names(tests), tests, strict=True):
        files |= _page_files(name, test, machine)
    return files


def _names(tests: Sequence[Evaluated]) -> list[str]:
    """File names without ending: the test and the campaign, unique and plain."""
    names: list[str] = []
    for number_, test in enumerate(tests, start=1):
        result = test.result
        part = f"2_{result.runs.axis}" if isinstance(result, Positioning) else f"3_{result.kind}"
        axis = f"_{result.axis}" if isinstance(result, ThermalTest) and result.axis else ""
        campaign = f"_{test.campaign.name}" if test.campaign is not None else ""
        name = file_label(f"iso230-{part}{axis}{campaign}", number_)
        names.append(name if name not in names else f"{name}-{number_}")
    return names


def _page_files(name: str, test: Evaluated, machine: Machine | None) -> dict[str, str | bytes]:
    result = test.result
    if isinstance(result, Positioning):
        figure = positioning_figure(name, result)
        grids = _positioning_grids(result, test.instrument)
    else:
        assert test.campaign is not None
        assert machine is not None
        figure = thermal_figure(name, result, test.campaign, machine)
        grids = (_thermal_grid(result),)
    drawings = draw([figure])
    text = page(
        "thetacomp.report/iso230.html.j2",
        title=test.title,
        machine=machine.name if machine is not None else "",
        campaign=test.campaign,
        unproven=test.campaign is not None and test.campaign.settings.sign == "unproven",
        grids=grids,
        conditions=_conditions(test),
        remarks=result.remarks,
        not_computed=result.not_computed if isinstance(result, ThermalTest) else (),
        figure=drawings.inline()[figure.name],
        positioning=isinstance(result, Positioning),
    )
    return {f"{name}.html": text, **drawings.files()}


def digits_for(values: Sequence[float]) -> int:
    """Decimals that show three digits of the largest value, but not more than two."""
    largest = max((abs(v) for v in values if math.isfinite(v)), default=0.0)
    return 1 if largest >= 10.0 else 2


def _u(value: float | None, digits: int) -> str:
    return NOT_AVAILABLE if value is None else f"± {value:.{digits}f}"


def _symbol(symbol: str) -> str:
    for tail, arrow in _ARROWS.items():
        if symbol.endswith(tail):
            return symbol.removesuffix(tail) + arrow
    return symbol


def _positioning_grids(result: Positioning, instrument: Instrument) -> tuple[Grid, ...]:
    values = {symbol: getattr(result.figures, name) for symbol, name, _ in AXIS_SYMBOLS}
    digits = 2 if values["E"] < 100.0 else 1
    lines = [
        (
            _symbol(symbol),
            meaning.replace(" -", " \N{MINUS SIGN}"),
            number(values[symbol], digits),
            _u(axis_u_um(symbol, result, instrument), digits),
        )
        for symbol, _, meaning in AXIS_SYMBOLS
        if math.isfinite(values[symbol])
    ]
    axis = Grid((("symbol", ""), ("figure", ""), ("value", "µm"), ("U of the instrument", "µm")), tuple(lines), 2)
    targets = result.targets
    heads = {"x_mean": "x mean", "x_mean_up": "x mean ↑", "x_mean_down": "x mean ↓", "B_i": "Bᵢ", "R_i": "Rᵢ"}
    heads |= {"R_i_up": "Rᵢ↑", "R_i_down": "Rᵢ↓"}
    shown = [(symbol, name) for symbol, name in TARGET_SYMBOLS if np.isfinite(getattr(targets, name)).all()]
    cells = tuple(
        (f"{target_mm:g}", *(number(float(getattr(targets, name)[i]), digits) for _, name in shown))
        for i, target_mm in enumerate(targets.target_mm)
    )
    columns = (("target", "mm"), *((heads.get(symbol, _symbol(symbol)), "µm") for symbol, _ in shown))
    return axis, Grid(columns, cells, 0, "At each target position")


def _thermal_grid(test: ThermalTest) -> Grid:
    digits = digits_for([line.period for line in test.lines])
    hours = f"{(test.end_s - test.start_s) / HOUR_S:.1f} h"
    etve = test.kind == "etve"
    placed = any(line.place for line in test.lines)
    heads = [("displacement", "")]
    heads += [("at", "")] * placed + [("unit", "")]
    heads += [] if etve else [("range in the first 60 min", "")]
    heads += [(f"{'ETVE: ' if etve else ''}range in {hours}", ""), (f"change after {hours}", "")]
    heads += [("U of the instrument", "")]
    cells = []
    for line in test.lines:
        words = [line.quantity, *([line.place.replace(" -", " \N{MINUS SIGN}")] if placed else []), line.unit]
        figures = [] if etve else [number(line.first_hour, digits)]
        figures += [number(line.period, digits), number(line.change, digits), _u(line.u, digits)]
        cells.append((*words, *figures))
    return Grid(tuple(heads), tuple(cells), 3 if placed else 2)


def _conditions(test: Evaluated) -> list[str]:
    """Instrument and conditions of the figures, as sentences."""
    result, words = test.result, []
    if isinstance(result, Positioning):
        runs = result.runs
        words.append(
            f"{len(runs.target_mm)} targets from {runs.target_mm[0]:g} to {runs.target_mm[-1]:g} mm, {runs.count}"
            f" run{'s' if runs.count > 1 else ''} in each direction. Deviations as read: no correction to 20 °C."
        )
        if math.isfinite(result.run_drift_um):
            words.append(f"Change from the first run to the last, mean of all targets: {result.run_drift_um:.2f} µm.")
        start_s, end_s = result.span_s
        if math.isfinite(start_s):
            words.append(f"Readings from {start_s / HOUR_S:.2f} to {end_s / HOUR_S:.2f} h.")
    else:
        start_s, end_s = result.start_s, result.end_s
        words.append(f"Period of the figures: {start_s / HOUR_S:.2f} to {end_s / HOUR_S:.2f} h of the campaign.")
    if test.campaign is not None:
        if math.isfinite(start_s):
            words += _temperature_words(test.campaign, start_s, end_s)
        words += _settings_words(test.campaign)
    not_stated = "not stated: a separate table has no uncertainty"
    words.append(f"Instrument: {test.instrument.statement if test.campaign is not None else not_stated}.")
    return words


def _temperature_words(campaign: Campaign, start_s: float, end_s: float) -> list[str]:
    heat = campaign.temperatures
    inside = heat.value_degC[(heat.t_s >= start_s) & (heat.t_s <= end_s)]
    if not np.isfinite(inside).any():
        return []
    spread = [np.ptp(c[np.isfinite(c)]) if np.isfinite(c).any() else -1.0 for c in inside.T]
    most = int(np.argmax(spread))
    return [
        f"Temperatures in this time: {np.nanmin(inside):.1f} to {np.nanmax(inside):.1f} °C over all sensors;"
        f" {heat.sensor_ids[most]} moved most, by {spread[most]:.1f} K."
    ]


def _settings_words(campaign: Campaign) -> list[str]:
    settings = campaign.settings
    words = [f"Operating mode: {settings.mode}."] if settings.mode else []
    if settings.compensation == "on" or settings.active_tables:
        active = ", ".join(settings.active_tables) or "thermal compensation"
        words.append(f"Active in the control during the test: {active}.")
    return words

"""What a family is: a way to fit a table of rows under each of its settings, and which inputs it may use."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from thetacomp.arrays import Floats, Ints
from thetacomp.axis_states import AxisStates, Samples
from thetacomp.errors import AnalysisError

BUDGET = 12
"""Settings that every family may try: one fixed list for every machine and channel."""

MAX_ROWS = 400
"""Most rows of a campaign that train any family; neighbours of a long recording are nearly copies."""

MISSING_SHARE = 0.10
LAGS, RISES = "rises and lags", "rises"


@dataclass(frozen=True)
class Rows:
    """Inputs of n rows in order of campaign and time: x (n, k), campaign (n,), elapsed_h (n,)."""

    x: Floats
    campaign: Ints
    elapsed_h: Floats

    def take(self, rows: np.ndarray) -> Rows:
        """Some of the rows."""
        return Rows(self.x[rows], self.campaign[rows], self.elapsed_h[rows])


@dataclass(frozen=True)
class Table:
    """What a family is fitted on: rows, their targets y (n, m), and the group (k,) of every input: one a sensor."""

    rows: Rows
    y: Floats
    group: Ints

    def take(self, rows: np.ndarray) -> Table:
        """Some of the rows."""
        return Table(self.rows.take(rows), self.y[rows], self.group)


Forecast = Callable[[Rows], Floats]
"""Targets (n, m) of rows from their inputs alone."""

Fit = Callable[[Table, Sequence[Any]], list[Forecast | None]]
"""One forecast a setting; None where the table cannot carry that setting."""


@dataclass(frozen=True)
class Family:
    """One family of models. `sequential` families need the rows of a campaign one after another."""

    name: str
    inputs: Literal["rises", "rises and lags"]
    settings: tuple[Any, ...]
    fit: Fit
    max_rows: int = MAX_ROWS
    sequential: bool = False
    remark: str = ""


def one_by_one(fit: Callable[[Table, Any], Forecast]) -> Fit:
    """A family without shortcuts between its settings; a setting that raises AnalysisError gives None."""

    def all_settings(table: Table, settings: Sequence[Any]) -> list[Forecast | None]:
        out: list[Forecast | None] = []
        for setting in settings:
            try:
                out.append(fit(table, setting))
            except AnalysisError:
                out.append(None)
        return out

    return all_settings


def linear(coef: Floats) -> Forecast:
    """The forecast `x coef` of coefficients (k, m): no rise, no error."""
    return lambda rows: np.asarray(rows.x @ coef)


def size_of(x: Floats) -> Floats:
    """Root mean square of every column about zero, (k,); 1 where a column is zero throughout."""
    size = np.sqrt(np.mean(x * x, axis=0))
    return np.where(size > 0.0, size, 1.0)


def thinned(campaign: Ints, most: int) -> Ints:
    """Rows (ascending) that remain when every campaign keeps at most `most` of its rows, evenly spread."""
    kept = []
    for label in np.unique(campaign):
        rows = np.flatnonzero(campaign == label)
        kept.append(rows if len(rows) <= most else rows[np.linspace(0, len(rows) - 1, most).round().astype(int)])
    return np.concatenate(kept)


def columns_of(states: AxisStates, inputs: str) -> tuple[Ints, Ints]:
    """Columns of the inputs that are read in nearly all states, and the group of each: a sensor with its lags."""
    if inputs == LAGS:
        if states.layout is None:
            raise AnalysisError(f"axis {states.axis or 'drift'}: no sensor was read in all campaigns.")
        value, group = states.history, np.unique(states.layout.groups, return_inverse=True)[1]
    else:
        value, group = states.rise_K, np.arange(states.rise_K.shape[1])
    known = np.isfinite(value)
    shares = [known[states.campaign == label].mean(axis=0) for label in np.unique(states.campaign)]
    columns = np.flatnonzero(np.min(shares, axis=0) >= 1.0 - MISSING_SHARE)
    if not len(columns):
        raise AnalysisError(f"axis {states.axis or 'drift'}: no sensor was read in all campaigns.")
    return columns, group[columns]


def state_rows(states: AxisStates, columns: Ints, inputs: str) -> Rows:
    """The inputs of all states."""
    value = states.history if inputs == LAGS else states.rise_K
    return Rows(value[:, columns], states.campaign, states.elapsed_h)


def sample_rows(states: AxisStates, samples: Samples, columns: Ints, inputs: str) -> Rows:
    """The inputs at the moments of single samples."""
    value = samples.history if inputs == LAGS else samples.rise_K
    return Rows(value[:, columns], states.campaign[samples.state], samples.elapsed_h)

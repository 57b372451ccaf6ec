"""The one procedure for all families: settings are compared by holding out campaigns inside the training campaigns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Bools, Floats, Ints
from thetacomp.axis_states import AxisStates, Samples
from thetacomp.errors import AnalysisError
from thetacomp.fitting.key_point_law import AnyProcedure
from thetacomp.validation.families.family import (
    Family,
    Forecast,
    Rows,
    Table,
    columns_of,
    sample_rows,
    state_rows,
    thinned,
)


@dataclass(frozen=True)
class FamilyModel:
    """A fitted family of one axis: its targets are those of `AxisStates.targets` for `components`.

    `chosen` holds the number of the setting of every target, `scored` how many settings could be compared.
    """

    family: Family
    components: tuple[str, ...]
    columns: Ints
    forecasts: tuple[Forecast, ...]
    chosen: tuple[int, ...]
    scored: int

    def predict(self, component: str, states: AxisStates, samples: Samples) -> tuple[Floats, Floats]:
        """Thermal error of samples in µm, (n,), from inputs alone; no interval is stated, so the second is NaN."""
        k = self.components.index(component)
        targets = range(k, len(self.chosen), len(self.components))
        powers = [self._target(j, states, samples) * samples.lever_m**power for power, j in enumerate(targets)]
        value = np.asarray(np.sum(powers, axis=0))
        return value, np.full(len(value), np.nan)

    def _target(self, target: int, states: AxisStates, samples: Samples) -> Floats:
        forecast, inputs = self.forecasts[target], self.family.inputs
        if self.family.sequential:
            # What came before a sample stands in the states of its campaign, so the whole campaign is run.
            rows = state_rows(states, self.columns, inputs)
            needed = np.asarray(np.isin(rows.campaign, np.unique(states.campaign[samples.state])))
            return _where_known(forecast, rows.take(needed), target, needed)[samples.state]
        rows = sample_rows(states, samples, self.columns, inputs)
        return _where_known(forecast, rows, target, np.ones(len(rows.x), dtype=bool))


def _where_known(forecast: Forecast, rows: Rows, target: int, place: Bools) -> Floats:
    """One target at the rows that `place` (n,) marks, (n,); NaN elsewhere and where an input is missing."""
    known = np.asarray(np.isfinite(rows.x).all(axis=1))
    out = np.full(len(place), np.nan)
    if known.any():
        out[np.flatnonzero(place)[known]] = forecast(rows.take(known))[:, target]
    return out


def family_procedure(family: Family) -> AnyProcedure:
    """Choose the setting of every target by leaving out each training campaign in turn, then fit on all of them.

    Raises AnalysisError where fewer than two campaigns train, or no setting can be fitted.
    """

    def procedure(states: AxisStates) -> FamilyModel:
        columns, table = training_table(states, family)
        errors = inner_errors(family, table)
        forecasts = family.fit(table, family.settings)
        usable = np.array([forecast is not None for forecast in forecasts])
        errors = np.where(usable[:, None], errors, np.inf)
        if not np.isfinite(errors).any(axis=0).all():
            raise AnalysisError(f"{family.name}: no setting can be fitted on these campaigns.")
        chosen = np.argmin(errors, axis=0)
        fitted = tuple(f for f in (forecasts[int(s)] for s in chosen) if f is not None)
        scored = int(np.isfinite(errors).any(axis=1).sum())
        return FamilyModel(family, states.components, columns, fitted, tuple(int(s) for s in chosen), scored)

    return procedure


def training_table(states: AxisStates, family: Family) -> tuple[Ints, Table]:
    """The columns that a family uses and its complete training rows, thinned. Raises AnalysisError for one campaign."""
    columns, group = columns_of(states, family.inputs)
    y = states.targets()
    table = Table(state_rows(states, columns, family.inputs), y, group)
    table = table.take(np.flatnonzero(np.isfinite(table.rows.x).all(axis=1) & np.isfinite(y).all(axis=1)))
    if len(np.unique(table.rows.campaign)) < 2:
        raise AnalysisError(f"{family.name}: settings are chosen by holding out a campaign; two must train.")
    return columns, table.take(thinned(table.rows.campaign, family.max_rows))


def inner_errors(family: Family, table: Table) -> Floats:
    """Mean square error (settings, m) when each campaign of the table is left out once; inf where not computable."""
    total = np.zeros((len(family.settings), table.y.shape[1]))
    for label in np.unique(table.rows.campaign):
        out = table.rows.campaign == label
        rest, test = table.take(np.flatnonzero(~out)), table.take(np.flatnonzero(out))
        for s, forecast in enumerate(family.fit(rest, family.settings)):
            total[s] += np.inf if forecast is None else np.sum((test.y - forecast(test.rows)) ** 2, axis=0)
    return np.where(np.isfinite(total), total / len(table.y), np.inf)

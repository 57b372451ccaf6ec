"""Temperatures and duty over time: what both wings are fed with. Numpy only."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thetacomp.arrays import Bools, Floats, Ints
from thetacomp.errors import AnalysisError
from thetacomp.model.sampling import Sampling, sampling_of

FEWEST = 5  # fewer readings show no interval
SLOWER = 1.5  # a sensor whose own interval is so many times that of the table has a sampling of its own


@dataclass(frozen=True)
class Temperatures:
    """Sensor temperatures: `t_s` (n,) ascending, `value_degC` (n, sensors), NaN where a reading is missing."""

    t_s: Floats
    sensor_ids: tuple[str, ...]
    value_degC: Floats

    @property
    def interval_s(self) -> float:
        """Median sampling interval in s; 0 for fewer than two samples."""
        return float(np.median(np.diff(self.t_s))) if len(self.t_s) > 1 else 0.0

    def select(self, sensors: Sequence[str]) -> Temperatures:
        """The named sensors in that order. Raises AnalysisError where one has no column."""
        absent = [name for name in sensors if name not in self.sensor_ids]
        if absent:
            raise AnalysisError(
                f"temperatures: no column {', '.join(absent)}, which the model needs as an input, or no value in it;"
                f" found {', '.join(self.sensor_ids)}."
                " Fix: add the column, fill it, or give it the name used in training."
            )
        columns = [self.sensor_ids.index(name) for name in sensors]
        return replace(self, sensor_ids=tuple(sensors), value_degC=self.value_degC[:, columns])

    def padded(self, sensors: Sequence[str]) -> Temperatures:
        """The named sensors in that order, one without a column as missing throughout."""
        value_degC = np.full((len(self.t_s), len(sensors)), np.nan)
        present = [name in self.sensor_ids for name in sensors]
        value_degC[:, present] = self.select([name for name in sensors if name in self.sensor_ids]).value_degC
        return replace(self, sensor_ids=tuple(sensors), value_degC=value_degC)

    def without(self, sensors: Collection[str]) -> Temperatures:
        """All sensors but these, as if they had never been read."""
        return self.select([name for name in self.sensor_ids if name not in sensors])

    def take(self, rows: slice | Ints | Bools) -> Temperatures:
        """Some of the samples."""
        return replace(self, t_s=self.t_s[rows], value_degC=self.value_degC[rows])

    def joined(self, later: Temperatures) -> Temperatures:
        """This table and a later part of the same recording; columns go by name, in the order of this table.

        Raises AnalysisError where the two have different sensors.
        """
        if odd := sorted(set(self.sensor_ids) ^ set(later.sensor_ids)):
            raise AnalysisError(f"temperatures: two parts of one recording have different sensors ({', '.join(odd)}).")
        value_degC = np.vstack([self.value_degC, later.select(self.sensor_ids).value_degC])
        return replace(self, t_s=np.concatenate([self.t_s, later.t_s]), value_degC=value_degC)

    def at(self, t_s: Floats) -> Floats:
        """Temperatures at other times, shape (len(t_s), sensors): linear between readings, held at the ends.

        A missing reading is bridged by its neighbours; a gap in the sampling of that sensor (`Sampling`) stays a gap
        (NaN), at the ends too. A sensor without any reading is NaN throughout. This looks ahead: at work on a machine
        use `unbridged_at`.
        """
        out = np.full((len(t_s), len(self.sensor_ids)), np.nan)
        for j in range(len(self.sensor_ids)):
            own = self.sampling(j)
            if own is not None:
                known_s = own.t_s
                after = np.clip(np.searchsorted(known_s, t_s), 0, len(known_s) - 1)
                before = np.maximum(after - 1, 0)
                far = (t_s > known_s[before]) & (t_s < known_s[after]) & np.append(own.is_gap, False)[before]
                far |= (t_s - known_s[-1] > own.limit_s) | (known_s[0] - t_s > own.limit_s)
                value = self.value_degC[np.isfinite(self.value_degC[:, j]), j]
                out[:, j] = np.where(far, np.nan, own.between(value, t_s))
        return out

    def sampling(self, column: int) -> Sampling | None:
        """How a sensor was sampled; None where it has no reading."""
        value = self.value_degC[:, column]
        good = np.isfinite(value)
        return sampling_of(self.t_s[good], value[good]) if good.any() else None

    def evenly_sampled(self) -> Temperatures:
        """The same samples, with a sensor that is read less often than the table filled in between its own readings.

        Where all sensors are read at every row a missing reading stays missing.
        """
        slow = [
            j
            for j in range(len(self.sensor_ids))
            if (own := self.sampling(j)) is not None
            and len(own.t_s) >= FEWEST
            and own.interval_s > SLOWER * self.interval_s > 0.0
        ]
        if not slow:
            return self
        value_degC = self.value_degC.copy()
        value_degC[:, slow] = replace(
            self, sensor_ids=tuple(self.sensor_ids[j] for j in slow), value_degC=value_degC[:, slow]
        ).at(self.t_s)
        return replace(self, value_degC=value_degC)

    def bridged(self) -> Temperatures:
        """The same samples with missing readings filled in as in `at`."""
        return replace(self, value_degC=self.at(self.t_s))

    def unbridged_at(self, t_s: Floats) -> Floats:
        """Temperatures at other times, (len(t_s), sensors): linear between two samples, NaN next to a missing one.

        After the last sample it holds for one sampling interval, no longer: a logger that stopped must not look like a
        machine that stays warm.
        """
        value_degC = between_samples(self.t_s, self.value_degC, t_s)
        value_degC[(t_s < self.t_s[0]) | (t_s > self.t_s[-1] + self.interval_s)] = np.nan
        return value_degC


@dataclass(frozen=True)
class Duty:
    """What the machine did: named columns such as `spindle_rpm`, `feed_mm_min`, each (n,).

    An entry holds until the next one.
    """

    t_s: Floats
    columns: Mapping[str, Floats]

    def take(self, rows: slice | Ints | Bools) -> Duty:
        """Some of the entries."""
        return Duty(self.t_s[rows], {name: values[rows] for name, values in self.columns.items()})

    def joined(self, later: Duty) -> Duty:
        """This duty and a later part of the same recording, with the columns of the later part.

        Where a column was not logged before, the machine counts as standing still.
        """
        still = np.zeros(len(self.t_s))
        columns = {name: np.concatenate([self.columns.get(name, still), v]) for name, v in later.columns.items()}
        return Duty(np.concatenate([self.t_s, later.t_s]), columns)


def between_samples(sample_s: Floats, value: Floats, t_s: Floats) -> Floats:
    """Values (len(t_s), k) of samples (n, k) at other times: linear, held at the ends, NaN next to a missing value."""
    after = np.clip(np.searchsorted(sample_s, t_s, side="left"), 0, len(sample_s) - 1)
    before = np.where((sample_s[after] > t_s) & (after > 0), after - 1, after)
    step_s = np.where(after > before, sample_s[after] - sample_s[before], 1.0)
    slope = (value[after] - value[before]) / step_s[:, None]
    between: Floats = slope * (np.clip(t_s, sample_s[0], sample_s[-1]) - sample_s[before])[:, None] + value[before]
    return between

"""A campaign under screening: what was read, what is believed so far, and what was found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.model.temperatures import Temperatures
from thetacomp.screening.faults import Finding
from thetacomp.screening.grid import Course, course
from thetacomp.screening.silent import longest_s, read_values
from thetacomp.screening.steps import Sharp, sharp

REBUILT = ("drift", "stuck", "missing", "noisy")


@dataclass(frozen=True)
class Record:
    """The record of a campaign, with what came before it where the recording is unbroken.

    `table` is as read, `value` (n, p) as it is believed so far: shifted and exchanged back, NaN where it has to be
    rebuilt. The campaign itself begins at `first_s`.
    """

    name: str
    table: Temperatures
    first_s: float
    value: Floats
    findings: tuple[Finding, ...] = ()

    @property
    def own(self) -> Temperatures:
        """The campaign itself, as it is believed so far."""
        rows = self.table.t_s >= self.first_s
        return Temperatures(self.table.t_s[rows], self.table.sensor_ids, self.value[rows])

    @cached_property
    def sharp(self) -> Sharp:
        """How sharply the sensors change, as read."""
        return sharp(replace(self.table, value_degC=read_values(self.table)))

    @cached_property
    def longest_s(self) -> Floats:
        """The longest runs of equal readings (p,), as read."""
        return longest_s(self.table.t_s, self.table.value_degC)

    @cached_property
    def course(self) -> Course:
        """The slow course of what is believed; a sensor that has to be rebuilt in the campaign says nothing."""
        made = course(self.own)
        out = [self.table.sensor_ids.index(f.sensor) for f in self.touching if f.kind in REBUILT and _lasting(f, self)]
        read = made.read.copy()
        read[out] = False
        return replace(made, read=read)

    @property
    def touching(self) -> tuple[Finding, ...]:
        """Findings that touch the campaign itself, not only what came before it."""
        return tuple(f for f in self.findings if f.end_s is None or f.end_s > self.first_s)

    def shifted(self, found: Finding, j: int, size_K: float, end_s: float = np.inf) -> Record:
        """Sensor j less `size_K` from the start of the finding on."""
        value = self.value.copy()
        rows = (self.table.t_s >= found.start_s) & (self.table.t_s < end_s)
        value[rows, j] -= size_K
        return replace(self, value=value, findings=(*self.findings, found))

    def silenced(self, found: Finding, j: int) -> Record:
        """Sensor j not believed for as long as the fault lasts."""
        value = self.value.copy()
        end_s = np.inf if found.end_s is None else found.end_s
        value[(self.table.t_s >= found.start_s) & (self.table.t_s < end_s), j] = np.nan
        return replace(self, value=value, findings=(*self.findings, found))

    def exchanged(self, found: Finding, j: int, k: int) -> Record:
        """Sensors j and k exchanged in the campaign."""
        value = self.value.copy()
        rows = self.table.t_s >= found.start_s
        value[rows, j], value[rows, k] = value[rows, k], value[rows, j]
        return replace(self, value=value, findings=(*self.findings, found))

    def told(self, found: Finding) -> Record:
        """One finding more that changes nothing."""
        return replace(self, findings=(*self.findings, found))


def _lasting(found: Finding, record: Record) -> bool:
    """Whether too little is left of the campaign to follow the sensor's course."""
    last_s = float(record.table.t_s[-1])
    begin_s, end_s = max(found.start_s, record.first_s), last_s if found.end_s is None else found.end_s
    return end_s - begin_s > 0.2 * (last_s - record.first_s)


def as_read(name: str, table: Temperatures, first_s: float) -> Record:
    """A record of which nothing is known yet."""
    return Record(name, table, first_s, read_values(table))


def with_same_sensors(records: Sequence[Record], ids: Sequence[str], fewest: int) -> list[Record]:
    """The records that hold all these sensors and enough samples, with their sensors in this order."""
    out = []
    for record in records:
        if set(ids) <= set(record.table.sensor_ids) and len(record.own.t_s) >= fewest:
            out.append(record if record.table.sensor_ids == tuple(ids) else _selected(record, ids))
    return out


def _selected(record: Record, ids: Sequence[str]) -> Record:
    order = [record.table.sensor_ids.index(name) for name in ids]
    kept = tuple(f for f in record.findings if f.sensor in ids)
    return replace(record, table=record.table.select(tuple(ids)), value=record.value[:, order], findings=kept)

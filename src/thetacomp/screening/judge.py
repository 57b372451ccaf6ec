"""The verdict on all campaigns of a machine: single readings first, then whole courses, learnt from the others.

Every rule asks for evidence that no heat can give. A campaign in which a fault is found is put right before it teaches.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thetacomp.machine import SensorRole
from thetacomp.screening.record import Record, with_same_sensors
from thetacomp.screening.single import with_held, with_missing, with_noisy, with_steps
from thetacomp.screening.whole import Mended, drift, offset, swapped

MIN_SAMPLES = 30
FAST: tuple[SensorRole, ...] = ("fluid", "workpiece")  # a pump, a new part: a step is no fault there
AIR_S = 60.0  # sampled more slowly, air makes steps too,
SOURCE_S = 120.0  # and what is mounted on a source of heat
LOOSE: tuple[SensorRole, ...] = ("fluid", "workpiece", "ambient", "foundation")  # season and hall move them
MOST_FAULTS = 20

Records = dict[str, Record]
Check = Callable[[Mended, Sequence[Record]], bool]
"""Whether the errors of a campaign, predicted by what the others teach, become no worse through a repair."""


@dataclass(frozen=True)
class Judge:
    """`roles` of the sensors by id; `train` names the campaigns that teach; `check` has the last word on a repair."""

    roles: Mapping[str, SensorRole]
    train: tuple[str, ...]
    check: Check

    def verdict(self, records: Records) -> Records:
        """The records with all findings, put right but for what has to be rebuilt."""
        out = {name: self._single(record, records) for name, record in records.items()}
        out = {name: with_held(record, self.others(record, out)) for name, record in out.items()}
        taught = self._whole({name: record for name, record in out.items() if name in self.train}, {})
        for name, record in out.items():
            if name not in taught:
                out[name] = self._whole({name: record}, taught)[name]
        return out | taught

    def others(self, record: Record, records: Records) -> list[Record]:
        """The other training campaigns, with the sensors of this one."""
        rest = [r for name, r in records.items() if name in self.train and name != record.name]
        return with_same_sensors(rest, record.table.sensor_ids, MIN_SAMPLES)

    def _single(self, record: Record, records: Records) -> Record:
        roles = [self.roles[name] for name in record.table.sensor_ids]
        interval_s = record.table.interval_s
        fast = [
            role in FAST
            or (interval_s > AIR_S and role == "ambient")
            or (interval_s > SOURCE_S and role in ("drive", "bearing"))
            for role in roles
        ]
        others = self.others(record, records)
        return with_noisy(with_steps(with_missing(record), others, roles, fast), others)

    def _whole(self, judged: Records, taught: Records) -> Records:
        """Swaps, then offsets, then drifts, the clearest first; each is put right before the next is looked for."""
        out = dict(judged)
        for rule in (swapped, offset, drift):
            refused: set[tuple[str, str]] = set()
            for _ in range(MOST_FAULTS):
                found = []
                for record in out.values():
                    others = self.others(record, taught | out)
                    if not others or len(record.own.t_s) < MIN_SAMPLES:
                        continue
                    steady = np.array([self.roles[name] not in LOOSE for name in record.table.sensor_ids])
                    mended = rule(record, others, steady)
                    if mended is not None and (record.name, mended.finding.sensor) not in refused:
                        found.append(mended)
                if not found:
                    break
                clearest = max(found, key=lambda m: m.weight)
                name = clearest.before.name
                if self.check(clearest, self.others(clearest.before, taught | out)):
                    out[name] = clearest.after
                else:
                    told = replace(clearest.finding, kind="unexplained", repair="none")
                    out[name] = clearest.before.told(told)
                    refused.add((name, told.sensor))
        return out

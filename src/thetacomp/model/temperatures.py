"""Temperatures and duty over time: what both wings are fed with. Numpy only."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats

GAP_INTERVALS = 3.0
GAP_S = 600.0


@dataclass(frozen=True)
class Temperatures:
    """Sensor temperatures: `t_s` (n,) ascending, `value_degC` (n, sensors)."""

    t_s: Floats
    sensor_ids: tuple[str, ...]
    value_degC: Floats

    def at(self, t_s: Floats) -> Floats:
        """Temperatures at other times, shape (len(t_s), sensors): linear between samples, held at the ends.

        A missing sample is bridged by its neighbours; a gap of more than three sampling intervals and ten minutes
        stays a gap (NaN), at the ends too. A sensor without any sample is NaN throughout.
        """
        interval_s = float(np.median(np.diff(self.t_s))) if len(self.t_s) > 1 else 0.0
        limit_s = max(GAP_INTERVALS * interval_s, GAP_S)
        out = np.full((len(t_s), len(self.sensor_ids)), np.nan)
        for j in range(len(self.sensor_ids)):
            good = np.isfinite(self.value_degC[:, j])
            if good.any():
                known_s = self.t_s[good]
                after = np.clip(np.searchsorted(known_s, t_s), 0, len(known_s) - 1)
                before = np.maximum(after - 1, 0)
                between = (t_s > known_s[before]) & (t_s < known_s[after])
                far = between & (known_s[after] - known_s[before] > limit_s)
                far |= (t_s - known_s[-1] > limit_s) | (known_s[0] - t_s > limit_s)
                out[:, j] = np.where(far, np.nan, np.interp(t_s, known_s, self.value_degC[good, j]))
        return out

    def without(self, sensors: Collection[str]) -> Temperatures:
        """The same table without the columns of some sensors."""
        kept = [j for j, name in enumerate(self.sensor_ids) if name not in sensors]
        return Temperatures(self.t_s, tuple(self.sensor_ids[j] for j in kept), self.value_degC[:, kept])


@dataclass(frozen=True)
class Duty:
    """What the machine did: named columns such as `spindle_rpm`, `feed_mm_min`, each (n,)."""

    t_s: Floats
    columns: Mapping[str, Floats]

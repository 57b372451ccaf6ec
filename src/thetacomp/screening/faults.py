"""What can go wrong with a thermometer: kinds of fault, what is reported about one, and faults put in on purpose."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.errors import AnalysisError
from thetacomp.model.temperatures import Temperatures

FaultKind = Literal["jump", "offset", "drift", "stuck", "swapped", "missing", "noisy", "unexplained"]
InjectedKind = Literal["jump", "drift", "detached", "stuck", "swapped", "missing"]
Repair = Literal["shifted back", "reconstructed", "swapped back", "lost", "none"]
PLAUSIBLE_DEGC = (-60.0, 300.0)


@dataclass(frozen=True)
class Finding:
    """One fault of one sensor, with the evidence.

    `start_s` is the estimated begin, `detected_s` the time of the verdict, `end_s` None where the fault lasts.
    `size_K` is the shift (jump, offset), the deviation at the end (drift), or how far two swapped courses are apart;
    NaN where none is known. `statistic` stands against `threshold`: K for jump, offset and drift; s for a stuck or
    missing channel; how many times the misfit falls, for a swap; times the usual scatter, for a noisy one.
    `repair_u_K` is the standard deviation of a repaired value at the end of the fault. A sensor whose repair is `lost`
    has no usable value from `start_s` on: use a model without it. `unexplained` is told and changes nothing: a step
    that a machine can make.
    """

    sensor: str
    kind: FaultKind
    start_s: float
    detected_s: float
    end_s: float | None
    size_K: float
    statistic: float
    threshold: float
    repair: Repair
    repaired_from: tuple[str, ...] = ()
    repair_u_K: float = 0.0
    partner: str = ""


def with_fault(
    temperatures: Temperatures,
    sensor: str,
    kind: InjectedKind,
    start_s: float,
    *,
    size_K: float = 0.0,
    rate_K_per_h: float = 0.5,
    air_degC: float | Floats = 20.0,
    time_constant_s: float = 300.0,
    duration_s: float = np.inf,
    partner: str = "",
) -> Temperatures:
    """The same table with one sensor made faulty from `start_s` on, for tests and trials.

    `jump` adds `size_K`; `drift` adds a ramp; `detached` relaxes with `time_constant_s` towards air until `size_K` (K,
    positive) of its distance from `air_degC` (a number, or one a sample) is lost: gain 1 - size / distance at the
    start; `stuck` repeats the last value; `swapped` exchanges with
    `partner`; `missing` gives NaN. `duration_s` ends the fault. AnalysisError for an unknown sensor.
    """
    for name in (sensor, *((partner,) if kind == "swapped" else ())):
        if name not in temperatures.sensor_ids:
            raise AnalysisError(f"the temperatures hold no sensor '{name}'")
    t, value = temperatures.t_s, temperatures.value_degC.copy()
    j = temperatures.sensor_ids.index(sensor)
    on = (t >= start_s) & (t < start_s + duration_s)
    if not on.any():
        return temperatures
    first = max(int(np.argmax(on)) - 1, 0)
    own = value[:, j].copy()
    if kind == "jump":
        value[on, j] += size_K
    elif kind == "drift":
        value[on, j] += rate_K_per_h * (t[on] - start_s) / 3600.0
    elif kind == "detached":
        distance_K = own - air_degC
        share = min(size_K / max(abs(float(distance_K[first])), 1e-9), 0.9)
        value[on, j] -= share * distance_K[on] * -np.expm1(-(t[on] - start_s) / time_constant_s)
    elif kind == "stuck":
        value[on, j] = own[first]
    elif kind == "swapped":
        k = temperatures.sensor_ids.index(partner)
        value[on, j], value[on, k] = value[on, k].copy(), own[on]
    else:
        value[on, j] = np.nan
    return replace(temperatures, value_degC=value)

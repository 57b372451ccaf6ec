"""What the temperature field shows: one row a sensor and campaign, and the layout rules."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SensorRise:
    """One sensor in one campaign (paper, section 1.2). NaN where a figure cannot be computed, `remark` says why.

    `rise_K` is maximum less start; `rate_K_per_h` the steepest rise over a window; `lag_s` the delay behind the
    sensor at its heat source `source` ("" where none is known).
    """

    campaign: str
    sensor: str
    start_degC: float
    maximum_degC: float
    maximum_at_s: float
    rise_K: float
    rate_K_per_h: float
    lag_s: float
    source: str
    remark: str


@dataclass(frozen=True)
class LayoutCheck:
    """One rule of initial sensor placement (paper, section 1.1), as a sentence."""

    rule: str
    passed: bool
    finding: str

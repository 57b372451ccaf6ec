"""What screening knows about a healthy machine: how the increments of its temperatures are correlated.

The increment of a sensor over a horizon is predicted from the increments of the other sensors and of their first-order
lags by ridge regression. All of it is held as one matrix of mean products a horizon, so that the prediction from any
subset of healthy sensors follows from the same numbers by solving a smaller system.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.errors import AnalysisError

RIDGE = 1e-3  # share of every input's own power; keeps near copies of one sensor from fighting each other
POWER = 2.0  # standard deviations beyond the threshold: a fault of that size is found in about 98 of 100 cases
LOST_SHARE = 0.5  # a reconstruction worse than half of what the sensor moves at all is worth nothing

ARRAYS = (
    "product_K2",
    "floor_K",
    "share",
    "scale_K",
    "activity_high",
    "threshold",
    "repair_sd_K",
    "held_s",
    "gate_K",
    "spike_K",
)


@dataclass(frozen=True)
class DetectionLimit:
    """The smallest faults of a sensor that are found, with the delay allowed; `quiet` machine and in a `transient`.

    A jump within ten minutes; a drift within the time that makes it smallest; a loss of contact by its final deviation
    (a drift to a level) within an hour; a stuck or missing channel by its duration alone.
    """

    sensor: str
    jump_quiet_K: float
    jump_transient_K: float
    drift_K_per_h: float
    drift_within_s: float
    detached_quiet_K: float
    detached_transient_K: float
    stuck_s: float
    missing_s: float


@dataclass(frozen=True)
class ScreeningModel:
    """Fitted parameters; H horizons, p sensors, inputs are the p temperatures and their p lags.

    `product_K2` (H, 2p, 2p) mean products of increments; `floor_K` and `share` (H, p) give the standard deviation of a
    held-out residual, sqrt(floor² + (share × activity)²); `scale_K` (H, p) the typical increment; `activity_high` (H,)
    the activity exceeded 5 % of the time; `threshold` (H,) in standard deviations; `repair_sd_K` (E, p) the error of a
    reconstruction after `elapsed_s` (E,).
    `held_s` (p,) is the longest healthy run of equal readings, `gate_K` (p,) the largest healthy deviation of a sample
    from the block before, `spike_K` (p,) the deviation from the minutes around it that one sample in a hundred exceeds.
    `screened` (p,) is False for a sensor without readings in training.
    """

    sensor_ids: tuple[str, ...]
    sampling_s: float
    step_s: float
    lag_s: float
    horizon_s: tuple[float, ...]
    product_K2: Floats
    floor_K: Floats
    share: Floats
    scale_K: Floats
    activity_high: Floats
    threshold: Floats
    elapsed_s: tuple[float, ...]
    repair_sd_K: Floats
    held_s: Floats
    gate_K: Floats
    spike_K: Floats
    screened: tuple[bool, ...]
    healthy_h: float
    _weights: dict[tuple[int, frozenset[int], int], Floats] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @cached_property
    def horizon_steps(self) -> tuple[int, ...]:
        """The horizons in blocks."""
        return tuple(round(h / self.step_s) for h in self.horizon_s)

    @cached_property
    def unscreened(self) -> frozenset[int]:
        """Sensors that had no readings in training."""
        return frozenset(j for j, known in enumerate(self.screened) if not known)

    def weights(self, h: int, excluded: frozenset[int], j: int) -> Floats:
        """Weights (2p,) that predict sensor j from the healthy ones at horizon number h; zero for all others."""
        key = (h, excluded, j)
        if key not in self._weights:
            if len(self._weights) > 20_000:
                self._weights.clear()
            self._weights[key] = ridge_weights(self.product_K2[h], excluded | self.unscreened, j)
        return self._weights[key]

    def inflation(self, h: int, excluded: frozenset[int], j: int) -> float:
        """How much larger the residual of sensor j becomes when the sensors `excluded` no longer help."""
        g = self.product_K2[h]
        power = []
        for out in (frozenset[int](), excluded):
            w = self.weights(h, out, j)
            power.append(float(g[j, j] - 2.0 * w @ g[:, j] + w @ g @ w))
        return float(np.sqrt(max(power[1] / power[0], 1.0))) if power[0] > 0 else 1.0

    def inflations(self, h: int, excluded: frozenset[int]) -> Floats:
        """`inflation` of all sensors at once (p,)."""
        power = [
            self._left_over(h, np.array([self.weights(h, out, j) for j in range(len(self.sensor_ids))]))
            for out in (frozenset[int](), excluded)
        ]
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(power[0] > 0, np.sqrt(np.maximum(power[1] / power[0], 1.0)), 1.0)

    def _left_over(self, h: int, weights: Floats) -> Floats:
        """Mean squared residual (p,) of weights (p, 2p)."""
        g, p = self.product_K2[h], len(self.sensor_ids)
        own = np.diag(g)[:p] - 2.0 * np.einsum("ji,ij->j", weights, g[:, :p])
        return np.asarray(own + np.einsum("ji,ji->j", weights @ g, weights))

    def sd_K(self, h: int, j: int, activity: float, excluded: frozenset[int] = frozenset()) -> float:
        """Standard deviation of a healthy residual of sensor j at horizon number h."""
        sd = float(np.hypot(self.floor_K[h, j], self.share[h, j] * activity))
        return sd * (self.inflation(h, excluded, j) if excluded else 1.0)

    def reconstruction_u_K(self, j: int, elapsed_s: float, excluded: frozenset[int]) -> float:
        """Standard deviation of a value of sensor j rebuilt from the others `elapsed_s` after its last good one."""
        sd = float(np.interp(elapsed_s, self.elapsed_s, self.repair_sd_K[:, j]))
        return sd * self.inflation(len(self.horizon_s) - 1, excluded - {j}, j)

    def is_lost(self, j: int, elapsed_s: float, excluded: frozenset[int]) -> bool:
        """Whether a reconstruction of sensor j would be worth too little to be used."""
        healthy = len(self.sensor_ids) - len(excluded | self.unscreened | {j})
        too_far = self.reconstruction_u_K(j, elapsed_s, excluded) > LOST_SHARE * float(self.scale_K[-1, j])
        return j in self.unscreened or healthy < 1 or too_far

    def limits(self) -> tuple[DetectionLimit, ...]:
        """The detection limits of every screened sensor."""
        found = []
        for j, sensor in enumerate(self.sensor_ids):
            if not self.screened[j]:
                continue
            reach = [float(t) + POWER for t in self.threshold]
            quiet = [r * self.sd_K(h, j, 0.0) for h, r in enumerate(reach)]
            busy = [r * self.sd_K(h, j, float(self.activity_high[h])) for h, r in enumerate(reach)]
            rates = [3600.0 * k / s for k, s in zip(busy, self.horizon_s, strict=True)]
            best = int(np.argmin(rates))
            sudden = [h for h, s in enumerate(self.horizon_s) if s <= max(600.0, self.horizon_s[0])]
            hour = [h for h, s in enumerate(self.horizon_s) if 600.0 <= s <= 3600.0] or [0]
            found.append(
                DetectionLimit(
                    sensor=sensor,
                    jump_quiet_K=min(quiet[h] for h in sudden),
                    jump_transient_K=min(busy[h] for h in sudden),
                    drift_K_per_h=rates[best],
                    drift_within_s=self.horizon_s[best],
                    detached_quiet_K=min(quiet[h] for h in hour),
                    detached_transient_K=min(busy[h] for h in hour),
                    stuck_s=float(self.held_s[j]),
                    missing_s=self.step_s,
                )
            )
        return tuple(found)

    def to_json(self) -> dict[str, Any]:
        """The model as plain lists and numbers, for a JSON file."""
        out: dict[str, Any] = {"format": 1}
        for name in self.__dataclass_fields__:
            if name != "_weights":
                value = getattr(self, name)
                out[name] = value.tolist() if isinstance(value, np.ndarray) else value
        return out


def from_json(data: Mapping[str, Any]) -> ScreeningModel:
    """The inverse of `ScreeningModel.to_json`. AnalysisError where a part is missing or the format is another."""
    names = [name for name in ScreeningModel.__dataclass_fields__ if name != "_weights"]
    missing = [name for name in names if name not in data]
    if data.get("format") != 1 or missing:
        raise AnalysisError(
            f"not a screening model of format 1 (missing: {', '.join(missing) or 'nothing'}). Fit it again."
        )
    values: dict[str, Any] = {name: data[name] for name in names}
    for name in ARRAYS:
        values[name] = np.asarray(values[name], float)
    for name in ("sensor_ids", "horizon_s", "elapsed_s", "screened"):
        values[name] = tuple(values[name])
    return ScreeningModel(**values)


def ridge_weights(product: Floats, excluded: frozenset[int], j: int) -> Floats:
    """Ridge weights (2p,) of sensor j on all sensors but itself and `excluded`, from mean products (2p, 2p).

    The penalty is a share of each input's own power (standardised ridge): minimise
    mean (y - x w)² + RIDGE Σ w_i² mean x_i².
    """
    p = len(product) // 2
    used = np.array([k for k in range(p) if k != j and k not in excluded and product[k, k] > 0], int)
    w = np.zeros(2 * p)
    if len(used) == 0 or not product[j, j] > 0:
        return w
    used = np.concatenate([used, used + p])
    size = np.sqrt(np.maximum(np.diag(product)[used], 1e-12))
    g = product[np.ix_(used, used)] / np.outer(size, size)
    w[used] = np.linalg.solve(g + RIDGE * np.eye(len(used)), product[used, j] / size) / size
    return w

"""Heat history: first-order lags of temperatures and speed, and the inputs that a model builds from them.

A lag with time constant τ follows its input u as `τ dx/dt = u - x`. The input is held between samples, so the exact
solution is a recursion with one stored number a filter, which a PLC can run:

    a = exp(-dt / τ)
    x = a x + (1 - a) u_previous

`0 < a < 1` for every dt, so the filter is stable at any sampling rate. A new datum does not change it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from pydantic import field_validator

from thetacomp.arrays import Floats
from thetacomp.errors import AnalysisError
from thetacomp.machine import Strict
from thetacomp.model.temperatures import Duty, Temperatures

# exp(30) keeps 13 decimal places of headroom in the closed form over one stretch of samples
_LONGEST_STRETCH = 30.0

SPEED = "spindle_rpm"
# rises are divided by this before they multiply others, so that products have the size of rises
PRODUCT_UNIT_K = 5.0
# fewer campaigns cannot tell whether the level at which they start plays a part, or anything else that differs
LEVEL_CAMPAIGNS = 10


@dataclass(frozen=True)
class FilterState:
    """What the filters remember: enough to continue after a pause, independent of any datum.

    `signal` (signals,) is the last good input, held until the next one; `lag` (time constants, signals) the filters'
    outputs at `t_s`; NaN for a signal that never had a good value.
    """

    t_s: float
    signal: Floats
    lag: Floats

    def to_dict(self) -> dict[str, Any]:
        """The state as JSON-able numbers; a missing value is null."""

        def plain(values: Floats) -> list[float | None]:
            return [float(value) if np.isfinite(value) else None for value in values]

        return {
            "t_s": self.t_s,
            "signal": plain(self.signal),
            "lag": [plain(row) for row in self.lag],
        }

    @classmethod
    def from_dict(cls, raw: Mapping[str, Any]) -> FilterState:
        """The inverse of `to_dict`."""
        return cls(
            t_s=float(raw["t_s"]),
            signal=np.array(raw["signal"], dtype=np.float64),
            lag=np.array(raw["lag"], dtype=np.float64),
        )


def start_filters(t_s: float, signal: Floats, time_constants_s: tuple[float, ...]) -> FilterState:
    """Filters at rest on the first values: every lag equals its input."""
    signal = np.asarray(signal, dtype=np.float64)
    return FilterState(t_s=t_s, signal=signal, lag=np.tile(signal, (len(time_constants_s), 1)))


def step_filters(state: FilterState, t_s: float, signal: Floats, time_constants_s: tuple[float, ...]) -> FilterState:
    """One sample later: the recursion of the module's head, as a PLC runs it.

    `signal` (signals,); a NaN leaves the last good value standing. Raises AnalysisError where time runs backward.
    """
    dt_s = t_s - state.t_s
    if dt_s < 0:
        raise AnalysisError(f"the sample at {t_s:g} s comes before the one at {state.t_s:g} s: sort samples by time.")
    signal = np.asarray(signal, dtype=np.float64)
    keep = np.exp(-dt_s / np.asarray(time_constants_s))[:, None]
    lag = keep * state.lag + (1.0 - keep) * state.signal
    first = np.isnan(state.signal) & np.isfinite(signal)
    lag[:, first] = signal[first]
    return FilterState(t_s=t_s, signal=np.where(np.isfinite(signal), signal, state.signal), lag=lag)


def run_filters(
    t_s: Floats, signal: Floats, time_constants_s: tuple[float, ...], state: FilterState | None = None
) -> tuple[Floats, FilterState]:
    """The recursion over many samples at once: lags (n, time constants, signals) and the state after the last.

    `t_s` (n,) ascending, any spacing; `signal` (n, signals), NaN where missing (the last good value is held).
    Continues from `state`, or starts at rest on the first good values. Equals `step_filters` to rounding.
    Raises AnalysisError for no samples or time that runs backward.
    """
    t_s = np.asarray(t_s, dtype=np.float64)
    signal = np.asarray(signal, dtype=np.float64)
    if len(t_s) == 0:
        raise AnalysisError("no samples: heat history needs at least one.")
    if state is None:
        state = start_filters(float(t_s[0]), signal[0], time_constants_s)
    all_t_s = np.concatenate([[state.t_s], t_s])
    if np.any(np.diff(all_t_s) < 0):
        row = int(np.flatnonzero(np.diff(all_t_s) < 0)[0])
        raise AnalysisError(f"time runs backward at sample {row} ({t_s[row]:g} s): sort samples by time.")
    held, first = _hold(np.vstack([state.signal, signal]))
    lags = np.empty((len(t_s), len(time_constants_s), signal.shape[1]))
    for k, time_constant_s in enumerate(time_constants_s):
        start = np.where(np.isnan(state.lag[k]), held[0], state.lag[k])
        lags[:, k, :] = _lag(all_t_s / time_constant_s, held, start)
    unknown = np.arange(1, len(t_s) + 1)[:, None] < first
    lags[np.broadcast_to(unknown[:, None, :], lags.shape)] = np.nan
    last = np.where(first > len(t_s), np.nan, held[-1])
    return lags, FilterState(t_s=float(t_s[-1]), signal=last, lag=lags[-1].copy())


def _hold(signal: Floats) -> tuple[Floats, Floats]:
    """Missing values replaced by the last good one (before the first: by the first), and the first good row."""
    good = np.isfinite(signal)
    rows = np.arange(len(signal))[:, None]
    first = np.where(good.any(axis=0), good.argmax(axis=0), len(signal))
    source = np.maximum.accumulate(np.where(good, rows, 0), axis=0)
    source = np.maximum(source, np.minimum(first, len(signal) - 1))
    held = np.take_along_axis(signal, source, axis=0)
    return np.nan_to_num(held), first


def _lag(time: Floats, held: Floats, start: Floats) -> Floats:
    """Lag (n - 1, signals) of inputs held from each of n times (in time constants) to the next.

    In a stretch of at most _LONGEST_STRETCH time constants the recursion has the closed form
    `x_k = exp(-s_k) (x_0 + Σ_{i<=k} (1 - a_i) u_{i-1} exp(s_i))`, a cumulative sum.
    """
    out = np.empty((len(time) - 1, held.shape[1]))
    value, at = start, 0
    while at < len(out):
        end = int(np.searchsorted(time, time[at] + _LONGEST_STRETCH, side="right")) - 1
        end = max(end, at + 1)
        gain = -np.expm1(-np.diff(time[at : end + 1]))
        if end == at + 1:
            value = value + gain[0] * (held[at] - value)
            out[at] = value
        else:
            growth = np.exp(time[at + 1 : end + 1] - time[at])
            moved = np.cumsum((gain * growth)[:, None] * (held[at:end] - value), axis=0) / growth[:, None]
            out[at:end] = value + moved
            value = out[end - 1]
        at = end
    return out


class InputLayout(Strict):
    """Which inputs a law has, in which order.

    `sensors` name the temperatures. `time_constants_s` are the lags; without any the temperatures are all there is.
    `speed_powers` are the powers of the spindle speed that drive lags (none: speed is not used). `base_degC` is the
    temperature from which levels count in products; it is a constant of the model, not a datum. `products` multiply
    the rise of every sensor since the reference: `median` by the median rise, for what does not grow in proportion;
    `level` by the median temperature at the reference, for machines that answer otherwise in a warm hall.
    """

    sensors: tuple[str, ...]
    time_constants_s: tuple[float, ...] = (900.0, 3600.0, 14400.0)
    speed_powers: tuple[int, ...] = (1, 2)
    base_degC: float
    products: tuple[Literal["median", "level"], ...] = ()

    @classmethod
    def plain(cls, sensors: Sequence[str]) -> InputLayout:
        """Temperatures as they are: no lags, no speed."""
        return cls(sensors=tuple(sensors), time_constants_s=(), speed_powers=(), base_degC=0.0)

    @field_validator("time_constants_s")
    @classmethod
    def _positive_and_apart(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if not all(tau_s > 0 for tau_s in value) or len(set(value)) != len(value):
            raise ValueError(f"time constants must be above zero and differ, found {value}")
        return value

    def signals(self, temperature_degC: Floats, speed_rpm: Floats | None = None) -> Floats:
        """What the filters are fed with: temperatures, then powers of the speed in 1000 rpm; (n, signals)."""
        temperature_degC = np.asarray(temperature_degC, dtype=np.float64)
        if temperature_degC.shape[1] != len(self.sensors):
            raise AnalysisError(f"{temperature_degC.shape[1]} temperatures found, {len(self.sensors)} expected.")
        if not self.speed_powers:
            return temperature_degC
        if speed_rpm is None:
            raise AnalysisError("this model needs the spindle speed. Fix: give spindle_rpm in duty.csv.")
        speed = np.abs(np.asarray(speed_rpm, dtype=np.float64)) / 1000.0
        return np.column_stack([temperature_degC, *(speed**power for power in self.speed_powers)])

    @property
    def blocks(self) -> dict[str, tuple[str, ...]]:
        """Names of the inputs, block by block, in the order of the columns of `since`."""
        out: dict[str, tuple[str, ...]] = {"temperature": self.sensors}
        for tau_s in self.time_constants_s:
            out[f"difference {tau_s:g} s"] = tuple(f"{name} - lag {tau_s:g} s" for name in self.sensors)
        for power in self.speed_powers:
            for tau_s in self.time_constants_s:
                out[f"speed^{power} {tau_s:g} s"] = (f"speed^{power} lag {tau_s:g} s",)
        for power in self.speed_powers:
            for tau_s in self.time_constants_s:
                out[f"speed^{power} x rise {tau_s:g} s"] = (f"speed^{power} lag {tau_s:g} s x mean rise",)
        for factor in self.products:
            out[f"rise x {factor}"] = tuple(f"{name} x {factor}" for name in self.sensors)
        return out

    @property
    def groups(self) -> tuple[str, ...]:
        """What every input of `blocks` tells of: its sensor, or a power of the speed, alone or with the mean rise."""
        out = list(self.sensors) * (1 + len(self.time_constants_s))
        for product in ("", " x rise"):
            out += [f"speed^{power}{product}" for power in self.speed_powers for _ in self.time_constants_s]
        return (*out, *self.sensors * len(self.products))

    @property
    def running(self) -> int:
        """How many inputs run on their own: those of `inputs`, without the products since a reference."""
        return sum(map(len, self.blocks.values())) - len(self.products) * len(self.sensors)

    def inputs(self, signals: Floats, lags: Floats) -> Floats:
        """Running inputs (n, running) from signals (n, signals) and their lags (n, time constants, signals).

        A filter keeps running when a new datum is set: what counts from a datum is made by `since`.
        """
        p = len(self.sensors)
        temperature = signals[:, :p]
        if not self.time_constants_s:
            return temperature
        rise_K = temperature.mean(axis=1, keepdims=True) - self.base_degC
        speed = lags[:, :, p:].transpose(0, 2, 1).reshape(len(signals), -1)
        differences = (temperature[:, None, :] - lags[:, :, :p]).reshape(len(signals), -1)
        return np.hstack([temperature, differences, speed, speed * rise_K])

    def without(self, sensor: str) -> InputLayout:
        """The layout without one of its sensors."""
        return self.model_copy(update={"sensors": tuple(name for name in self.sensors if name != sensor)})

    def running_without(self, sensor: str, inputs: Floats) -> Floats:
        """Running inputs of the layout `without` a sensor from those of this layout, (n, running)."""
        p, taus = len(self.sensors), len(self.time_constants_s)
        speeds = p * (1 + taus) + np.arange(len(self.speed_powers) * taus)
        own = inputs[:, : p * (1 + taus)].reshape(len(inputs), 1 + taus, p)
        left = np.delete(own, self.sensors.index(sensor), axis=2)
        rise_K = left[:, 0].mean(axis=1, keepdims=True) - self.base_degC
        return np.hstack([left.reshape(len(inputs), -1), inputs[:, speeds], inputs[:, speeds] * rise_K])

    def since(self, inputs: Floats, reference: Floats) -> Floats:
        """All inputs of the law (n, k) since a reference (running,), from running inputs (n, running)."""
        moved: Floats = np.asarray(inputs) - reference
        if not self.products:
            return moved
        rise_K, start_degC = moved[:, : len(self.sensors)], float(np.median(reference[: len(self.sensors)]))
        factors_K: dict[str, Any] = {
            "median": np.median(rise_K, axis=1, keepdims=True),
            "level": start_degC - self.base_degC,
        }
        return np.hstack([moved, *(rise_K * factors_K[factor] / PRODUCT_UNIT_K for factor in self.products)])


def history_inputs(
    layout: InputLayout, t_s: Floats, temperature_degC: Floats, speed_rpm: Floats | None = None
) -> Floats:
    """Running inputs (n, running) of one unbroken recording, with filters that start at rest on its first row."""
    signals = layout.signals(temperature_degC, speed_rpm)
    if not layout.time_constants_s:
        return layout.inputs(signals, np.empty((len(signals), 0, signals.shape[1])))
    lags, _ = run_filters(t_s, signals, layout.time_constants_s)
    return layout.inputs(signals, lags)


def recorded_inputs(layout: InputLayout, temperatures: Temperatures, duty: Duty | None) -> tuple[Floats, Floats]:
    """Times (n,) and running inputs (n, running) of an unbroken recording, gaps bridged; filters start at rest.

    Raises AnalysisError for a sensor without a column, and where the layout has speeds and the duty has none.
    """
    # Filters need an unbroken signal; where plain temperatures are all there is, a gap stays a gap.
    read = (temperatures.bridged() if layout.time_constants_s else temperatures).select(layout.sensors)
    if layout.speed_powers and (duty is None or SPEED not in duty.columns):
        raise AnalysisError(
            f"this model needs the spindle speed, and there is no {SPEED}."
            " Fix: give a duty table with t_s and spindle_rpm."
        )
    speed_rpm = _speed_rpm(duty, read.t_s) if duty is not None and layout.speed_powers else None
    return read.t_s, history_inputs(layout, read.t_s, read.value_degC, speed_rpm)


def _speed_rpm(duty: Duty, t_s: Floats) -> Floats:
    """Spindle speed at the times of the temperatures: it holds until the next entry of the duty table."""
    rows = np.clip(np.searchsorted(duty.t_s, t_s, side="right") - 1, 0, None)
    return np.nan_to_num(duty.columns[SPEED][rows])

"""The temperature field: what each sensor did in each campaign (paper, section 1.2)."""

from __future__ import annotations

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.campaign import Campaign, MachineFolder
from thetacomp.machine import Machine
from thetacomp.temperature.lag import first_order_lag
from thetacomp.temperature.rises import SensorRise

NAN = float("nan")
RATE_WINDOW_S = 900.0
RATE_SAMPLES = 3
START_WINDOW_S = 60.0
# A running median of this many samples takes single spikes out of densely sampled series.
SPIKE_SAMPLES = 5
DENSE_SAMPLES = 50
# Below this rise a Pt100 chain shows its own noise and resolution rather than heat.
SMALL_RISE_K = 0.5
FOLLOWS_R_SQUARED = 0.90
# Sensors of these roles are not heated by a source of the machine, so they have no lag behind one.
OUTSIDE_ROLES = ("ambient", "foundation", "workpiece")


def sensor_rises(folder: MachineFolder) -> tuple[SensorRise, ...]:
    """Start, maximum, rise, steepest rate and lag of every sensor that was read, campaign by campaign.

    The start is the median of the samples up to the campaign's reference, or of the first minute where no reference
    is stated. A figure that cannot be computed is NaN and `remark` says why.
    """
    return tuple(rise for campaign in folder.campaigns for rise in _campaign_rises(folder.machine, campaign))


def _campaign_rises(machine: Machine, campaign: Campaign) -> list[SensorRise]:
    table = campaign.temperatures
    value = np.column_stack([without_spikes(column) for column in table.value_degC.T]) if table.sensor_ids else None
    if value is None or not len(table.t_s):
        return []
    start = start_degC(table.t_s, table.value_degC, campaign.settings.reference_s)
    rises = np.full(value.shape[1], NAN)
    read = np.isfinite(value).any(axis=0) & np.isfinite(start)
    rises[read] = np.nanmax(value[:, read], axis=0) - start[read]
    rates = steepest_rate_K_per_h(table.t_s, value)
    out = []
    for j, sensor in enumerate(table.sensor_ids):
        if not read[j]:
            out.append(SensorRise(campaign.name, sensor, NAN, NAN, NAN, NAN, NAN, NAN, "", "no reading"))
            continue
        highest = int(np.nanargmax(value[:, j]))
        source, heated_by, remarks = _source_of(machine, table.sensor_ids, sensor, rises)
        lag_s = NAN
        if heated_by is not None:
            lag_s, remark = _lag_s(table.t_s, value[:, heated_by], value[:, j], heated_by == j, rises[[heated_by, j]])
            remarks = [*remarks, remark]
        if np.isnan(rates[j]):
            remarks = [*remarks, f"fewer than {RATE_SAMPLES} readings: no rate"]
        out.append(
            SensorRise(
                campaign=campaign.name,
                sensor=sensor,
                start_degC=float(start[j]),
                maximum_degC=float(value[highest, j]),
                maximum_at_s=float(table.t_s[highest]),
                rise_K=float(rises[j]),
                rate_K_per_h=float(rates[j]),
                lag_s=lag_s,
                source=source,
                remark="; ".join(filter(None, remarks)),
            )
        )
    return out


def start_degC(t_s: Floats, value_degC: Floats, reference_s: float | None) -> Floats:
    """Temperature of each sensor before the heat, (sensors,): NaN where a sensor has no reading at all.

    Median of the readings up to `reference_s`, or of the first minute; where a sensor has none there, its first one.
    """
    until_s = t_s[0] + START_WINDOW_S if reference_s is None else reference_s
    before = t_s <= until_s
    start = np.full(value_degC.shape[1], NAN)
    for j, column in enumerate(value_degC.T):
        good = np.isfinite(column)
        if (good & before).any():
            start[j] = np.median(column[good & before])
        elif good.any():
            start[j] = column[good][0]
    return start


def without_spikes(value_degC: Floats) -> Floats:
    """A running median over five readings of a densely sampled series, (n,); short series come back unchanged.

    Missing readings stay NaN and do not count as neighbours.
    """
    good = np.isfinite(value_degC)
    if np.count_nonzero(good) < DENSE_SAMPLES:
        return value_degC
    out = value_degC.copy()
    readings = value_degC[good]
    half = SPIKE_SAMPLES // 2
    padded = np.concatenate([np.repeat(readings[0], half), readings, np.repeat(readings[-1], half)])
    out[good] = np.median(np.lib.stride_tricks.sliding_window_view(padded, SPIKE_SAMPLES), axis=1)
    return out


def steepest_rate_K_per_h(t_s: Floats, value_degC: Floats) -> Floats:
    """Steepest rise of each sensor in K/h, (sensors,): slope of a straight line over 15 min or 3 samples.

    All windows of all sensors at once, from running sums; missing readings are skipped. NaN where no window has
    three readings.
    """
    n = len(t_s)
    rates = np.full(value_degC.shape[1], NAN)
    if n < RATE_SAMPLES:
        return rates
    first = np.arange(n - RATE_SAMPLES + 1)
    last = np.maximum(np.searchsorted(t_s, t_s[first] + RATE_WINDOW_S), first + RATE_SAMPLES - 1)
    # A window that is cut off by the end of the record may be short and noisy: the last full one serves.
    full = last < n
    if not full.any():
        full, last = first == 0, np.full_like(last, n - 1)
    first, last = first[full], last[full]

    good = np.isfinite(value_degC)
    t_h = ((t_s - t_s.mean()) / 3600.0)[:, None] * good
    theta = np.where(good, value_degC - np.nanmean(np.where(good.any(axis=0), value_degC, 0.0), axis=0), 0.0)

    def window_sum(terms: Floats) -> Floats:
        running = np.vstack([np.zeros(terms.shape[1]), np.cumsum(terms, axis=0)])
        return np.asarray(running[last + 1] - running[first])

    count = window_sum(good.astype(float))
    sum_t, sum_y = window_sum(t_h), window_sum(theta)
    enough = count >= RATE_SAMPLES
    safe = np.where(enough, count, 1.0)
    spread = np.where(enough, window_sum(t_h * t_h) - sum_t**2 / safe, 1.0)
    slope = np.where(enough, (window_sum(t_h * theta) - sum_t * sum_y / safe) / spread, -np.inf)
    best = slope.max(axis=0)
    rates[np.isfinite(best)] = best[np.isfinite(best)]
    return rates


def _source_of(
    machine: Machine, measured: tuple[str, ...], sensor: str, rises: Floats
) -> tuple[str, int | None, list[str]]:
    """Name of the heat source of a sensor, the column of the sensor at that source, and what to remark."""
    column = {name: j for j, name in enumerate(measured)}
    known = [(h, column[h.sensor]) for h in machine.heat_sources if h.sensor in column]
    own = [h.name for h, j in known if measured[j] == sensor]
    if own:
        return " and ".join(own), column[sensor], []
    entry = machine.sensor(sensor) if sensor in machine.sensor_ids else None
    if entry is not None and entry.role in OUTSIDE_ROLES:
        return "", None, [f"role {entry.role}: no heat source of the machine drives it, no lag"]
    axis = entry.axis if entry is not None else None
    same_axis = [(h, j) for h, j in known if axis is not None and h.axis == axis and np.isfinite(rises[j])]
    if same_axis:
        nearest, j = max(same_axis, key=lambda item: rises[item[1]])
        return nearest.name, j, []
    if not np.isfinite(rises).any():
        return "", None, []
    hottest = int(np.nanargmax(rises))
    names = [h.name for h, j in known if j == hottest]
    remark = "no source is named on its axis; it has the largest rise of all"
    if measured[hottest] != sensor:
        remark = f"no source is named on its axis: lag behind {measured[hottest]}, the sensor with the largest rise"
    return " and ".join(names), hottest, [remark]


def _lag_s(t_s: Floats, source: Floats, sensor: Floats, same: bool, rises_K: Floats) -> tuple[float, str]:
    """Lag of a sensor behind the one at its source, and a remark where it is poorly determined."""
    if same:
        return 0.0, ""
    if not np.min(rises_K) >= SMALL_RISE_K:
        return NAN, f"rise of sensor or source below {SMALL_RISE_K:g} K: the lag is unknown"
    good = np.isfinite(source) & np.isfinite(sensor)
    if np.count_nonzero(good) < 5:
        return NAN, "fewer than 5 common readings: the lag is unknown"
    t, u, y = t_s[good], source[good], sensor[good]
    behind, ahead = first_order_lag(t, u, y), first_order_lag(t, y, u)
    # A sensor can sit nearer to the heat than the one named for the source: then it leads, and its lag is negative.
    leads = ahead.r_squared > behind.r_squared
    fit = ahead if leads else behind
    lag_s = -fit.lag_s if leads else fit.lag_s
    if fit.r_squared < FOLLOWS_R_SQUARED:
        return NAN, f"does not follow its source (R² {fit.r_squared:.2f} with a first-order lag)"
    if fit.at_limit:
        return NAN, "lag longer than the record can show"
    step_s = float(np.median(np.diff(t)))
    if fit.lag_s < step_s:
        return lag_s, f"sampling of {step_s / 60:.3g} min is too coarse for a lag below that"
    return lag_s, "leads the sensor at its source" if leads else ""

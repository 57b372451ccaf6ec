"""What only shows when sensors or campaigns are compared: another unit, another scale, another sign, another clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.campaign import Campaign, MachineFolder
from thetacomp.machine import Machine
from thetacomp.model.temperatures import Temperatures
from thetacomp.reading.clock import check_clocks
from thetacomp.reading.components import lever_of, measured_components
from thetacomp.reading.problems import ProblemList
from thetacomp.reading.sweep_jumps import check_sweep_jumps

FAR_K = 15.0
LIKE_FAHRENHEIT_K = 6.0
FEWEST_SENSORS = 4
TIMES_SMALLER = 100.0
LARGEST_IN_MM = 20.0  # errors reach 20 mm at most: µm columns that hold mm show no more than 20

# Opposite signs: only clear cases. Both growths must explain most of the change, be large, and mirror each other.
SMALLEST_HEATING_K = 2.0
SMALLEST_GROWTH_UM = 10.0
SMALLEST_SHARE = 0.7
MIRRORED = -0.8
LARGEST_RATIO = 4.0


def compare(folder: MachineFolder, recorded: bool, problems: ProblemList) -> None:
    """Note everything doubtful that single tables do not show. `recorded`: the campaigns come from one recording."""
    for campaign in folder.campaigns:
        file = "recording.toml" if recorded else f"campaigns/{campaign.name}"
        others = [other for other in folder.campaigns if other is not campaign]
        _sensors(campaign, others, folder.machine, file, problems)
    _sizes(folder.campaigns, recorded, problems)
    _signs(folder.campaigns, recorded, problems)
    check_clocks(folder.campaigns, recorded, problems)
    check_sweep_jumps(folder.campaigns, recorded, problems)


def _starts_degC(heat: Temperatures) -> dict[str, float]:
    """First reading of every sensor, the median of three against a stray value."""
    starts = {}
    for j, sensor in enumerate(heat.sensor_ids):
        good = heat.value_degC[np.isfinite(heat.value_degC[:, j]), j]
        if len(good):
            starts[sensor] = float(np.median(good[:3]))
    return starts


def _sensors(
    campaign: Campaign, others: Sequence[Campaign], machine: Machine, file: str, problems: ProblemList
) -> None:
    starts = _starts_degC(campaign.temperatures)
    elsewhere = [_starts_degC(other.temperatures) for other in others]
    for sensor, start in starts.items():
        rest = [value for name, value in starts.items() if name != sensor]
        own = [found[sensor] for found in elsewhere if sensor in found]
        found = ""
        if len(rest) >= FEWEST_SENSORS - 1 and abs(start - np.median(rest)) > FAR_K:
            found = _far_from(start, float(np.median(rest)), "the median of the other sensors")
        elif own and abs(start - np.median(own)) > FAR_K and _like_fahrenheit(start, float(np.median(own))):
            found = _far_from(start, float(np.median(own)), "the same sensor in the other campaigns")
        if found:
            role = machine.sensor(sensor).role
            problems.warning(
                "sensor-far-off",
                file,
                f"campaign {campaign.name}: {found}",
                f"check the unit and the plug of the sensor; a sensor of the role '{role}' may truly be warm from"
                " earlier work, then the campaign did not start cold.",
                (),
                sensor,
            )


def _far_from(start_degC: float, usual_degC: float, whose: str) -> str:
    text = f"the sensor starts at {start_degC:.1f} °C, {whose} is {usual_degC:.1f} °C"
    if _like_fahrenheit(start_degC, usual_degC):
        return f"{text}: is the column in degrees Fahrenheit ({(start_degC - 32.0) / 1.8:.1f} °C)?"
    return f"{text}, {abs(start_degC - usual_degC):.0f} K away."


def _like_fahrenheit(start_degC: float, usual_degC: float) -> bool:
    return abs((start_degC - 32.0) / 1.8 - usual_degC) < LIKE_FAHRENHEIT_K


def _largest_um(campaign: Campaign) -> float:
    """Largest |error| of all tables of a campaign; NaN where it has none."""
    found = [
        values
        for values in (
            campaign.sweeps.error_um if campaign.sweeps is not None else None,
            campaign.drift.error_um if campaign.drift is not None else None,
            campaign.parameters.intercept_um if campaign.parameters is not None else None,
        )
        if values is not None and np.isfinite(values).any()
    ]
    return max((float(np.nanmax(np.abs(values))) for values in found), default=float("nan"))


def _sizes(campaigns: Sequence[Campaign], recorded: bool, problems: ProblemList) -> None:
    """Millimetres under `_um`: errors a thousand times smaller than those of the other campaigns."""
    largest = {c.name: _largest_um(c) for c in campaigns}
    largest = {name: value for name, value in largest.items() if value > 0.0}
    for name, value in largest.items():
        rest = [other for key, other in largest.items() if key != name]
        if not rest or value > LARGEST_IN_MM or float(np.median(rest)) < TIMES_SMALLER * value:
            continue
        usual = min((key for key in largest if key != name), key=lambda key: abs(largest[key] - float(np.median(rest))))
        problems.error(
            "error-unit",
            "recording.toml" if recorded else f"campaigns/{name}",
            f"the largest error of campaign {name} is {value:.3g} µm, that of campaign {usual} {largest[usual]:.3g} µm,"
            f" {largest[usual] / value:.0f} times as much: are the errors of {name} in mm?",
            f"if so, name the columns of {name} _mm instead of _um; else correct those of {usual}.",
        )


@dataclass(frozen=True)
class _Growth:
    """Growth of one error with the mean temperature rise.

    `profile_um_per_K` holds it at the low end, the middle and the high end of the travel; `share` is the part of the
    change that it explains; `rise_K` the largest mean rise.
    """

    profile_um_per_K: Floats
    share: float
    rise_K: float

    @property
    def size_um_per_K(self) -> float:
        return float(np.sqrt(np.mean(self.profile_um_per_K**2)))

    @property
    def is_clear(self) -> bool:
        large = self.size_um_per_K * self.rise_K >= SMALLEST_GROWTH_UM
        return large and self.share >= SMALLEST_SHARE and self.rise_K >= SMALLEST_HEATING_K


def _signs(campaigns: Sequence[Campaign], recorded: bool, problems: ProblemList) -> None:
    """Errors that grow with heat in one campaign and fall in another: the sign of one of them may be turned."""
    grown = [(campaign, _growths(campaign)) for campaign in campaigns]
    for (first, one), (second, other) in combinations(grown, 2):
        if first.settings.mode != second.settings.mode:
            continue  # heated in another way, as the user says
        opposite = [name for name in one if name in other and _are_opposite(one[name], other[name])]
        if opposite:
            name = opposite[0]
            problems.warning(
                "opposite-signs",
                "recording.toml" if recorded else f"campaigns/{second.name}",
                f"{', '.join(opposite)}: errors grow with the temperature in one direction in campaign {first.name}"
                f" ({one[name].size_um_per_K:.1f} µm/K for {name}) and in the opposite one in campaign {second.name}"
                f" ({other[name].size_um_per_K:.1f} µm/K).",
                "check the sign in both: E = actual - commanded, along machine X, Y, Z; a correction has the opposite"
                " sign. If both are right, the machine was heated in different ways: set `mode` in campaign.toml.",
            )


def _are_opposite(one: _Growth, other: _Growth) -> bool:
    if not (one.is_clear and other.is_clear):
        return False
    a, b = one.size_um_per_K, other.size_um_per_K
    likeness = float(np.mean(one.profile_um_per_K * other.profile_um_per_K)) / (a * b)
    return likeness < MIRRORED and max(a, b) < LARGEST_RATIO * min(a, b)


def _mean_degC(heat: Temperatures) -> Floats:
    """Mean of all sensors at every row, (n,); a line bridges a gap of one sensor, or the mean would jump."""
    columns = []
    for values in heat.value_degC.T:
        good = np.isfinite(values)
        columns.append(np.interp(heat.t_s, heat.t_s[good], values[good]))
    return np.asarray(np.mean(columns, axis=0))


def _growths(campaign: Campaign) -> dict[str, _Growth]:
    """Growth of every component (`EYX`) that was measured in sweeps or came as lines."""
    heat = campaign.temperatures
    mean_degC = _mean_degC(heat)
    found: dict[str, _Growth] = {}

    def add(name: str, t_s: Floats, lever: Floats, place: Floats, error_um: Floats) -> None:
        good = np.isfinite(error_um)
        rise_K = np.interp(t_s[good], heat.t_s, mean_degC) - mean_degC[0]
        growth = _growth(rise_K, lever[good], place[good], error_um[good])
        if growth is not None:
            found[name] = growth

    for one in measured_components(campaign):
        add(one.name, one.t_s, one.lever, one.place, one.error_um)
    if campaign.parameters is not None:
        lines = campaign.parameters
        for name in dict.fromkeys(lines.component):
            mine = np.array([n == name for n in lines.component]) & np.isfinite(lines.p0_mm)
            ends = np.concatenate([lines.p_min_mm[mine], lines.p_max_mm[mine]])
            lever_m = (ends - np.tile(lines.p0_mm[mine], 2)) / 1000.0
            error = np.tile(lines.intercept_um[mine], 2) + np.tile(lines.slope_um_per_m[mine], 2) * lever_m
            lever = lever_of(ends)
            add(name, np.tile(lines.t_s[mine], 2), lever, np.round(lever, 2)[:, None], error)
    return found


def _growth(rise_K: Floats, lever: Floats, place: Floats, error_um: Floats) -> _Growth | None:
    """Regression `error = geometry(place) + rise (a + b u)`, u the lever, from -1 to 1 over the travel.

    None where positions were not measured again, or nothing was heated.
    """
    if len(error_um) < 6 or np.ptp(lever) == 0.0:
        return None
    group = np.unique(place, axis=0, return_inverse=True)[1].ravel()
    columns = np.column_stack([rise_K, rise_K * lever, error_um])
    means = np.column_stack([np.bincount(group, column) for column in columns.T]) / np.bincount(group)[:, None]
    centred = columns - means[group]
    change = float(centred[:, 2] @ centred[:, 2])
    if change == 0.0 or len(error_um) - len(means) < 4:
        return None
    (a, b), *_ = np.linalg.lstsq(centred[:, :2], centred[:, 2], rcond=None)
    left = centred[:, 2] - centred[:, :2] @ np.array([a, b])
    return _Growth(np.array([a - b, a, a + b]), 1.0 - float(left @ left) / change, float(np.ptp(rise_K)))

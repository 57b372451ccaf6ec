"""Conditions of a thermal test in words: what moved, and whether the machine had settled."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.campaign import Campaign

HOUR_S = 3600.0
SHORTEST_HISTORY_MIN = 30.0


def moving(name: str) -> bool:
    """Whether a column of duty.csv describes motion: speeds in rpm, feeds in mm/min."""
    return name.endswith(("_rpm", "_mm_min"))


def speeds(campaign: Campaign, *endings: str) -> tuple[Floats, Floats] | None:
    """Largest of the columns with these endings over time, with what an unbroken recording holds before."""
    duty = campaign.duty
    if duty is None or not (names := [name for name in duty.columns if name.endswith(endings)]):
        return None
    earlier = campaign.before.duty if campaign.before is not None else None
    if earlier is not None and all(name in earlier.columns for name in names):
        duty = earlier.joined(duty)
    return duty.t_s, np.max([np.abs(np.nan_to_num(duty.columns[name])) for name in names], axis=0)


def in_force(t_s: Floats, start_s: float, end_s: float) -> slice:
    """Samples that hold during the time from `start_s` to `end_s`: each holds until the next one."""
    first = max(int(np.searchsorted(t_s, start_s, side="right")) - 1, 0)
    return slice(first, int(np.searchsorted(t_s, end_s)))


def speed_words(t_s: Floats, rpm: Floats, start_s: float, end_s: float) -> str:
    """The spindle speeds of a test."""
    inside = rpm[in_force(t_s, start_s, end_s)]
    levels = np.unique(inside[inside > 0])
    if len(levels) <= 4:
        return f"Spindle speed: {', '.join(f'{v:g}' for v in levels)} rpm."
    return f"Spindle speed: {levels[0]:g} to {levels[-1]:g} rpm, {len(levels)} levels."


def other_motion(campaign: Campaign, start_s: float, end_s: float) -> list[str]:
    """Feeds during a spindle test; nothing where the axes rested or no feed was logged."""
    feed = speeds(campaign, "_mm_min")
    if feed is None:
        return []
    largest = float(np.max(feed[1][in_force(feed[0], start_s, end_s)], initial=0.0))
    if not largest:
        return []
    return [f"Axes moved meanwhile (up to {largest:g} mm/min): this is not the distortion of the spindle alone."]


def all_motion(campaign: Campaign, start_s: float, end_s: float) -> list[str]:
    """What ran during an axis test, as far as duty.csv says."""
    if campaign.duty is None or not any(moving(name) for name in campaign.duty.columns):
        return ["duty.csv does not show what moved between the visits: the heat cannot be attributed to this axis."]
    inside = in_force(campaign.duty.t_s, start_s, end_s)
    top = {n: float(np.nanmax(np.abs(v[inside]), initial=0.0)) for n, v in campaign.duty.columns.items() if moving(n)}
    ran = [f"{name} up to {value:g}" for name, value in top.items() if value > 0]
    if not ran:
        return ["Nothing moved between the visits (duty.csv): this is drift, not distortion by a moving axis."]
    return [f"Meanwhile: {', '.join(ran)}. The distortion includes all the heat of that time."]


def ambient_words(campaign: Campaign, ambient: Sequence[str], start_s: float, end_s: float) -> str:
    """Range of the ambient temperature during a test, or that it was not measured."""
    heat = campaign.temperatures
    inside = (heat.t_s >= start_s) & (heat.t_s <= end_s)
    ranges = []
    for sensor in ambient:
        value = heat.padded((sensor,)).value_degC[inside]
        value = value[np.isfinite(value)]
        if len(value):
            ranges.append(f"{sensor} {value.min():.1f} to {value.max():.1f} °C ({np.ptp(value):.1f} K)")
    if not ranges:
        return "No ambient temperature: no sensor of machine.toml with the role ambient has readings in this time."
    return f"Ambient temperature: {', '.join(ranges)}."


def unsettled(campaign: Campaign, start_s: float) -> tuple[str, ...]:
    """How far the temperatures had settled in the hour before the test, as far as they were logged."""
    heat, _ = campaign.recording()
    t_s, value = heat.t_s, heat.value_degC
    inside = (t_s >= start_s - HOUR_S) & (t_s <= start_s)
    logged_min = (start_s - float(t_s[inside][0])) / 60.0 if inside.any() else 0.0
    if logged_min < SHORTEST_HISTORY_MIN:
        return (
            f"Only {logged_min:.0f} min of temperatures before the start: whether the machine had settled is open.",
        )
    spread = np.array([np.ptp(c[np.isfinite(c)]) if np.isfinite(c).any() else 0.0 for c in value[inside].T])
    worst = int(np.argmax(spread))
    return (
        f"In the {logged_min:.0f} min before the start no sensor moved by more than {spread[worst]:.1f} K"
        f" ({heat.sensor_ids[worst]}).",
    )

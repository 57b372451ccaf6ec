"""Rules of initial sensor placement (paper, section 1.1), as sentences."""

from __future__ import annotations

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.campaign import MachineFolder
from thetacomp.machine import Machine
from thetacomp.temperature.field import start_degC
from thetacomp.temperature.rises import LayoutCheck

REDUNDANT_R = 0.99
PAIRS_NAMED = 5
MEASURED, PUBLISHED = "in the campaigns", "in the published table"


def layout_checks(folder: MachineFolder) -> tuple[LayoutCheck, ...]:
    """The rules of initial placement on the machine file and on what was read, one sentence or two each."""
    machine = folder.machine
    return (
        _more_sensors_than_sources(machine),
        _one_near_every_source(machine),
        _reference(machine),
        _all_read(folder),
        _redundancy(folder),
    )


def _more_sensors_than_sources(machine: Machine) -> LayoutCheck:
    rule = "more sensors than heat sources"
    sensors, sources = len(machine.sensors), len(machine.heat_sources)
    if not sources:
        return LayoutCheck(
            rule,
            False,
            "machine.toml lists no heat source, so the rule cannot be checked. Add [[heat_sources]]: spindle bearings,"
            " motors, screw nuts, gears, pumps, oil.",
        )
    if sensors > sources:
        return LayoutCheck(rule, True, f"{sensors} sensors for {sources} heat sources.")
    return LayoutCheck(
        rule,
        False,
        f"{sensors} sensors for {sources} heat sources: mount at least {sources + 1 - sensors} more. The first"
        " campaigns need as many sensors as possible; the choice of the few that stay comes later.",
    )


def _one_near_every_source(machine: Machine) -> LayoutCheck:
    rule = "a sensor near every heat source"
    if not machine.heat_sources:
        return LayoutCheck(rule, False, "machine.toml lists no heat source, so the rule cannot be checked.")
    without = [source.name for source in machine.heat_sources if source.sensor is None]
    if without:
        return LayoutCheck(
            rule,
            False,
            f'no sensor is named for: {", ".join(without)}. Mount one there, or name the nearest with sensor = "…".',
        )
    return LayoutCheck(rule, True, f"all {len(machine.heat_sources)} heat sources name the sensor next to them.")


def _reference(machine: Machine) -> LayoutCheck:
    rule = "a reference temperature"
    found = [s.id for s in machine.sensors if s.role in ("reference", "ambient")]
    if found:
        return LayoutCheck(rule, True, f"away from the heat sources: {', '.join(found)}.")
    return LayoutCheck(
        rule,
        False,
        "no sensor has the role reference or ambient. Mount one far from every heat source: without it a warm workshop"
        " and a warm machine look the same.",
    )


def _all_read(folder: MachineFolder) -> LayoutCheck:
    rule = "every sensor was read"
    silent = [name for name in folder.machine.sensor_ids if not _campaigns_with(folder, name)]
    if not folder.campaigns:
        return LayoutCheck(rule, False, "the folder holds no campaign.")
    if silent:
        total = len(folder.machine.sensor_ids)
        return LayoutCheck(
            rule,
            False,
            f"{len(silent)} of {total} sensors have no reading in any campaign: {', '.join(silent)}."
            " They cannot become key points from these measurements.",
        )
    return LayoutCheck(rule, True, "every sensor has readings in at least one campaign.")


def _campaigns_with(folder: MachineFolder, sensor: str) -> list[str]:
    return [c.name for c in folder.campaigns if np.isfinite(c.temperatures.padded((sensor,)).value_degC).any()]


def _redundancy(folder: MachineFolder) -> LayoutCheck:
    """At least two sensors an axis, and more sensors than one key point an axis; near copies are named."""
    rule = "redundancy"
    machine = folder.machine
    count = {axis.name: sum(s.axis == axis.name for s in machine.sensors) for axis in machine.axes}
    thin = [f"{name} has {'none' if k == 0 else 'one'}" for name, k in count.items() if k < 2]
    needed = max(len(machine.axes), 1)
    passed = not thin and len(machine.sensors) > needed
    words = []
    if thin:
        words.append(f"Fewer than two sensors on an axis: {', '.join(thin)}; no other can replace it when it fails.")
    else:
        words.append("Every axis has at least two sensors.")
    if len(machine.sensors) <= needed:
        words.append(f"{len(machine.sensors)} sensors for {needed} key points (one an axis) leave no reserve.")
    pairs, where = near_copies(folder)
    if pairs:
        # Published figures are shown as printed: 1.000 would claim digits that they do not have.
        digits = ".3f" if where == MEASURED else "g"
        named = ", ".join(f"{a} and {b} ({r:{digits}})" for a, b, r in pairs[:PAIRS_NAMED])
        more = f" and {len(pairs) - PAIRS_NAMED} more pairs" if len(pairs) > PAIRS_NAMED else ""
        words.append(
            f"Near copies, |r| above {REDUNDANT_R:g} {where}: {named}{more}. Each can replace the other when it fails;"
            " a model needs only one of them."
        )
    return LayoutCheck(rule, passed, " ".join(words))


def near_copies(folder: MachineFolder) -> tuple[list[tuple[str, str, float]], str]:
    """Pairs of sensors with |r| above 0.99, largest first, and where that was seen.

    From the rises of all campaigns together, else from the published correlations of the folder.
    """
    ids = folder.machine.sensor_ids
    rises = pooled_rises_K(folder)
    moving = [j for j in range(len(ids)) if np.isfinite(rises[:, j]).sum() >= 5 and np.nanstd(rises[:, j]) > 0]
    if len(moving) >= 2:
        complete = np.isfinite(rises[:, moving]).all(axis=1)
        if np.count_nonzero(complete) >= 5 and (np.ptp(rises[complete][:, moving], axis=0) > 0).all():
            r = np.asarray(np.corrcoef(rises[complete][:, moving], rowvar=False))
            return _pairs([ids[j] for j in moving], r), MEASURED
    table = folder.sensor_correlations
    if table is not None:
        order = [table.columns.index(row) if row in table.columns else -1 for row in table.rows]
        if min(order, default=-1) >= 0:
            return _pairs(list(table.rows), table.value[:, order]), PUBLISHED
    return [], ""


def pooled_rises_K(folder: MachineFolder) -> Floats:
    """Rises of all sensors of the machine over all campaigns, (samples, sensors), NaN where not read."""
    ids = folder.machine.sensor_ids
    blocks = []
    for campaign in folder.campaigns:
        table = campaign.temperatures
        if not len(table.t_s):
            continue
        value_degC = table.padded(ids).value_degC
        blocks.append(value_degC - start_degC(table.t_s, value_degC, campaign.settings.reference_s))
    return np.vstack(blocks) if blocks else np.empty((0, len(ids)))


def _pairs(names: list[str], r: Floats) -> list[tuple[str, str, float]]:
    # A published table may hold one triangle only.
    size = np.tril(np.fmax(np.abs(r), np.abs(r).T), -1)
    rows, columns = np.nonzero(size > REDUNDANT_R)
    found = [(names[j], names[i], float(min(size[i, j], 1.0))) for i, j in zip(rows, columns, strict=True)]
    return sorted(found, key=lambda pair: -pair[2])

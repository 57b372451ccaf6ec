"""The thermal error anywhere in the working volume: drift once, every axis, rotations over their arms. Numpy only.

    E(p, L) = D + Σ_a [S_a (p_a - P0_a) + C_a (p_a - P0_a)²] + Σ_a [σ_a (p_a - P0_a)] × arm_a + r × (L - L0) t
    r = D_r + Σ_a σ_a (p_a - P0_a)

D, S and C are the drift (µm), the slopes (µm/m) and the bends (µm/m²) of the joint form, at the tool length L0; `σ_a`
(µrad/m) is the thermal change of the angles along axis a, `D_r` (µrad) that at fixed positions; `arm_a` is made of the
axes behind a in the chain; t points from the spindle nose to the tool tip. A rotation that does not change with a
position is in the slopes of the axes behind it already. So 99 µrad over a 600 mm arm, 59 µm, are counted once.

Where no angles were measured, a longer tool is taken to lean with the guide of the last axis, if that runs along the
spindle: its slopes, and the tangent of its bend, hold the rotation of everything that carries it. The bending of ram
and spindle is not in them.

Uncertainty: the half widths of all parts are taken as independent and add as squares. The parts are fits of their own
on different sweeps. The band of an axis on heat history is calibrated on measured points over its travel, so it holds
the scatter of one reading: of all axes together that counts once. What the parts share (the key sensors' own errors,
the slopes that were taken off the drift) is not counted, and is small while the axes stand near P0 in the measuring
sweeps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.model.axis_chain import TOOL, ChainAxis, arms_behind_m


@dataclass(frozen=True)
class Part:
    """One term at n moments with its 95 % half width, both (n, 3): µm or µm/m, or µrad or µrad/m for angles."""

    value: Floats
    half_width: Floats


@dataclass(frozen=True)
class ThermalParts:
    """All terms of the joint form at n moments; `slopes` and `angle_slopes` by axis, angles only where measured.

    `there_um` holds by axis the half width (n, 3) of what it does at its own position. Where it is absent, the half
    width of the slope grows with the arm. `reading_um` (3,) by axis is the scatter of one reading in it, as half width.
    `bends_um_per_m2` (n, 3) by axis; absent where all axes stay lines.
    """

    drift: Part
    slopes: Mapping[str, Part]
    angle: Part | None = None
    angle_slopes: Mapping[str, Part] = field(default_factory=dict)
    there_um: Mapping[str, Floats] = field(default_factory=dict)
    reading_um: Mapping[str, Floats] = field(default_factory=dict)
    bends_um_per_m2: Mapping[str, Floats] = field(default_factory=dict)


def spindle_lean(chain: Sequence[ChainAxis]) -> ChainAxis | None:
    """The last axis where it runs along the spindle: a longer tool is then the same as a ram further out."""
    last = chain[-1]
    return last if np.isclose(abs(float(last.direction @ TOOL)), 1.0) else None


def volume_error(
    chain: Sequence[ChainAxis], parts: ThermalParts, positions_mm: Mapping[str, Floats], longer_mm: Floats
) -> tuple[Floats, Floats]:
    """Error (n, 3) in µm and half width (n, 3) of its 95 % interval at n positions of all axes.

    `chain` runs from the workpiece to the tool; `longer_mm` (n,) is how much longer the tool is than in the model.
    Without angles it counts only where `spindle_lean` names an axis; ValueError where it does not.
    """
    longer_m = np.asarray(longer_mm, dtype=np.float64) / 1000.0
    error_um, square = parts.drift.value.copy(), parts.drift.half_width**2
    reading_um = [parts.reading_um.get(axis.name, np.zeros(3)) for axis in chain]
    square = square + np.max(reading_um, axis=0) ** 2
    lean = spindle_lean(chain)
    if parts.angle is None and lean is None and np.any(longer_m):
        raise ValueError("no angles, and no axis along the spindle carries the tool: its length has no known effect")
    for axis, own_um in zip(chain, reading_um, strict=True):
        part = parts.slopes[axis.name]
        here_m = axis.arm_m(positions_mm[axis.name])[:, None]
        arm_m = np.repeat(here_m, 3, axis=1)
        if parts.angle is None and lean is axis:
            across = np.abs(axis.direction) < 0.5
            arm_m[:, across] += (float(axis.direction @ TOOL) * longer_m)[:, None]
        bend = parts.bends_um_per_m2.get(axis.name, np.zeros((len(longer_m), 3)))
        # The tangent continues beyond the axis: u² + 2 u (arm - u).
        error_um = error_um + part.value * arm_m + bend * here_m * (2.0 * arm_m - here_m)
        half_um = part.half_width * np.abs(arm_m)
        if axis.name in parts.there_um:
            # A band that was calibrated over the travel does not shrink with the arm; only a longer tool widens it.
            there_um = parts.there_um[axis.name]
            half_um = np.where(longer_m[:, None] != 0, np.maximum(there_um, half_um), there_um)
        square = square + np.maximum(half_um**2 - own_um**2, 0.0)
    tool_m = longer_m[:, None] * TOOL
    turns = [(parts.angle, np.ones(len(longer_m)), tool_m)] if parts.angle is not None else []
    arms_m = arms_behind_m(chain, positions_mm)
    for axis in chain:
        if axis.name in parts.angle_slopes:
            turns.append(
                (parts.angle_slopes[axis.name], axis.arm_m(positions_mm[axis.name]), arms_m[axis.name] + tool_m)
            )
    for part, factor, arm_m in turns:
        error_um = error_um + np.cross(part.value * factor[:, None], arm_m)
        square = square + _turned_square(part.half_width * factor[:, None], arm_m)
    return error_um, np.sqrt(square)


def volume_slope(
    chain: Sequence[ChainAxis], parts: ThermalParts, positions_mm: Mapping[str, Floats], moving: str
) -> Floats:
    """How the error changes with the position of one axis, (n, 3) in µm/m, with the tool of the measurements.

    Its own slope and bend, its own twist over the arms behind it, and the twists before it, which turn its travel.
    """
    arms_m = arms_behind_m(chain, positions_mm)
    number = [axis.name for axis in chain].index(moving)
    axis = chain[number]
    here_m = axis.arm_m(positions_mm[moving])[:, None]
    slope = parts.slopes[moving].value + 2.0 * here_m * parts.bends_um_per_m2.get(moving, np.zeros_like(here_m))
    if moving in parts.angle_slopes:
        slope = slope + np.cross(parts.angle_slopes[moving].value, arms_m[moving])
    for before in chain[:number]:
        if before.name in parts.angle_slopes:
            turn_urad = parts.angle_slopes[before.name].value * before.arm_m(positions_mm[before.name])[:, None]
            slope = slope + np.cross(turn_urad, axis.direction)
    return np.asarray(slope)


def _turned_square(half_urad: Floats, arm_m: Floats) -> Floats:
    """Squared half widths of r × arm, with independent rotations about X, Y, Z."""
    r, d = half_urad**2, arm_m**2
    return np.stack(
        [
            r[:, 1] * d[:, 2] + r[:, 2] * d[:, 1],
            r[:, 2] * d[:, 0] + r[:, 0] * d[:, 2],
            r[:, 0] * d[:, 1] + r[:, 1] * d[:, 0],
        ],
        axis=1,
    )

"""A machine of rigid bodies with known errors: homogeneous transforms of three axes, not the formula of the model.

The chain is X (column on the bed), Y (headstock on the column), W (ram in the headstock), tool along -Z. Every joint
has three displacements and three rotations, of position (geometry) and of heat. The tool error is the product of the
exact matrices less the product of the ideal ones. Everything that is compared with it is measured on this product.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thetacomp.campaign import Campaign, CampaignSettings, Drift, SweepPoints
from thetacomp.machine import Axis, Machine, Sensor
from thetacomp.model.temperatures import Temperatures

Floats = NDArray[np.float64]

AXES = (
    Axis(name="X", direction="+X", travel_mm=(0.0, 2000.0)),
    Axis(name="Y", direction="+Y", travel_mm=(0.0, 1600.0)),
    Axis(name="W", direction="+Z", travel_mm=(0.0, 800.0)),
)
MACHINE = Machine(
    name="rigid",
    axes=AXES,
    sensors=(Sensor(id="t1", role="drive"), Sensor(id="t2", role="structure")),
)
NAMES = tuple(axis.name for axis in AXES)
P0_MM = {axis.name: float(np.mean(axis.travel_mm)) for axis in AXES}
UNIT = {axis.name: np.eye(3)["XYZ".index(axis.cartesian)] for axis in AXES}
TOOL_MM = 200.0
# Where each joint stands in the body before it, in mm: arms that no axis position includes.
BASE_MM = {"X": np.array([0.0, 400.0, 0.0]), "Y": np.array([-150.0, 900.0, 250.0]), "W": np.array([0.0, 80.0, -700.0])}
ROUND_S, SWEEP_S, REFERENCE_S = 3600.0, 600.0, 2400.0
# Where the other axes stand while one is swept: away from P0, so that their tilt is in every intercept.
STAND_MM = {"X": 1500.0, "Y": 500.0, "W": 650.0}


@dataclass(frozen=True)
class Rigid:
    """Errors of every joint, (6,) displacement µm and rotation µrad, for s = (p - P0) / 1 m.

    `geometry` (4, 6) holds polynomial coefficients in s; `heat` (2, 2, 6) for two warmths the constant and the change
    with s. `tau_s` are the time constants of the warmths.
    """

    geometry: Mapping[str, Floats]
    heat: Mapping[str, Floats]
    tau_s: tuple[float, float]

    def warmth(self, t_s: Floats) -> Floats:
        """(n, 2), zero until the end of the cold block."""
        since = np.maximum(np.atleast_1d(t_s) - REFERENCE_S, 0.0)[:, None]
        return 1.0 - np.exp(-since / np.array(self.tau_s))

    def tool(self, positions_mm: Mapping[str, float], warmth: Floats, tool_mm: float = TOOL_MM) -> Floats:
        """Error of the tool (6,): µm along and µrad about X, Y, Z."""
        real, ideal = np.eye(4), np.eye(4)
        for name in NAMES:
            s = (positions_mm[name] - P0_MM[name]) / 1000.0
            error = np.polyval(self.geometry[name][::-1], s)
            error = error + warmth @ (self.heat[name][:, 0] + self.heat[name][:, 1] * s)
            move = _shift(BASE_MM[name] + UNIT[name] * positions_mm[name])
            ideal = ideal @ move
            real = real @ move @ _shift(error[:3] * 1e-3) @ _turn(error[3:] * 1e-6)
        tip = np.array([0.0, 0.0, -tool_mm, 1.0])
        turned = real[:3, :3] @ ideal[:3, :3].T
        angles = 0.5 * np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]])
        return np.concatenate([((real - ideal) @ tip)[:3] * 1e3, angles * 1e6])

    def thermal(self, positions_mm: Mapping[str, float], t_s: float, tool_mm: float = TOOL_MM) -> Floats:
        """Error of the tool (6,) less that of the cold machine at the same place."""
        warmth = self.warmth(np.array([t_s]))[0]
        return self.tool(positions_mm, warmth, tool_mm) - self.tool(positions_mm, np.zeros(2), tool_mm)

    def slope(self, axis: str, t_s: float) -> Floats:
        """Thermal slope (6,) in µm/m and µrad/m along one axis, the others at P0, by differences."""
        ends = [self.thermal({**P0_MM, axis: P0_MM[axis] + side}, t_s) for side in (-100.0, 100.0)]
        return (ends[1] - ends[0]) / 0.2


def draw_rigid(rng: np.random.Generator, *, turning: bool = True) -> Rigid:
    """Errors of a heavy machine: tens of µm and µrad cold, up to a hundred more when warm.

    Without `turning` the angles of a joint do not change with its position: tilts, but no twist of the guides.
    """
    scale = np.array([1.0] * 3 + [0.5] * 3)
    # A constant angle of a joint is squareness: position and approach alone make it, and it is in the slopes.
    geometry = {name: rng.normal(0, 15, (4, 6)) * scale for name in NAMES}
    heat = {name: rng.normal(0, 40, (2, 2, 6)) * scale for name in NAMES}
    if not turning:
        for name in NAMES:
            geometry[name][1:, 3:] = 0.0
            heat[name][:, 1, 3:] = 0.0
    return Rigid(geometry, heat, (rng.uniform(1.5, 2.5) * 3600.0, rng.uniform(3.0, 5.0) * 3600.0))


def measure(
    rigid: Rigid,
    rng: np.random.Generator,
    name: str = "warm-up",
    *,
    rounds: int = 7,
    targets: int = 7,
    point_sd_um: float = 4.0,
    angle_sd_urad: float | None = None,
    drift_zero_um: float | None = None,
    at: bool = True,
) -> Campaign:
    """One cold round and warm ones, an hour apart; each sweeps X, Y and W out and back, every point at its own time.

    `angle_sd_urad` measures angles too; `drift_zero_um` adds a drift record with a zero of its own.
    """
    rows: list[tuple[float, str, int, int, dict[str, float]]] = []
    drift: list[tuple[float, dict[str, float]]] = []
    for k in range(rounds):
        for j, axis in enumerate(AXES):
            begin_s = k * ROUND_S + j * (SWEEP_S + 100.0)
            out = np.linspace(*axis.travel_mm, targets)
            order = np.concatenate([out, out[::-1]])
            times = begin_s + np.linspace(0.0, SWEEP_S, len(order))
            for i, (t_s, p) in enumerate(zip(times, order, strict=True)):
                place = {**STAND_MM, axis.name: float(p)}
                rows.append((float(t_s), axis.name, len(AXES) * k + j, 1 if i < targets else -1, place))
            drift.append((float(times[-1] + 30.0), dict(STAND_MM)))
    t_s = np.array([row[0] for row in rows])
    moving = np.array([row[1] for row in rows])
    warmth = rigid.warmth(t_s)
    true = np.array([rigid.tool(row[4], w) for row, w in zip(rows, warmth, strict=True)])
    place = {n: np.array([row[4][n] for row in rows]) for n in NAMES}
    error = true[:, :3] + rng.normal(0, point_sd_um, (len(rows), 3))
    angles = None if angle_sd_urad is None else true[:, 3:] + rng.normal(0, angle_sd_urad, (len(rows), 3))
    record = None
    if drift_zero_um is not None:
        drift_s = np.array([one[0] for one in drift])
        value = np.array([rigid.tool(p, w) for (_, p), w in zip(drift, rigid.warmth(drift_s), strict=True)])
        noisy = value[:, :3] + drift_zero_um + rng.normal(0, point_sd_um, (len(drift), 3))
        record = Drift(drift_s, noisy, None, {n: np.full(len(drift), STAND_MM[n]) for n in NAMES} if at else {})
    clock = np.arange(0.0, rounds * ROUND_S, 300.0)
    return Campaign(
        name=name,
        settings=CampaignSettings(tool_length_mm=TOOL_MM, reference_s=REFERENCE_S, instrument_u_um_per_m=0.0),
        temperatures=Temperatures(clock, ("t1", "t2"), 20.0 + 10.0 * rigid.warmth(clock)),
        sweeps=SweepPoints(
            t_s=t_s,
            axis=tuple(moving.tolist()),
            sweep=np.array([row[2] for row in rows], dtype=np.int64),
            position_mm=np.array([row[4][row[1]] for row in rows]),
            direction=np.array([row[3] for row in rows], dtype=np.int64),
            error_um=error,
            rotation_urad=angles,
            at_mm={n: np.where(moving == n, np.nan, place[n]) for n in NAMES} if at else {},
        ),
        drift=record,
    )


def _shift(by_mm: Floats) -> Floats:
    out = np.eye(4)
    out[:3, 3] = by_mm
    return out


def _turn(rotation: Floats) -> Floats:
    """Rotation about X, then Y, then Z."""
    (ca, cb, cc), (sa, sb, sc) = np.cos(rotation), np.sin(rotation)
    about_x = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
    about_y = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    about_z = np.array([[cc, -sc, 0], [sc, cc, 0], [0, 0, 1]])
    out = np.eye(4)
    out[:3, :3] = about_z @ about_y @ about_x
    return out

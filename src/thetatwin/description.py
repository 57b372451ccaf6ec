"""What the virtual machine is made of, as its TOML file says it. Lengths in mm, everything else as the name says.

The machine frame is the Cartesian one of ISO 841: X along the bed, Y up, Z out of the workpiece into the machine.
Every body is described where it stands when all its axes read zero.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from thetacomp.machine import Axis, HeatSource, Sensor, SensorRole, Strict
from thetatwin.files import load_toml

Point = tuple[float, float, float]
Normal = Literal["+X", "-X", "+Y", "-Y", "+Z", "-Z", "any"]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]

MACHINES = ("tk6920",)


class Material(Strict):
    """Properties near 20 °C; `source` says where the figures come from."""

    young_GPa: Positive
    poisson: Annotated[float, Field(ge=0, lt=0.5)]
    expansion_per_K: Positive
    conductivity_W_per_m_K: Positive
    density_kg_per_m3: Positive
    specific_heat_J_per_kg_K: Positive
    source: str


class Block(Strict):
    """A box of the body's material. With `wall_mm` (thickness across X, Y, Z) it is hollow, 0 leaves that side open.

    `ribs_<axis>_mm` are the centres of full plates across that axis, `rib_mm` thick.
    """

    from_mm: Point
    to_mm: Point
    wall_mm: tuple[NotNegative, NotNegative, NotNegative] | None = None
    ribs_X_mm: tuple[float, ...] = ()
    ribs_Y_mm: tuple[float, ...] = ()
    ribs_Z_mm: tuple[float, ...] = ()
    rib_mm: NotNegative = 0.0

    @model_validator(mode="after")
    def _box_has_volume(self) -> Block:
        if not all(b > a for a, b in zip(self.from_mm, self.to_mm, strict=True)):
            raise ValueError(f"a box from {self.from_mm} to {self.to_mm} has no volume")
        return self


class Body(Strict):
    """One casting: blocks added, then cuts taken away. `element_mm` is the largest edge of an element.

    Outer faces meet the air of the hall with `to_air_W_per_m2_K`, faces inside hollow blocks and cuts meet the air
    of one cavity with `to_cavity_W_per_m2_K` (convection and radiation together).
    """

    name: str
    material: str
    element_mm: Positive
    to_air_W_per_m2_K: NotNegative
    to_cavity_W_per_m2_K: NotNegative
    blocks: tuple[Block, ...]
    cuts: tuple[Block, ...] = ()


class Patch(Strict):
    """The part of a body's faces with this normal that lies inside the box; "any" only where heat passes."""

    name: str
    body: str
    normal: Normal
    from_mm: Point
    to_mm: Point


class Lump(Strict):
    """A part small enough to have one temperature: oil tank, motor, gear, bearing ring."""

    name: str
    capacity_kJ_per_K: Positive
    to_air_W_per_K: NotNegative = 0.0
    at_mm: Point


class Rod(Strict):
    """A screw, a scale or the spindle: a slender part with its own temperature along its length.

    It is tied at `from_mm` and expands freely from there to `to_mm`. It lies along `patch` and exchanges
    `to_patch_W_per_m_K` with the neighbouring face.
    """

    name: str
    material: str
    from_mm: Point
    to_mm: Point
    section_mm2: Positive
    segments: Annotated[int, Field(ge=2)]
    to_air_W_per_m_K: NotNegative
    patch: str
    to_patch_W_per_m_K: NotNegative


class Contact(Strict):
    """Heat passes between the mean temperatures of two places (patches, lumps or rods)."""

    a: str
    b: str
    conductance_W_per_K: Positive


class Bearing(Strict):
    """Rolling bearing friction after Palmgren: M0 = 1e-7 f0 (ν n)^(2/3) dm³, M1 = f1 P1 dm (N mm)."""

    mean_diameter_mm: Positive
    f0: Positive
    f1: NotNegative
    load_N: NotNegative
    film: str


class Source(Strict):
    """A heat source. Its power is the sum of the terms that are given.

    `on_W` while the machine is switched on; `per_rpm_W` times the spindle speed; `per_m_min_W` and `friction_N`
    times the feed of `axis`; `torque_Nm` times the angular speed of its screw of `lead_mm`; `bearing` at the
    spindle speed.
    `shares` says where the heat goes; the shares add up to one or less (the rest leaves with chips, fan or flow).
    """

    name: str
    axis: str | None = None
    on_W: NotNegative = 0.0
    per_rpm_W: NotNegative = 0.0
    per_m_min_W: NotNegative = 0.0
    friction_N: NotNegative = 0.0
    torque_Nm: NotNegative = 0.0
    lead_mm: Positive | None = None
    bearing: Bearing | None = None
    shares: dict[str, Annotated[float, Field(gt=0, le=1)]]
    sensor: str | None = None


class Cooling(Strict):
    """A chiller on one lump: takes conductance * (lump - set point), never less than 0 nor more than the limit."""

    lump: str
    conductance_W_per_K: Positive
    limit_W: Positive
    setpoint_degC: float


class Oil(Strict):
    """Viscosity of the bearings' oil: ν = ν40 exp(-falloff (T - 40 °C)), taken between 5 and 70 °C."""

    nu40_mm2_per_s: Positive
    falloff_per_K: NotNegative
    source: str


class Air(Strict):
    """How the air of the hall is laid out: height zero of the stratification and shape of the door's draught.

    A draught cools the air at `door_mm` by 1 K per unit and fades with `door_fade_mm` across X, Y and Z.
    """

    level_height_mm: float
    door_mm: Point
    door_fade_mm: tuple[Positive, Positive, Positive]


class Feedback(Strict):
    """How an axis knows its position. `rod` is the scale or screw; its tied end is fixed to `datum` on the lower
    body, the reading head or nut sits at `head` on the upper body (both patches)."""

    rod: str
    datum: str
    head: str


class TwinAxis(Axis):
    """An axis of the machine file with its kinematics: the `lower` body carries the `upper` one.

    One of the two has the long guide over the whole travel, the other short pads on it; at each position the part of
    the long guide that lies under the short pads counts. The first axis stands on the ground, each next one on the
    upper body of the one before.
    """

    lower: str
    upper: str
    lower_pads: tuple[str, ...]
    upper_pads: tuple[str, ...]
    long_guide: Literal["lower", "upper"]
    stations: Annotated[int, Field(ge=3)]
    measuring: Feedback


class TwinSensor(Strict):
    """A Pt100: where it sits in the field. `place` is a lump, rod, patch or body; at_mm picks the spot on rod and
    patch, on a body the nearest node of its surface."""

    id: str
    location: str
    role: SensorRole
    axis: str | None = None
    place: str
    at_mm: Point


class Description(Strict):
    """The whole virtual machine.

    `ground` are the patches that stand on the foundation. `nose` is the patch that holds the fixed bearing of the
    rod `spindle`, whose far end is the tool's seat.
    """

    format: Literal[1]
    name: str
    reference_degC: float
    materials: dict[str, Material]
    bodies: tuple[Body, ...]
    ground: tuple[str, ...]
    ground_stiffness_N_per_mm3: Positive
    ground_shear_N_per_mm3: Positive
    ground_conductance_W_per_m2_K: NotNegative
    patches: tuple[Patch, ...]
    lumps: tuple[Lump, ...]
    rods: tuple[Rod, ...]
    contacts: tuple[Contact, ...]
    sources: tuple[Source, ...]
    cooling: Cooling
    oil: Oil
    air: Air
    axes: tuple[TwinAxis, ...]
    nose: str
    spindle: str
    sensors: tuple[TwinSensor, ...]

    @model_validator(mode="after")
    def _references_exist(self) -> Description:
        bodies = {b.name for b in self.bodies}
        patches = {p.name for p in self.patches}
        rods = {r.name for r in self.rods}
        places = patches | rods | {lump.name for lump in self.lumps}
        known_axes = {a.name for a in self.axes}
        wanted: list[tuple[str, str, set[str]]] = []
        for b in self.bodies:
            wanted.append((f"body {b.name}", b.material, set(self.materials)))
        for p in self.patches:
            wanted.append((f"patch {p.name}", p.body, bodies))
        for r in self.rods:
            wanted += [(f"rod {r.name}", r.material, set(self.materials)), (f"rod {r.name}", r.patch, patches)]
        for c in self.contacts:
            wanted += [("a contact", c.a, places), ("a contact", c.b, places)]
        for s in self.sources:
            wanted += [(f"source {s.name}", target, places) for target in s.shares]
            if s.bearing is not None:
                wanted.append((f"source {s.name}", s.bearing.film, {lump.name for lump in self.lumps}))
            if s.axis is not None:
                wanted.append((f"source {s.name}", s.axis, known_axes))
        for a in self.axes:
            wanted += [(f"axis {a.name}", n, bodies) for n in (a.lower, a.upper)]
            wanted += [(f"axis {a.name}", n, patches) for n in (*a.lower_pads, *a.upper_pads)]
            wanted += [(f"axis {a.name}", n, patches) for n in (a.measuring.datum, a.measuring.head)]
            wanted.append((f"axis {a.name}", a.measuring.rod, rods))
        wanted += [(f"sensor {s.id}", s.place, places | bodies) for s in self.sensors]
        wanted += [("ground", g, patches) for g in self.ground]
        wanted += [("nose", self.nose, patches), ("spindle", self.spindle, rods)]
        wanted.append(("cooling", self.cooling.lump, {lump.name for lump in self.lumps}))
        for owner, name, known in wanted:
            if name not in known:
                raise ValueError(f"{owner} names {name!r}, which is not described; known are {sorted(known)}")
        for s in self.sources:
            if sum(s.shares.values()) > 1.0 + 1e-9:
                raise ValueError(f"source {s.name}: the shares add up to {sum(s.shares.values()):.3f}, more than one")
        return self

    def machine_axes(self) -> tuple[Axis, ...]:
        """The axes as machine.toml has them."""
        return tuple(Axis(**{name: getattr(a, name) for name in Axis.model_fields}) for a in self.axes)

    def machine_sensors(self) -> tuple[Sensor, ...]:
        """The sensors as machine.toml has them."""
        return tuple(
            Sensor(id=s.id, location=s.location, role=s.role, axis=s.axis, at_mm=s.at_mm) for s in self.sensors
        )

    def machine_heat_sources(self) -> tuple[HeatSource, ...]:
        """The heat sources as machine.toml has them."""
        return tuple(HeatSource(name=s.name, sensor=s.sensor, axis=s.axis) for s in self.sources)


def load_description(name_or_path: str | Path) -> Description:
    """Read a bundled machine ("tk6920") or a TOML file. Raises InputError with everything that is wrong in it."""
    return load_toml(Description, name_or_path, MACHINES)

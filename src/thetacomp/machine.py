"""The machine as its `machine.toml` describes it: axes, sensors, heat sources."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, field_validator, model_validator

from thetacomp.safe_names import checked_name, checked_text

SensorRole = Literal[
    "drive", "bearing", "guide", "structure", "fluid", "ambient", "foundation", "workpiece", "reference"
]
Direction = Literal["+X", "-X", "+Y", "-Y", "+Z", "-Z"]
FreeText = Annotated[str, AfterValidator(checked_text)]
Text = Annotated[str, AfterValidator(checked_name)]
Identifier = Annotated[Text, Field(min_length=1)]


class Strict(BaseModel):
    """Base of all file models: unknown keys are errors, values do not change after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Axis(Strict):
    """A linear axis. `direction` is the Cartesian machine direction (ISO 841) of positive travel."""

    name: Identifier
    direction: Direction
    travel_mm: tuple[float, float]
    feedback: Literal["scale", "screw"] = "scale"
    expansion_per_K: float | None = None
    sensor: str | None = None

    @field_validator("travel_mm")
    @classmethod
    def _travel_has_length(cls, value: tuple[float, float]) -> tuple[float, float]:
        if not value[1] > value[0]:
            raise ValueError(f"the end of the travel ({value[1]} mm) must be above its start ({value[0]} mm)")
        return value

    @property
    def cartesian(self) -> str:
        """The Cartesian letter X, Y or Z along which the axis moves."""
        return self.direction[1]

    @property
    def sign(self) -> int:
        """+1 where positive travel runs along the positive Cartesian direction, else -1."""
        return 1 if self.direction[0] == "+" else -1


class Sensor(Strict):
    """A temperature sensor. `axis` is absent where it belongs to no axis; `at_mm` is only used to draw it."""

    id: Identifier
    location: FreeText = ""
    role: SensorRole
    axis: str | None = None
    at_mm: tuple[float, float, float] | None = None


class HeatSource(Strict):
    """A source of heat. `sensor` names the sensor mounted nearest to it, where there is one."""

    name: Identifier
    sensor: str | None = None
    axis: str | None = None


class WantedLength(Strict):
    """Which length the machine is to produce; see docs/wanted_length.md.

    `true`: lengths are true metres, so a part is right if it is at 20 °C when cut. `workpiece`: lengths follow the
    workpiece, so a part cut warm or cold is right once it is at 20 °C. The workpiece expands by
    `workpiece_expansion_per_K` from `zero_mm` on each axis (default: P0 of the axis' error) with the temperature of
    `workpiece_sensor`, which is used only inside `workpiece_degC`.
    """

    wanted: Literal["true", "workpiece"] = "true"
    workpiece_expansion_per_K: Annotated[float, Field(gt=0.0, lt=1e-4)] | None = None
    workpiece_sensor: str | None = None
    workpiece_degC: tuple[float, float] = (5.0, 45.0)
    zero_mm: dict[str, float] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _complete(self) -> WantedLength:
        if self.wanted == "workpiece" and (self.workpiece_expansion_per_K is None or self.workpiece_sensor is None):
            raise ValueError(
                'wanted = "workpiece" needs workpiece_expansion_per_K (1/K, steel: 11.5e-6) and workpiece_sensor'
            )
        if not self.workpiece_degC[1] > self.workpiece_degC[0]:
            raise ValueError("workpiece_degC must be [lowest, highest]")
        return self


class Machine(Strict):
    """One machine. Names of axes and ids of sensors are unique; references between them exist."""

    name: Identifier
    axes: tuple[Axis, ...] = ()
    sensors: tuple[Sensor, ...]
    heat_sources: tuple[HeatSource, ...] = ()
    length: WantedLength = WantedLength()
    origin: str = ""

    @model_validator(mode="after")
    def _references_exist(self) -> Machine:
        axes = [axis.name for axis in self.axes]
        ids = [sensor.id for sensor in self.sensors]
        for label, names in (("axis", axes), ("sensor", ids)):
            twice = sorted({name for name in names if names.count(name) > 1})
            if twice:
                raise ValueError(f"{label} named twice: {', '.join(twice)}")
        for owner, sensor, axis in (
            *((f"axis {a.name}", a.sensor, None) for a in self.axes),
            *((f"sensor {s.id}", None, s.axis) for s in self.sensors),
            *((f"heat source {h.name}", h.sensor, h.axis) for h in self.heat_sources),
            ("length", self.length.workpiece_sensor, None),
            *(("length, zero_mm", None, name) for name in self.length.zero_mm),
        ):
            if sensor is not None and sensor not in ids:
                raise ValueError(f"{owner} names the sensor {sensor!r}, which is not in [[sensors]]")
            if axis is not None and axis not in axes:
                raise ValueError(f"{owner} names the axis {axis!r}, which is not in [[axes]]")
        return self

    @property
    def sensor_ids(self) -> tuple[str, ...]:
        """Ids of all sensors, in the order of the file."""
        return tuple(sensor.id for sensor in self.sensors)

    def axis(self, name: str) -> Axis:
        """The axis of that name; KeyError where there is none."""
        for axis in self.axes:
            if axis.name == name:
                return axis
        raise KeyError(name)

    def sensor(self, sensor_id: str) -> Sensor:
        """The sensor of that id; KeyError where there is none."""
        for sensor in self.sensors:
            if sensor.id == sensor_id:
                return sensor
        raise KeyError(sensor_id)

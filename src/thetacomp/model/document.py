"""`model.json`, format 2: the one document that passes from the analysis wing to the machine wing.

It holds one kind of law. A component of the error is `E = Σ_k u^k (constant_k + c_k · (x - x_ref))`, u = distance from
P0 in m, k = 0, 1, 2, x = the inputs that the law's layout makes of temperatures and speed.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from thetacomp.files import write_file
from thetacomp.machine import Axis, Strict, WantedLength
from thetacomp.model.band import Band
from thetacomp.model.border import Border
from thetacomp.model.filters import InputLayout
from thetacomp.model.leverage import Leverage

FORMAT: Literal[2] = 2


class Reference(Strict):
    """The moment at which the error counts as zero: all inputs of the layout there, filters and all."""

    campaign: str
    t_s: float
    inputs: tuple[float, ...]


class Term(Strict):
    """What one power of u carries: `constant + Σ coefficient_j (x_j - x_j,reference)`.

    One coefficient an input; none at all where no input predicts the error, which then stays at its constant. In µm,
    µm/m or µm/m² by the power (angles: µrad, µrad/m), the coefficients per unit of the input. `beyond` is the prior, a
    law on the plain rises of the layout's sensors (per K) that takes over outside the border; None where the law goes
    on as it is. `r_squared` is in-sample, None where it was not worked out.
    """

    constant: float = 0.0
    coefficients: tuple[float, ...]
    beyond: tuple[float, ...] | None = None
    r_squared: float | None = None


class Component(Strict):
    """One component of the error: `terms` by the power of u, one for drift, two for a line, three where it bends.

    `leverage` stands where the component was fitted on other states than the rest of its axis. `through_zero` says
    that the residuals count against the reference, where the error is zero by definition; the constants are then
    zero. `dof` and `states` belong to a regression. `residual_um` holds the RMS and the maximum of what remains over
    the travel on the training states (in-sample); `held_out_um` the RMS, 95th percentile and maximum on data that the
    same procedure had not seen, None where nothing could be held out.
    """

    direction: Literal["X", "Y", "Z"]
    terms: Annotated[tuple[Term, ...], Field(min_length=1, max_length=3)]
    band: Band
    leverage: Leverage | None = None
    through_zero: bool = True
    dof: Annotated[int, Field(ge=0)] | None = None
    states: Annotated[int, Field(ge=0)] | None = None
    residual_um: tuple[float, float]
    held_out_um: tuple[float, float, float] | None = None
    equation: str = ""

    @property
    def predicted(self) -> bool:
        """False where no input predicts the error: it stays at its constant."""
        return any(term.coefficients for term in self.terms)


class Accuracy(Strict):
    """Held-out RMS errors of one component in µm: with all sensors, without the lost one, without any compensation."""

    full_rms_um: float
    without_rms_um: float
    nothing_rms_um: float


class Fallback(Strict):
    """What changes in the law of an axis on the day on which the sensor `lost` is lost.

    `components` are made by the same procedure without it, on the inputs of `layout`. Leverage and border are those
    of the whole law, seen in the inputs that are left, where none are given. `accuracy` has one entry a component;
    its held-out errors come from the same procedure inside every fold.
    """

    lost: str
    layout: InputLayout
    reference: Reference
    components: dict[str, Component]
    accuracy: dict[str, Accuracy]
    leverage: Leverage | None = None
    border: Border | None = None


class AxisLaw(Strict):
    """The law of all errors while one axis moves (`axis` "": drift at a fixed position, without positions).

    `layout` says what the inputs are and in which order; its first inputs are the temperatures themselves.
    `leverage` measures how far inputs (from the reference) lie from training, for the bands. `candidates` counts the
    models that were compared inside the training campaigns.
    """

    axis: str
    p0_mm: float | None = None
    p_min_mm: float | None = None
    p_max_mm: float | None = None
    layout: InputLayout
    reference: Reference
    leverage: Leverage
    border: Border
    components: dict[str, Component]
    candidates: int | None = None
    fallbacks: tuple[Fallback, ...] = ()


class Training(Strict):
    """What the model was trained on."""

    campaigns: tuple[str, ...]
    mode: str
    instrument: str
    datum: Literal["campaign", "common"]


class ModelDocument(Strict):
    """A thermal model as it is stored, read and exported. Units are in the names; see docs/nomenclature.md.

    `control` holds by axis ("" for drift) the law on a few key temperatures, which any control can carry;
    `prediction` the law on heat history, which predictions use where an axis has one. `failed_checks` names the
    acceptance checks that the model in use failed, `failed_static_checks` those that `control` failed, where that is
    not what is in use: a user of one of them must see its own.

    `form`: in the "joint" form the components `DX`, `DY`, `DZ` hold the drift of all axes and every `E..` is zero at
    its P0, with the tool of `tool_length_mm`; `axes` then stand in the order from the workpiece to the tool. In the
    "separate" form every constant term holds the drift. `rotations` are thermal angles of the joint form by axis, in
    µrad and µrad/m instead of µm and µm/m: `EAX` about X while X moves, `DA` at fixed positions; their `direction` is
    the axis about which they turn.
    """

    kind: Literal["thetacomp model"] = "thetacomp model"
    format: Literal[2] = FORMAT
    version: str
    created: str
    machine: str
    axes: tuple[Axis, ...]
    length: WantedLength = WantedLength()
    sign: Literal["stated", "unproven"]
    method: str
    form: Literal["separate", "joint"] = "separate"
    tool_length_mm: float = 0.0
    control: dict[str, AxisLaw]
    prediction: dict[str, AxisLaw] = Field(default_factory=dict)
    rotations: dict[str, AxisLaw] = Field(default_factory=dict)
    training: Training
    failed_checks: tuple[str, ...] = ()
    failed_static_checks: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def in_use(self) -> dict[str, AxisLaw]:
        """By axis the law that answers for it: on heat history where there is one."""
        return {**self.control, **self.prediction}

    @property
    def components(self) -> dict[str, Component]:
        """The components that a control carries, of all axes."""
        return components_of(self.control)

    @property
    def trained(self) -> Border:
        """The box of everything that `control` and its fallbacks were trained on."""
        borders = [law.border for law in self.control.values()]
        borders += [f.border for law in self.control.values() for f in law.fallbacks if f.border is not None]
        return Border(
            {sensor: span for border in borders for sensor, span in border.temperature_degC.items()},
            {sensor: span for border in borders for sensor, span in border.rise_K.items()},
        )

    @property
    def failed_export_checks(self) -> tuple[str, ...]:
        """The acceptance checks that `control` failed: what stands in the way of handing it to a control."""
        return self.failed_static_checks if self.prediction else self.failed_checks

    def to_json(self) -> str:
        """The document as indented JSON text, rows of numbers on one line, non-ASCII letters kept readable."""
        return _indented(self.model_dump(mode="json")) + "\n"

    def save(self, path: Path) -> None:
        """Write the document as UTF-8 JSON, whole or not at all. Raises OutputError."""
        write_file(path, self.to_json())


def components_of(laws: Mapping[str, AxisLaw]) -> dict[str, Component]:
    """The components of several axes by name."""
    return {name: component for law in laws.values() for name, component in law.components.items()}


def _indented(value: object, indent: str = "") -> str:
    """JSON with one line an entry; a list of plain values stays on one line."""
    inner = indent + "  "
    if isinstance(value, dict) and value:
        entries = [f"{inner}{json.dumps(key, ensure_ascii=False)}: {_indented(v, inner)}" for key, v in value.items()]
        return "{\n" + ",\n".join(entries) + f"\n{indent}}}"
    if isinstance(value, list) and any(isinstance(item, dict | list) for item in value):
        return "[\n" + ",\n".join(inner + _indented(item, inner) for item in value) + f"\n{indent}]"
    return json.dumps(value, ensure_ascii=False)

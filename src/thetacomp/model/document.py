"""`model.json`: the one document that passes from the analysis wing to the machine wing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from thetacomp.errors import ModelFileError
from thetacomp.files import write_file
from thetacomp.machine import Axis, Strict, WantedLength
from thetacomp.model.band import Band
from thetacomp.model.border import Validity
from thetacomp.model.filters import HistoryLayout
from thetacomp.model.leverage import Reach

FORMAT = 1


class Reference(Strict):
    """The state at which the thermal error counts as zero: temperatures of the inputs at that moment."""

    campaign: str
    t_s: float
    temperature_degC: dict[str, float]


class LinearTerm(Strict):
    """`constant + Σ coefficient_j (θ_j - θ_j,reference)`, in the unit that the owner states.

    `covariance` is that of (constant, coefficients); `residual_sd` the standard deviation of the fit's residuals
    with `dof` degrees of freedom.
    """

    constant: float
    coefficients_per_K: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    residual_sd: Annotated[float, Field(ge=0.0)]
    r_squared: float


class Component(Strict):
    """Thermal part of one error component: `E = intercept + slope (p - p0_mm) / 1000`, in µm.

    `intercept` is in µm, `slope` in µm/m; `slope`, `axis` and the positions are absent for drift at a fixed position.
    `residual_correlation` is that between the residuals of intercept and slope; `residual_um` holds the RMS and the
    maximum of what remains over the travel on the training states (in-sample); `held_out_um` the RMS, 95th percentile
    and maximum on data that the same procedure had not seen, None where nothing could be held out. Both terms share
    `inputs` and `dof`. `through_zero` says that the fit was forced through zero at the reference, where the error is
    zero by definition; the constants are then exactly zero.
    """

    direction: Literal["X", "Y", "Z"]
    axis: str | None
    p0_mm: float | None
    p_min_mm: float | None
    p_max_mm: float | None
    reference: Reference
    inputs: tuple[str, ...]
    intercept: LinearTerm
    slope: LinearTerm | None
    residual_correlation: float
    through_zero: bool = False
    dof: Annotated[int, Field(ge=0)]
    states: int
    residual_um: tuple[float, float]
    held_out_um: tuple[float, float, float] | None = None
    equation: str


class Accuracy(Strict):
    """Held-out RMS errors of one component in µm: with all sensors, without the lost one, without any compensation."""

    full_rms_um: float
    without_rms_um: float
    nothing_rms_um: float


class Fallback(Strict):
    """Ready components for the day on which the sensor `lost` is lost: all those that use it, made without it.

    `accuracy` has one entry a component. The held-out errors come from the same procedure inside every fold.
    """

    lost: str
    components: dict[str, Component]
    accuracy: dict[str, Accuracy]


class HistoryReference(Strict):
    """The moment at which the error counts as zero: all inputs of the layout there, filters and all."""

    campaign: str
    t_s: float
    inputs: tuple[float, ...]


class HistoryComponent(Strict):
    """One error component on heat history: `E = Σ (intercept_j + slope_j u + bend_j u²) (x_j - x_j,reference)`.

    u = (p - p0_mm) / 1000. One coefficient an input of the layout: `intercept_um` in µm, `slope_um_per_m` in µm/m (None
    for drift), `bend_um_per_m2` in µm/m² (None for what stays a line) per unit of the input. `prior_*` is the law on
    the plain rises of the layout's sensors that takes over where the model is outside its border, per K. `band` is the
    95 % band of E; it holds the scatter `noise_sd_um` of one reading. `residual_um` and `held_out_um` as in Component.
    """

    direction: Literal["X", "Y", "Z"]
    intercept_um: tuple[float, ...]
    slope_um_per_m: tuple[float, ...] | None
    bend_um_per_m2: tuple[float, ...] | None = None
    prior_intercept_um_per_K: tuple[float, ...]
    prior_slope_um_per_m_per_K: tuple[float, ...] | None
    prior_bend_um_per_m2_per_K: tuple[float, ...] | None = None
    band: Band
    residual_um: tuple[float, float]
    held_out_um: tuple[float, float, float] | None = None
    noise_sd_um: float = 0.0


class HistoryFallback(Strict):
    """What changes in the model of an axis on the day on which the sensor `lost` is lost.

    `layout` is that of the other sensors, `reference_inputs` its inputs at the reference; `components` are fitted on
    it by the same procedure, their bands widened by what the loss costs. `accuracy` has one entry a component.
    """

    lost: str
    layout: HistoryLayout
    reference_inputs: tuple[float, ...]
    components: dict[str, HistoryComponent]
    accuracy: dict[str, Accuracy]


class HistoryAxis(Strict):
    """The model of one moving axis on heat history (`axis` None: drift at a fixed position).

    `layout` says what the inputs are and in which order; its first inputs are the temperatures themselves. `reach`
    measures how far inputs (from the reference) lie from training, for the bands; `validity` is the border in those
    inputs and, behind them, the absolute temperatures. `candidates` counts the block models that were compared inside
    the training campaigns.
    """

    axis: str | None
    p0_mm: float | None
    p_min_mm: float | None
    p_max_mm: float | None
    layout: HistoryLayout
    reference: HistoryReference
    reach: Reach
    validity: Validity
    components: dict[str, HistoryComponent]
    campaigns: int
    candidates: int
    fallbacks: tuple[HistoryFallback, ...] = ()


class Training(Strict):
    """What the model was trained on. `range_degC` is the span of each input, `range_rise_K` that of its rise."""

    campaigns: tuple[str, ...]
    mode: str
    instrument: str
    datum: Literal["campaign", "common"]
    range_degC: dict[str, tuple[float, float]]
    range_rise_K: dict[str, tuple[float, float]]


class ModelDocument(Strict):
    """A thermal model as it is stored, read and exported. Units are in the names; see docs/nomenclature.md.

    `components` are the laws on a few key temperatures, which any control can carry. `history` holds, by axis ("" for
    drift), the models on heat history; where an axis has one, it is what a prediction uses. `failed_checks` names the
    acceptance checks that the model in use failed, `failed_static_checks` those that `components` failed, where these
    are not what is in use: whoever uses one of them must see its own.

    `form`: in the "joint" form the components `DX`, `DY`, `DZ` hold the drift of all axes and every `E..` is zero at
    its P0, with the tool of `tool_length_mm`; `axes` then stand in the order from the workpiece to the tool. In the
    "separate" form every intercept holds the drift. `rotations` are thermal angles of the joint form, in µrad and
    µrad/m instead of µm and µm/m: `EAX` about X while X moves, `DA` at fixed positions; their `direction` is the axis
    about which they turn.
    """

    kind: Literal["thetacomp model"] = "thetacomp model"
    format: Literal[1] = 1
    version: str
    created: str
    machine: str
    axes: tuple[Axis, ...]
    sign: Literal["stated", "unproven"]
    method: str
    components: dict[str, Component]
    training: Training
    failed_checks: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    fallbacks: tuple[Fallback, ...] = ()
    history: dict[str, HistoryAxis] = Field(default_factory=dict)
    failed_static_checks: tuple[str, ...] = ()
    form: Literal["separate", "joint"] = "separate"
    length: WantedLength = WantedLength()
    tool_length_mm: float = 0.0
    rotations: dict[str, Component] = Field(default_factory=dict)

    @property
    def failed_export_checks(self) -> tuple[str, ...]:
        """The acceptance checks that `components` failed: what stands in the way of handing them to a control."""
        return self.failed_static_checks if self.history else self.failed_checks

    def to_json(self) -> str:
        """The document as indented JSON text, rows of numbers on one line, non-ASCII letters kept readable."""
        return _indented(self.model_dump(mode="json")) + "\n"

    def save(self, path: Path) -> None:
        """Write the document as UTF-8 JSON, whole or not at all. Raises OutputError."""
        write_file(path, self.to_json())


def _indented(value: object, indent: str = "") -> str:
    """JSON with one line an entry; a list of plain values stays on one line."""
    inner = indent + "  "
    if isinstance(value, dict) and value:
        entries = [f"{inner}{json.dumps(key, ensure_ascii=False)}: {_indented(v, inner)}" for key, v in value.items()]
        return "{\n" + ",\n".join(entries) + f"\n{indent}}}"
    if isinstance(value, list) and any(isinstance(item, dict | list) for item in value):
        return "[\n" + ",\n".join(inner + _indented(item, inner) for item in value) + f"\n{indent}]"
    return json.dumps(value, ensure_ascii=False)


def load_model(path: Path) -> ModelDocument:
    """Read a stored model. Raises ModelFileError with what was found, what was expected and what to do."""
    try:
        raw = json.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise ModelFileError(
            f"{path}: there is no such file. Fix: name the model.json that `thetacomp analyze` wrote."
        ) from None
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as exc:
        raise ModelFileError(f"{path}: not readable as JSON ({exc}). Fix: run `thetacomp analyze` again.") from None
    if not isinstance(raw, dict) or raw.get("kind") != "thetacomp model":
        raise ModelFileError(f"{path}: this JSON file is not a thetacomp model (no kind 'thetacomp model').")
    if raw.get("format") != FORMAT:
        raise ModelFileError(
            f"{path}: model format {raw.get('format')!r}; this version reads format {FORMAT}."
            " Fix: use the thetacomp version that wrote it, or run `thetacomp analyze` again."
        )
    try:
        return ModelDocument.model_validate(raw)
    except ValidationError as exc:
        first = exc.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise ModelFileError(
            f"{path}: {place}: {first['msg']} ({exc.error_count()} problems in all)."
            " Fix: do not edit model files by hand; run `thetacomp analyze` again."
        ) from None

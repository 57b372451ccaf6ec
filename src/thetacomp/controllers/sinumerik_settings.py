"""`export.toml` for SINUMERIK: what the model cannot know of the control, and whether it fits the model."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import Field

from thetacomp.errors import InputError, Problem
from thetacomp.machine import Strict
from thetacomp.model.document import ModelDocument

Sign = Literal[1, -1]
Cartesian = Literal["X", "Y", "Z"]
AXIS_NAME = r"^[A-Za-z_][A-Za-z0-9_]*$"
AxisName = Annotated[str, Field(pattern=AXIS_NAME)]


class ReplaySettings(Strict):
    """`[replay]` of `export.toml`: what the replay of measured campaigns assumes of writer and control.

    `update_s`: how often the writer brings new values; `entry_step_um`: what it rounds to, at the worst position;
    `largest_entry_um`: the largest value that an operator's or PLC's entry takes, at the worst position (default:
    none); `filter_cycles`, `filter_cycle_s`: a mean over the last n cycles on the way, as ISG and TwinCAT have it
    (default: none); `md32000_mm_per_min`: fastest velocity of the axes, from which MD32760 and MD32730 count.
    """

    update_s: Annotated[float, Field(ge=0.0)] = 60.0
    entry_step_um: Annotated[float, Field(ge=0.0)] = 0.1
    largest_entry_um: Annotated[float, Field(gt=0.0)] | None = None
    filter_cycles: Annotated[int, Field(ge=1, le=1000)] = 1
    filter_cycle_s: Annotated[float, Field(gt=0.0)] = 0.004
    md32000_mm_per_min: Annotated[float, Field(gt=0.0)] = 10000.0


class SinumerikSettings(Strict):
    """`export.toml` for SINUMERIK. Every default that leaves a question open is listed in the sheet.

    `sign_temperature`, `sign_cec`: +1 writes the error with its own sign; the sign test decides.
    `axis_name`: axis of the model -> channel axis of the control (default `X` -> `X1`); `axis_number`: its number n
    in `AXn` (default: place in the model). `output_axis`: direction -> axis that corrects all errors of that
    direction (default: the axis that moved, else the first axis along the direction). `drift_source`: direction ->
    the one component whose intercept becomes K0. `reference_degC`: temperatures at the moment of zero; the constant
    of the fit is then dropped (default: the reference stored in the model, constant kept). `reserve`: factor on
    the largest values of the training range, for table slopes and clamps. `rate_limit_um_per_s`: how fast the writer
    may move an axis. `md32720_cec_max_sum_mm`: default sized from the tables. `replay`: see ReplaySettings.
    """

    sign_temperature: Sign = 1
    sign_cec: Sign = 1
    axis_name: dict[str, AxisName] = Field(default_factory=dict)
    axis_number: dict[str, Annotated[int, Field(ge=1, le=31)]] = Field(default_factory=dict)
    output_axis: dict[Cartesian, str] = Field(default_factory=dict)
    drift_source: dict[Cartesian, str] = Field(default_factory=dict)
    reference_degC: dict[str, float] | None = None
    reserve: Annotated[float, Field(ge=1.0, le=10.0)] = 1.25
    first_cec_table: Annotated[int, Field(ge=0)] = 0
    rate_limit_um_per_s: Annotated[float, Field(gt=0.0)] = 1.0
    md32760_comp_add_velo_factor: Annotated[float, Field(gt=0.0, le=0.1)] = 0.01
    md32720_cec_max_sum_mm: Annotated[float, Field(gt=0.0)] | None = None
    md32730_cec_max_velo_factor: Annotated[float, Field(gt=0.0, le=1.0)] = 0.01
    replay: ReplaySettings = Field(default_factory=ReplaySettings)


def check_settings(model: ModelDocument, settings: SinumerikSettings, file: str) -> None:
    """Raise InputError with all settings of `file` that name what the model does not have."""
    axes, components = {axis.name: axis for axis in model.axes}, model.components
    found: list[tuple[str, str]] = []
    for key in ("axis_name", "axis_number"):
        for name in getattr(settings, key):
            if name not in axes:
                found.append((f"{key}.{name}: the model has no axis {name}.", f"its axes are {', '.join(axes)}."))
    for direction, name in settings.output_axis.items():
        if name not in axes or axes[name].cartesian != direction:
            along = [axis.name for axis in model.axes if axis.cartesian == direction]
            found.append(
                (f"output_axis.{direction} = {name!r}: not an axis along {direction}.", f"choose from {along}.")
            )
    for direction, name in settings.drift_source.items():
        if name not in components or components[name].direction != direction:
            known = [n for n, component in components.items() if component.direction == direction]
            found.append(
                (f"drift_source.{direction} = {name!r}: not an error in {direction}.", f"choose from {known}.")
            )
        elif model.form == "joint" and name[0] == "E":
            found.append(
                (
                    f"drift_source.{direction} = {name!r}: the model is in the joint form, its drift is D{direction}.",
                    "leave the setting out.",
                )
            )
        elif not components[name].predicted:
            found.append((f"drift_source.{direction} = {name!r}: no sensor predicts it.", "choose another error."))
    if settings.reference_degC is not None:
        inputs = {sensor for law in model.control.values() for sensor in law.layout.sensors}
        lacking, spare = sorted(inputs - set(settings.reference_degC)), sorted(set(settings.reference_degC) - inputs)
        if lacking or spare:
            text = f"reference_degC: missing {lacking or 'nothing'}, not an input of the model: {spare or 'nothing'}."
            found.append((text, f"give the temperature of each of {sorted(inputs)}."))
    for axis in model.axes:
        if axis.name not in settings.axis_name and not re.match(AXIS_NAME, f"{axis.name}1"):
            found.append(
                (
                    f"axis_name: the control cannot have an axis {axis.name}1 (Latin letters, digits and _ only).",
                    f'name its channel axis in export.toml: [axis_name] "{axis.name}" = "Y1".',
                )
            )
    for key, values in (
        ("axis_number", [str(settings.axis_number.get(a.name, i + 1)) for i, a in enumerate(model.axes)]),
        ("axis_name", [settings.axis_name.get(a.name, f"{a.name}1") for a in model.axes]),
    ):
        twice = sorted({value for value in values if values.count(value) > 1})
        if twice:
            found.append((f"{key}: {', '.join(twice)} stands for two axes.", f"set [{key}] for every axis."))
    _raise(found, file)


def check_sum(settings: SinumerikSettings, needed_mm: dict[str, float], file: str) -> None:
    """Raise InputError where the stated limit would clamp the sum `needed_mm` of the tables of an axis."""
    limit = settings.md32720_cec_max_sum_mm
    _raise(
        [
            (
                f"md32720_cec_max_sum_mm = {limit} mm, but the tables for axis {name} reach {value} mm;"
                " the control would clamp the sum.",
                f"set at least {value}, or leave the setting out.",
            )
            for name, value in needed_mm.items()
            if limit is not None and limit < value
        ],
        file,
    )


def _raise(found: list[tuple[str, str]], file: str) -> None:
    if found:
        raise InputError([Problem("error", "export-settings", file, message, fix) for message, fix in found])

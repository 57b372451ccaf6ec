"""`thetacomp predict`: the thermal error at given times and positions, from a stored model."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thetacomp.cli.common import JsonOption, Outcome, run

if TYPE_CHECKING:
    from thetacomp.model.document import ModelDocument
    from thetacomp.model.prediction import Breach, Prediction, Reference
    from thetacomp.model.temperatures import Duty, Temperatures
    from thetacomp.model.volumetric import VolumePrediction
    from thetacomp.reading.single_tables import Positions

EARLIEST_DATE_S = 1e8  # tables with dates count from 1970; no campaign runs for three years


def predict(
    model: Annotated[Path, typer.Argument(help="The model.json that `thetacomp analyze` wrote.")],
    temperatures: Annotated[Path, typer.Option(help="Table: t_s and one column a sensor, °C.")],
    positions: Annotated[
        Path, typer.Option(help="Table: t_s, axis, position_mm (axis empty: drift); or t_s and <axis>_mm of all axes.")
    ],
    out: Annotated[Path, typer.Option(help="Table to write, .csv or .xlsx.")],
    duty: Annotated[
        Path | None, typer.Option(help="Table: t_s, spindle_rpm; where the model was trained with the spindle speed.")
    ] = None,
    reference: Annotated[
        str, typer.Option(help="Moment of zero: first_row, model, or a time in s (ISO 8601 where the table has dates).")
    ] = "first_row",
    as_json: JsonOption = False,
) -> None:
    """Predict the thermal error, with 95 % bounds, from temperatures and positions."""
    run(lambda: _predict(model, temperatures, positions, duty, out, reference), as_json)


def _predict(
    model_path: Path, temperatures_path: Path, positions_path: Path, duty_path: Path | None, out: Path, reference: str
) -> Outcome:
    from thetacomp.outputs import output_table

    inputs = [model_path, temperatures_path, positions_path, *([duty_path] if duty_path is not None else [])]
    with output_table(out, inputs):
        _refuse_foreign(out)
        return _predicted(model_path, temperatures_path, positions_path, duty_path, out, reference)


def _refuse_foreign(out: Path) -> None:
    """Only an older prediction is replaced, and a file without content."""
    from thetacomp.errors import OutputError

    if not out.is_file() or not out.stat().st_size:
        return
    names = _column_names(out)
    if names[:1] != ["t_s"] or names[-1:] != ["in_domain"]:
        found = f"its columns are {', '.join(names[:3])}{', …' * (len(names) > 3)}" if any(names) else "no table"
        raise OutputError(out, f"it holds no prediction ({found}) and would be lost.", "name another file.")


def _column_names(path: Path) -> list[str]:
    """What stands in the header of a table, however it was saved again; empty where it cannot be read."""
    from thetacomp.reading.problems import UnreadableError
    from thetacomp.reading.sources import read_source

    if path.suffix.lower() == ".csv":
        with path.open("rb") as file:
            head = file.readline(10_000).decode(errors="replace")
        return ["".join(filter(str.isprintable, name)).strip(' "') for name in re.split("[,;\t]", head)]
    try:
        return [column.header for column in read_source(path, path.name).columns]
    except UnreadableError:
        return []


def _predicted(
    model_path: Path, temperatures_path: Path, positions_path: Path, duty_path: Path | None, out: Path, reference: str
) -> Outcome:
    from thetacomp.model.load import load_model
    from thetacomp.model.prediction import predict, write_prediction
    from thetacomp.reading import read_duty, read_positions, read_temperatures

    model = load_model(model_path)
    temperatures = read_temperatures(temperatures_path)
    positions = read_positions(positions_path)
    moment = _reference(reference, temperatures)
    duty = read_duty(duty_path) if duty_path is not None else None
    if positions.at_mm:
        return _predict_volume(model, temperatures, positions, duty, moment, out, _place(positions_path))
    prediction = predict(model, temperatures, positions, moment, _place(positions_path), duty)
    write_prediction(prediction, out)
    zero = _reference_text(moment, temperatures, model, prediction.axis)
    lines = ["  tool_length_mm was not used: it needs the positions of all axes, as columns <axis>_mm."]
    return _outcome(model, prediction, prediction.axis, out, zero, lines * (positions.tool_length_mm is not None))


def _predict_volume(
    model: ModelDocument,
    temperatures: Temperatures,
    positions: Positions,
    duty: Duty | None,
    moment: Reference,
    out: Path,
    place: Callable[[int], str],
) -> Outcome:
    """Positions of all axes at once: the joint form."""
    from thetacomp.model.volumetric import predict_volume, write_volume

    at_mm, length_mm = positions.at_mm, positions.tool_length_mm
    prediction = predict_volume(model, temperatures, positions.t_s, at_mm, length_mm, moment, place, duty)
    write_volume(prediction, out)
    zero = _reference_text(moment, temperatures, model, ("", *prediction.positions_mm))
    lines = [f"  No component {', '.join(prediction.absent)}: the values of these directions are empty."]
    lines = lines * bool(prediction.absent)
    if prediction.lost_angles:
        lines.append(
            f"  Without the angles {', '.join(prediction.lost_angles)}, whose sensors the table lacks: their effect"
            " over the arms of the axes is not included, and no row counts as inside the training."
        )
    if prediction.lean:
        lines.append(f"  Tool length, {model.tool_length_mm:g} mm in the measurements: {prediction.lean}.")
    return _outcome(model, prediction, ("", *prediction.positions_mm), out, zero, lines)


def _place(path: Path) -> Callable[[int], str]:
    """How a message names a row of the positions: the file and, where it is a plain table, the spreadsheet row."""

    def place(i: int) -> str:
        from thetacomp.reading.sources import read_source

        if path.suffix.lower() == ".xlsx":
            return f"{path.name}, data row {i + 1}"
        # Blank lines separate rows in the file: the file is read again, but only for a message.
        return f"{path.name}, row {int(read_source(path, path.name).rows[i])}"

    return place


def _reference(text: str, temperatures: Temperatures) -> Reference:
    """The moment of zero; a date and time on the clock of the reader: seconds since 1970-01-01, UTC without a zone."""
    from thetacomp.errors import AnalysisError

    if text == "first_row":
        return "first_row"
    if text == "model":
        return "model"
    try:
        return float(text)
    except ValueError:
        pass
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        raise AnalysisError(
            f"--reference {text}: expected first_row, model or a time in s, also where the tables count in min or h"
            " (ISO 8601 where they have dates)."
        ) from None
    if temperatures.t_s[-1] < EARLIEST_DATE_S:
        raise AnalysisError(
            f"--reference {text}: the temperature table counts seconds, not dates. Fix: give the reference in s."
        )
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _reference_text(reference: Reference, temperatures: Temperatures, model: ModelDocument, axes: Sequence[str]) -> str:
    """Where the thermal error counts as zero in this prediction, in words."""
    if reference == "model":
        zeros = [law.reference for axis, law in model.in_use.items() if axis in axes]
        moments = dict.fromkeys(f"campaign {zero.campaign} at {zero.t_s:.10g} s" for zero in zeros)
        return f"the model's own, {'; '.join(moments)}; the constants of the fit are kept"
    if reference == "first_row":
        return f"first row of the temperatures, {_moment(float(temperatures.t_s[0]))}; the error is zero there"
    return f"the temperatures at {_moment(float(reference))}; the error is zero there"


def _moment(t_s: float) -> str:
    if t_s < EARLIEST_DATE_S:
        return f"t = {t_s:.10g} s"
    return f"time = {datetime.fromtimestamp(t_s, UTC).replace(tzinfo=None).isoformat()}"


_UNITS = {
    "temperature": "°C",
    "rise": "K above the reference",
    "position": "mm",
    "distance": "(1: border of the training)",
}


def _rows(count: int) -> str:
    return f"{count} row{'s' * (count != 1)}"


def _breach_text(breach: Breach) -> str:
    low, high = breach.values
    what = {"position": "position of ", "rise": "rise of ", "distance": "distance from training, "}.get(breach.kind, "")
    return (
        f"    {what}{breach.name}: {_rows(breach.rows)} outside; values {low:.6g} … {high:.6g},"
        f" trained {breach.trained[0]:.6g} … {breach.trained[1]:.6g} {_UNITS[breach.kind]}"
    )


def _outcome(
    model: ModelDocument,
    prediction: Prediction | VolumePrediction,
    axes: Sequence[str],
    out: Path,
    reference: str,
    further: list[str],
) -> Outcome:
    """What a person wants to know of a prediction; `axes` were requested, `further` lines go in the middle."""
    import numpy as np

    from thetacomp.model.document import components_of

    rows = len(prediction.t_s)
    outside, missing = int((~prediction.in_domain).sum()), int(prediction.missing.sum())
    largest = {
        f"d{d}_um": float(np.nanmax(np.abs(column))) if np.isfinite(column).any() else None
        for d, column in zip("XYZ", prediction.error_um.T, strict=True)
    }
    asked = components_of({axis: law for axis, law in model.in_use.items() if axis in axes})
    unpredicted = [name for name, component in asked.items() if not component.predicted]
    history = sorted(axis or "drift" for axis in model.prediction if axis in axes)
    lines = [f"{_rows(rows)} written to {out}", f"  reference: {reference}"]
    for name, accuracy in prediction.replaced.items():
        cost = f": {accuracy.without_rms_um:.1f} instead of {accuracy.full_rms_um:.1f} µm RMS" if accuracy else ""
        lines.append(f"  {name}: the table lacks a sensor, the fallback was used{cost}")
    if history:
        lines.append(
            f"  heat history for {', '.join(history)}: the filters start at rest on the first row of the temperatures;"
            " begin the table when the machine has been at rest, or hours before the times wanted"
        )
    lines += [f"  largest |{name[:-3]}|: {value:.1f} µm" for name, value in largest.items() if value is not None]
    if outside:
        lines.append(f"  {_rows(outside)} outside what the model was trained on (in_domain = 0): no result to rely on.")
        lines += [_breach_text(breach) for breach in prediction.breaches]
    if missing:
        lines.append(f"  {_rows(missing)} without a temperature for an input: the values are empty.")
    if (np.isfinite(prediction.error_um) & ~np.isfinite(prediction.lower_um)).any():
        lines.append("  Some bounds are empty: the fit had no degree of freedom left for them.")
    if unpredicted:
        lines.append(f"  No sensor predicts {', '.join(unpredicted)}: they do not change with temperature here.")
    lines += further
    if model.sign == "unproven":
        lines.append("  SIGN UNPROVEN: the source of the model does not state its sign convention or axis directions.")
    if model.failed_checks:
        count = len(model.failed_checks)
        failed = f"{count} acceptance check{'s' * (count > 1)} failed: {'; '.join(model.failed_checks)}"
        lines.append(f"  NOT FIT FOR USE: {failed}")
    data = {
        "out": str(out),
        "rows": rows,
        "reference": reference,
        "outside_domain": outside,
        "breaches": [vars(breach) for breach in prediction.breaches],
        "missing_temperature": missing,
        "unpredicted": unpredicted,
        "heat_history": history,
        "fallbacks": sorted(prediction.replaced),
        "largest": largest,
        "sign": model.sign,
        "failed_checks": list(model.failed_checks),
    }
    return Outcome("\n".join(lines), data)

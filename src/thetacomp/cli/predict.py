"""`thetacomp predict`: the thermal error at given times and positions, from a stored model."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thetacomp.cli.common import JsonOption, Outcome, run

if TYPE_CHECKING:
    from thetacomp.campaign import Temperatures
    from thetacomp.models.document import ModelDocument
    from thetacomp.prediction import Breach, Prediction, Reference

EARLIEST_DATE_S = 1e8  # tables with dates count from 1970; no campaign runs for three years


def predict(
    model: Annotated[Path, typer.Argument(help="The model.json that `thetacomp analyze` wrote.")],
    temperatures: Annotated[Path, typer.Option(help="Table: t_s and one column a sensor, °C.")],
    positions: Annotated[Path, typer.Option(help="Table: t_s, axis, position_mm; axis empty for drift.")],
    out: Annotated[Path, typer.Option(help="CSV file to write.")],
    duty: Annotated[
        Path | None, typer.Option(help="Table: t_s, spindle_rpm; where the model was trained with the spindle speed.")
    ] = None,
    reference: Annotated[
        str, typer.Option(help="Moment of zero: first_row, model, or a time of the temperature table.")
    ] = "first_row",
    as_json: JsonOption = False,
) -> None:
    """Predict the thermal error, with 95 % bounds, from temperatures and positions."""
    run(lambda: _predict(model, temperatures, positions, duty, out, reference), as_json)


def _predict(
    model_path: Path, temperatures_path: Path, positions_path: Path, duty_path: Path | None, out: Path, reference: str
) -> Outcome:
    from thetacomp.errors import AnalysisError
    from thetacomp.models.document import load_model
    from thetacomp.prediction import predict, write_prediction
    from thetacomp.reading import read_duty, read_positions, read_temperatures

    model = load_model(model_path)
    temperatures = read_temperatures(temperatures_path)
    positions = read_positions(positions_path)
    if positions.at_mm:
        raise AnalysisError(
            f"{positions_path}: positions of several axes at once ({', '.join(f'{a}_mm' for a in positions.at_mm)})"
            " need the joint form, which this version does not have. Fix: give t_s, axis, position_mm."
        )
    moment = _reference(reference, temperatures)
    duty = read_duty(duty_path) if duty_path is not None else None
    prediction = predict(model, temperatures, positions, moment, _place(positions_path), duty)
    write_prediction(prediction, out)
    zero = _reference_text(moment, temperatures, model, prediction)
    return _outcome(model, prediction, out, zero, tool_length_given=positions.tool_length_mm is not None)


def _place(path: Path) -> Callable[[int], str]:
    """How a message names a row of the positions: the file and, where it is a plain table, the spreadsheet row."""

    def place(i: int) -> str:
        from thetacomp.reading.sources import read_source

        if path.suffix.lower() == ".xlsx":
            return f"{path.name}, data row {i + 1}"
        # Rows may be apart where the file has blank lines: the file is asked again, but only for a message.
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
            f"--reference {text}: expected first_row, model or a time of the temperature table"
            " (seconds, or ISO 8601 where the table has dates)."
        ) from None
    if temperatures.t_s[-1] < EARLIEST_DATE_S:
        raise AnalysisError(
            f"--reference {text}: the temperature table counts seconds, not dates. Fix: give the reference in s."
        )
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _reference_text(
    reference: Reference, temperatures: Temperatures, model: ModelDocument, prediction: Prediction
) -> str:
    """Where the thermal error counts as zero in this prediction, in words."""
    if reference == "model":
        asked = [c for c in model.components.values() if (c.axis or "") in prediction.axis]
        zeros = [
            model.history[c.axis or ""].reference if (c.axis or "") in model.history else c.reference for c in asked
        ]
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
    model: ModelDocument, prediction: Prediction, out: Path, reference: str, *, tool_length_given: bool
) -> Outcome:
    import numpy as np

    rows = len(prediction.t_s)
    outside, missing = int((~prediction.in_domain).sum()), int(prediction.missing.sum())
    largest = {
        f"d{d}_um": float(np.nanmax(np.abs(column))) if np.isfinite(column).any() else None
        for d, column in zip("XYZ", prediction.error_um.T, strict=True)
    }
    asked = {name: c for name, c in model.components.items() if (c.axis or "") in prediction.axis}
    unpredicted = [name for name, c in asked.items() if not c.inputs and (c.axis or "") not in model.history]
    history = sorted({c.axis or "drift" for c in asked.values() if (c.axis or "") in model.history})
    lines = [f"{_rows(rows)} written to {out}", f"  reference: {reference}"]
    if history:
        lines.append(
            f"  heat history for {', '.join(history)}: the filters start at rest on the first row of the temperatures;"
            " begin the table in a machine that has rested, or hours before the moments wanted"
        )
    lines += [f"  largest |{name[:-3]}|: {value:.1f} µm" for name, value in largest.items() if value is not None]
    if outside:
        lines.append(f"  {_rows(outside)} outside what the model was trained on (in_domain = 0): no result to rely on.")
        lines += [_breach_text(breach) for breach in prediction.breaches]
    if missing:
        lines.append(f"  {_rows(missing)} without a temperature for an input: the values are empty.")
    if (np.isfinite(prediction.error_um) & ~np.isfinite(prediction.lower_um)).any():
        lines.append("  Some bounds are empty: the fit had no degree of freedom left to tell them.")
    if unpredicted:
        lines.append(f"  No sensor predicts {', '.join(unpredicted)}: they do not change with temperature here.")
    if tool_length_given:
        lines.append("  tool_length_mm was not used: the model has no rotations.")
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
        "largest": largest,
        "sign": model.sign,
        "failed_checks": list(model.failed_checks),
    }
    return Outcome("\n".join(lines), data)

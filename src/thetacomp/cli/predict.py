"""`thetacomp predict`: the thermal error at given times and positions, from a stored model."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thetacomp.cli.common import JsonOption, Outcome, run

if TYPE_CHECKING:
    from thetacomp.campaign import Temperatures
    from thetacomp.models.document import ModelDocument
    from thetacomp.prediction import Prediction, Reference

EARLIEST_DATE_S = 1e8  # tables with dates count from 1970; no campaign runs for three years


def predict(
    model: Annotated[Path, typer.Argument(help="The model.json that `thetacomp analyze` wrote.")],
    temperatures: Annotated[Path, typer.Option(help="Table: t_s and one column a sensor, °C.")],
    positions: Annotated[Path, typer.Option(help="Table: t_s, axis, position_mm; axis empty for drift.")],
    out: Annotated[Path, typer.Option(help="CSV file to write.")],
    reference: Annotated[
        str, typer.Option(help="Moment of zero: first_row, model, or a time of the temperature table.")
    ] = "first_row",
    as_json: JsonOption = False,
) -> None:
    """Predict the thermal error, with 95 % bounds, from temperatures and positions."""
    run(lambda: _predict(model, temperatures, positions, out, reference), as_json)


def _predict(model_path: Path, temperatures_path: Path, positions_path: Path, out: Path, reference: str) -> Outcome:
    from thetacomp.errors import AnalysisError
    from thetacomp.models.document import load_model
    from thetacomp.prediction import predict, write_prediction
    from thetacomp.reading import read_positions, read_temperatures

    model = load_model(model_path)
    temperatures = read_temperatures(temperatures_path)
    positions = read_positions(positions_path)
    if positions.at_mm:
        raise AnalysisError(
            f"{positions_path}: positions of several axes at once ({', '.join(f'{a}_mm' for a in positions.at_mm)})"
            " need the joint form, which this version does not have. Fix: give t_s, axis, position_mm."
        )
    prediction = predict(model, temperatures, positions, _reference(reference, temperatures))
    write_prediction(prediction, out)
    return _outcome(model, prediction, out, tool_length_given=positions.tool_length_mm is not None)


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


def _outcome(model: ModelDocument, prediction: Prediction, out: Path, *, tool_length_given: bool) -> Outcome:
    import numpy as np

    rows = len(prediction.t_s)
    outside, missing = int((~prediction.in_domain).sum()), int(prediction.missing.sum())
    largest = {
        f"d{d}_um": float(np.nanmax(np.abs(column))) if np.isfinite(column).any() else None
        for d, column in zip("XYZ", prediction.error_um.T, strict=True)
    }
    lines = [f"{rows} rows written to {out}"]
    lines += [f"  largest |{name[:-3]}|: {value:.1f} µm" for name, value in largest.items() if value is not None]
    if outside:
        lines.append(f"  {outside} rows lie outside the training range (in_domain = 0): do not rely on them.")
    if missing:
        lines.append(f"  {missing} rows have no temperature for an input: their values are empty.")
    if (np.isfinite(prediction.error_um) & ~np.isfinite(prediction.lower_um)).any():
        lines.append("  Some bounds are empty: the fit had no degree of freedom left to tell them.")
    if tool_length_given:
        lines.append("  tool_length_mm was not used: the model has no rotations.")
    if model.sign == "unproven":
        lines.append("  SIGN UNPROVEN: the source of the model does not state its sign convention or axis directions.")
    data = {"out": str(out), "rows": rows, "outside_domain": outside, "missing_temperature": missing}
    return Outcome("\n".join(lines), {**data, "largest": largest, "sign": model.sign})

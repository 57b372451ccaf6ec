"""What validation found goes into the model document, so that nobody can use the model without seeing it."""

from __future__ import annotations

from collections.abc import Sequence

from thetacomp.model.document import AxisLaw, ModelDocument
from thetacomp.validation.outcome import DEFAULT, KEY_POINTS, ValidationRow
from thetacomp.validation.validate import ALL_CAMPAIGNS


def with_verdict(
    model: ModelDocument,
    rows: Sequence[ValidationRow],
    failed_checks: Sequence[str],
    failed_static_checks: Sequence[str],
    notes: Sequence[str],
) -> ModelDocument:
    """The document with what validation found: held-out figures of every component, and the checks that failed."""
    control = {
        axis: _judged(law, rows, KEY_POINTS if axis in model.prediction else DEFAULT)
        for axis, law in model.control.items()
    }
    prediction = {axis: _judged(law, rows, DEFAULT) for axis, law in model.prediction.items()}
    return model.model_copy(
        update={
            "control": control,
            "prediction": prediction,
            "failed_checks": tuple(failed_checks),
            "failed_static_checks": tuple(failed_static_checks),
            "notes": tuple(notes),
        }
    )


def _judged(law: AxisLaw, rows: Sequence[ValidationRow], judged: str) -> AxisLaw:
    components = {
        name: c.model_copy(update={"held_out_um": _held_out(rows, name, judged)}) for name, c in law.components.items()
    }
    return law.model_copy(update={"components": components})


def _held_out(rows: Sequence[ValidationRow], component: str, judged: str) -> tuple[float, float, float] | None:
    """RMS, 95th percentile and maximum of what a model leaves: over all campaigns where there are several."""
    own = [row for row in rows if row.component == component and row.model == judged]
    if not own:
        return None
    row = next((row for row in own if row.campaign == ALL_CAMPAIGNS), own[0])
    return row.rms_after_um, row.p95_after_um, row.max_after_um

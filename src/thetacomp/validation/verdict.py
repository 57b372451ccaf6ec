"""What validation found goes into the model document, so that nobody can use the model without seeing it."""

from __future__ import annotations

from collections.abc import Sequence

from thetacomp.models.document import ModelDocument
from thetacomp.validation.result import ValidationRow
from thetacomp.validation.validate import ALL_CAMPAIGNS


def with_verdict(
    model: ModelDocument, rows: Sequence[ValidationRow], failed_checks: Sequence[str], notes: Sequence[str]
) -> ModelDocument:
    """The document with what validation found: held-out figures of every component, and the checks that failed."""
    components = {
        name: component.model_copy(update={"held_out_um": _held_out(rows, name)})
        for name, component in model.components.items()
    }
    return model.model_copy(
        update={"components": components, "failed_checks": tuple(failed_checks), "notes": tuple(notes)}
    )


def _held_out(rows: Sequence[ValidationRow], component: str) -> tuple[float, float, float] | None:
    """RMS, 95th percentile and maximum of what the default model leaves: over all campaigns where there are several."""
    own = [row for row in rows if row.component == component and row.model == "default"]
    if not own:
        return None
    row = next((row for row in own if row.campaign == ALL_CAMPAIGNS), own[0])
    return row.rms_after_um, row.p95_after_um, row.max_after_um

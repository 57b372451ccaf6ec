"""One line of comparison.csv."""

from __future__ import annotations

from dataclasses import dataclass

COMPARISON_ONLY = "comparison only"
STORED = "stored in model.json"
BASELINE = "baseline"


@dataclass(frozen=True)
class ComparisonRow:
    """One family and component, held out with the folds of the validation and fitted on all for the in-sample figure.

    `component` may be `column_X` or `column_Z`. `inputs` says in words what the family may use. `configurations` is
    the number of settings that were compared inside the training campaigns (None: a search without a fixed list);
    `rows_per_campaign` the most rows of a campaign that train it (0: all). `fit_s` is the time of choosing and fitting
    once on all campaigns of the axis. `use` says what the family is for.
    """

    component: str
    campaign: str
    family: str
    use: str
    inputs: str
    configurations: int | None
    rows_per_campaign: int
    fit_s: float
    n: int
    max_before_um: float
    max_after_um: float
    p95_before_um: float
    p95_after_um: float
    rms_before_um: float
    rms_after_um: float
    rms_in_sample_um: float

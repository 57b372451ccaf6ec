"""What validation gives: before and after of every component with the baselines, and an acceptance table."""

from __future__ import annotations

from dataclasses import dataclass

from thetacomp.arrays import Floats

# What `ValidationRow.model` says.
NOTHING, DEFAULT, KEY_POINTS, CLOCK = "nothing", "default", "key_points", "clock"
ONE_SENSOR, ALL_SENSORS, TRAINING_MEAN = "one_sensor", "all_sensors", "training_mean"


@dataclass(frozen=True)
class ValidationRow:
    """One row of validation.csv: one component, one campaign, one model, held out.

    `component` may be `column_X` or `column_Z`, the column deviation. `split` is `campaign`, `state` or `forward`.
    `reduction_percent` compares the maxima. `rms_in_sample_um` is the residual RMS of the same model fitted on all
    data: the optimistic figure, shown next to the honest one. `coverage_percent` is the share of held-out points
    inside the model's 95 % interval; NaN where the model states none.
    """

    component: str
    campaign: str
    model: str
    split: str
    n: int
    max_before_um: float
    max_after_um: float
    p95_before_um: float
    p95_after_um: float
    rms_before_um: float
    rms_after_um: float
    reduction_percent: float
    coverage_percent: float
    rms_in_sample_um: float


@dataclass(frozen=True)
class HeldOutStates:
    """One component in one campaign: the largest |error| over the travel at each held-out state, all (n,), in µm."""

    component: str
    campaign: str
    t_s: Floats
    before_um: Floats
    after_um: Floats


@dataclass(frozen=True)
class PermutationTest:
    """R² of the whole choose-and-fit procedure against the same procedure on shuffled states."""

    axis: str
    r2: float
    r2_shuffled_median: float
    r2_shuffled_p95: float
    p_value: float
    shuffles: int


@dataclass(frozen=True)
class AcceptanceCheck:
    """One line of the acceptance table. `statistic` and `threshold` are in the unit that `name` states."""

    name: str
    statistic: float
    operator: str
    threshold: float
    passed: bool
    meaning: str

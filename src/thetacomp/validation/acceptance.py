"""Acceptance: a table of named checks that a model must pass before it may go to a machine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thetacomp.folds import NAMED_TEST
from thetacomp.model.document import AxisLaw, ModelDocument
from thetacomp.validation.outcome import (
    CLOCK,
    DEFAULT,
    KEY_POINTS,
    NOTHING,
    AcceptanceCheck,
    PermutationTest,
    ValidationRow,
)
from thetacomp.validation.validate import ALL_CAMPAIGNS, Residuals

MAX_RESIDUAL_RATIO = 0.5
# At 1.0 a model is as good as a clock, which proves nothing about the thermometer: it must be clearly better.
MAX_CLOCK_RATIO = 0.9
# Of the machine's largest RMS error: a quiet direction may lose a little to noise, nothing may lose much.
MAX_HARM_SHARE = 0.05
MAX_CHANCE = 0.05
MIN_STATES_PER_INPUT = 4.0
MIN_COVERAGE_PERCENT = 85.0
MIN_CAMPAIGNS = 2


def acceptance_checks(
    residuals: Sequence[Residuals],
    rows: Sequence[ValidationRow],
    permutations: Sequence[PermutationTest],
    model: ModelDocument,
) -> tuple[AcceptanceCheck, ...]:
    """All checks, axis by axis where they belong to an axis. A model is fit for use where every one is passed.

    `residuals` and `rows` are those held out by campaign, state or block; the forward split is not judged, since with
    few campaigns it repeats one of the folds.
    """
    checks: list[AcceptanceCheck] = []
    for axis in dict.fromkeys(_axis(r.component) for r in residuals):
        own = [r for r in residuals if _axis(r.component) == axis]
        label = f"axis {axis}" if axis else "drift"
        checks += _reductions(label, own)
        checks.append(_campaigns(label, own))
    checks += _no_harm(rows)
    for test in permutations:
        if test.axis in model.prediction:
            continue
        label = f"axis {test.axis}" if test.axis else "drift"
        checks.append(
            _at_most(
                f"{label}: chance of this in-sample R² when the states are shuffled",
                test.p_value,
                MAX_CHANCE,
                f"R² {test.r2:.3f}; {test.shuffles} shuffles reach {test.r2_shuffled_median:.3f} (median; 0 where no"
                " sensor was chosen)",
            )
        )
    checks += _never_tested(residuals, model)
    checks += _from_model(model)
    checks += _coverage(rows)
    return tuple(checks)


def acceptance_of_static_law(
    residuals: Sequence[Residuals],
    rows: Sequence[ValidationRow],
    permutations: Sequence[PermutationTest],
    model: ModelDocument,
) -> tuple[AcceptanceCheck, ...]:
    """The same checks for `model.control`: the law on key temperatures, which a control carries."""
    replaced = {r.component for r in residuals if r.model == KEY_POINTS}
    replaced |= {row.component for row in rows if row.model == KEY_POINTS}
    kept_residuals = [r for r in residuals if not (r.model == DEFAULT and r.component in replaced)]
    kept_rows = [r for r in rows if not (r.model == DEFAULT and r.component in replaced)]
    return acceptance_checks(
        [replace(r, model=DEFAULT) if r.model == KEY_POINTS else r for r in kept_residuals],
        [replace(r, model=DEFAULT) if r.model == KEY_POINTS else r for r in kept_rows],
        permutations,
        model.model_copy(update={"prediction": {}}),
    )


def fit_for_use(acceptance: Sequence[AcceptanceCheck]) -> bool:
    """True where every acceptance check is passed."""
    return all(check.passed for check in acceptance)


def in_words(check: AcceptanceCheck) -> str:
    """A check as one line: name, what was found, what is required."""
    return f"{check.name}: {check.statistic:.3g} (must be {check.operator} {check.threshold:g})"


def _reductions(label: str, own: Sequence[Residuals]) -> list[AcceptanceCheck]:
    before, after, clock = (_rms(own, name) for name in (NOTHING, DEFAULT, CLOCK))
    return [
        _at_most(
            f"{label}: residual RMS / uncompensated RMS, held out",
            after / before if before > 0 else float("nan"),
            MAX_RESIDUAL_RATIO,
            "the model removes at least half of the error on data it has not seen",
        ),
        _at_most(
            f"{label}: residual RMS / residual RMS of the clock, held out",
            after / clock if clock > 0 else float("nan"),
            MAX_CLOCK_RATIO,
            "the temperatures are clearly better than a clock; otherwise the model has learnt the warm-up curve",
        ),
    ]


def _campaigns(label: str, own: Sequence[Residuals]) -> AcceptanceCheck:
    """Enough campaigns that the model had not seen: where they are named for the test, others trained it."""
    count = float(len({int(c) for r in own for c in r.campaign}))
    if any(r.split == NAMED_TEST for r in own):
        return _at_least(
            f"{label}: campaigns for the test", count, 1.0, "at least one whole campaign was not trained on"
        )
    meaning = "one campaign cannot separate heat from time: at least two, with different duty, each held out whole"
    return _at_least(f"{label}: campaigns", count, MIN_CAMPAIGNS, meaning)


def _axis(component: str) -> str:
    return "" if component.startswith("D") else component[2:]


def _rms(residuals: Sequence[Residuals], model: str) -> float:
    """Residual RMS over the components of one axis; NaN where the model could not be fitted in the folds."""
    values = [r.after_um for r in residuals if r.model == model]
    return float(np.sqrt(np.mean(np.concatenate(values) ** 2))) if values else float("nan")


def _no_harm(rows: Sequence[ValidationRow]) -> list[AcceptanceCheck]:
    """The component and campaign that loses most, against the largest error of the machine."""
    own = [row for row in rows if row.model == DEFAULT and row.campaign != ALL_CAMPAIGNS]
    largest = max((row.rms_before_um for row in own), default=0.0)
    if not largest > 0:
        return []
    worst = max(own, key=lambda row: row.rms_after_um - row.rms_before_um)
    return [
        _at_most(
            "RMS added to the worst component and campaign / largest uncompensated RMS, held out",
            max(worst.rms_after_um - worst.rms_before_um, 0.0) / largest,
            MAX_HARM_SHARE,
            f"no component is made worse by much; the worst is {worst.component} in campaign {worst.campaign}"
            f" (RMS {worst.rms_before_um:.1f} to {worst.rms_after_um:.1f} µm, {worst.split} held out)",
        )
    ]


def _never_tested(residuals: Sequence[Residuals], model: ModelDocument) -> list[AcceptanceCheck]:
    """Components of the model that no held-out data judged, and axes for which no sensor was found."""
    tested = {r.component for r in residuals if r.model == DEFAULT and len(r.after_um)}
    untested = [name for name in model.components if name not in tested]
    dumb = [name for law in _key_point_laws(model) if not law.layout.sensors for name in law.components]
    return [
        _at_most(
            "components of the model without held-out data",
            float(len(untested)),
            0.0,
            f"every component was judged on unseen data{': not ' + ', '.join(untested) if untested else ''}",
        ),
        _at_most(
            "components of the model without any temperature",
            float(len(dumb)),
            0.0,
            f"a sensor was found for every component{': not for ' + ', '.join(dumb) if dumb else ''}",
        ),
    ]


def _key_point_laws(model: ModelDocument) -> list[AxisLaw]:
    """The laws on key temperatures that are what is in use."""
    return [law for axis, law in model.control.items() if axis not in model.prediction]


def _from_model(model: ModelDocument) -> list[AcceptanceCheck]:
    ratios = [
        (c.states or 0) / len(law.layout.sensors)
        for law in _key_point_laws(model)
        if law.layout.sensors
        for c in law.components.values()
    ]
    checks = []
    if ratios:
        checks.append(
            _at_least(
                "states per input, smallest over the components",
                min(ratios),
                MIN_STATES_PER_INPUT,
                "enough states for the number of temperatures in the equations",
            )
        )
    if model.sign == "unproven":
        checks.append(
            _at_least(
                "sign convention of the data stated (1) or unproven (0)",
                0.0,
                1.0,
                "a wrong sign doubles the error; measure a known displacement first",
            )
        )
    return checks


def _coverage(rows: Sequence[ValidationRow]) -> list[AcceptanceCheck]:
    """The component whose 95 % interval holds the fewest held-out points: a pooled figure would hide it."""
    stated = [row for row in rows if row.model == DEFAULT and np.isfinite(row.coverage_percent)]
    pooled = [row for row in stated if row.campaign == ALL_CAMPAIGNS] or stated
    if not pooled:
        return []
    worst = min(pooled, key=lambda row: row.coverage_percent)
    return [
        _at_least(
            "worst component: held-out points inside the 95 % interval, percent",
            worst.coverage_percent,
            MIN_COVERAGE_PERCENT,
            f"the stated uncertainty can be trusted; the worst is {worst.component} ({worst.split} held out)",
        )
    ]


def _at_most(name: str, statistic: float, threshold: float, meaning: str) -> AcceptanceCheck:
    # A statistic that cannot be computed is not a pass.
    return AcceptanceCheck(name, statistic, "<=", threshold, bool(statistic <= threshold), meaning)


def _at_least(name: str, statistic: float, threshold: float, meaning: str) -> AcceptanceCheck:
    return AcceptanceCheck(name, statistic, ">=", threshold, bool(statistic >= threshold), meaning)

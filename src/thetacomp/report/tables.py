"""Tables and words of the report page, made from an `AnalysisResult`: no HTML here, no drawing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from thetacomp.analysis_result import AnalysisResult
from thetacomp.axis_states import LINE_POSITIONS
from thetacomp.campaign import Campaign
from thetacomp.model.document import Component, ModelDocument
from thetacomp.model.law import ComponentLaw, component_laws
from thetacomp.report import style
from thetacomp.report.predicted_states import explains
from thetacomp.sensors.key_points import AxisKeyPoints
from thetacomp.separation.component import ComponentSeparation
from thetacomp.validation.outcome import ValidationRow
from thetacomp.validation.validate import ALL_CAMPAIGNS, pooled

NOT_AVAILABLE = "–"
NOTHING_CHOSEN = "only sensor with readings: nothing was chosen"
_MOST_STATES = 24
_MODEL_ORDER = ("default", "key_points", "clock", "one_sensor", "all_sensors", "training_mean", "nothing")


def number(value: float | None, digits: int = 1) -> str:
    """A number with fixed digits; a dash where there is none; never "-0.0"."""
    if value is None or not math.isfinite(value):
        return NOT_AVAILABLE
    text = f"{value:.{digits}f}"
    return text[1:] if text.startswith("-") and float(text) == 0.0 else text


def significant(value: float) -> str:
    """A number of unknown unit with three significant digits."""
    if not math.isfinite(value):
        return NOT_AVAILABLE
    size = abs(value)
    if size and (size < 1e-3 or size >= 1e5):
        return f"{value:.2e}"
    digits = 1 if size >= 100.0 else 2 if size >= 10.0 else 3
    text = number(value, digits)
    return text.rstrip("0").rstrip(".") if "." in text else text


@dataclass(frozen=True)
class Verdict:
    """Fit for use or not, in words. `level` is `good`, `bad` or `open`."""

    level: str
    text: str
    detail: str


@dataclass(frozen=True)
class KeyPoint:
    """One key point of an axis with its place and the reason that speaks most to a user."""

    axis: str
    sensor: str
    location: str
    reason: str


@dataclass(frozen=True)
class Headline:
    """Held-out figures of one component, with the residual maximum of the clock (NaN: none)."""

    name: str
    row: ValidationRow
    clock_max_um: float


@dataclass(frozen=True)
class ValidationLine:
    """One line of the table: the names of its models, their row, `states` and `points` (None: not stated).

    `remark` is shown instead of the figures where they are those of the default model.
    """

    name: str
    row: ValidationRow
    states: int | None
    points: int | None
    remark: str = ""


@dataclass(frozen=True)
class ValidationGroup:
    """Lines of one component and campaign, the model first, then the baselines."""

    component: str
    campaign: str
    lines: tuple[ValidationLine, ...]


@dataclass(frozen=True)
class ValidationTable:
    """One kind of hold-out. `folded` tables hold single campaigns behind the table over all of them."""

    title: str
    groups: tuple[ValidationGroup, ...]
    folded: bool


@dataclass(frozen=True)
class Equation:
    """One component of a model in print: equation, and R² in-sample of intercept and slope, or why there is none."""

    text: str
    part: Component
    intercept: str
    slope: str
    remark: str


@dataclass(frozen=True)
class StateTable:
    """Slope and intercept of one component at its states; `skipped` says how many rows were left out."""

    part: ComponentSeparation
    states: tuple[int, ...]
    skipped: int


@dataclass(frozen=True)
class CampaignLine:
    """What one campaign holds, in words."""

    campaign: Campaign
    hours: float
    content: str
    conditions: str


def verdict(analysis: AnalysisResult) -> Verdict:
    """Whether every acceptance check passed."""
    checks = analysis.acceptance
    failed = [check for check in checks if not check.passed]
    if not checks:
        return Verdict("open", "Fitness for use was not checked", "No acceptance check could be made with these data.")
    if failed:
        count = f"{len(failed)} of {len(checks)} checks failed"
        return Verdict("bad", "Not fit for use", f"{count}: {'; '.join(check.name for check in failed)}.")
    passed = f"All {len(checks)} checks passed."
    if analysis.model.sign == "unproven":
        return Verdict("open", "Fit for use only after its sign is proven on the machine", passed)
    return Verdict("good", "Fit for use", passed)


def component_name(component: str) -> str:
    """A component as the report names it."""
    return f"column deviation {component[7:]}" if component.startswith("column_") else component


def main_split(analysis: AnalysisResult) -> str:
    """The hold-out that the summary quotes: by campaign, else by state, else what there is."""
    splits = list(dict.fromkeys(row.split for row in analysis.validation))
    return next((s for s in ("test", "campaign", "state") if s in splits), splits[0] if splits else "")


def split_words(split: str) -> str:
    """A kind of hold-out in words."""
    return {
        "campaign": "each campaign held out in turn",
        "state": "each state held out in turn",
        "forward": "trained on the first half, tested on the second",
        "test": "tested on the campaigns named as test",
    }.get(split, f"hold-out '{split}'")


def headlines(analysis: AnalysisResult) -> list[Headline]:
    """Column deviations where they exist, else the three largest components."""
    rows = pooled([r for r in analysis.validation if r.split == main_split(analysis)])
    found = [r for r in rows if r.model == "default" and math.isfinite(r.max_before_um)]
    columns = [r for r in found if r.component.startswith("column_")]
    clock = {(r.component, r.campaign): r.max_after_um for r in rows if r.model == "clock"}
    ordered = sorted(columns or found, key=lambda r: -r.max_before_um)[:3]
    return [
        Headline(component_name(r.component), r, clock.get((r.component, r.campaign), float("nan"))) for r in ordered
    ]


def key_points(analysis: AnalysisResult) -> list[KeyPoint]:
    """Key points of every axis with the reasons for them."""
    machine = analysis.folder.machine
    found = []
    for points in analysis.key_points:
        for sensor in points.key_points:
            location = machine.sensor(sensor).location if sensor in machine.sensor_ids else ""
            only = nothing_was_chosen(analysis, points)
            reason = NOTHING_CHOSEN if only else _reason(points, sensor)
            found.append(KeyPoint(axis_name(points), sensor, location, reason))
    return found


def axis_name(points: AxisKeyPoints) -> str:
    """The moving axis of a set of key points in words."""
    return f"axis {points.axis}" if points.axis else "drift"


def _reason(points: AxisKeyPoints, sensor: str) -> str:
    """What the search for the fewest sensors says, for it speaks of held-out µm; else the last strategy."""
    said = {
        table.strategy: v.reason for table in points.tables for v in table.decisions if v.sensor == sensor and v.stays
    }
    return said.get("fewest sensors", list(said.values())[-1] if said else points.method)


def sentence(text: str) -> str:
    """The text with a capital first letter, the rest as it is."""
    return text[:1].upper() + text[1:]


def counted(number: int, noun: str, plural: str = "") -> str:
    """A number with its noun: `1 axis`, `2 axes`."""
    return f"{number} {noun if number == 1 else plural or noun + 's'}"


def sensors_with_readings(analysis: AnalysisResult, parts: Sequence[ComponentSeparation]) -> int:
    """Number of sensors that have readings in every campaign of these separations."""
    known = [set(analysis.folder.campaign(s.campaign).temperatures.sensor_ids) for s in parts]
    return len(set.intersection(*known)) if known else 0


def nothing_was_chosen(analysis: AnalysisResult, points: AxisKeyPoints) -> bool:
    """Whether the key point of an axis is the only sensor that has readings."""
    mine = [s for s in analysis.separations if (s.axis or "") == points.axis]
    return bool(points.key_points) and sensors_with_readings(analysis, mine) == 1


def equations(analysis: AnalysisResult, document: ModelDocument) -> list[Equation]:
    """The equations of a model with what each of its two terms explains in-sample."""
    found = []
    for name, law in component_laws(document.control).items():
        part = law.component
        remark = "" if law.inputs else f"{name}: no sensor predicts this component; nothing is compensated."
        slope = _explained(law, 1) if len(part.terms) > 1 else NOT_AVAILABLE
        found.append(Equation(part.equation, part, _explained(law, 0), slope, remark))
    return found


def _explained(law: ComponentLaw, power: int) -> str:
    term = law.component.terms[power]
    if not any(term.coefficients) or term.r_squared is None:
        return NOT_AVAILABLE
    return number(term.r_squared, 2) if explains(law, power) else "not explained"


def validation_tables(analysis: AnalysisResult) -> list[ValidationTable]:
    """For each kind of hold-out one table; where there are several campaigns, each of them folded behind it."""
    tables = []
    for split in dict.fromkeys(row.split for row in analysis.validation):
        rows = [row for row in analysis.validation if row.split == split]
        title = sentence(split_words(split))
        main = pooled(rows)
        tables.append(ValidationTable(title, _groups(analysis, main), False))
        apart = [row for row in rows if row not in main]
        for campaign in dict.fromkeys(row.campaign for row in apart):
            own = [row for row in apart if row.campaign == campaign]
            tables.append(ValidationTable(f"{title}: campaign {campaign}", _groups(analysis, own), True))
    return tables


def _groups(analysis: AnalysisResult, rows: Sequence[ValidationRow]) -> tuple[ValidationGroup, ...]:
    return tuple(_group(analysis, rows, *key) for key in dict.fromkeys((r.component, r.campaign) for r in rows))


def _group(analysis: AnalysisResult, rows: Sequence[ValidationRow], component: str, campaign: str) -> ValidationGroup:
    mine = [r for r in rows if r.component == component and r.campaign == campaign]
    rank = {model: k for k, model in enumerate(_MODEL_ORDER)}
    mine.sort(key=lambda r: rank.get(r.model, 1.5))
    default = next((r for r in mine if r.model == "default"), None)
    same = [r for r in mine if default is not None and r is not default and _same_figures(r, default)]
    lines = [_line(analysis, style.MODEL_NAMES.get(r.model, r.model), r) for r in mine if r not in same]
    if same:
        names = ", ".join(style.MODEL_NAMES.get(r.model, r.model) for r in same)
        parts = [s for s in analysis.separations if _belongs(analysis, s, component)]
        only = sensors_with_readings(analysis, parts) == 1
        why = "only one sensor has readings" if only else "they use the same inputs"
        lines.insert(1, _line(analysis, names, same[0], f"same as default: {why}"))
    label = "all campaigns" if campaign == ALL_CAMPAIGNS else campaign
    return ValidationGroup(component_name(component), label, tuple(lines))


def _same_figures(one: ValidationRow, other: ValidationRow) -> bool:
    fields = ("max_after_um", "p95_after_um", "rms_after_um", "rms_in_sample_um")
    return one.model != "nothing" and all(
        math.isclose(getattr(one, f), getattr(other, f), rel_tol=1e-9) for f in fields
    )


def _belongs(analysis: AnalysisResult, part: ComponentSeparation, component: str) -> bool:
    """Whether a separation stands behind a component, or behind the column deviation of its direction."""
    if not component.startswith("column_"):
        return part.component == component
    vertical = [axis.name for axis in analysis.folder.machine.axes if axis.direction.endswith("Y")]
    return part.axis in vertical and part.direction == component.removeprefix("column_")


def _line(analysis: AnalysisResult, name: str, row: ValidationRow, remark: str = "") -> ValidationLine:
    """States and points of a row: already separated lines and drift have states alone, no measured points."""
    parts = [s for s in analysis.separations if s.component == row.component]
    if row.component.startswith("column_") or all(s.axis is None for s in parts):
        return ValidationLine(name, row, row.n, None, remark)
    if all(s.points is None for s in parts):
        return ValidationLine(name, row, row.n // LINE_POSITIONS, None, remark)
    states = [
        len(item.t_s)
        for item in analysis.held_out
        if item.component == row.component and row.campaign in (item.campaign, ALL_CAMPAIGNS)
    ]
    known = states and row.split == main_split(analysis)
    return ValidationLine(name, row, sum(states) if known else None, row.n, remark)


def date_words(created: str) -> str:
    """The date of a model as people read it; the text itself where it is no ISO 8601 time."""
    try:
        moment = datetime.fromisoformat(created)
    except ValueError:
        return created
    return f"{moment:%Y-%m-%d %H:%M} {moment.tzname() or ''}".strip()


def state_tables(analysis: AnalysisResult) -> list[StateTable]:
    """Slopes and intercepts of all components; long records are thinned evenly."""
    tables = []
    for part in analysis.separations:
        n = len(part.t_s)
        shown = (
            tuple(range(n)) if n <= _MOST_STATES else tuple(np.linspace(0, n - 1, _MOST_STATES).astype(int).tolist())
        )
        tables.append(StateTable(part, shown, n - len(shown)))
    return tables


def campaign_lines(analysis: AnalysisResult) -> list[CampaignLine]:
    """What was analysed, campaign by campaign."""
    lines = []
    for campaign in analysis.folder.campaigns:
        settings = campaign.settings
        t_s = campaign.temperatures.t_s
        hours = float(t_s[-1] - t_s[0]) / style.HOUR_S if len(t_s) else 0.0
        active = f", active tables: {', '.join(settings.active_tables)}" if settings.active_tables else ""
        conditions = [
            settings.instrument,
            f"mode {settings.mode}" if settings.mode else "",
            f"compensation {settings.compensation}{active}",
            f"datum {settings.datum}",
            "sign unproven" if settings.sign == "unproven" else "",
        ]
        lines.append(CampaignLine(campaign, hours, _content(analysis, campaign), "; ".join(c for c in conditions if c)))
    return lines


def _content(analysis: AnalysisResult, campaign: Campaign) -> str:
    sensors = len(campaign.temperatures.sensor_ids)
    rows = len(campaign.temperatures.t_s)
    content = [f"{counted(sensors, 'sensor')}, {counted(rows, 'temperature row')}"]
    if campaign.sweeps is not None:
        sweeps = campaign.sweeps
        content.append(f"{counted(len(np.unique(sweeps.sweep)), 'sweep')}, {counted(len(sweeps.t_s), 'point')}")
    if campaign.drift is not None:
        content.append(counted(len(campaign.drift.t_s), "drift row"))
    if campaign.parameters is not None:
        content.append("slopes and intercepts as given")
    mine = [s for s in analysis.separations if s.campaign == campaign.name]
    axes = list(dict.fromkeys(s.axis for s in mine if s.axis is not None))
    if axes:
        content.append(f"moving {'axis' if len(axes) == 1 else 'axes'} {', '.join(axes)}")
    return "; ".join(content)

"""Tables and words of the report page, made from an `Analysis`: no HTML here, no drawing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from thetacomp.analysis_result import Analysis
from thetacomp.campaign import Campaign
from thetacomp.keypoints.result import AxisKeyPoints
from thetacomp.report import style
from thetacomp.separation.result import ComponentSeparation
from thetacomp.validation.result import ValidationRow

NOT_AVAILABLE = "–"
_MOST_STATES = 24
POOLED = "all"  # the campaign name of rows over all campaigns
_MODEL_ORDER = ("default", "clock", "one_sensor", "all_sensors", "training_mean", "nothing")


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
    """Held-out figures of one component, with the residual maximum of the clock beside them (NaN: none)."""

    name: str
    row: ValidationRow
    clock_max_um: float


@dataclass(frozen=True)
class ValidationGroup:
    """Rows of one component and campaign, the model first, then the baselines."""

    component: str
    campaign: str
    rows: tuple[tuple[str, ValidationRow], ...]


@dataclass(frozen=True)
class ValidationTable:
    """One kind of hold-out. `folded` tables hold single campaigns behind the table over all of them."""

    title: str
    groups: tuple[ValidationGroup, ...]
    folded: bool


@dataclass(frozen=True)
class StateTable:
    """Slope and intercept of one component at its states; `skipped` tells how many rows a long record left out."""

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


def verdict(analysis: Analysis) -> Verdict:
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


def main_split(analysis: Analysis) -> str:
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


def headlines(analysis: Analysis) -> list[Headline]:
    """Column deviations where they exist, else the three largest components."""
    rows = pooled([r for r in analysis.validation if r.split == main_split(analysis)])
    found = [r for r in rows if r.model == "default" and math.isfinite(r.max_before_um)]
    columns = [r for r in found if r.component.startswith("column_")]
    clock = {(r.component, r.campaign): r.max_after_um for r in rows if r.model == "clock"}
    ordered = sorted(columns or found, key=lambda r: -r.max_before_um)[:3]
    return [
        Headline(component_name(r.component), r, clock.get((r.component, r.campaign), float("nan"))) for r in ordered
    ]


def pooled(rows: Sequence[ValidationRow]) -> list[ValidationRow]:
    """Of each component the rows over all campaigns, or those of its campaigns where there are none."""
    over_all = {r.component for r in rows if r.campaign == POOLED}
    return [r for r in rows if r.campaign == POOLED or r.component not in over_all]


def key_points(analysis: Analysis) -> list[KeyPoint]:
    """Key points of every axis with the reasons for them."""
    machine = analysis.folder.machine
    found = []
    for points in analysis.key_points:
        for sensor in points.key_points:
            location = machine.sensor(sensor).location if sensor in machine.sensor_ids else ""
            found.append(KeyPoint(axis_name(points), sensor, location, _reason(points, sensor)))
    return found


def axis_name(points: AxisKeyPoints) -> str:
    """The moving axis of a set of key points in words."""
    return f"axis {points.axis}" if points.axis else "drift"


def _reason(points: AxisKeyPoints, sensor: str) -> str:
    """What the search for the fewest sensors says, for it speaks of held-out µm; else the last strategy."""
    said = {
        table.strategy: v.reason for table in points.tables for v in table.verdicts if v.sensor == sensor and v.stays
    }
    return said.get("fewest sensors", list(said.values())[-1] if said else points.method)


def sentence(text: str) -> str:
    """The text with a capital first letter, the rest as it is."""
    return text[:1].upper() + text[1:]


def validation_tables(analysis: Analysis) -> list[ValidationTable]:
    """For each kind of hold-out one table; where there are several campaigns, each of them folded behind it."""
    tables = []
    for split in dict.fromkeys(row.split for row in analysis.validation):
        rows = [row for row in analysis.validation if row.split == split]
        title = sentence(split_words(split))
        main = pooled(rows)
        tables.append(ValidationTable(title, _groups(main), False))
        apart = [row for row in rows if row not in main]
        for campaign in dict.fromkeys(row.campaign for row in apart):
            own = [row for row in apart if row.campaign == campaign]
            tables.append(ValidationTable(f"{title}: campaign {campaign}", _groups(own), True))
    return tables


def _groups(rows: Sequence[ValidationRow]) -> tuple[ValidationGroup, ...]:
    return tuple(_group(rows, *key) for key in dict.fromkeys((r.component, r.campaign) for r in rows))


def _group(rows: Sequence[ValidationRow], component: str, campaign: str) -> ValidationGroup:
    mine = [r for r in rows if r.component == component and r.campaign == campaign]
    rank = {model: k for k, model in enumerate(_MODEL_ORDER)}
    mine.sort(key=lambda r: rank.get(r.model, 1.5))
    named = tuple((style.MODEL_NAMES.get(r.model, r.model), r) for r in mine)
    return ValidationGroup(component_name(component), "all campaigns" if campaign == POOLED else campaign, named)


def date_words(created: str) -> str:
    """The date of a model as people read it; the text itself where it is no ISO 8601 time."""
    try:
        moment = datetime.fromisoformat(created)
    except ValueError:
        return created
    return f"{moment:%Y-%m-%d %H:%M} {moment.tzname() or ''}".strip()


def state_tables(analysis: Analysis) -> list[StateTable]:
    """Slopes and intercepts of all components; long records are thinned evenly."""
    tables = []
    for part in analysis.separations:
        n = len(part.t_s)
        shown = (
            tuple(range(n)) if n <= _MOST_STATES else tuple(np.linspace(0, n - 1, _MOST_STATES).astype(int).tolist())
        )
        tables.append(StateTable(part, shown, n - len(shown)))
    return tables


def campaign_lines(analysis: Analysis) -> list[CampaignLine]:
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


def _content(analysis: Analysis, campaign: Campaign) -> str:
    sensors = len(campaign.temperatures.sensor_ids)
    content = [f"{sensors} sensor{'s' if sensors != 1 else ''}, {len(campaign.temperatures.t_s)} temperature rows"]
    if campaign.sweeps is not None:
        sweeps = campaign.sweeps
        content.append(f"{len(np.unique(sweeps.sweep))} sweeps, {len(sweeps.t_s)} points")
    if campaign.drift is not None:
        content.append(f"{len(campaign.drift.t_s)} drift rows")
    if campaign.parameters is not None:
        content.append("slopes and intercepts as given")
    mine = [s for s in analysis.separations if s.campaign == campaign.name]
    axes = list(dict.fromkeys(s.axis for s in mine if s.axis is not None))
    if axes:
        content.append(f"moving axes {', '.join(axes)}")
    return "; ".join(content)

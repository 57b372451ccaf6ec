"""The table of model families in the report, component by component."""

from __future__ import annotations

from dataclasses import dataclass

from thetacomp.analysis_result import AnalysisResult
from thetacomp.report import style
from thetacomp.report.tables import component_name
from thetacomp.validation.families.comparison_row import ComparisonRow
from thetacomp.validation.validate import ALL_CAMPAIGNS


@dataclass(frozen=True)
class ComparisonGroup:
    """All families of one component: name, held-out campaigns in words, rows, and the least RMS among them."""

    name: str
    campaign: str
    rows: tuple[ComparisonRow, ...]
    least_rms_um: float


def comparison_groups(analysis: AnalysisResult) -> list[ComparisonGroup]:
    """Column deviations first, then the components in the order of the axes; nothing where none were compared."""
    keys = list(dict.fromkeys((row.component, row.campaign) for row in analysis.comparison))
    keys.sort(key=lambda key: not key[0].startswith("column_"))
    groups = []
    for component, campaign in keys:
        rows = tuple(r for r in analysis.comparison if (r.component, r.campaign) == (component, campaign))
        label = "all campaigns" if campaign == ALL_CAMPAIGNS else campaign
        least = min(row.rms_after_um for row in rows)
        groups.append(ComparisonGroup(component_name(component), label, rows, least))
    return groups


def family_name(row: ComparisonRow) -> str:
    """A family as the report names it."""
    return style.MODEL_NAMES.get(row.family, row.family)


def thinning(analysis: AnalysisResult) -> list[tuple[int, list[str]]]:
    """The most training rows of a campaign, and the families that it holds for."""
    most: dict[int, list[str]] = {}
    for row in analysis.comparison:
        names = most.setdefault(row.rows_per_campaign, [])
        if row.rows_per_campaign and row.family not in names:
            names.append(row.family)
    return sorted((rows, names) for rows, names in most.items() if names)

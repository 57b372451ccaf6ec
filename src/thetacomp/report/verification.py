"""The verification page: go or no-go on one A4 page, its figures, and its tables as CSV."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thetacomp.report import tables
from thetacomp.report.figures_verification import verification_figures
from thetacomp.report.page_writer import page
from thetacomp.report.rendering import Drawings, draw
from thetacomp.table_file import Cell, Number, csv_text, fixed
from thetacomp.verification.outcome import BeforeAfter, RunFacts, VerificationResult

OWN = ("verification*", "figures/verification_*")
PAGE_FILE = "verification.html"
_MOST_ROWS = 14
_MOST_NOTES = 4
_MOST_SENSORS = 4


@dataclass(frozen=True)
class RiseLine:
    """The largest rise of one sensor off and on, in K; NaN where it was not read."""

    sensor: str
    off_K: float
    on_K: float


def verification_files(result: VerificationResult) -> dict[str, str | bytes]:
    """The page, three tables and the figures, by file name, the page first."""
    drawings = draw(verification_figures(result))
    return {PAGE_FILE: _page(result, drawings), **_tables(result), **drawings.files()}


def _page(result: VerificationResult, drawings: Drawings) -> str:
    rows = _rows_to_show(result)
    return page(
        "thetacomp.report/verification.html.j2",
        result=result,
        rows=rows,
        left_out=len(result.rows) - len(rows),
        names={row.component: tables.component_name(row.component).replace("deviation", "dev.") for row in rows},
        straightness=_straightness_to_show(result),
        rises=_rises(result.off, result.on),
        figures={name: drawn for name, drawn in drawings.inline().items() if drawn[0].section == "page"},
        notes=result.notes[:_MOST_NOTES],
        more_notes=max(0, len(result.notes) - _MOST_NOTES),
        isfinite=np.isfinite,
    )


def _rows_to_show(result: VerificationResult) -> list[BeforeAfter]:
    """The column deviation first, then as many components as fit on the page, the largest first."""
    columns = [row for row in result.rows if row.component.startswith("column")]
    others = sorted((r for r in result.rows if r not in columns), key=lambda row: -row.of("max").before_um)
    kept = others[: _MOST_ROWS - len(columns)]
    return columns + [row for row in result.rows if row in kept]


def _straightness_to_show(result: VerificationResult) -> list[tuple[str, object, object]]:
    """Component with its two straightness figures, least squares and end points."""
    names = list(dict.fromkeys(one.component for one in result.straightness))
    return [(name, *(one for one in result.straightness if one.component == name)) for name in names]  # type: ignore[misc]


def _rises(off: RunFacts, on: RunFacts) -> list[RiseLine]:
    rises = dict(on.rises_K)
    return [RiseLine(name, rise, rises.get(name, float("nan"))) for name, rise in off.rises_K[:_MOST_SENSORS]]


def _tables(result: VerificationResult) -> dict[str, str]:
    before_after: list[Sequence[Cell]] = [
        (row.component, row.states_off, row.states_on, s.kind, *map(_plain, (
            s.before_um, s.like_before_um, s.after_um, s.reduction_percent, s.like_reduction_percent,
            s.low_percent, s.high_percent,
        )))
        for row in result.rows
        for s in row.statistics
    ]  # fmt: skip
    shares: list[Sequence[Cell]] = [
        (s.component, s.part, *map(_plain, (s.value, s.low, s.high)), s.kind, int(s.material),
         *map(_plain, (s.size_um, s.unexplained_um, s.usual_um)))
        for s in result.shares
    ]  # fmt: skip
    harm = [
        (one.component, fixed(t, 0), fixed(p, 3), _plain(one.harm_um[k, j]))
        for one in result.harm
        for k, t in enumerate(one.t_s)
        for j, p in enumerate(one.position_mm)
    ]
    head = "component,states_off,states_on,statistic,before_um,like_before_um,after_um,reduction_percent,"
    head += "like_reduction_percent,like_reduction_lo_percent,like_reduction_hi_percent"
    harm_head = "component,t_s,position_mm,harm_um"
    share_head = "component,part,share,share_lo,share_hi,kind,material,size_um,unexplained_um,usual_um"
    return {
        "verification.csv": csv_text(head.split(","), before_after),
        "verification_share.csv": csv_text(share_head.split(","), shares),
        "verification_harm.csv": csv_text(harm_head.split(","), harm),
    }


def _plain(value: float) -> Number | str:
    return fixed(value, 3)

"""The report page: one HTML file that opens anywhere without a network, and every figure as SVG and PNG."""

from __future__ import annotations

from collections.abc import Mapping

from markupsafe import Markup

from thetacomp.analysis_result import AnalysisResult
from thetacomp.report import comparison, style, tables
from thetacomp.report.figures import all_figures
from thetacomp.report.page_writer import page
from thetacomp.report.rendering import Drawings, draw

REPORT_FILE = "report.html"


def report_files(analysis: AnalysisResult) -> dict[str, str | bytes]:
    """`report.html` and `figures/*.svg`, `figures/*.png`, by file name, the report first.

    Where a name has letters that no installed font can draw, one note says so on stderr and in the report.
    """
    drawings = draw(all_figures(analysis))
    return {REPORT_FILE: render_page(analysis, drawings), **drawings.files()}


def render_page(analysis: AnalysisResult, drawings: Drawings) -> str:
    """The whole page as HTML text."""
    faulty = _faulty(analysis)
    notes = [*analysis.notes, *analysis.model.notes, *drawings.remarks()]
    return page(
        "thetacomp.report/report.html.j2",
        analysis=analysis,
        checks=sorted(analysis.acceptance, key=lambda check: check.passed),
        machine=analysis.folder.machine,
        faulty=faulty,
        repaired=analysis.screening is not None and analysis.screening.repair,
        model=analysis.model,
        sections=_sections(drawings),
        verdict=tables.verdict(analysis),
        headlines=tables.headlines(analysis),
        split_words=tables.split_words(tables.main_split(analysis)),
        key_points=tables.key_points(analysis),
        campaigns=tables.campaign_lines(analysis),
        validation=tables.validation_tables(analysis),
        states=tables.state_tables(analysis),
        compared=comparison.comparison_groups(analysis),
        family_name=comparison.family_name,
        thinning=comparison.thinning(analysis),
        notes=[note for note in dict.fromkeys(notes) if note not in faulty],
        equations=[tables.equations(analysis, document) for document in (analysis.model, analysis.paper_model)],
        counted=tables.counted,
        only_sensor=[tables.nothing_was_chosen(analysis, points) for points in analysis.key_points],
        nothing_chosen=tables.NOTHING_CHOSEN,
        axis_name=tables.axis_name,
        unit_of=style.unit_of,
        created=tables.date_words(analysis.model.created),
        operators={">=": "≥", "<=": "≤"},
        hour_s=style.HOUR_S,
    )


def _faulty(analysis: AnalysisResult) -> tuple[str, ...]:
    """Sentences of the part on faulty readings, which is left out where there are none."""
    found = analysis.screening
    return found.notes if found is not None and (found.findings or found.held) else ()


def _sections(drawings: Drawings) -> Mapping[str, list[tuple[style.NamedFigure, Markup]]]:
    """Figures with their SVG, by the place in the page that shows them."""
    found: dict[str, list[tuple[style.NamedFigure, Markup]]] = {}
    for figure, svg in drawings.inline().values():
        found.setdefault(figure.section, []).append((figure, svg))
    return found

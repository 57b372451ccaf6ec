"""The report page: one HTML file that opens anywhere without a network, and every figure as SVG and PNG."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from thetacomp.analysis_result import Analysis
from thetacomp.report import comparison, style, tables
from thetacomp.report.figures import all_figures
from thetacomp.report.rendering import Rendered, inline_svg, missing_note, render

REPORT_FILE = "report.html"
FIGURE_FOLDER = "figures"


def write_report(analysis: Analysis, out: Path) -> tuple[Path, ...]:
    """Write `report.html` and `figures/*.svg`, `figures/*.png` into `out`; returns the paths, the report first.

    Where a name has letters that no installed font can draw, one note says so on stderr and in the report.
    """
    folder = out / FIGURE_FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    figures = all_figures(analysis)
    rendered = [render(figure) for figure in figures]
    paths: list[Path] = [out / REPORT_FILE]
    for figure, files in zip(figures, rendered, strict=True):
        svg, png = folder / f"{figure.name}.svg", folder / f"{figure.name}.png"
        svg.write_text(files.svg, encoding="utf-8")
        png.write_bytes(files.png)
        paths += [svg, png]
    remarks = _remarks(rendered)
    for remark in remarks:
        print(f"note: {remark}", file=sys.stderr)
    paths[0].write_text(render_page(analysis, figures, rendered, remarks), encoding="utf-8")
    return tuple(paths)


def _remarks(rendered: Sequence[Rendered]) -> list[str]:
    missing = dict.fromkeys(text for files in rendered for text in files.missing)
    remarks = list(dict.fromkeys(remark for files in rendered for remark in files.remarks))
    return ([missing_note(list(missing))] if missing else []) + remarks


def render_page(
    analysis: Analysis, figures: Sequence[style.NamedFigure], rendered: Sequence[Rendered], remarks: Sequence[str]
) -> str:
    """The whole page as HTML text."""
    environment = Environment(
        loader=PackageLoader("thetacomp.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(number=tables.number, significant=tables.significant, sentence=tables.sentence)
    faulty = _faulty(analysis)
    return environment.get_template("report.html.j2").render(
        analysis=analysis,
        checks=sorted(analysis.acceptance, key=lambda check: check.passed),
        machine=analysis.folder.machine,
        faulty=faulty,
        repaired=analysis.screening is not None and analysis.screening.repair,
        model=analysis.model,
        sections=_sections(figures, rendered),
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
        notes=[
            note for note in dict.fromkeys([*analysis.notes, *analysis.model.notes, *remarks]) if note not in faulty
        ],
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


def _faulty(analysis: Analysis) -> tuple[str, ...]:
    """Sentences of the part on faulty readings, which is left out where there are none."""
    found = analysis.screening
    return found.notes if found is not None and (found.findings or found.held) else ()


def _sections(
    figures: Sequence[style.NamedFigure], rendered: Sequence[Rendered]
) -> Mapping[str, list[tuple[style.NamedFigure, Markup]]]:
    """Figures with their SVG, by the place in the page that shows them."""
    found: dict[str, list[tuple[style.NamedFigure, Markup]]] = {}
    for figure, files in zip(figures, rendered, strict=True):
        svg = Markup(inline_svg(files.svg, figure.name, str(escape(figure.title))))  # our own drawing, text escaped
        found.setdefault(figure.section, []).append((figure, svg))
    return found

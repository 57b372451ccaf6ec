"""What a notebook shows of an analysis: the verdict, the held-out reductions, and the picture before and after."""

from __future__ import annotations

from html import escape

from thetacomp.analysis_result import AnalysisResult
from thetacomp.report import tables
from thetacomp.report.figures_validation import before_and_after
from thetacomp.report.rendering import inline_svg, render


def analysis_html(analysis: AnalysisResult) -> str:
    """A few lines and one picture, as HTML for the inside of a page."""
    verdict = tables.verdict(analysis)
    split = tables.main_split(analysis)
    lines = [f"<strong>{escape(verdict.text)}.</strong> {escape(verdict.detail)}"]
    for line in tables.headlines(analysis):
        row = line.row
        before, after, clock = map(tables.number, (row.max_before_um, row.max_after_um, line.clock_max_um))
        lines.append(
            f"{escape(line.name)}, held out: largest error {before} → {after} µm"
            f" ({tables.number(row.reduction_percent)} % less; the clock alone leaves {clock} µm)"
        )
    picture = next((one for one in before_and_after(analysis) if one.name == f"before_after_{split}"), None)
    body = [f"<pre>{escape(repr(analysis))}</pre>", *(f"<p>{line}</p>" for line in lines)]
    if picture is not None:
        svg = inline_svg(render(picture).svg, picture.name, escape(picture.title))
        body.append(f"<figure>{svg}<figcaption>{escape(picture.caption)}</figcaption></figure>")
    return f'<div class="thetacomp" style="max-width: 60em">{"".join(body)}</div>'

"""The verification page: go or no-go on one A4 page, its figures, and its tables as CSV."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from thetacomp import __version__
from thetacomp.report import tables
from thetacomp.report.figures_verification import verification_figures
from thetacomp.report.page import FIGURE_FOLDER
from thetacomp.report.rendering import inline_svg, render
from thetacomp.report.style import NamedFigure
from thetacomp.verification.findings import BeforeAfter, RunFacts, Verification

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


def write_verification(result: Verification, out: Path) -> tuple[Path, ...]:
    """Write the page, three tables and the figures into `out`; returns the paths, the page first."""
    folder = out / FIGURE_FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    figures = verification_figures(result)
    drawn = [render(figure) for figure in figures]
    paths = [out / PAGE_FILE, *_write_tables(result, out)]
    for figure, files in zip(figures, drawn, strict=True):
        svg, png = folder / f"{figure.name}.svg", folder / f"{figure.name}.png"
        svg.write_text(files.svg, encoding="utf-8")
        png.write_bytes(files.png)
        paths += [svg, png]
    inline = {
        figure.name: (figure, Markup(inline_svg(files.svg, figure.name, str(escape(figure.title)))))
        for figure, files in zip(figures, drawn, strict=True)
        if figure.section == "page"
    }
    paths[0].write_text(_page(result, inline), encoding="utf-8")
    return tuple(paths)


def _page(result: Verification, figures: Mapping[str, tuple[NamedFigure, Markup]]) -> str:
    environment = Environment(
        loader=PackageLoader("thetacomp.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(number=tables.number, sentence=tables.sentence)
    rows = _rows_to_show(result)
    return environment.get_template("verification.html.j2").render(
        result=result,
        rows=rows,
        left_out=len(result.rows) - len(rows),
        names={row.component: tables.component_name(row.component).replace("deviation", "dev.") for row in rows},
        straightness=_straightness_to_show(result),
        rises=_rises(result.off, result.on),
        figures=figures,
        notes=result.notes[:_MOST_NOTES],
        more_notes=max(0, len(result.notes) - _MOST_NOTES),
        version=__version__,
        isfinite=np.isfinite,
    )


def _rows_to_show(result: Verification) -> list[BeforeAfter]:
    """The column deviation first, then as many components as fit on the page, the largest first."""
    columns = [row for row in result.rows if row.component.startswith("column")]
    others = sorted((r for r in result.rows if r not in columns), key=lambda row: -row.of("max").before_um)
    kept = others[: _MOST_ROWS - len(columns)]
    return columns + [row for row in result.rows if row in kept]


def _straightness_to_show(result: Verification) -> list[tuple[str, object, object]]:
    """Component with its two straightness figures, least squares and end points."""
    names = list(dict.fromkeys(one.component for one in result.straightness))
    return [(name, *(one for one in result.straightness if one.component == name)) for name in names]  # type: ignore[misc]


def _rises(off: RunFacts, on: RunFacts) -> list[RiseLine]:
    rises = dict(on.rises_K)
    return [RiseLine(name, rise, rises.get(name, float("nan"))) for name, rise in off.rises_K[:_MOST_SENSORS]]


def _write_tables(result: Verification, out: Path) -> list[Path]:
    before_after = [
        (row.component, row.states_off, row.states_on, s.kind, *map(_plain, (
            s.before_um, s.like_before_um, s.after_um, s.reduction_percent, s.like_reduction_percent,
            s.low_percent, s.high_percent,
        )))
        for row in result.rows
        for s in row.statistics
    ]  # fmt: skip
    shares = [
        (s.component, s.part, *map(_plain, (s.value, s.low, s.high)), s.kind, int(s.material),
         *map(_plain, (s.size_um, s.unexplained_um, s.usual_um)))
        for s in result.shares
    ]  # fmt: skip
    harm = [
        (one.component, f"{t:.0f}", f"{p:.3f}", _plain(one.harm_um[k, j]))
        for one in result.harm
        for k, t in enumerate(one.t_s)
        for j, p in enumerate(one.position_mm)
    ]
    head = "component,states_off,states_on,statistic,before_um,like_before_um,after_um,reduction_percent,"
    head += "like_reduction_percent,like_reduction_lo_percent,like_reduction_hi_percent"
    made = [_csv(out / "verification.csv", head, before_after)]
    head = "component,part,share,share_lo,share_hi,kind,material,size_um,unexplained_um,usual_um"
    made.append(_csv(out / "verification_share.csv", head, shares))
    made.append(_csv(out / "verification_harm.csv", "component,t_s,position_mm,harm_um", harm))
    return made


def _csv(path: Path, head: str, rows: Iterable[Sequence[object]]) -> Path:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(head.split(","))
        writer.writerows(rows)
    return path


def _plain(value: float) -> str:
    return f"{value:.3f}" if np.isfinite(value) else ""

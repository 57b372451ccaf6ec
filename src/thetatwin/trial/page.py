"""The files of a trial: monthly.csv, the page, its pictures, and the model."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from itertools import groupby
from pathlib import Path

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from thetacomp import __version__
from thetacomp.report import tables
from thetacomp.report.rendering import inline_svg, render
from thetacomp.screening import Finding
from thetacomp.validation.rows import AcceptanceCheck
from thetatwin.hall import DAY_S
from thetatwin.trial.figures import month_by_month, one_week
from thetatwin.trial.monthly import TOOL, WORSE_BY_UM, MonthRow
from thetatwin.trial.run import ADAPTIVE, Trial
from thetatwin.year import MONTH_DAYS, Schedule

PAGE_FILE, TABLE_FILE, FIGURE_FOLDER = "trial.html", "monthly.csv", "figures"


def write_trial(
    trial: Trial, rows: Sequence[MonthRow], checks: Sequence[AcceptanceCheck], out: Path
) -> tuple[Path, ...]:
    """Write trial.html, monthly.csv, model.json and figures into `out`; returns the paths, the page first."""
    folder = out / FIGURE_FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    figures = [month_by_month(rows), one_week(trial)]
    rendered = [render(figure) for figure in figures]
    paths = [out / PAGE_FILE, out / TABLE_FILE, out / "model.json"]
    for figure, files in zip(figures, rendered, strict=True):
        svg, png = folder / f"{figure.name}.svg", folder / f"{figure.name}.png"
        svg.write_text(files.svg, encoding="utf-8")
        png.write_bytes(files.png)
        paths += [svg, png]
    pictures = [
        (figure, Markup(inline_svg(files.svg, figure.name, str(escape(figure.title)))))  # our own drawing
        for figure, files in zip(figures, rendered, strict=True)
    ]
    paths[0].write_text(_page(trial, rows, checks, pictures), encoding="utf-8")
    _table(paths[1], rows)
    trial.trained.model.save(paths[2])
    return tuple(paths)


@dataclass(frozen=True)
class _Told:
    """A fault as the page tells it: begin and end as month and day of the months that are judged, from 1 on."""

    sensor: str
    kind: str
    begin: str
    seen_min: float
    end: str
    size_K: float
    done: str

    @classmethod
    def of(cls, found: Finding, schedule: Schedule) -> _Told:
        end = "lasts" if found.end_s is None else _date(found.end_s, schedule)
        seen_min = max(found.detected_s - found.start_s, 0.0) / 60.0
        done = {"reconstructed": "rebuilt", "lost": "model without it"}.get(found.repair, found.repair)
        return cls(found.sensor, found.kind, _date(found.start_s, schedule), seen_min, end, found.size_K, done)


def _date(t_s: float, schedule: Schedule) -> str:
    days = t_s / DAY_S - schedule.training_days
    return f"{int(days // MONTH_DAYS) + 1} / {int(days % MONTH_DAYS) + 1}" if days >= 0.0 else "before"


def _page(trial: Trial, rows: Sequence[MonthRow], checks: Sequence[AcceptanceCheck], pictures: Sequence[object]) -> str:
    environment = Environment(
        loader=ChoiceLoader(
            [PackageLoader("thetatwin.trial", "templates"), PackageLoader("thetacomp.report", "templates")]
        ),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(number=tables.number, significant=tables.significant)
    tool = [row for row in rows if row.direction == TOOL]
    return environment.get_template("trial.html.j2").render(
        trial=trial,
        version=__version__,
        checks=checks,
        passed=all(check.passed for check in checks),
        operators={">=": "≥", "<=": "≤"},
        taken=trial.probes.get("adapted", 0) + trial.probes.get("limited", 0),
        refused=sum(trial.probes.get(name, 0) for name in ("gated", "alarm", "blocked")),
        lost=trial.probes.get("lost", 0),
        figures=pictures,
        worse_um=WORSE_BY_UM,
        main=ADAPTIVE,
        readings=[_Told.of(f, trial.schedule) for f in trial.screened.findings],
        judged=trial.screened.judged,
        months=[(month, list(lines)) for month, lines in groupby(tool, key=lambda row: row.month)],
    )


def _table(path: Path, rows: Sequence[MonthRow]) -> None:
    """Numbers with six significant digits, a missing value as an empty cell."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([field.name for field in fields(MonthRow)])
        for row in rows:
            writer.writerow([_cell(value) for value in astuple(row)])


def _cell(value: object) -> object:
    if not isinstance(value, float):
        return value
    return f"{value:.6g}" if math.isfinite(value) else ""

"""The files of a trial: monthly.csv, the page, its pictures, and the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from itertools import groupby

from thetacomp.report.page_writer import page
from thetacomp.report.rendering import Drawings, draw
from thetacomp.screening import Finding
from thetacomp.table_file import csv_text, plain
from thetacomp.validation.outcome import AcceptanceCheck
from thetatwin.hall import DAY_S
from thetatwin.trial.figures import month_by_month, one_week
from thetatwin.trial.monthly_figures import TOOL, WORSE_BY_UM, MonthRow
from thetatwin.trial.run import ADAPTIVE, Trial
from thetatwin.year import MONTH_DAYS, Schedule

PAGE_FILE, TABLE_FILE = "trial.html", "monthly.csv"


def trial_files(trial: Trial, rows: Sequence[MonthRow], checks: Sequence[AcceptanceCheck]) -> dict[str, str | bytes]:
    """trial.html, monthly.csv, model.json and figures, by file name, the page first."""
    drawings = draw([month_by_month(rows), one_week(trial)])
    cells = ([plain(value) for value in astuple(row)] for row in rows)
    return {
        PAGE_FILE: _page(trial, rows, checks, drawings),
        TABLE_FILE: csv_text([field.name for field in fields(MonthRow)], cells),
        "model.json": trial.trained.model.to_json(),
        **drawings.files(),
    }


@dataclass(frozen=True)
class _Told:
    """A fault as the page shows it: start and end as month and day of the months that are judged, from 1 on."""

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


def _page(trial: Trial, rows: Sequence[MonthRow], checks: Sequence[AcceptanceCheck], drawings: Drawings) -> str:
    tool = [row for row in rows if row.direction == TOOL]
    return page(
        "thetatwin.trial/trial.html.j2",
        trial=trial,
        checks=checks,
        passed=all(check.passed for check in checks),
        operators={">=": "≥", "<=": "≤"},
        taken=trial.probes.get("adapted", 0) + trial.probes.get("limited", 0),
        refused=sum(trial.probes.get(name, 0) for name in ("gated", "alarm", "blocked")),
        lost=trial.probes.get("lost", 0),
        figures=drawings.inline(),
        worse_um=WORSE_BY_UM,
        main=ADAPTIVE,
        readings=[_Told.of(f, trial.schedule) for f in trial.screened.findings],
        judged=trial.screened.judged,
        months=[(month, list(lines)) for month, lines in groupby(tool, key=lambda row: row.month)],
    )

"""The files of a trial, from made-up months: every number finds its place, without a year on the virtual machine."""

from __future__ import annotations

import csv
import io
from types import SimpleNamespace
from typing import Any

import numpy as np

from thetatwin.trial.monthly_figures import acceptance, monthly
from thetatwin.trial.page import trial_files
from thetatwin.trial.run import Place, Trial
from thetatwin.trial.screened_year import ScreenedYear
from thetatwin.year import Schedule

COLUMNS = ("nothing", "frozen default", "adaptive default", "one sensor (paper)", "clock", "probes alone")


def made_up() -> Trial:
    schedule = Schedule((2, 2), months=2)
    t_s = np.arange(0.0, 60.0 * 86400.0, 600.0) + schedule.training_days * 86400.0
    places = (Place("middle", "", {"X": 0.0}), Place("X 1000", "X", {"X": 1000.0}))
    rng = np.random.default_rng(1)
    error = {name: rng.normal(size=(len(t_s), 2, 3)) * (40.0 if name == "nothing" else 4.0) for name in COLUMNS}
    inside, band = np.ones((len(t_s), 2)), np.full((len(t_s), 2, 3), 9.0)
    trained: Any = SimpleNamespace(model=SimpleNamespace(to_json=lambda: "{}\n"))
    return Trial(
        "standard", 1, schedule, places, 150.0, t_s, schedule.training_days, error, band, inside,
        {"adapted": 3, "lost": 1}, trained, ScreenedYear((), (), judged=False),
    )  # fmt: skip


def test_files_of_a_trial() -> None:
    trial = made_up()
    rows = monthly(trial)
    files = trial_files(trial, rows, acceptance(rows))
    assert list(files) == [
        "trial.html", "monthly.csv", "model.json",
        *(f"figures/{name}.{end}" for name in ("month_by_month", "one_week") for end in ("svg", "png")),
    ]  # fmt: skip
    page = str(files["trial.html"])
    assert page.count("<svg") == 2
    assert "no fault was looked for" in page
    assert "(3 measured values used, 0 refused by the gate, 1 lost)" in page
    table = list(csv.DictReader(io.StringIO(str(files["monthly.csv"]))))
    assert len(table) == 2 * len(COLUMNS) * 4
    assert float(table[0]["p95_before_um"]) == float(f"{rows[0].p95_before_um:.6g}")

"""The tables of the ruler as Markdown, and where they stand in the document."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from carry.measure import SIMPLE, Row
from thetacomp.files import write_files
from thetacomp.validation.outcome import DEFAULT, KEY_POINTS

BEGIN, END = "<!-- table of make bench-carry: begin -->", "<!-- table of make bench-carry: end -->"
MOST_RATIO = 1.05
MANY = 4  # campaigns from which on heat history has three to train on in every fold
COVERED_PERCENT = (93.0, 97.0)
COVERED_FROM = 5


def tables(rows: Sequence[Row]) -> str:
    """What every model leaves, and then more about the default."""
    left = ["machine", "n", *(name.replace("_", " ") for name in SIMPLE), "key points", "**default**", "**ratio**"]
    more = ["machine", "n", "p95", "worst campaign", "worst component", "coverage", "least", "half width", "CPU s"]
    return (
        "RMSE in µm, held out:\n\n"
        + _table(left, [_left(row) for row in rows])
        + "\n\nThe default; in brackets the best simple baseline:\n\n"
        + _table(more, [_more(row) for row in rows])
    )


def _left(row: Row) -> list[str]:
    # Where heat history is not fitted the default is the law on key points.
    names = [*SIMPLE, KEY_POINTS if KEY_POINTS in row.models else DEFAULT, DEFAULT]
    values = [_um(row.models[name].rms_um) if name in row.models else "–" for name in names]
    return [row.name, str(row.campaigns), *values, f"{row.ratio():.2f}" if DEFAULT in row.models else "–"]


def _more(row: Row) -> list[str]:
    if DEFAULT not in row.models:
        return [row.name, str(row.campaigns), *["–"] * 7]
    own, best = row.models[DEFAULT], row.models[row.best_simple]
    component, ratio = row.worst_component
    return [
        row.name,
        str(row.campaigns),
        f"{_um(own.p95_um)} ({_um(best.p95_um)})",
        f"{_um(own.worst_campaign_um)} ({_um(best.worst_campaign_um)})",
        f"{component} {ratio:.2f}",
        f"{own.coverage_percent:.0f}",
        f"{own.least_coverage_percent:.0f}",
        _um(own.half_width_um),
        f"{own.cpu_s:.1f}",
    ]


def families_table(rows: Sequence[Row]) -> str:
    """What other families of models leave against the best simple baseline of each row."""
    beside = {*SIMPLE, KEY_POINTS, DEFAULT, "clock", "training_mean"}
    names = list(dict.fromkeys(name for row in rows for name in row.models if name not in beside))
    body = [[row.name, str(row.campaigns), *(_ratio(row, name) for name in (DEFAULT, *names))] for row in rows]
    return "Ratio to the best simple baseline:\n\n" + _table(["machine", "n", "default", *names], body)


def _ratio(row: Row, name: str) -> str:
    return f"{row.ratio(name):.2f}" if name in row.models else "–"


def summary(rows: Sequence[Row]) -> str:
    """How many rows hold what is asked of them, and the worst ones."""
    served = [row for row in rows if DEFAULT in row.models]
    ratio = np.array([row.ratio() for row in served])
    many = np.array([row.campaigns >= MANY for row in served])
    worst = sorted(served, key=lambda row: -row.ratio())[:5]
    lines = [
        f"{np.sum(ratio <= MOST_RATIO)} of {len(rows)} rows have a ratio of at most {MOST_RATIO:g}.",
        "Worst: " + ", ".join(f"{row.name} on {row.campaigns} ({row.ratio():.2f})" for row in worst) + ".",
    ]
    for label, chosen in ((f"less than {MANY}", ~many), (f"{MANY} and more", many)):
        if chosen.any():
            low, middle, high = np.quantile(ratio[chosen], (0.0, 0.5, 1.0))
            lines.append(f"Ratio on {label} campaigns: median {middle:.2f}, {low:.2f} to {high:.2f}.")
    poor = [f"{row.name} on {row.campaigns} ({row.unserved_share:.0%})" for row in served if row.unserved_share > 0.05]
    if poor:
        lines.append("More than 5 % of the points are not predicted by the default: " + ", ".join(poor) + ".")
    banded = [row.models[DEFAULT] for row in served if row.campaigns >= COVERED_FROM]
    if banded:
        low, high = COVERED_PERCENT
        inside = sum(low <= own.coverage_percent <= high for own in banded)
        lines.append(
            f"Bands on {COVERED_FROM} campaigns and more: {inside} of {len(banded)} rows cover {low:g} to {high:g} %,"
            f" {sum(own.least_coverage_percent >= 90.0 for own in banded)} at least 90 % of every component."
        )
    return "\n".join(f"- {one}" for one in lines)


def put_into(page: Path, text: str) -> None:
    """Write text between the two marks of a document. ValueError where they are not there once each, in order."""
    before, found, rest = (whole := page.read_text(encoding="utf-8")).partition(BEGIN)
    _, closed, after = rest.partition(END)
    if not (found and closed) or whole.count(BEGIN) + whole.count(END) != 2:
        raise ValueError(f"{page}: expected the line {BEGIN!r} and below it {END!r}, once each")
    write_files(page.parent, {page.name: f"{before}{BEGIN}\n\n{text}\n\n{END}{after}"})


def _table(head: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *body))


def _um(value: float) -> str:
    return f"{value:.1f}" if value >= 10.0 else f"{value:.2f}"

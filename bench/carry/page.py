"""The table of the ruler as Markdown."""

from __future__ import annotations

from carry.measure import SIMPLE, Row
from thetacomp.validation.outcome import DEFAULT

HEAD = (
    "| machine | n | nothing | mean curve | one sensor | best three | all sensors | **default** | **ratio** |"
    " worst component | p95 | worst campaign | coverage % | least | half width | CPU s |\n"
    "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|"
)


def line(row: Row) -> str:
    """One row of the table."""
    simple = [_um(row.models[name].rms_um) if name in row.models else "–" for name in SIMPLE]
    cells = [row.name, str(row.campaigns), *simple]
    default = row.models.get(DEFAULT)
    if default is None:
        return _joined([*cells, *["–"] * 9])
    component, worst = row.worst_component
    cells += [_um(default.rms_um), f"{row.ratio():.2f}", f"{component} {worst:.2f}", _um(default.p95_um)]
    cells += [
        _um(default.worst_campaign_um),
        f"{default.coverage_percent:.0f}",
        f"{default.least_coverage_percent:.0f}",
    ]
    return _joined([*cells, _um(default.half_width_um), f"{default.cpu_s:.1f}"])


def _um(value: float) -> str:
    return f"{value:.1f}" if value >= 10.0 else f"{value:.2f}"


def _joined(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"

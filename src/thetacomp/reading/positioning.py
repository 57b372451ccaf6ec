"""A single table of positioning deviations: axis, target, run, approach, deviation; for ISO 230-2."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from thetacomp.reading.checks import LARGEST_ERROR_UM
from thetacomp.reading.columns import TIME, Meaning, Schema, match
from thetacomp.reading.problems import ProblemList, UnreadableError
from thetacomp.reading.sources import read_source
from thetacomp.reading.sweep_table import directions
from thetacomp.reading.tables import Table, convert
from thetacomp.standards.iso230_2 import Readings

_TEXTS = ("axis", "run", "direction")
SCHEMA = Schema(
    dict(TIME)
    | {name: Meaning(name, "text") for name in _TEXTS}
    | {"target_mm": Meaning("target_mm"), "error_um": Meaning("error_um"), "error_mm": Meaning("error_um", factor=1e3)},
    (("axis",), ("target_mm",), ("run",), ("direction",), ("error_um", "error_mm")),
    frozenset({"target_mm"}),
    known_hint="axis, target_mm, run, direction, error_um (or error_mm), and optionally t_s (or t_min, t_h, time)",
)


def read_positioning(path: Path) -> tuple[Readings, ...]:
    """Read a table `axis,target_mm,run,direction,error_um[,t_s]`, one `Readings` an axis. Raises InputError.

    The deviation is actual minus target position along the axis; an empty one is a missing reading.
    """
    problems = ProblemList()
    table = _table(Path(path), problems)
    direction = directions(table, problems) if table is not None else None
    if table is not None:
        _filled(table, problems)
        _plausible(table, problems)
    problems.raise_errors()
    assert table is not None
    assert direction is not None
    t_s = table.t_s(table.clock.first_micros if table.clock else 0) if "t_s" in table.matched.columns else None
    names = np.array(table.texts["axis"])
    found = []
    for axis in dict.fromkeys(table.texts["axis"]):
        rows = np.flatnonzero(names == axis)
        found.append(
            Readings(
                axis=axis,
                target_mm=table.numbers["target_mm"][rows],
                run=tuple(table.texts["run"][i] for i in rows),
                direction=direction[rows],
                deviation_um=table.numbers["error_um"][rows],
                t_s=t_s[rows] if t_s is not None else None,
            )
        )
    return tuple(found)


def _table(path: Path, problems: ProblemList) -> Table | None:
    try:
        source = read_source(path, path.name)
    except UnreadableError as refusal:
        problems.refuse(path.name, refusal)
        return None
    matched = match(source, SCHEMA, problems)
    return None if matched is None else convert("positioning", matched, SCHEMA, problems)


def _plausible(table: Table, problems: ProblemList) -> None:
    beyond = np.flatnonzero(np.abs(table.numbers["error_um"]) > LARGEST_ERROR_UM)
    if len(beyond):
        problems.error(
            "error-unit",
            table.file,
            f"found {table.numbers['error_um'][beyond[0]]:g} µm, expected deviations below {LARGEST_ERROR_UM:g} µm.",
            "name the column by its unit (error_um, error_mm); give deviations from the target, not positions.",
            table.rows[beyond].tolist(),
            table.header("error_um"),
        )


def _filled(table: Table, problems: ProblemList) -> None:
    for name in _TEXTS:
        empty = [i for i, text in enumerate(table.texts[name]) if not text]
        if empty:
            problems.error(
                "missing-value",
                table.file,
                f"the cell is empty, expected the {name} in every row.",
                "fill it in, or delete the row.",
                table.rows[empty].tolist(),
                name,
            )

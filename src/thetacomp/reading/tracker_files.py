"""Points as the program of a tracker exports them (`tracker*.txt`): name and x y z, joined with the planned points."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from thetacomp.arrays import Floats, Ints
from thetacomp.campaign import TrackerSettings
from thetacomp.reading import text
from thetacomp.reading.columns import XYZ, Matched, match, tracker_file_schema
from thetacomp.reading.problems import ProblemList, UnreadableError, nearest, quoted
from thetacomp.reading.sources import Column, Source
from thetacomp.reading.tables import Clock, Table, convert
from thetacomp.reading.tracker import coordinates_are_plausible

ENDINGS = (".txt", ".asc")
COMMENT = "//"
CELLS = ("collection", "group", "target", "x", "y", "z", "station", "t_s", "t_min", "t_h", "time", "-")
NEEDED = ("target", "x", "y", "z")
SKIPPED = "-"


def is_tracker_file(name: str) -> bool:
    """Whether a file of a campaign's folder holds exported tracker points."""
    path = Path(name.lower())
    return path.suffix in ENDINGS and path.stem.startswith("tracker")


def tracker_table(
    files: Sequence[tuple[str, Path]], planned: Table | None, settings: TrackerSettings | None, place: str,
    problems: ProblemList,
) -> Table | None:  # fmt: skip
    """One table `tracker` from exported points and the table `tracker_points`. None, with the problems noted, else.

    Every exported point takes axis, positions and station from the planned point of its name (column `point`, else
    `target`). A name that was planned several times, like a foundation target, is joined in the order of measuring.
    """
    columns = settings.columns if settings is not None else TrackerSettings.model_fields["columns"].default
    unit = settings.unit if settings is not None else "mm"
    if not _columns_are_known(columns, f"{place}/campaign.toml", problems):
        return None
    if planned is None:
        problems.error(
            "missing-table",
            place,
            f"{files[0][0].rsplit('/', 1)[-1]} holds points, but no table tracker_points says what they are.",
            "add tracker_points.csv with target, t_s, station, axis, position_mm and at_<axis>_mm for every name.",
        )
        return None
    tables = [_read(path, label, columns, unit, problems) for label, path in files]
    read = [table for table in tables if table is not None]
    if len(read) < len(files):
        return None
    return _joined(read, planned, place, problems)


def _columns_are_known(columns: Sequence[str], file: str, problems: ProblemList) -> bool:
    unknown = [name for name in columns if name not in CELLS]
    missing = [name for name in NEEDED if name not in columns]
    twice = [name for name in dict.fromkeys(columns) if name != SKIPPED and columns.count(name) > 1]
    if not unknown and not missing and not twice:
        return True
    what = [f"unknown {', '.join(f'{name!r}{nearest(name, CELLS)}' for name in unknown)}"] if unknown else []
    what += [f"without {quoted(missing)}"] if missing else []
    what += [f"with {quoted(twice)} twice"] if twice else []
    problems.error(
        "tracker-columns",
        file,
        f"`columns` of [tracker] is {'; '.join(what)}; expected {quoted(CELLS, 12)} in the order of the cells.",
        'write it like columns = ["collection", "group", "target", "x", "y", "z"]; "-" skips a cell.',
    )
    return False


def _read(path: Path, label: str, columns: Sequence[str], unit: str, problems: ProblemList) -> Table | None:
    try:
        source = _source(path, label, columns)
    except UnreadableError as refusal:
        problems.refuse(label, refusal)
        return None
    wanted = tracker_file_schema(columns, unit)
    matched = match(source, wanted, problems)
    table = convert("tracker", matched, wanted, problems) if matched is not None else None
    if table is None:
        return None
    found = ProblemList()
    coordinates_are_plausible(table, found)
    problems.extend(found)
    return None if found.has_errors else table


def _source(path: Path, label: str, columns: Sequence[str]) -> Source:
    lines = text.decode(text.read_bytes(path)).splitlines()
    rows = [(i, line) for i, line in enumerate(lines, start=1) if line.strip() and not line.strip().startswith(COMMENT)]
    if not rows:
        raise UnreadableError("empty-table", "the file holds no points.", "export the points again, or delete it.")
    delimiter = "," if any("," in line for _, line in rows) else " "
    cells = [_cells(line, delimiter) for _, line in rows]
    wrong = [(number, found) for (number, _), found in zip(rows, cells, strict=True) if len(found) != len(columns)]
    if wrong:
        raise UnreadableError(
            "ragged-rows",
            f"found {len(wrong[0][1])} cells, expected {len(columns)} ({', '.join(columns)}).",
            'name every cell in `columns` of [tracker] in campaign.toml, in order; "-" skips one.',
            rows=[number for number, _ in wrong],
        )
    kept = [(name, k) for k, name in enumerate(columns) if name != SKIPPED]
    numbers = np.array([number for number, _ in rows], dtype=np.int64)
    return Source(label, tuple(Column(name, [row[k] for row in cells]) for name, k in kept), numbers, delimiter)


def _cells(line: str, delimiter: str) -> list[str]:
    line = line.strip().replace("\t", " ") if delimiter == " " else line.strip().rstrip(",")
    (row,) = csv.reader([line], delimiter=delimiter, skipinitialspace=True)
    return [cell.strip() for cell in row if cell.strip() or delimiter == ","]


def _joined(tables: Sequence[Table], planned: Table, place: str, problems: ProblemList) -> Table | None:
    found = ProblemList()
    names = [table.texts["target"] for table in tables]
    plan = _by_name(planned.texts.get("point", planned.texts["target"]))
    seen = _by_name([name for part in names for name in part])
    where = [(table, i) for table in tables for i in range(len(table.rows))]
    for table, part in zip(tables, names, strict=True):
        unknown = [i for i, name in enumerate(part) if name not in plan]
        if unknown:
            found.error(
                "unplanned-target",
                table.file,
                f"the target '{part[unknown[0]]}' is not in {planned.file}{nearest(part[unknown[0]], plan)}.",
                "add it there with its axis and positions, or without an axis where it is a foundation target.",
                table.rows[unknown].tolist(),
                table.header("target"),
            )
    for name, rows in seen.items():
        if name in plan and len(plan[name]) != len(rows):
            table, i = where[rows[-1]]
            found.error(
                "target-count",
                table.file,
                f"the target '{name}' was measured {len(rows)} times and planned {len(plan[name])} times:"
                " it is not clear which is which.",
                f"delete the rows of {planned.file} that were not measured, or give every reading a name of its own, in"
                " the column `point` there.",
                [int(table.rows[i])],
                table.header("target"),
            )
    absent = [name for name in plan if name not in seen]
    if absent:
        found.warning(
            "target-not-measured",
            planned.file,
            f"{len(absent)} planned targets were not measured: {quoted(absent)}.",
            "continue if their beam was lost; otherwise export them too.",
        )
    problems.extend(found)
    if found.has_errors:
        return None
    of_plan = np.full(len(where), -1)
    moments = _moments(tables)
    for name, rows in seen.items():
        of_plan[sorted(rows, key=lambda i: moments[i])] = plan[name]
    return _merged(tables, planned, of_plan, place, problems)


def _by_name(names: Sequence[str]) -> dict[str, list[int]]:
    found: dict[str, list[int]] = {}
    for i, name in enumerate(names):
        found.setdefault(name, []).append(i)
    return found


def _merged(tables: Sequence[Table], planned: Table, of_plan: Ints, place: str, problems: ProblemList) -> Table | None:
    timed = [table for table in tables if _has_time(table)]
    source = timed or [planned]
    if (timed and len(timed) < len(tables)) or len({table.clock is None for table in source}) > 1:
        problems.error(
            "time-mixed",
            place,
            "the tracker files do not state times in one way.",
            "export all files with the same time column, or all without.",
        )
        return None
    if not all(_has_time(table) for table in source):
        problems.error(
            "no-time-column",
            planned.file,
            "neither this table nor the tracker files say when the points were measured.",
            "add t_s here, or name a time cell in `columns` of [tracker] in campaign.toml.",
        )
        return None
    if not timed:
        problems.warning(
            "planned-times",
            planned.file,
            "the tracker files hold no times: the planned times are used.",
            "export the time of every point and name its cell t_s or time in `columns` of [tracker].",
        )
    taken = slice(None) if timed else of_plan
    elapsed, clock = None, None
    if source[0].clock is None:
        elapsed = np.concatenate([table.elapsed_s for table in source if table.elapsed_s is not None])[taken]
        order = np.argsort(elapsed, kind="stable")
        elapsed = elapsed[order]
    else:
        clocks = [table.clock for table in source if table.clock is not None]
        micros = np.concatenate([item.micros for item in clocks])[taken]
        order = np.argsort(micros, kind="stable")
        clock = Clock(micros[order], min(clocks, key=lambda item: item.first_micros).first)
    rows = of_plan[order]
    numbers = {name: values[rows] for name, values in planned.numbers.items()}
    for name in XYZ:
        numbers[name] = np.concatenate([table.numbers[name] for table in tables])[order]
    texts = {name: tuple(values[i] for i in rows.tolist()) for name, values in planned.texts.items()}
    if all("station" in table.texts for table in tables):
        stations = [name for table in tables for name in table.texts["station"]]
        texts["station"] = tuple(stations[i] for i in order.tolist())
    source_of_plan = replace(planned.matched.source, rows=planned.rows[rows])
    return Table("tracker", Matched(source_of_plan, planned.matched.columns), elapsed, clock, numbers, texts)


def _moments(tables: Sequence[Table]) -> Floats:
    """Something that rises with the time of measuring, over the rows of all files: their times, else their order."""
    if all(table.clock is not None for table in tables):
        return np.concatenate([table.clock.micros / 1e6 for table in tables if table.clock is not None])
    if all(table.elapsed_s is not None for table in tables):
        return np.concatenate([table.elapsed_s for table in tables if table.elapsed_s is not None])
    return np.arange(float(sum(len(table.rows) for table in tables)))


def _has_time(table: Table) -> bool:
    return table.clock is not None or table.elapsed_s is not None

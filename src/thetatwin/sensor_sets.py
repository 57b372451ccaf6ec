"""Sensors at chosen places: from the table of `thetacomp place` to a virtual machine that carries exactly these."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from pathlib import Path

from thetacomp.errors import InputError, Problem
from thetacomp.machine import SensorRole
from thetatwin.description import Description, Lump, Source, TwinSensor
from thetatwin.mesh import BodyMesh, mesh_body, nearest_surface_node, sides

PLACED = "place_"  # ids are place_1, place_2, …: the rank, and no mistaking them for the publication's theta_1 …
FARTHEST_MM = 5.0  # places.csv is rounded to 0.1 mm; distances of nodes are many times larger
_NUMBERS = ("rank", "x_mm", "y_mm", "z_mm")
_COLUMNS = ("strategy", "rank", "part", "x_mm", "y_mm", "z_mm")
_WRITTEN_BY = "use a places.csv as `thetacomp place` writes it"


def read_places(path: str | Path, strategy: str = "displacement") -> tuple[TwinSensor, ...]:
    """The places of one strategy as sensors `place_<rank>`, in the order of their ranks.

    Reads `strategy, rank, part, x_mm, y_mm, z_mm`; other columns are not needed. Whether the machine has such a place,
    what its role is and how it is called in words `with_sensors` says. Raises InputError with every problem found.
    """
    file, problems = str(path), list[Problem]()
    table = _rows(Path(path), file)
    known = list(dict.fromkeys(row["strategy"] for _, row in table))
    own = [(line, row) for line, row in table if row["strategy"] == strategy]
    if not own:
        found = f"found {', '.join(known)}" if known else "the table has no rows"
        message = f"there is no place of the strategy {strategy!r}; {found}."
        raise InputError([Problem("error", "empty-strategy", file, message, "name one of the table with --strategy.")])
    sensors: dict[int, TwinSensor] = {}
    for line, row in own:
        values = [_number(row[name], name, file, line, problems) for name in _NUMBERS]
        if None in values:
            continue
        rank, x, y, z = (float(v) for v in values if v is not None)
        if rank < 1 or rank != int(rank) or int(rank) in sensors:
            message = f"found the rank {row['rank']}, expected 1, 2, 3 …, each once."
            problems.append(Problem("error", "rank", file, message, _WRITTEN_BY + ".", line, "rank"))
            continue
        sensors[int(rank)] = TwinSensor(
            id=f"{PLACED}{int(rank)}", location="", role="structure", place=row["part"], at_mm=(x, y, z)
        )
    if problems:
        raise InputError(problems)
    return tuple(sensors[rank] for rank in sorted(sensors))


def _rows(path: Path, file: str) -> list[tuple[int, dict[str, str]]]:
    """Rows of the file with their line. Raises InputError where it is no such table."""

    def refuse(code: str, message: str, fix: str, line: int | None = None) -> InputError:
        return InputError([Problem("error", code, file, message, fix, line)])

    try:
        reader = csv.reader(io.StringIO(path.read_text(encoding="utf-8-sig")), strict=True)
        lines = [(reader.line_num, [cell.strip() for cell in cells]) for cells in reader if cells]
    except FileNotFoundError:
        raise refuse("missing", "there is no such file.", f"{_WRITTEN_BY}.") from None
    except IsADirectoryError:
        raise refuse(
            "missing", "this is a folder, not a table.", f"name the file in it: {path / 'places.csv'}."
        ) from None
    except (UnicodeDecodeError, csv.Error):
        raise refuse("text", "this is not a text table (UTF-8, separated by commas).", f"{_WRITTEN_BY}.") from None
    head = lines[0][1] if lines else []
    missing = [name for name in _COLUMNS if name not in head]
    if missing:
        found = f"found {', '.join(head)}" if any(head) else "the file is empty"
        raise refuse("missing-column", f"there is no column {', '.join(missing)}; {found}.", f"{_WRITTEN_BY}.", 1)
    uneven = [line for line, cells in lines[1:] if len(cells) != len(head)]
    if uneven:
        message = f"this row has not {len(head)} cells as the header has."
        raise refuse("row", message, "write numbers with a decimal point, and no row shorter than others.", uneven[0])
    return [(line, dict(zip(head, cells, strict=True))) for line, cells in lines[1:]]


def _number(text: str, column: str, file: str, line: int, problems: list[Problem]) -> float | None:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isfinite(value):
        return value
    message = f"found {text!r}, expected a number."
    problems.append(Problem("error", "number", file, message, "write a number with a decimal point.", line, column))
    return None


def with_sensors(description: Description, sensors: Sequence[TwinSensor], refinement: float = 1.0) -> Description:
    """The machine with these sensors instead of its own; everything else stays.

    A sensor on a small part has role and axis of the one that sat there, else those of the part's heat source; a sensor
    on a casting belongs to the structure. Heat sources and axes name the sensor on the part where theirs sat, and a
    source the one on the part that takes most of its heat; what named a sensor that is gone names none. Places on
    castings must be nodes of the surface of the mesh of this `refinement`. Raises InputError with every problem found.
    """
    problems: list[Problem] = []
    lumps = {lump.name: lump for lump in description.lumps}
    meshes = {
        body.name: mesh_body(body, refinement)
        for body in description.bodies
        if any(sensor.place == body.name for sensor in sensors)
    }
    carried = [_carried(description, sensor, lumps, meshes, problems) for sensor in sensors]
    _each_once(sensors, meshes, problems)
    if problems:
        raise InputError(problems)
    kept = {sensor.id for sensor in carried}
    on_part = {sensor.place: sensor.id for sensor in carried if sensor.place in lumps}
    places = {sensor.id: sensor.place for sensor in description.sensors}

    def heir(gone: str | None) -> str | None:
        return gone if gone in kept else on_part.get(places.get(gone or "", ""))

    sources = tuple(
        source.model_copy(update={"sensor": heir(source.sensor) or on_part.get(_main_part(source))})
        for source in description.sources
    )
    axes = tuple(axis.model_copy(update={"sensor": heir(axis.sensor)}) for axis in description.axes)
    changed = {"sensors": tuple(carried), "sources": sources, "axes": axes}
    return Description.model_validate({**dict(description), **changed})


def _main_part(source: Source) -> str:
    """Where most of a source's heat goes."""
    return max(source.shares, key=lambda place: source.shares[place])


def _carried(
    description: Description,
    sensor: TwinSensor,
    lumps: dict[str, Lump],
    meshes: dict[str, BodyMesh],
    problems: list[Problem],
) -> TwinSensor:
    """The sensor with role, axis and words of its place; what is wrong with the place is noted."""
    if sensor.place in meshes:
        mesh = meshes[sensor.place]
        node, apart_mm = nearest_surface_node(mesh, sensor.at_mm)
        _near(sensor, mesh.points_m[node] * 1e3, apart_mm, "node of its surface", problems)
        where = _face_words(sides(mesh, [node])[0])
        return sensor.model_copy(update={"location": sensor.location or _words(sensor.place, where, sensor.at_mm)})
    if sensor.place in lumps:
        lump = lumps[sensor.place]
        _near(sensor, lump.at_mm, math.dist(lump.at_mm, sensor.at_mm), "place of that part", problems)
        role, axis, what = _role(description, lump.name)
        location = sensor.location or _words(lump.name, f" ({what})" if what else "", sensor.at_mm)
        return sensor.model_copy(update={"role": role, "axis": axis, "location": location})
    if sensor.place not in {p.name for p in description.patches} | {r.name for r in description.rods}:
        known = ", ".join([*(body.name for body in description.bodies), *lumps])
        message = f"{description.name} has no part {sensor.place!r}; known are {known}."
        fix = "use places that were chosen on this machine, by the same preset."
        problems.append(Problem("error", "unknown-part", f"sensor {sensor.id}", message, fix))
    return sensor


def _near(sensor: TwinSensor, place_mm: Sequence[float], apart_mm: float, what: str, problems: list[Problem]) -> None:
    if apart_mm > FARTHEST_MM:
        here, there = (", ".join(f"{v:.1f}" for v in at) for at in (sensor.at_mm, place_mm))
        message = (
            f"({here}) mm on {sensor.place} is {apart_mm:.0f} mm away from the nearest {what}, ({there}) mm;"
            f" at most {FARTHEST_MM:g} mm are allowed."
        )
        fix = "take that one, or places that were chosen on this machine, by the same preset."
        problems.append(Problem("error", "no-such-place", f"sensor {sensor.id}", message, fix))


def _each_once(sensors: Sequence[TwinSensor], meshes: dict[str, BodyMesh], problems: list[Problem]) -> None:
    """No id and, among parts and nodes of castings, no place may stand twice."""
    ids: set[str] = set()
    taken: dict[tuple[str, object], str] = {}
    for sensor in sensors:
        at = nearest_surface_node(meshes[sensor.place], sensor.at_mm)[0] if sensor.place in meshes else sensor.at_mm
        other = taken.setdefault((sensor.place, at), sensor.id)
        if sensor.id in ids or other != sensor.id:
            message = (
                f"it sits on {sensor.place} where {other} sits." if other != sensor.id else "this id stands twice."
            )
            problems.append(Problem("error", "twice", f"sensor {sensor.id}", message, "leave one of them out."))
        ids.add(sensor.id)


def _role(description: Description, part: str) -> tuple[SensorRole, str | None, str]:
    """Role and axis of a sensor on a small part, and what that sensor was called in words."""
    for sensor in description.sensors:
        if sensor.place == part:
            return sensor.role, sensor.axis, sensor.location
    if part == description.cooling.lump:
        return "fluid", None, ""
    for source in description.sources:
        if source.bearing is not None and source.bearing.film == part:
            return "bearing", None, ""
        if source.axis is not None and _main_part(source) == part:
            return "drive", source.axis, ""
    return "structure", None, ""


def _words(part: str, where: str, at_mm: Sequence[float]) -> str:
    """Such as "column, face towards +X, at X 1050, Y 5348, Z 238 mm"."""
    at = ", ".join(f"{letter} {round(value)}" for letter, value in zip("XYZ", at_mm, strict=True))
    return f"{part}{where}, at {at} mm"


def _face_words(side: str) -> str:
    """Such as ", edge between +X and -Z" for "+X-Z"."""
    looks = [side[k : k + 2] for k in range(0, len(side), 2)]
    if len(looks) == 1:
        return f", face towards {looks[0]}"
    return f", {'edge' if len(looks) == 2 else 'corner'} between {', '.join(looks[:-1])} and {looks[-1]}"

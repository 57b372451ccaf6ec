"""The file of the ruler: numbers, inputs and models of one version of the program, in one compressed archive."""

from __future__ import annotations

import io
import json
import platform
import sys
import tarfile
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path

from ruler.tables import Table

NUMBERS, LIBRARIES, INPUTS, MODELS = "numbers.json", "libraries.json", "inputs", "models"


def pack(out: Path, tables: Mapping[str, Table], folder: Path) -> None:
    """Write `tables`, and the folders `inputs` and `models` of `folder`, to the archive `out`."""
    numbers = {name: asdict(table) for name, table in sorted(tables.items())}
    files = {NUMBERS: json.dumps(numbers, ensure_ascii=False, separators=(",", ":")).encode()}
    files[LIBRARIES] = json.dumps(libraries()).encode()
    for path in sorted(p for part in (INPUTS, MODELS) for p in (folder / part).rglob("*") if p.is_file()):
        files[path.relative_to(folder).as_posix()] = path.read_bytes()
    out.parent.mkdir(parents=True, exist_ok=True)
    with tarfile.open(out, "w:xz", preset=9) as archive:
        for name, content in files.items():
            entry = tarfile.TarInfo(name)
            entry.size = len(content)
            archive.addfile(entry, io.BytesIO(content))


def libraries() -> dict[str, str]:
    """Versions of what computes: with others the last digits may differ."""
    return {"Python": platform.python_version(), **{name: version(name) for name in ("numpy", "scipy", "scikit-learn")}}


def unpack(path: Path, folder: Path) -> dict[str, Table]:
    """Unpack `inputs` and `models` into `folder` and return the tables. Says where other libraries are in use now."""
    with tarfile.open(path, "r:xz") as archive:
        archive.extractall(folder, filter="data")
    then, now = json.loads((folder / LIBRARIES).read_text(encoding="utf-8")), libraries()
    for name in (name for name in now if then.get(name) != now[name]):
        print(f"stored with {name} {then.get(name)}, now {now[name]}: the last digits may differ", file=sys.stderr)
    numbers = json.loads((folder / NUMBERS).read_text(encoding="utf-8"))
    return {name: Table(one["kind"], one["columns"], tuple(one["keys"])) for name, one in numbers.items()}

"""Where a thermometer can be mounted on the virtual machine, as a TOML file says it, and the candidates that follow."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from thetacomp.arrays import Floats, Ints
from thetacomp.errors import AnalysisError, InputError, Problem
from thetacomp.machine import Strict
from thetatwin.description import Description, Point
from thetatwin.files import load_toml
from thetatwin.mesh import BodyMesh, patch_weights, sides
from thetatwin.virtual_machine import VirtualMachine

MOUNTINGS = ("tk6920_mounting",)
_TOUCH_MM = 0.01


class KeepOut(Strict):
    """A box in which nothing can be mounted on `body`; with all axes at zero, as bodies are described."""

    name: str
    body: str
    from_mm: Point
    to_mm: Point


class Mounting(Strict):
    """Outer faces of all bodies are open except `keep_off` (names of patches) and the boxes in `keep_out`.

    `parts` are the lumps that take a thermometer; `inside` opens the faces of cavities as well; chosen places stand
    at least `apart_mm` from each other.
    """

    format: Literal[1]
    apart_mm: Annotated[float, Field(ge=0)]
    inside: bool = False
    parts: tuple[str, ...] = ()
    keep_off: tuple[str, ...] = ()
    keep_out: tuple[KeepOut, ...] = ()


def load_mounting(name_or_path: str | Path, description: Description) -> Mounting:
    """Read a bundled file ("tk6920_mounting") or a TOML file. Raises InputError with everything that is wrong in it."""
    mounting = load_toml(Mounting, name_or_path, MOUNTINGS)
    bodies, patches = {b.name for b in description.bodies}, {p.name for p in description.patches}
    lumps = {lump.name for lump in description.lumps}
    wanted = [
        *(("parts", name, lumps) for name in mounting.parts),
        *(("keep_off", name, patches) for name in mounting.keep_off),
        *((f"keep_out {box.name}", box.body, bodies) for box in mounting.keep_out),
    ]
    problems = [
        Problem(
            "error", "unknown", str(name_or_path),
            f"{owner} names {name!r}, which {description.name} does not have.",
            f"use one of {', '.join(sorted(known))}.",
        )
        for owner, name, known in wanted
        if name not in known
    ]  # fmt: skip
    if problems:
        raise InputError(problems)
    return mounting


@dataclass(frozen=True)
class Candidates:
    """Places where a thermometer can be mounted, n of them: states of the full model, names, coordinates.

    `part` is the body or lump; `side` where its free faces look, such as "-X" or "-X+Y", "" on a lump;
    `at_mm` (n, 3) with all axes at zero.
    """

    state: Ints
    part: tuple[str, ...]
    side: tuple[str, ...]
    at_mm: Floats


def candidates(machine: VirtualMachine, mounting: Mounting) -> Candidates:
    """All nodes that the mounting file leaves, body by body, then parts. Raises AnalysisError where none is left."""
    description, system = machine.description, machine.system
    state: list[int] = []
    part: list[str] = []
    side: list[str] = []
    at: list[Floats] = []
    for body in description.bodies:
        mesh = machine.meshes[body.name]
        nodes, looks = _open_nodes(mesh, mounting, description)
        state += [system.offset[body.name] + int(k) for k in nodes]
        part += [body.name] * len(nodes)
        side += looks
        at += list(mesh.points_m[nodes] * 1e3)
    for lump in description.lumps:
        if lump.name in mounting.parts:
            state.append(system.offset[lump.name])
            part.append(lump.name)
            side.append("")
            at.append(np.array(lump.at_mm))
    if not state:
        raise AnalysisError("no place is left for a sensor. Fix: the keep-out boxes of the mounting file cover all.")
    return Candidates(np.array(state, dtype=np.int64), tuple(part), tuple(side), np.array(at))


def _open_nodes(mesh: BodyMesh, mounting: Mounting, description: Description) -> tuple[Ints, list[str]]:
    """Nodes of a body that are open, in order, and where their faces look."""
    faces = mesh.faces
    allowed = np.zeros(len(mesh.points_m), dtype=bool)
    allowed[faces.corners if mounting.inside else faces.corners[~faces.inner]] = True
    if not mounting.inside:
        allowed[faces.corners[faces.inner]] = False  # the rim of a bore or an open cavity
    for patch in description.patches:
        if patch.body == mesh.name and patch.name in mounting.keep_off:
            allowed[patch_weights(mesh, patch).nodes] = False
    points_mm = mesh.points_m * 1e3
    for box in mounting.keep_out:
        if box.body == mesh.name:
            lo, hi = np.array(box.from_mm) - _TOUCH_MM, np.array(box.to_mm) + _TOUCH_MM
            allowed &= ~np.all((points_mm >= lo) & (points_mm <= hi), axis=1)
    nodes = np.flatnonzero(allowed)
    return nodes, sides(mesh, nodes)

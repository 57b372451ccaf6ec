"""The program under test: its command line, and the few functions that are called for numbers in full precision.

This is the only place that knows where these functions live. A new home goes to the front of its line in HOMES.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

Floats = np.ndarray[Any, np.dtype[np.float64]]

HOMES: dict[str, tuple[str, ...]] = {
    "load_model": ("thetacomp.model.load", "thetacomp.model.document", "thetacomp.models.document"),
    "predict": ("thetacomp.model.predict", "thetacomp.model.prediction", "thetacomp.prediction"),
    "predict_volume": ("thetacomp.model.volumetric", "thetacomp.model.predict", "thetacomp.volumetric"),
    "Temperatures": ("thetacomp.campaign", "thetacomp.data.campaign"),
    "Duty": ("thetacomp.campaign", "thetacomp.data.campaign"),
}
DONE, NOT_FIT = 0, 3


class ProgramError(Exception):
    """The program under test could not do what the ruler asked."""


@dataclass(frozen=True)
class Request:
    """A prediction to ask for, n rows: one axis each (`axis`, `position_mm`), or all axes (`at_mm`).

    `temperatures` and `duty` hold `t_s` and a column for each sensor or quantity. An empty `axis` asks for the drift.
    """

    name: str
    temperatures: Mapping[str, Floats]
    duty: Mapping[str, Floats] | None
    reference: str
    t_s: Floats
    axis: tuple[str, ...] = ()
    position_mm: Floats = field(default_factory=lambda: np.zeros(0))
    at_mm: Mapping[str, Floats] = field(default_factory=dict)
    tool_length_mm: Floats | None = None


def _find(name: str) -> Any:
    """The class or function of that name, from the first of its homes that has it."""
    for home in HOMES[name]:
        try:
            found = getattr(importlib.import_module(home), name)
        except (ImportError, AttributeError):
            continue
        if callable(found):
            return found
    raise ProgramError(f"{name} is in none of {', '.join(HOMES[name])}: add its new home to bench/ruler/program.py.")


def load_model(path: Path) -> Any:
    """A stored model, as the program under test reads it."""
    return _find("load_model")(path)


def predicted(model: Any, request: Request) -> dict[str, list[Any]]:
    """Errors and 95 % bounds in µm with all digits, and the two flags: one column each, n rows."""
    series = {name: values for name, values in request.temperatures.items() if name != "t_s"}
    temperatures = _find("Temperatures")(
        request.temperatures["t_s"], tuple(series), np.column_stack(list(series.values()))
    )
    duty = None
    if request.duty is not None:
        columns = {name: values for name, values in request.duty.items() if name != "t_s"}
        duty = _find("Duty")(request.duty["t_s"], columns)
    if request.at_mm:
        found = _find("predict_volume")(
            model,
            temperatures,
            request.t_s,
            request.at_mm,
            request.tool_length_mm,
            reference=request.reference,
            duty=duty,
        )
    else:
        found = _find("predict")(model, temperatures, request, reference=request.reference, duty=duty)
    out: dict[str, list[Any]] = {}
    for kind in ("error", "lower", "upper"):
        for k, direction in enumerate("XYZ"):
            values = np.asarray(getattr(found, f"{kind}_um"))[:, k]
            out[f"d{direction}_{kind}_um"] = [float(v) if np.isfinite(v) else None for v in values]
    for flag in ("in_domain", "missing"):
        out[flag] = [bool(v) for v in getattr(found, flag)]
    return out


def command(work: Path, *arguments: str | Path) -> dict[str, Any]:
    """Run `thetacomp … --json` in the folder `work` and return its JSON object. Raises ProgramError where it fails."""
    words = [str(part) for part in arguments]
    print(f"  thetacomp {' '.join(words)}", file=sys.stderr, flush=True)
    done = subprocess.run(
        [sys.executable, "-m", "thetacomp", *words, "--json"],
        cwd=work,
        env={**os.environ, "PYTHONUTF8": "1", "COLUMNS": "120"},
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    if done.returncode not in (DONE, NOT_FIT):
        raise ProgramError(
            f"`thetacomp {' '.join(words)}` ended with {done.returncode}:\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
        )
    document: dict[str, Any] = json.loads(done.stdout)
    return document


def whereabouts() -> str:
    """The folder of the program under test."""
    return str(Path(str(importlib.import_module("thetacomp").__file__)).parent)

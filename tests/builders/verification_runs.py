"""Machine folders with one run off and others on, of known truth: what verification has to find out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from small_models import Part, component, document, term

from thetacomp.model.document import ModelDocument

Floats = NDArray[np.float64]

AXES = {"X": ("+X", 2000.0), "Y": ("+Y", 3000.0), "W": ("+Z", 1000.0)}
SENSORS = ("tx", "ty", "tw", "oil", "hall")
DRIVE = {"X": "tx", "Y": "ty", "W": "tw"}
TARGETS = 11
POINT_SD_UM = 3.0
ANGLE_SD_URAD = 1.5

# The machine's law, cooling off: (intercept µm/K, slope µm/m/K) of the rise of the axis' drive sensor.
LAW = {
    "EXX": (3.0, 9.0),
    "EYX": (-6.0, 2.0),
    "EZX": (5.0, -3.0),
    "EXY": (11.0, 12.0),
    "EYY": (8.0, 7.0),
    "EZY": (-9.0, -8.0),
    "EXW": (4.0, 3.0),
    "EYW": (-3.0, 5.0),
    "EZW": (7.0, 9.0),
}
Shares = Mapping[str, float]


@dataclass(frozen=True)
class Run:
    """One campaign. `heat` scales the rises, `share` of the correction reaches each component (default for all).

    `law` gives the factor on the machine's own law by component and elapsed hours: another cooling mode.
    `rest_um` is the standard deviation of what no thermometer knows, one line a sweep.
    """

    name: str
    compensation: str = "off"
    heat: float = 1.0
    share: float = 0.0
    shares: Shares = field(default_factory=dict)
    mode: str = "no cooling"
    tables: tuple[str, ...] = ("pitch",)
    law: Callable[[str, Floats], Floats] | None = None
    rest_um: float = 4.0
    rounds: int = 9


def rises_K(t_s: Floats, heat: float) -> dict[str, Floats]:
    """Rises of the sensors: warm-up for six hours, then cool-down; different time constants; a slow hall."""
    out = {}
    for name, size_K, tau_h in (("tx", 8.0, 2.0), ("ty", 7.0, 3.0), ("tw", 12.0, 1.2), ("oil", 10.0, 0.8)):
        t_h = np.maximum(t_s / 3600.0 - 0.9, 0.0)
        on_h = np.minimum(t_h, 6.0)
        warm = size_K * (1.0 - np.exp(-on_h / tau_h))
        out[name] = heat * warm * np.exp(-np.maximum(t_h - 6.0, 0.0) / tau_h)
    out["hall"] = 0.3 * t_s / 3600.0
    return out


def write_folder(path: Path, runs: list[Run], seed: int = 1) -> Path:
    """Write machine.toml and every run as a campaign; the first sweeps (before any heat) are the cold block."""
    rng = np.random.default_rng(seed)
    lines = ["format = 1", "[machine]", 'name = "known mill"']
    for name, (direction, travel_mm) in AXES.items():
        lines += ["[[axes]]", f'name = "{name}"', f'direction = "{direction}"', f"travel_mm = [0.0, {travel_mm}]"]
    for sensor in SENSORS:
        owner = next((axis for axis, own in DRIVE.items() if own == sensor), None)
        role = "drive" if owner else "fluid" if sensor == "oil" else "ambient"
        lines += ["[[sensors]]", f'id = "{sensor}"', f'role = "{role}"', *([f'axis = "{owner}"'] if owner else [])]
    path.mkdir(parents=True, exist_ok=True)
    (path / "machine.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    geometry = {name: rng.normal(0.0, 8.0, 3) for name in LAW}
    for run in runs:
        _write_run(path / "campaigns" / run.name, run, geometry, rng)
    return path


def _write_run(path: Path, run: Run, geometry: Mapping[str, Floats], rng: np.random.Generator) -> None:
    path.mkdir(parents=True)
    tables = ", ".join(f'"{name}"' for name in run.tables)
    (path / "campaign.toml").write_text(
        f'instrument = "tracker"\ninstrument_u_um = {2 * POINT_SD_UM}\ninstrument_u_um_per_m = {2 * ANGLE_SD_URAD}\n'
        f'compensation = "{run.compensation}"\nactive_tables = [{tables}]\nmode = "{run.mode}"\n',
        encoding="utf-8",
    )
    clock = np.arange(0.0, 3600.0 * run.rounds + 1.0, 120.0)
    rises = rises_K(clock, run.heat)
    rows = ["t_s," + ",".join(SENSORS)]
    columns = [20.0 + rng.uniform(-1, 1) + rises[s] + rng.normal(0.0, 0.03, len(clock)) for s in SENSORS]
    rows += [f"{t:.0f}," + ",".join(f"{c[i]:.3f}" for c in columns) for i, t in enumerate(clock)]
    (path / "temperatures.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    rows = ["t_s,axis,position_mm,dX_um,dY_um,dZ_um"]
    for round_ in range(run.rounds):
        for k, (axis, (_, travel_mm)) in enumerate(AXES.items()):
            out = np.linspace(0.0, travel_mm, TARGETS)
            position = np.concatenate([out, out[::-1]])
            t_s = 3600.0 * round_ + 900.0 * k + 30.0 * np.arange(1, len(position) + 1)
            error = sweep_um(run, axis, position, t_s, geometry, rng, cold=round_ == 0)
            rows += [
                f"{t:.0f},{axis},{p:.0f},{e[0]:.2f},{e[1]:.2f},{e[2]:.2f}"
                for t, p, e in zip(t_s, position, error, strict=True)
            ]
    (path / "sweeps.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")


def sweep_um(
    run: Run,
    axis: str,
    position_mm: Floats,
    t_s: Floats,
    geometry: Mapping[str, Floats],
    rng: np.random.Generator,
    *,
    cold: bool,
) -> Floats:
    """Measured error of one sweep, (n, 3): geometry, what the machine does less what is corrected, rest and noise."""
    lever = (position_mm - AXES[axis][1] / 2) / 1000.0
    rise = rises_K(t_s, run.heat)[DRIVE[axis]]
    error = np.empty((len(t_s), 3))
    for j, direction in enumerate("XYZ"):
        name = f"E{direction}{axis}"
        a, b, c = geometry[name]
        wanted = (LAW[name][0] + LAW[name][1] * lever) * rise
        own = wanted if run.law is None else wanted * run.law(name, t_s / 3600.0)
        rest = np.zeros(len(t_s))
        if not cold:
            rest = run.rest_um * (rng.standard_normal() + rng.standard_normal() * lever / AXES[axis][1] * 1000.0)
        shape = a * lever + b * lever**2 + c * np.sin(3.0 * lever)
        angle = rng.normal(0.0, ANGLE_SD_URAD) * lever
        share = run.shares.get(name, run.share)
        error[:, j] = shape + own - share * wanted + rest + angle + rng.normal(0.0, POINT_SD_UM, len(t_s))
    return error


def true_model(leave_out: tuple[str, ...] = (), mode: str = "no cooling", **other: Part) -> ModelDocument:
    """The machine's law as a stored model, without some components and with others in their place."""
    parts = {}
    for name, (intercept, slope) in LAW.items():
        if name in leave_out:
            continue
        _, travel_mm = AXES[name[2]]
        parts[name] = component(
            name, term(0.0, intercept, sd=4.0), term(0.0, slope, sd=2.0), {DRIVE[name[2]]: 20.0},
            p=(travel_mm / 2, 0.0, travel_mm),
        )  # fmt: skip
    rises = dict.fromkeys(DRIVE.values(), (-1.0, 15.0))
    return document({name: direction for name, (direction, _) in AXES.items()}, parts | other, rises, mode=mode)

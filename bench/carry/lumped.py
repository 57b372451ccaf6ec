"""A lumped machine with its sensors and its errors, measured for some campaigns and written as a machine folder."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from carry.network import Drive, Floats, Network, REFERENCE_degC, lagged, simulate
from carry.work import STEP_S, Air, Kind, Work, air_degC, joined, rest, work

CARTESIAN = "XYZ"
Gains = Mapping[str, Sequence[float]]  # node: X, Y, Z


@dataclass(frozen=True)
class Heat:
    """Where power goes: W at full speed or feed into a node. `friction` of bearings and nuts falls as they warm."""

    node: str
    source: str  # "spindle", an axis, "coolant" (a pump) or "on" (whatever stands switched on)
    power_W: float
    friction: bool = False


@dataclass(frozen=True)
class Probe:
    """A thermometer: id, place (a node or a fluid), role, axis, share of air in its reading, and lag."""

    id: str
    place: str
    role: str = "structure"
    axis: str = ""
    air_share: float = 0.0
    lag_s: float = 30.0


@dataclass(frozen=True)
class Slope:
    """Error along a travel for each K of a node: µm/m and µm/m² in X, Y, Z."""

    axis: str
    node: str
    slope_um_per_m: tuple[float, float, float]
    bend_um_per_m2: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Plan:
    """How campaigns go: `hours` of `kind`, then `cool_h` of rest; before it a shift and a pause (ranges in h).

    `sweep_every_min` 0: drift alone, read every `drift_every_s`.
    """

    kind: Kind
    hours: tuple[float, float]
    cool_h: float
    before_h: tuple[float, float]
    pause_h: tuple[float, float]
    drift_every_s: float
    sweep_every_min: float = 0.0
    points: int = 9


@dataclass(frozen=True)
class LumpedMachine:
    """Everything that makes one machine. `drift` and `curved` are µm/K and µm/K² of the nodes' rises above 20 °C in X,
    Y, Z; what is curved makes a kelvin count differently at another level. `travel_mm` names the axes X, Y, Z."""

    name: str
    network: Network
    heats: tuple[Heat, ...]
    probes: tuple[Probe, ...]
    drift: Gains
    plan: Plan
    air: Air
    seed: int
    directions: str = "XYZ"
    curved: Gains = field(default_factory=dict)
    slopes: tuple[Slope, ...] = ()
    travel_mm: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    rpm_max: float = 4000.0
    with_duty: bool = True
    sensor_noise_K: float = 0.03
    sensor_resolution_K: float = 0.1
    sample_s: float = 60.0
    gauge_noise_um: float = 0.4
    gauge_resolution_um: float = 0.1
    coolant_degC: float = 20.0


@dataclass(frozen=True)
class Day:
    """One campaign as it happened, minute by minute from its start: nodes, fluids, work (n rows each)."""

    t_s: Floats
    node_degC: Floats
    fluid_degC: Floats
    work: Work


def make_folder(machine: LumpedMachine, folder: Path, campaigns: int) -> None:
    """Live and measure some campaigns, and write them."""
    folder.mkdir(parents=True)
    (folder / "machine.toml").write_text(_machine_toml(machine), encoding="utf-8")
    for number in range(campaigns):
        rng = np.random.default_rng([machine.seed, number])
        path = folder / "campaigns" / f"c{number + 1:02d}"
        path.mkdir(parents=True)
        _write_campaign(machine, path, live(machine, rng), rng)


def live(machine: LumpedMachine, rng: np.random.Generator) -> Day:
    """A shift before, a pause, and the campaign: so it starts at a level of its own."""
    plan, axes = machine.plan, len(machine.travel_mm)
    before = work(plan.kind, round(60 * rng.uniform(*plan.before_h)), axes, rng)
    pause = rest(round(60 * rng.uniform(*plan.pause_h)), axes)
    cold = rest(round(2 * _round_s(machine) / STEP_S) if plan.sweep_every_min else 0, axes)
    shift = work(plan.kind, round(60 * rng.uniform(*plan.hours)), axes, rng)
    whole = joined(before, pause, cold, shift, rest(round(60 * plan.cool_h), axes))
    begin = len(before) + len(pause)
    air = air_degC(machine.air, len(whole), rng)
    drive = _drive(machine, whole, air)
    node_degC = simulate(machine.network, drive, np.full(len(machine.network.nodes), air[0]), STEP_S)
    own = slice(begin, None)
    work_of_it = Work(whole.spindle[own], whole.feed[own], whole.coolant[own])
    return Day(STEP_S * np.arange(len(work_of_it)), node_degC[own], drive.fluid_degC[own], work_of_it)


def _drive(machine: LumpedMachine, done: Work, air: Floats) -> Drive:
    network, axes = machine.network, list(machine.travel_mm)
    level = {"spindle": done.spindle, "coolant": done.coolant, "on": np.ones(len(done))}
    level |= {axis: done.feed[:, k] for k, axis in enumerate(axes)}
    heat, friction = np.zeros((2, len(done), len(network.nodes)))
    for one in machine.heats:
        share = level[one.source]
        # Friction grows with speed a little faster than in proportion.
        made = one.power_W * (0.6 * share + 0.4 * share**2 if one.friction else share)
        (friction if one.friction else heat)[:, network.node(one.node)] += made
    fluid = np.column_stack([air if name == "air" else _fluid(machine, name, air) for name in network.fluids])
    flow = np.column_stack([done.coolant if name == "coolant" else done.spindle for name in network.fluids])
    return Drive(heat, friction, fluid, flow)


def _fluid(machine: LumpedMachine, name: str, air: Floats) -> Floats:
    """A coolant is held near its own level; floor and cooling water follow the mean of the air by half."""
    if name == "coolant":
        return np.asarray(machine.coolant_degC + 0.15 * (air - air.mean()))
    return np.full(len(air), 0.5 * (air.mean() + REFERENCE_degC))


def error_um(machine: LumpedMachine, day: Day, t_s: Floats, axis: str, position_mm: Floats) -> Floats:
    """True thermal error (n, 3) at moments, with one axis away from the middle of its travel ("": none)."""
    rise_K = np.column_stack([np.interp(t_s, day.t_s, column) for column in day.node_degC.T]) - REFERENCE_degC
    nodes = machine.network.nodes
    out = rise_K @ _table(machine.drift, nodes) + rise_K**2 @ _table(machine.curved, nodes)
    if axis:
        lever_m = (position_mm - np.mean(machine.travel_mm[axis])) / 1000.0
        for slope in machine.slopes:
            if slope.axis == axis:
                own_K = rise_K[:, nodes.index(slope.node)]
                out += np.outer(own_K * lever_m, slope.slope_um_per_m)
                out += np.outer(own_K * lever_m**2, slope.bend_um_per_m2)
    return out


def _table(gains: Gains, nodes: Sequence[str]) -> Floats:
    out = np.zeros((len(nodes), 3))
    for node, gain in gains.items():
        out[nodes.index(node)] = gain
    return out


# --- what is measured and written ---


def _write_campaign(machine: LumpedMachine, path: Path, day: Day, rng: np.random.Generator) -> None:
    _write_temperatures(machine, path, day, rng)
    columns = [f"d{d}_um" for d in machine.directions]
    wanted = [CARTESIAN.index(d) for d in machine.directions]
    if machine.plan.sweep_every_min:
        _write_sweeps(machine, path, day, rng, columns, wanted)
    else:
        t_s = np.arange(0.0, day.t_s[-1], machine.plan.drift_every_s)
        start = error_um(machine, day, t_s[:1], "", t_s[:1])
        read = _gauge(machine, error_um(machine, day, t_s, "", t_s) - start, rng)[:, wanted]
        _write(path / "drift.csv", ["t_s", *columns], ([f"{t:.0f}", *map(_um, row)] for t, row in _rows(t_s, read)))
        (path / "campaign.toml").write_text('datum = "campaign"\nreference_s = 0\n', encoding="utf-8")
    if machine.with_duty:
        done = day.work
        feeds = [f"feed_{axis}_mm_min" for axis in machine.travel_mm]
        head = ["t_s", "spindle_rpm", *feeds]
        rows = zip(day.t_s, done.spindle * machine.rpm_max, done.feed * 10000.0, strict=True)
        _write(path / "duty.csv", head, ([f"{t:.0f}", f"{n:.0f}", *(f"{f:.0f}" for f in feed)] for t, n, feed in rows))


def _write_temperatures(machine: LumpedMachine, path: Path, day: Day, rng: np.random.Generator) -> None:
    network = machine.network
    air = day.fluid_degC[:, network.fluids.index("air")]
    places = {**dict(zip(network.nodes, day.node_degC.T, strict=True)),
              **dict(zip(network.fluids, day.fluid_degC.T, strict=True))}  # fmt: skip
    mixed = np.column_stack([(1 - p.air_share) * places[p.place] + p.air_share * air for p in machine.probes])
    true = lagged(mixed, np.array([p.lag_s for p in machine.probes]), STEP_S)
    t_s = np.arange(0.0, day.t_s[-1] + 1.0, machine.sample_s)
    read = np.column_stack([np.interp(t_s, day.t_s, column) for column in true.T])
    offset_K = np.random.default_rng([machine.seed, 999]).normal(0.0, 0.15, len(machine.probes))
    read = read + offset_K + rng.normal(0.0, machine.sensor_noise_K, read.shape)
    read = np.round(read / machine.sensor_resolution_K) * machine.sensor_resolution_K
    head = ["t_s", *(probe.id for probe in machine.probes)]
    _write(path / "temperatures.csv", head, ([f"{t:.0f}", *(f"{v:.3f}" for v in row)] for t, row in _rows(t_s, read)))


def _round_s(machine: LumpedMachine) -> float:
    """How long a round of sweeps takes."""
    return len(machine.travel_mm) * (2 * machine.plan.points * 8.0 + 60.0)


def _write_sweeps(
    machine: LumpedMachine, path: Path, day: Day, rng: np.random.Generator, columns: list[str], wanted: list[int]
) -> None:
    """Rounds of sweeps of all axes, out and back; the first two rounds are cold."""
    plan, rows, sweep = machine.plan, [], 0
    shape = np.random.default_rng([machine.seed, 998])
    geometry = {axis: shape.normal(0.0, 8.0, (3, 3)) for axis in machine.travel_mm}
    length_s = _round_s(machine)
    starts = [0.0, *np.arange(length_s, day.t_s[-1] - length_s, plan.sweep_every_min * 60.0)]
    for start in starts:
        now = start
        for axis, (low, high) in machine.travel_mm.items():
            out = np.linspace(low, high, plan.points)
            position = np.concatenate([out, out[::-1]])
            t_s = now + 30.0 + 8.0 * np.arange(len(position))
            s = (position - low) / (high - low) - 0.5
            cold = np.column_stack([s, s**2, np.sin(6.0 * s)]) @ geometry[axis]
            read = _gauge(machine, error_um(machine, day, t_s, axis, position) + cold, rng)[:, wanted]
            sign = ["+"] * plan.points + ["-"] * plan.points
            for t, p, d, row in zip(t_s, position, sign, read, strict=True):
                rows.append([f"{t:.0f}", axis, f"{p:.1f}", *map(_um, row), d, str(sweep)])
            sweep, now = sweep + 1, float(t_s[-1]) + 30.0
    _write(path / "sweeps.csv", ["t_s", "axis", "position_mm", *columns, "direction", "run"], rows)
    text = f'datum = "campaign"\nreference_s = {2 * length_s:.0f}\n'
    (path / "campaign.toml").write_text(text, encoding="utf-8")


def _gauge(machine: LumpedMachine, true_um: Floats, rng: np.random.Generator) -> Floats:
    step = machine.gauge_resolution_um
    return np.asarray(np.round((true_um + rng.normal(0.0, machine.gauge_noise_um, true_um.shape)) / step) * step)


def _machine_toml(machine: LumpedMachine) -> str:
    text = f'format = 1\n\n[machine]\nname = "{machine.name}"\norigin = "lumped network, made for bench-carry"\n'
    for axis, travel in machine.travel_mm.items():
        text += f'\n[[axes]]\nname = "{axis}"\ndirection = "+{axis}"\ntravel_mm = {list(travel)}\n'
    for probe in machine.probes:
        text += f'\n[[sensors]]\nid = "{probe.id}"\nrole = "{probe.role}"\nlocation = "{probe.place}"\n'
        text += f'axis = "{probe.axis}"\n' if probe.axis else ""
    return text


def _um(value: float) -> str:
    return f"{value + 0.0:.2f}"


def _rows(t_s: Floats, table: Floats) -> Iterable[tuple[float, Floats]]:
    return zip(t_s, table, strict=True)


def _write(path: Path, head: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(head)
        writer.writerows(rows)

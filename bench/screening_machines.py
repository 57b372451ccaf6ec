"""Healthy machines for the bench of screening, and faults to plant: lumped networks, and the virtual machine.

The networks share no code with the twin. Every machine has its own places, time constants, noise, resolution and
sampling; every campaign its own axes, speed, season, start (cold or warm), coolant and doors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm

from thetacomp.arrays import Floats
from thetacomp.campaign import Campaign, CampaignSettings, Drift, MachineFolder
from thetacomp.machine import Machine, Sensor
from thetacomp.model.temperatures import Temperatures
from thetatwin import duty
from thetatwin.campaigns import NEW_YEAR, make_twin
from thetatwin.conditions import load_conditions
from thetatwin.description import load_description
from thetatwin.hall import hall_inputs
from thetatwin.instruments import read_sensors
from thetatwin.operation import rest_state, simulate
from thetatwin.virtual_machine import VirtualMachine, build

HOUR_S = 3600.0
SIM_S = 20.0
KINDS = ("step", "offset", "swap", "drift", "frozen")
# name, role, heat capacity kJ/K, exchange with air W/K
NODES = [
    ("bed", "structure", 900.0, 25.0),
    ("column", "structure", 600.0, 25.0),
    ("table", "structure", 300.0, 15.0),
    ("headstock", "structure", 120.0, 12.0),
    ("foundation", "foundation", 4000.0, 10.0),
    ("spindle_front", "bearing", 12.0, 1.5),
    ("spindle_rear", "bearing", 10.0, 1.5),
    ("spindle_motor", "drive", 18.0, 6.0),
    *((f"{axis}_motor", "drive", 9.0, 3.0) for axis in "XYZ"),
    *((f"{axis}_bearing", "bearing", 5.0, 0.8) for axis in "XYZ"),
    *((f"{axis}_nut", "drive", 6.0, 0.8) for axis in "XYZ"),
    *((f"{axis}_guide", "guide", 60.0, 4.0) for axis in "XYZ"),
    ("tank", "fluid", 250.0, 20.0),
    ("cabinet", "structure", 40.0, 8.0),
]
NAMES = [node[0] for node in NODES]
LINKS = [
    ("bed", "column", 40.0), ("bed", "table", 8.0), ("bed", "foundation", 15.0), ("column", "headstock", 20.0),
    ("headstock", "spindle_front", 12.0), ("headstock", "spindle_rear", 10.0), ("headstock", "spindle_motor", 6.0),
    ("spindle_front", "spindle_rear", 3.0), ("bed", "X_guide", 15.0), ("table", "X_guide", 8.0),
    ("column", "Y_guide", 15.0), ("headstock", "Y_guide", 6.0), ("bed", "Z_guide", 12.0), ("column", "Z_guide", 8.0),
    ("bed", "tank", 2.0), ("column", "cabinet", 3.0),
    *((f"{a}_motor", f"{a}_bearing", 4.0) for a in "XYZ"), *((f"{a}_bearing", f"{a}_nut", 1.5) for a in "XYZ"),
    *((f"{a}_nut", f"{a}_guide", 3.0) for a in "XYZ"),
    ("X_bearing", "bed", 5.0), ("Y_bearing", "column", 5.0), ("Z_bearing", "bed", 5.0),
]  # fmt: skip


@dataclass(frozen=True)
class Planted:
    """A fault put into a folder: `partner` belongs to a swap."""

    kind: str
    campaign: str
    sensor: str
    partner: str = ""


def lumped(seed: int) -> MachineFolder:
    """A machine of first-order nodes with 2 to 6 campaigns, each with its own feeds and speed."""
    rng = np.random.default_rng([seed, 77])
    capacity = np.array([n[2] for n in NODES]) * 1e3 * rng.uniform(0.5, 2.0, len(NODES)) * rng.uniform(0.5, 2.0)
    air = np.array([n[3] for n in NODES]) * rng.uniform(0.6, 1.6, len(NODES))
    g = np.zeros((len(NODES), len(NODES)))
    for a, b, w in LINKS:
        i, j = NAMES.index(a), NAMES.index(b)
        g[i, j] = g[j, i] = w * rng.uniform(0.5, 2.0)
    a = (g - np.diag(g.sum(axis=1) + air)) / capacity[:, None]
    count = int(rng.integers(7, 23))
    wanted = [NAMES.index("bed"), *rng.permutation(len(NODES))]
    nodes = list(dict.fromkeys(int(k) for k in wanted))[:count]
    settings = _Logger(
        nodes=tuple(nodes),
        offset_K=rng.normal(0.0, rng.choice([0.05, 0.15, 0.3]), len(nodes) + 1),
        lag_s=np.exp(rng.uniform(np.log(15.0), np.log(300.0), len(nodes) + 1)),
        noise_K=float(rng.choice([0.01, 0.03, 0.06, 0.1])),
        resolution_K=float(rng.choice([0.01, 0.05, 0.1])),
        sample_s=float(rng.choice([10.0, 30.0, 60.0, 120.0, 300.0])),
    )
    gain = np.where(rng.random((len(NODES), 2)) < 0.4, rng.uniform(-4.0, 8.0, (len(NODES), 2)), 0.0)
    power = {name: rng.uniform(0.6, 1.5) for name in ("X", "Y", "Z", "S", "pump")}
    plan = int(rng.integers(3))  # all axes in every campaign, another one in each, or any of them
    has_coolant, warm = bool(rng.random() < 0.4), bool(rng.random() < 0.5)
    campaigns = []
    for k in range(int(rng.integers(2, 7))):
        axes = ("XYZ", "XYZ"[k % 3], "".join(c for c in "XYZ" if rng.random() < 0.6))[plan]
        campaigns.append(_campaign(rng, k, a, air / capacity, capacity, power, axes, has_coolant, warm, settings, gain))
    sensors = [Sensor(id=f"{NAMES[n]}", role=NODES[n][1]) for n in nodes]
    machine = Machine(name=f"lumped {seed}", sensors=(*sensors, Sensor(id="air", role="ambient")))
    return MachineFolder(machine, tuple(campaigns))


@dataclass(frozen=True)
class _Logger:
    nodes: tuple[int, ...]
    offset_K: Floats
    lag_s: Floats
    noise_K: float
    resolution_K: float
    sample_s: float


def _campaign(
    rng: np.random.Generator, number: int, a: Floats, air_rate: Floats, capacity: Floats, power: dict[str, float],
    axes: str, has_coolant: bool, warm: bool, logger: _Logger, gain: Floats,
) -> Campaign:  # fmt: skip
    cold_h, warm_h, cool_h = rng.uniform(0.1, 0.8), rng.uniform(1.5, 5.0), rng.uniform(0.5, 4.0)
    before_h = 30.0
    n = int((before_h + cold_h + warm_h + cool_h) * HOUR_S / SIM_S)
    t_s = SIM_S * np.arange(n) - before_h * HOUR_S
    season = rng.uniform(15.0, 28.0)
    air = season + rng.uniform(0.3, 2.5) * np.sin(2 * np.pi * (t_s / 86400.0 + rng.random()))
    wander = np.cumsum(rng.normal(0.0, 1.0, n + 60)) * 0.004
    air += wander[60:] - np.convolve(wander, np.ones(n // 4) / (n // 4), "same")[60:]
    running = _runs(rng, t_s, cold_h * HOUR_S, warm_h * HOUR_S)
    if warm and rng.random() < 0.6:  # yesterday's work has not yet gone
        rest_h = rng.uniform(1.0, 5.0)
        running = np.maximum(running, (t_s > -(rest_h + 4.0) * HOUR_S) & (t_s < -rest_h * HOUR_S))
    heat = np.zeros((n, len(NODES)))
    for axis in axes:
        level = rng.uniform(0.4, 1.2) * power[axis]
        for node, watt in ((f"{axis}_motor", 60.0), (f"{axis}_bearing", 12.0), (f"{axis}_nut", 25.0)):
            heat[:, NAMES.index(node)] += level * watt * running
        heat[:, NAMES.index(f"{axis}_guide")] += level * 30.0 * running
    speed = rng.choice([0.0, 0.4, 0.7, 1.0]) * power["S"]
    for node, watt in (("spindle_front", 180.0), ("spindle_rear", 120.0), ("spindle_motor", 250.0)):
        heat[:, NAMES.index(node)] += speed * watt * running
    heat[:, NAMES.index("cabinet")] += 60.0 * (t_s > -0.5 * HOUR_S)
    if rng.random() < 0.3:  # somebody opens the door
        opened = rng.uniform(0.2, 0.9) * t_s[-1]
        air -= rng.uniform(1.0, 4.0) * ((t_s > opened) * np.exp(-np.maximum(t_s - opened, 0.0) / 600.0))
    cooled = np.zeros(n, bool)
    if has_coolant and rng.random() < 0.7:
        on, off = np.sort(rng.uniform(cold_h, cold_h + warm_h, 2)) * HOUR_S
        cooled = (t_s > on) & (t_s < off)
    x = _simulate(a, air_rate, capacity, air, heat, cooled, power["pump"])
    felt = np.column_stack([x[:, list(logger.nodes)], air])
    for j, lag_s in enumerate(logger.lag_s):
        felt[:, j] = _lagged(felt[:, j], SIM_S / lag_s)
    own = t_s >= 0.0
    at = np.arange(0.0, t_s[-1], logger.sample_s)
    value = np.column_stack([np.interp(at, t_s[own], felt[own, j]) for j in range(felt.shape[1])])
    value += logger.offset_K + rng.normal(0.0, logger.noise_K, value.shape)
    value = np.round(np.round(value / logger.resolution_K) * logger.resolution_K, 4)
    label_s = np.arange(60.0, at[-1], 300.0)
    rise = np.column_stack([np.interp(label_s, t_s[own], (x[own] @ gain - (x[own] @ gain)[0])[:, d]) for d in (0, 1)])
    error_um = np.full((len(label_s), 3), np.nan)
    error_um[:, [0, 2]] = rise + rng.normal(0.0, 1.0, rise.shape)
    ids = (*(NAMES[k] for k in logger.nodes), "air")
    table = Temperatures(at, ids, value)
    return Campaign(f"c{number}", CampaignSettings(), table, drift=Drift(label_s, error_um))


def _runs(rng: np.random.Generator, t_s: Floats, cold_s: float, warm_s: float) -> Floats:
    """1 where the machine moves: at one go, or in jobs with pauses."""
    on = (t_s >= cold_s) & (t_s < cold_s + warm_s)
    if rng.random() < 0.5:
        period, share = rng.uniform(1200.0, 4800.0), rng.uniform(0.5, 0.9)
        on &= ((t_s - cold_s) % period) < share * period
    return on.astype(float)


def _simulate(
    a: Floats, air_rate: Floats, capacity: Floats, air: Floats, heat: Floats, cooled: Floats, pump: float
) -> Floats:
    """Node temperatures (n, nodes); where the coolant runs, tank, table and headstock exchange heat."""
    n, p = heat.shape
    wet = a.copy()
    for node, w in (("table", 60.0), ("headstock", 30.0)):
        i, j = NAMES.index(node), NAMES.index("tank")
        for r, c in ((i, j), (j, i)):
            wet[r, c] += w / capacity[r]
            wet[r, r] -= w / capacity[r]
    step = {}
    for state, matrix in ((False, a), (True, wet)):
        whole = np.zeros((2 * p, 2 * p))
        whole[:p, :p], whole[:p, p:] = matrix, np.eye(p)
        both = expm(whole * SIM_S)
        step[state] = (both[:p, :p], both[:p, p:])
    forced = heat / capacity + air_rate * air[:, None]
    forced[cooled, NAMES.index("tank")] += 300.0 * pump / capacity[NAMES.index("tank")]
    x = np.empty((n, p))
    x[0] = -np.linalg.solve(a, air_rate * air[0])
    for i in range(1, n):
        now, push = step[bool(cooled[i])]
        x[i] = now @ x[i - 1] + push @ forced[i - 1]
    return x


def _lagged(x: Floats, share: float) -> Floats:
    from scipy.signal import lfilter

    keep = np.exp(-share)
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], x, zi=np.array([keep * x[0]]))[0])


def virtual_machine() -> VirtualMachine:
    """The virtual machine, built once for all its copies."""
    return build(load_description(load_conditions("standard").machine))


def twin(machine: VirtualMachine, seed: int) -> MachineFolder:
    """A copy of the virtual machine with 2 to 6 campaigns, each with its own axes and speed; temperatures alone."""
    rng = np.random.default_rng([seed, 78])
    conditions = load_conditions(str(rng.choice(["standard", "hard"])))
    pt100 = conditions.pt100.model_copy(
        update={
            "fault_probability": 0.0, "noise_K": float(rng.choice([0.01, 0.03, 0.06])),
            "resolution_K": float(rng.choice([0.01, 0.1])), "sample_s": float(rng.choice([30.0, 60.0, 120.0])),
        }
    )  # fmt: skip
    made = make_twin(machine, conditions.model_copy(update={"pt100": pt100}), seed)
    axes = [axis.name for axis in machine.description.axes]
    campaigns = []
    way = int(rng.integers(3))
    for k in range(int(rng.integers(2, 7))):
        moved = (axes, [axes[k % len(axes)]], [a for a in axes if rng.random() < 0.6])[way]
        day = int(rng.integers(0, 360))
        cold, cool = duty.idle(int(rng.integers(20, 50)), axes, 1.0), duty.idle(int(rng.integers(40, 180)), axes, 1.0)
        minutes = int(rng.integers(120, 300))
        shift = duty.paper_run(minutes, axes)
        if rng.random() < 0.5:
            shift = duty.random_shift(rng, minutes, axes, conditions.work)
        feeds = {a: shift.feed_m_min[a] * (a in moved) for a in axes}
        shift = replace(shift, feed_m_min=feeds, rpm=shift.rpm * rng.choice([0.0, 0.5, 1.0]))
        before = duty.weeks(rng, 2, axes, conditions.work, int(rng.integers(0, 7)))
        night = duty.idle(60 * int(rng.integers(4, 9)), axes)
        work = duty.join([before, night, cold, shift, cool])
        chiller = np.full(len(work.on), float(rng.random() < 0.5))
        if conditions.work.chiller_change:
            chiller[-minutes // 2 :] = 1.0 - chiller[0]
        work = duty.with_chiller(work, chiller)
        t_s = 60.0 * np.arange(float(len(work.on)))
        air, floor = hall_inputs(conditions.hall, rng, t_s, day, work.on, machine.description.reference_degC)
        history = simulate(machine, work, air, floor, rest_state(machine, air[:1440].mean(axis=0), float(floor[0])))
        begin_s = 60.0 * (len(before.on) + len(night.on))
        at, value = read_sensors(rng, history, made.sensors, (), pt100, begin_s)
        ids = tuple(s.id for s in machine.description.sensors)
        campaigns.append(Campaign(f"{NEW_YEAR.year}-{k}", CampaignSettings(), Temperatures(at, ids, value)))
    sensors = tuple(Sensor(id=s.id, role=s.role) for s in machine.description.sensors)
    return MachineFolder(Machine(name=f"twin {seed}", sensors=sensors), tuple(campaigns))


def planted(folder: MachineFolder, kind: str, rng: np.random.Generator) -> tuple[MachineFolder, Planted]:
    """The folder with one fault in one campaign."""
    campaign = folder.campaigns[int(rng.integers(len(folder.campaigns)))]
    table = campaign.temperatures
    value, t_s = table.value_degC.copy(), table.t_s
    ids = table.sensor_ids
    sign, size = float(rng.choice([-1.0, 1.0])), float(rng.uniform(2.0, 8.0))
    j = int(rng.integers(len(ids)))
    partner = ""
    start = rng.uniform(0.15, 0.7) * t_s[-1]
    if kind == "step":
        value[t_s >= start, j] += sign * size
    elif kind == "offset":
        value[:, j] += sign * size
    elif kind == "drift":
        onset = rng.uniform(0.0, 0.3) * t_s[-1]
        value[:, j] += sign * rng.uniform(2.0, 5.0) * np.clip((t_s - onset) / (t_s[-1] - onset), 0.0, 1.0)
    elif kind == "frozen":
        late = value[t_s >= start]
        moved = np.nanmax(late, axis=0) - np.nanmin(late, axis=0)
        j = int(rng.choice(np.flatnonzero(moved > 0.5))) if (moved > 0.5).any() else int(np.argmax(moved))
        value[t_s >= start, j] = late[np.isfinite(late[:, j]), j][0]
    else:
        thin = value[:: max(1, len(value) // 200)]
        rise = thin - np.nanmean(value[:3], axis=0)
        apart = np.sqrt(np.nanmean((rise[:, :, None] - rise[:, None, :]) ** 2, axis=0))
        far = np.argwhere(np.triu(apart > min(1.5, 0.7 * apart.max())))
        j, k = (int(i) for i in far[int(rng.integers(len(far)))])
        value[:, [j, k]] = value[:, [k, j]]
        partner = ids[k]
    changed = replace(campaign, temperatures=replace(table, value_degC=value))
    campaigns = tuple(changed if c is campaign else c for c in folder.campaigns)
    return replace(folder, campaigns=campaigns), Planted(kind, campaign.name, ids[j], partner)


def machines(kind: str, seeds: Sequence[int]) -> list[MachineFolder]:
    """Healthy machines of the kind `lumped` or `twin`."""
    if kind == "lumped":
        return [lumped(seed) for seed in seeds]
    built = virtual_machine()
    return [twin(built, seed) for seed in seeds]

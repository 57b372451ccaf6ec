"""A small thermal network: a machine of first-order nodes with duty cycles in a workshop with a daily cycle.

Heat balance of a node: C dT/dt = sum G (T_other - T) + G_air (T_air - T) + P(t), integrated exactly for inputs that
are constant over a step (matrix exponential).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from thetacomp.arrays import Floats
from thetacomp.model.temperatures import Temperatures

SENSORS = 15
NODES = 20  # the last five carry no sensor: what is not seen keeps the predictions from being perfect
SOURCES = 5  # spindle, three feed drives, hydraulics
NOISE_K = 0.02


@dataclass(frozen=True)
class Network:
    """`a` (nodes, nodes) in 1/s, `air` (nodes,) in 1/s, `heat` (nodes, sources) in K/s; `gain_um_per_K` (nodes,)."""

    a: Floats
    air: Floats
    heat: Floats
    gain_um_per_K: Floats


def network(seed: int) -> Network:
    """A machine: a chain with some cross links, time constants from minutes to hours."""
    rng = np.random.default_rng(seed)
    capacity = rng.uniform(5e3, 6e4, NODES)
    g = np.zeros((NODES, NODES))
    links = [(i, i + 1) for i in range(NODES - 1)] + [tuple(rng.choice(NODES, 2, replace=False)) for _ in range(14)]
    for i, j in links:
        g[i, j] = g[j, i] = rng.uniform(3.0, 20.0)
    air = rng.uniform(1.0, 6.0, NODES)
    air[SENSORS - 1] = 60.0  # the last sensor hangs in the air
    a = (g - np.diag(g.sum(axis=1) + air)) / capacity[:, None]
    heat = np.zeros((NODES, SOURCES))
    for source, node in enumerate(rng.choice(NODES - 1, SOURCES, replace=False)):
        heat[node, source] = rng.uniform(80.0, 250.0) / capacity[node]
    gain = np.where(rng.random(NODES) < 0.4, rng.uniform(-3.0, 6.0, NODES), 0.0)
    return Network(a, air / capacity, heat, gain)


def operate(
    machine: Network, hours: float, rng: np.random.Generator, *, step_s: float = 30.0, season_degC: float = 20.0
) -> tuple[Temperatures, Floats]:
    """Temperatures of the sensors and the displacement (n,) in µm of one campaign that starts in balance with the air.

    Shifts of work and rest: every source runs at a random level for 20 to 120 minutes, or stands (nights are quiet).
    """
    n = int(hours * 3600.0 / step_s) + 1
    t_s = step_s * np.arange(n)
    air = season_degC + rng.uniform(1.0, 2.5) * np.sin(2 * np.pi * (t_s / 86400.0 + rng.random()))
    air += np.convolve(rng.normal(0.0, 0.3, n + 120), np.ones(121) / 121.0, "valid")[:n]
    duty = np.zeros((n, SOURCES))
    for source in range(SOURCES):
        at = int(rng.uniform(0.0, 1800.0) / step_s)
        while at < n:
            until = at + int(rng.uniform(1200.0, 7200.0) / step_s)
            working = (t_s[at] / 3600.0) % 24.0 < 16.0
            duty[at:until, source] = rng.random() if working and rng.random() < 0.65 else 0.0
            at = until
    inputs = np.hstack([air[:, None] * 1.0, duty])
    b = np.hstack([machine.air[:, None], machine.heat])
    whole = np.zeros((NODES + b.shape[1],) * 2)
    whole[:NODES, :NODES], whole[:NODES, NODES:] = machine.a, b
    stepped = expm(whole * step_s)
    a, b = stepped[:NODES, :NODES], stepped[:NODES, NODES:]
    x = np.full((n, NODES), air[0])
    forced = inputs @ b.T
    for i in range(1, n):
        x[i] = a @ x[i - 1] + forced[i - 1]
    offset = np.linspace(-0.2, 0.2, SENSORS)
    value = x[:, :SENSORS] + offset + rng.normal(0.0, NOISE_K, (n, SENSORS))
    displacement = (x - x[0]) @ machine.gain_um_per_K + rng.normal(0.0, 0.5, n)
    ids = tuple(f"theta_{i + 1}" for i in range(SENSORS))
    return Temperatures(t_s, ids, value), displacement

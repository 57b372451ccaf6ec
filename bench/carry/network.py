"""A lumped thermal network of a machine tool: nodes, links, friction, fluids. It shares no code with the twin.

Heat balance of a node: C dT/dt = sum G (T_other - T) + sum G_fluid(t) (T_fluid(t) - T) + P(t, T), by implicit Euler.
Friction falls as the lubricant warms, air cools faster past what turns, a coolant only while it flows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

REFERENCE_degC = 20.0
THINNING_PER_K = 0.012  # share of its friction that a bearing loses for each kelvin


@dataclass(frozen=True)
class Network:
    """`capacity_J_K` (n,), `link_W_K` (n, n) symmetric, and what fluids do: `still_W_K` (n, fluids) always, and in
    addition `flow_W_K` (n, fluids) times the flow of the moment (0 to 1)."""

    nodes: tuple[str, ...]
    fluids: tuple[str, ...]
    capacity_J_K: Floats
    link_W_K: Floats
    still_W_K: Floats
    flow_W_K: Floats

    def node(self, name: str) -> int:
        """Index of a node."""
        return self.nodes.index(name)


def network(
    nodes: Mapping[str, float],
    links: Sequence[tuple[str, str, float]],
    still: Sequence[tuple[str, str, float]],
    flow: Sequence[tuple[str, str, float]] = (),
) -> Network:
    """A network from `nodes` (kJ/K), links between nodes (W/K), and between a node and a fluid (W/K)."""
    names = tuple(nodes)
    fluids = tuple(dict.fromkeys(fluid for _, fluid, _ in (*still, *flow)))
    link = np.zeros((len(names), len(names)))
    for one, other, value in links:
        i, j = names.index(one), names.index(other)
        link[i, j] = link[j, i] = link[i, j] + value
    tables = []
    for entries in (still, flow):
        table = np.zeros((len(names), len(fluids)))
        for node, fluid, value in entries:
            table[names.index(node), fluids.index(fluid)] += value
        tables.append(table)
    return Network(names, fluids, 1000.0 * np.array(list(nodes.values())), link, *tables)


@dataclass(frozen=True)
class Drive:
    """What drives a network over n steps: heat that does not depend on temperature (n, nodes) in W, friction at 20 °C
    (n, nodes) in W, temperatures of the fluids (n, fluids), their flow (n, fluids) from 0 to 1."""

    heat_W: Floats
    friction_W: Floats
    fluid_degC: Floats
    flow: Floats


def simulate(machine: Network, drive: Drive, start_degC: Floats, step_s: float) -> Floats:
    """Temperatures (n, nodes) at the end of every step."""
    own = np.diag(machine.capacity_J_K / step_s + machine.link_W_K.sum(axis=1)) - machine.link_W_K
    store = machine.capacity_J_K / step_s
    diagonal = np.diag_indices(len(machine.nodes))
    out = np.empty((len(drive.heat_W), len(machine.nodes)))
    now_degC = start_degC
    for i in range(len(out)):
        to_fluid = machine.still_W_K + machine.flow_W_K * drive.flow[i]
        thinned = np.exp(-THINNING_PER_K * (now_degC - REFERENCE_degC))
        heat_W = drive.heat_W[i] + drive.friction_W[i] * thinned + to_fluid @ drive.fluid_degC[i]
        system = own.copy()
        system[diagonal] += to_fluid.sum(axis=1)
        now_degC = np.linalg.solve(system, store * now_degC + heat_W)
        out[i] = now_degC
    return out


def lagged(value: Floats, tau_s: Floats, step_s: float) -> Floats:
    """First-order lag of every column (n, k) with its own time constant (k,), at rest in the beginning."""
    share = step_s / (tau_s + step_s)
    out = np.empty_like(value)
    now = value[0].copy()
    for i, row in enumerate(value):
        now = now + share * (row - now)
        out[i] = now
    return out

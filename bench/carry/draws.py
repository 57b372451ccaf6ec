"""Other machines of the same kinds, drawn at random: for figures of a change that nobody has looked at before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from carry.lumped import LumpedMachine
from carry.network import Floats, Network
from carry.twins import TwinPlan

SPREAD = 0.25  # standard deviation of the logarithm of every property of a lumped machine


def drawn_lumped(machine: LumpedMachine, draw: int) -> LumpedMachine:
    """A machine of the same build: every mass, link, heat and gain is another, and so are duty, air and noise."""
    rng = np.random.default_rng([machine.seed, 997, draw])

    def near(value: float) -> float:
        return float(value * np.exp(rng.normal(0.0, SPREAD)))

    return replace(
        machine,
        network=_drawn_network(machine.network, rng),
        heats=tuple(replace(heat, power_W=near(heat.power_W)) for heat in machine.heats),
        drift={node: tuple(near(gain) for gain in gains) for node, gains in machine.drift.items()},
        curved={node: tuple(near(gain) for gain in gains) for node, gains in machine.curved.items()},
        slopes=tuple(
            replace(
                slope,
                slope_um_per_m=tuple(near(gain) for gain in slope.slope_um_per_m),
                bend_um_per_m2=tuple(near(gain) for gain in slope.bend_um_per_m2),
            )
            for slope in machine.slopes
        ),
        seed=machine.seed + 10_000 * draw,
    )


def _drawn_network(network: Network, rng: np.random.Generator) -> Network:
    def near(value: Floats) -> Floats:
        return value * np.exp(rng.normal(0.0, SPREAD, value.shape))

    links = np.triu(near(network.link_W_K))
    return replace(
        network,
        capacity_J_K=near(network.capacity_J_K),
        link_W_K=links + links.T,
        still_W_K=near(network.still_W_K),
        flow_W_K=near(network.flow_W_K),
    )


def drawn_twin(plan: TwinPlan, draw: int) -> TwinPlan:
    """Another machine with other work, sensors and tracker, mounted alike."""
    return replace(plan, seed=plan.seed + 1000 * draw)

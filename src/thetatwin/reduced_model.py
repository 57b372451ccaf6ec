"""The reduced model: block rational Krylov projection of the heat equation, then modes, stepped exactly.

C and K are symmetric and positive definite, so the projection is stable, and every mode is a first-order lag
z' = -λ z + b u. With inputs held over a step the modes are stepped without any error in time.
Source: Grimme, Krylov projection methods for model reduction, 1997.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.linalg import eigh
from scipy.sparse.linalg import splu

from thetacomp.arrays import Floats
from thetatwin.thermal import ThermalSystem

# Time constants (s) at which the response is matched; the first, infinity, makes every steady state exact.
MATCHED_S = (np.inf, 5 * 86400.0, 86400.0, 6 * 3600.0, 5400.0, 1200.0, 300.0, 60.0)
_DEPENDENT = 1e-7  # directions this small against the largest of their block add nothing


@dataclass(frozen=True)
class ReducedModel:
    """Modes with `rate_per_s` (r,), `source` (r, inputs) and outputs `rows` (outputs, r): y = rows z.

    `shapes` (states, r) are the modes themselves: all temperatures of the full model are about shapes z.
    """

    rate_per_s: Floats
    source: Floats
    rows: Floats
    shapes: Floats
    inputs: tuple[str, ...]

    def step(self, step_s: float) -> tuple[Floats, Floats]:
        """Decay (r,) and input matrix (r, inputs) of one step with inputs held."""
        decay = np.exp(-self.rate_per_s * step_s)
        gain = -np.expm1(-self.rate_per_s * step_s) / self.rate_per_s
        return decay, gain[:, None] * self.source

    def steady(self, inputs: Floats) -> Floats:
        """Modal state (r,) in equilibrium with constant inputs."""
        return np.asarray((self.source @ inputs) / self.rate_per_s)

    def run(self, inputs: Floats, step_s: float, start: Floats | None = None) -> Floats:
        """Outputs (steps + 1, outputs) under inputs (steps, inputs) held over each step."""
        decay, drive = self.step(step_s)
        state = np.zeros(len(decay)) if start is None else start
        forced = inputs @ drive.T
        states = np.empty((len(inputs) + 1, len(decay)))
        states[0] = state
        for k in range(len(inputs)):
            state = decay * state + forced[k]
            states[k + 1] = state
        return states @ self.rows.T


def reduce_system(system: ThermalSystem, rows: Floats) -> ReducedModel:
    """Project the full system on the responses of all its inputs at the time constants MATCHED_S.

    `rows` (outputs, states) are the outputs wanted. The error against the full model is a matter of measurement;
    the tests hold it below 1 % of each output's range over a random week.
    """
    basis = np.zeros((system.states, 0))
    for constant in MATCHED_S:
        shift = 0.0 if np.isinf(constant) else 1.0 / constant
        factor = splu(
            sp.csc_matrix(system.conductance + shift * system.capacity),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        block = factor.solve(system.source)
        block /= np.sqrt(np.einsum("ij,ij->j", block, system.capacity @ block))
        basis = np.concatenate([basis, _new_directions(system, basis, block)], axis=1)
    small_k = basis.T @ (system.conductance @ basis)
    small_c = basis.T @ (system.capacity @ basis)
    rate, modes = eigh(0.5 * (small_k + small_k.T), 0.5 * (small_c + small_c.T))
    shapes = basis @ modes
    return ReducedModel(rate, shapes.T @ system.source, rows @ shapes, shapes, system.inputs)


def _new_directions(system: ThermalSystem, basis: Floats, block: Floats) -> Floats:
    """What a block of unit columns adds to a basis, orthonormal in the capacity's inner product."""
    for _ in range(2):  # twice is enough to stay orthogonal
        block = block - basis @ (basis.T @ (system.capacity @ block))
    gram = block.T @ (system.capacity @ block)
    size, mix = np.linalg.eigh(0.5 * (gram + gram.T))
    keep = size > _DEPENDENT**2
    fresh = block @ (mix[:, keep] / np.sqrt(size[keep]))
    fresh = fresh - basis @ (basis.T @ (system.capacity @ fresh))
    gram = fresh.T @ (system.capacity @ fresh)
    return np.asarray(fresh @ np.linalg.inv(np.linalg.cholesky(gram)).T)

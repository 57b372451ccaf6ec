"""What one axis adds to the error of the tool at any position and moment, from its separation. P0 counts as zero."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.separation.component import ComponentSeparation
from thetacomp.separation.sweep_fit import ComponentData, SweepFit, rate_matrix


@dataclass(frozen=True)
class AxisFit:
    """One component of one axis: the points that were fitted, the fit, and what it says."""

    data: ComponentData
    fit: SweepFit
    separation: ComponentSeparation

    @property
    def constant_um(self) -> float:
        """Geometry at P0, mean of the approach directions."""
        return float(geometry_um(self, np.array([self.data.p0_mm]))[0])


def node_weights(fitted: AxisFit, t_s: Floats) -> Floats:
    """Matrix (n, m) that turns values at the heated sweeps into values at other moments; zero up to the reference."""
    data, states = fitted.data, fitted.fit.states
    if not len(states):
        return np.zeros((len(t_s), 0))
    zero_s = max(float(data.t_s[data.cold[data.sweep]].max()), fitted.separation.reference_s)
    return between_nodes(zero_s, data.middle_s[states], t_s)


def between_nodes(zero_s: float, node_s: Floats, t_s: Floats) -> Floats:
    """Matrix (n, m) of interpolation between nodes (m,) in order of time, zero up to `zero_s`, where the heat begins.

    Cubic Hermite with the rates of the parabola through neighbouring nodes, as inside a sweep
    (`sweep_fit.state_weights`); after the last node it continues at the last rate.
    """
    times = np.concatenate([[zero_s], node_s])
    rates, unit = rate_matrix(times), np.eye(len(times))
    j = np.clip(np.searchsorted(times, t_s, side="right") - 1, 0, len(times) - 2)
    step_s = times[j + 1] - times[j]
    x = np.clip((t_s - times[j]) / step_s, 0.0, 1.0)
    between = (
        (2 * x**3 - 3 * x**2 + 1)[:, None] * unit[j]
        + ((x**3 - 2 * x**2 + x) * step_s)[:, None] * rates[j]
        + (3 * x**2 - 2 * x**3)[:, None] * unit[j + 1]
        + ((x**3 - x**2) * step_s)[:, None] * rates[j + 1]
    )
    between[t_s <= times[0]] = 0.0
    after_s = np.maximum(t_s - times[-1], 0.0)
    return np.asarray(between + after_s[:, None] * rates[-1])[:, 1:]


def geometry_um(fitted: AxisFit, position_mm: Floats) -> Floats:
    """Geometry at positions (n,), mean of the approach directions; held at the ends of the measured travel."""
    fit, low_mm, high_mm = fitted.fit, fitted.data.position_mm.min(), fitted.data.position_mm.max()
    basis = fit.curve.basis(np.clip(position_mm, low_mm, high_mm))
    coefficients = fit.geometry_coefficients.reshape(len(fit.directions), fit.curve.size).mean(axis=0)
    return np.asarray(basis @ coefficients)


def axis_share_um(fits: Sequence[AxisFit], letters: Sequence[str], t_s: Floats, position_mm: Floats) -> Floats:
    """`G(p) - G(P0) + S(t) (p - P0) + C(t) (p - P0)²` of one axis, (n, 3) in the order of `letters`."""
    share = np.zeros((len(t_s), len(letters)))
    for fitted in fits:
        weights = node_weights(fitted, t_s)
        slope, bend = weights @ fitted.fit.slope_um_per_m, weights @ fitted.fit.bend_um_per_m2
        arm_m = (position_mm - fitted.data.p0_mm) / 1000.0
        geometry = geometry_um(fitted, position_mm) - fitted.constant_um
        share[:, letters.index(fitted.separation.direction)] = geometry + slope * arm_m + bend * arm_m**2
    return share

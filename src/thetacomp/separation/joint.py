"""Joint fit of one error component over all sweeps of a campaign: geometry, slope and intercept with their errors.

Model of a measured point i in sweep k (paper, equations 1 and 2, every point at its own time):

    E_i = G_dir(p_i) + I(t_i) + S(t_i) (p_i - P0) + α_k (p_i - mean of sweep k) + noise

`I = S = 0` in the cold block. Between sweeps I and S change; inside a sweep they move with the rate of the parabola
through the neighbouring states, which is linear in the unknowns, so one least-squares problem holds it all. `α_k` is
an angle error of the instrument common to a sweep: it cannot be told from a slope and enters as a random effect of
known standard deviation, which widens the stated intervals by just what it costs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from thetacomp.campaign import Floats, Ints
from thetacomp.separation.geometry import (
    Curve,
    choose_curve,
    direction_design,
    direction_penalty,
    flexible_curve,
)
from thetacomp.separation.result import Bools

# 4.5 standard deviations: in a thousand good points fewer than one in a hundred campaigns loses one.
OUTLIER_SIGMA = 4.5
HUBER_SIGMA = 1.345


@dataclass(frozen=True)
class ComponentData:
    """Points of one component of one axis, n points; sweeps counted 0 … K-1 and `cold` (K,) marking the cold ones."""

    position_mm: Floats
    t_s: Floats
    direction: Ints
    sweep: Ints
    error_um: Floats
    middle_s: Floats
    cold: Bools
    p0_mm: float
    angle_sd_urad: float


@dataclass(frozen=True)
class JointFit:
    """Solution of the joint fit. `states` lists the heated sweeps; arrays of states have length m.

    `line_covariance` (2 m, 2 m) is that of (intercepts, slopes).
    """

    curve: Curve
    directions: tuple[int, ...]
    states: Ints
    intercept_um: Floats
    intercept_se_um: Floats
    slope_um_per_m: Floats
    slope_se_um_per_m: Floats
    line_covariance: Floats
    geometry_coefficients: Floats
    geometry_covariance: Floats
    geometry_um: Floats
    line_um: Floats
    outlier: Bools
    noise_sd_um: float
    dof: float
    rss_um2: float


def lever_m(data: ComponentData) -> Floats:
    """Distance of every point from P0 in metres, (n,)."""
    return (data.position_mm - data.p0_mm) / 1000.0


def state_weights(data: ComponentData, states: Ints) -> Floats:
    """Matrix (n, m) with `I(t_i) = Σ_j W_ij I_j`: the value of the point's own sweep plus its rate times the offset.

    The nodes are the end of the cold sweeps (zero) and the heated sweeps; the rate at a node is that of the parabola
    through it and its neighbours (at the last one, through the last three). Rows of cold sweeps are zero.
    """
    cold_end_s = data.t_s[data.cold[data.sweep]].max()
    times = np.concatenate([[cold_end_s], data.middle_s[states]])
    rates = rate_matrix(times)
    weights = np.zeros((len(data.t_s), len(states)))
    for j, state in enumerate(states):
        rows = np.flatnonzero(data.sweep == state)
        offset_s = data.t_s[rows] - times[j + 1]
        weights[rows] = offset_s[:, None] * rates[j + 1, 1:][None, :]
        weights[rows, j] += 1.0
    return weights


def rate_matrix(times: Floats) -> Floats:
    """`rate = R @ values` at every node: derivative of the parabola through a node and its two neighbours."""
    count = len(times)
    rates = np.zeros((count, count))
    if count == 2:
        step = times[1] - times[0]
        rates[:] = np.array([-1.0, 1.0]) / step
        return rates
    for node in range(count):
        first = min(max(node - 1, 0), count - 3)
        trio = np.arange(first, first + 3)
        for a in trio:
            b, c = (other for other in trio if other != a)
            slope = (2 * times[node] - times[b] - times[c]) / ((times[a] - times[b]) * (times[a] - times[c]))
            rates[node, a] = slope
    return rates


def _angle_columns(data: ComponentData) -> Floats:
    """One column a sweep: distance from the sweep's mean position in metres, (n, K)."""
    columns = np.zeros((len(data.position_mm), len(data.middle_s)))
    for number in range(len(data.middle_s)):
        rows = data.sweep == number
        if rows.any():
            columns[rows, number] = (data.position_mm[rows] - data.position_mm[rows].mean()) / 1000.0
    return columns


@dataclass(frozen=True)
class _System:
    design: Floats
    prior: Floats  # roughness of the geometry, in units of 1/noise variance
    angle: slice
    geometry: slice
    intercepts: slice
    slopes: slice


def _system(data: ComponentData, curve: Curve, directions: Sequence[int], states: Ints, extra: Floats) -> _System:
    geometry = direction_design(curve, data.position_mm, data.direction, directions)
    weights = state_weights(data, states) if len(states) else np.zeros((len(data.t_s), 0))
    angles = _angle_columns(data) if data.angle_sd_urad > 0 else np.zeros((len(data.t_s), 0))
    design = np.hstack([geometry, weights, weights * lever_m(data)[:, None], angles, extra])
    g, m, k = geometry.shape[1], len(states), angles.shape[1]
    prior = np.zeros((design.shape[1], design.shape[1]))
    prior[:g, :g] = direction_penalty(curve, directions)
    return _System(
        design, prior, slice(g + 2 * m, g + 2 * m + k), slice(0, g), slice(g, g + m), slice(g + m, g + 2 * m)
    )


@dataclass(frozen=True)
class _Solution:
    coefficients: Floats
    covariance: Floats
    residual: Floats
    noise_sd_um: float
    dof: float
    rss: float


def _solve(system: _System, target: Floats, weight: Floats, angle_sd_urad: float) -> _Solution:
    """Weighted least squares with the priors; the noise variance and the prior of the angles agree at the end."""
    design = system.design
    gram = design.T @ (design * weight[:, None])
    right = design.T @ (target * weight)
    variance = float(np.average((target - np.average(target, weights=weight)) ** 2, weights=weight)) + 1e-12
    effective = float(weight.sum())
    for _ in range(50):
        normal = gram + system.prior
        if angle_sd_urad > 0:
            index = np.arange(system.angle.start, system.angle.stop)
            normal[index, index] += variance / angle_sd_urad**2
        inverse = _inverse(normal)
        coefficients = inverse @ right
        residual = target - design @ coefficients
        rss = float(np.sum(weight * residual**2))
        dof = max(effective - float(np.trace(inverse @ gram)), 1.0)
        previous, variance = variance, rss / dof + 1e-12
        if abs(previous - variance) <= 1e-4 * variance:
            break
    return _Solution(coefficients, variance * inverse, residual, float(np.sqrt(variance)), dof, rss)


def _inverse(normal: Floats) -> Floats:
    """Inverse of a normal matrix; the pseudo-inverse where the sweeps leave an unknown undetermined."""
    try:
        factor = linalg.cho_factor(normal, lower=True)
    except linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(normal, hermitian=True), dtype=float)
    return np.asarray(linalg.cho_solve(factor, np.eye(len(normal))), dtype=float)


def _robust_scale(residual: Floats, parameters: float) -> float:
    """Standard deviation from the median absolute residual, corrected for the fitted parameters."""
    n = len(residual)
    return float(1.4826 * np.median(np.abs(residual)) * np.sqrt(n / max(n - parameters, 1.0))) + 1e-9


def find_outliers(data: ComponentData, curve: Curve, directions: Sequence[int], states: Ints) -> Bools:
    """Points more than 4.5 robust standard deviations from a Huber fit, (n,)."""
    system = _system(data, curve, directions, states, np.zeros((len(data.t_s), 0)))
    weight = np.ones(len(data.error_um))
    for _ in range(30):
        solution = _solve(system, data.error_um, weight, data.angle_sd_urad)
        scaled = np.abs(solution.residual) / _robust_scale(solution.residual, len(weight) - solution.dof)
        new_weight = np.minimum(1.0, HUBER_SIGMA / np.maximum(scaled, 1e-12))
        done = np.max(np.abs(new_weight - weight)) < 1e-3
        weight = new_weight
        if done:
            break
    outlier = scaled > OUTLIER_SIGMA
    for _ in range(5):
        solution = _solve(system, data.error_um, (~outlier).astype(float), data.angle_sd_urad)
        again = np.abs(solution.residual) > OUTLIER_SIGMA * solution.noise_sd_um
        if np.array_equal(again, outlier):
            break
        outlier = again
    return outlier


def fit_component(data: ComponentData) -> JointFit:
    """Separate one component: outliers first, then the curve by hold-out, then the joint fit on the good points."""
    directions = tuple(int(d) for d in np.unique(data.direction))
    states = np.flatnonzero(~data.cold)
    # Outliers disturb the choice of the curve and a stiff curve makes good points look like outliers: start flexible.
    curve = flexible_curve(data.position_mm)
    for _ in range(2):
        outlier = find_outliers(data, curve, directions, states)
        good = ~outlier
        curve = choose_curve(data.position_mm[good], data.direction[good], data.sweep[good], data.error_um[good])
    system = _system(data, curve, directions, states, np.zeros((len(data.t_s), 0)))
    solution = _solve(system, data.error_um, (~outlier).astype(float), data.angle_sd_urad)
    se = np.sqrt(np.diag(solution.covariance))
    g = system.geometry
    line_part = slice(system.intercepts.start, system.slopes.stop)
    return JointFit(
        curve=curve,
        directions=directions,
        states=states,
        intercept_um=solution.coefficients[system.intercepts],
        intercept_se_um=se[system.intercepts],
        slope_um_per_m=solution.coefficients[system.slopes],
        slope_se_um_per_m=se[system.slopes],
        line_covariance=solution.covariance[line_part, line_part],
        geometry_coefficients=solution.coefficients[g],
        geometry_covariance=solution.covariance[g, g],
        geometry_um=system.design[:, g] @ solution.coefficients[g],
        line_um=system.design[:, line_part] @ solution.coefficients[line_part],
        outlier=outlier,
        noise_sd_um=solution.noise_sd_um,
        dof=solution.dof,
        rss_um2=solution.rss,
    )


def shape_change(data: ComponentData, fit: JointFit) -> tuple[float, int, Floats, Floats]:
    """Fit a change of shape to every heated sweep: second and third Legendre terms and a change of reversal.

    Returns the residual sum of squares with it, the number of added terms, and for each heated sweep and measured
    point the change of shape with its standard error, both (n,).
    """
    good = ~fit.outlier
    span = (data.position_mm.min(), data.position_mm.max())
    x = 2.0 * (data.position_mm - span[0]) / (span[1] - span[0]) - 1.0
    terms = [1.5 * x**2 - 0.5, 2.5 * x**3 - 1.5 * x]
    if len(fit.directions) == 2:
        terms.append(data.direction / 2.0)
    blocks = [term * (data.sweep == state) for state in fit.states for term in terms]
    extra = np.column_stack(blocks)
    system = _system(data, fit.curve, fit.directions, fit.states, extra)
    rich = _solve(system, data.error_um, good.astype(float), data.angle_sd_urad)
    tail = slice(system.angle.stop, system.design.shape[1])
    change = extra @ rich.coefficients[tail]
    variance = np.einsum("ij,jk,ik->i", extra, rich.covariance[tail, tail], extra)
    return rich.rss, extra.shape[1], change, np.sqrt(np.maximum(variance, 0.0))

"""One fit of an error component over all sweeps of a campaign: geometry, slope and intercept with their errors.

Model of a measured point i in sweep k (paper, equations 1 and 2, every point at its own time):

    E_i = G_dir(p_i) + I(t_i) + S(t_i) (p_i - P0) + C(t_i) (p_i - P0)² + α_k (p_i - mean of sweep k) + noise

`I = S = C = 0` in the cold block, and C = 0 throughout where a line follows the heat. Between sweeps they change;
inside a sweep they move with the rate of the parabola through the neighbouring states, which is linear in the unknowns,
so one least-squares problem holds it all. `α_k` is an angle error of the instrument common to a sweep: it cannot be
distinguished from a slope and enters as a random effect of known standard deviation, which widens the stated intervals
by just what it costs. Tracker points bring a second one: what the tie to the foundation leaves in a sweep, an offset
and a slope of known covariance. They also bring weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from thetacomp.arrays import Bools, Floats, Ints
from thetacomp.instrument import resolution
from thetacomp.separation.geometry import (
    Curve,
    choose_curve,
    direction_design,
    direction_penalty,
    flexible_curve,
)

# 4.5 standard deviations: in a thousand good points fewer than one in a hundred campaigns loses one.
OUTLIER_SIGMA = 4.5
HUBER_SIGMA = 1.345


@dataclass(frozen=True)
class ComponentData:
    """Points of one component of one axis, n points; sweeps counted 0 … K-1 and `cold` (K,) marking the cold ones.

    `weight` (n,) has the mean 1. `tie` (K, 2, 2) is the covariance of offset (µm, at the sweep's mean position) and
    slope (µm/m) that a sweep has in common. `bent` selects a parabola in every heated sweep, not only a line.
    """

    position_mm: Floats
    t_s: Floats
    direction: Ints
    sweep: Ints
    error_um: Floats
    middle_s: Floats
    cold: Bools
    p0_mm: float
    angle_sd_urad: float
    weight: Floats | None = None
    tie: Floats | None = None
    bent: bool = False


@dataclass(frozen=True)
class SweepFit:
    """Solution of the fit over all sweeps. `states` lists the heated sweeps; arrays of states have length m.

    `line_covariance` (2 m, 2 m) is that of (intercepts, slopes). `bend_um_per_m2` is zero where no bend was fitted;
    `line_um` (n,) is the whole thermal part at the points, bend included.
    """

    curve: Curve
    directions: tuple[int, ...]
    states: Ints
    intercept_um: Floats
    intercept_se_um: Floats
    slope_um_per_m: Floats
    slope_se_um_per_m: Floats
    bend_um_per_m2: Floats
    bend_se_um_per_m2: Floats
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


def _point_weight(data: ComponentData) -> Floats:
    return np.ones(len(data.error_um)) if data.weight is None else data.weight


def _common_columns(data: ComponentData) -> tuple[Floats, Floats]:
    """What the points of a sweep share: columns (n, q), and the inverse of its covariance (q, q).

    A slope for every sweep (lever in metres from the sweep's mean position), and an offset where there is a tie.
    """
    n, count = len(data.position_mm), len(data.middle_s)
    if data.tie is None and data.angle_sd_urad <= 0:
        return np.zeros((n, 0)), np.zeros((0, 0))
    offset, slope = np.zeros((n, count)), np.zeros((n, count))
    for number in range(count):
        rows = data.sweep == number
        if rows.any():
            offset[rows, number] = 1.0
            slope[rows, number] = (data.position_mm[rows] - data.position_mm[rows].mean()) / 1000.0
    if data.tie is None:
        return slope, np.eye(count) / data.angle_sd_urad**2
    # Known better than a thousandth of a µm is known exactly: the floor keeps the inverse finite.
    shared = data.tie + np.diag([1e-6, data.angle_sd_urad**2 + 1e-6])
    precision = np.zeros((2 * count, 2 * count))
    for number, inverse in enumerate(np.linalg.inv(shared)):
        pair = [number, count + number]
        precision[np.ix_(pair, pair)] = inverse
    return np.hstack([offset, slope]), precision


@dataclass(frozen=True)
class _System:
    design: Floats
    prior: Floats  # roughness of the geometry, in units of 1/noise variance
    precision: Floats  # of what sweeps have in common
    common: slice
    geometry: slice
    intercepts: slice
    slopes: slice
    bends: slice  # empty for a component that stays a line


def _system(data: ComponentData, curve: Curve, directions: Sequence[int], states: Ints, extra: Floats) -> _System:
    geometry = direction_design(curve, data.position_mm, data.direction, directions)
    weights = state_weights(data, states) if len(states) else np.zeros((len(data.t_s), 0))
    common, precision = _common_columns(data)
    powers = [lever_m(data)[:, None] ** power for power in range(3 if data.bent else 2)]
    design = np.hstack([geometry, *(weights * power for power in powers), common, extra])
    g, m, k = geometry.shape[1], len(states), common.shape[1]
    heat = g + len(powers) * m
    prior = np.zeros((design.shape[1], design.shape[1]))
    prior[:g, :g] = direction_penalty(curve, directions)
    return _System(
        design=design,
        prior=prior,
        precision=precision,
        common=slice(heat, heat + k),
        geometry=slice(0, g),
        intercepts=slice(g, g + m),
        slopes=slice(g + m, g + 2 * m),
        bends=slice(g + 2 * m, heat),
    )


@dataclass(frozen=True)
class _Solution:
    coefficients: Floats
    covariance: Floats
    residual: Floats
    noise_sd_um: float
    dof: float
    rss: float


def _solve(system: _System, data: ComponentData, robust: Floats) -> _Solution:
    """Weighted least squares with the priors; the noise variance and the priors of the sweeps agree at the end.

    `robust` (n,) takes weight from outliers, on top of the stated weights.
    """
    design, target = system.design, data.error_um
    weight = robust * _point_weight(data)
    gram = design.T @ (design * weight[:, None])
    right = design.T @ (target * weight)
    variance = float(np.average((target - np.average(target, weights=weight)) ** 2, weights=weight)) + 1e-12
    effective = float(robust.sum())
    for _ in range(50):
        normal = gram + system.prior
        normal[system.common, system.common] += variance * system.precision
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
    """Points more than 4.5 robust standard deviations from a Huber fit, (n,).

    One such deviation is at least the instrument's resolution.
    """
    least = resolution(data.error_um)
    system = _system(data, curve, directions, states, np.zeros((len(data.t_s), 0)))
    stated = np.sqrt(_point_weight(data))
    weight = np.ones(len(data.error_um))
    for _ in range(30):
        solution = _solve(system, data, weight)
        own = stated * solution.residual
        scaled = np.abs(own) / max(_robust_scale(own, len(weight) - solution.dof), least)
        new_weight = np.minimum(1.0, HUBER_SIGMA / np.maximum(scaled, 1e-12))
        done = np.max(np.abs(new_weight - weight)) < 1e-3
        weight = new_weight
        if done:
            break
    outlier = scaled > OUTLIER_SIGMA
    for _ in range(5):
        solution = _solve(system, data, (~outlier).astype(float))
        again = np.abs(stated * solution.residual) > OUTLIER_SIGMA * max(solution.noise_sd_um, least)
        if np.array_equal(again, outlier):
            break
        outlier = again
    return outlier


def fit_component(data: ComponentData) -> SweepFit:
    """Separate one component: outliers first, then the curve by hold-out, then the fit on the good points."""
    directions = tuple(int(d) for d in np.unique(data.direction))
    states = np.flatnonzero(~data.cold)
    # Outliers disturb the choice of the curve and a stiff curve makes good points look like outliers: start flexible.
    curve = flexible_curve(data.position_mm)
    for _ in range(2):
        outlier = find_outliers(data, curve, directions, states)
        good = ~outlier
        curve = choose_curve(data.position_mm[good], data.direction[good], data.sweep[good], data.error_um[good])
    system = _system(data, curve, directions, states, np.zeros((len(data.t_s), 0)))
    solution = _solve(system, data, (~outlier).astype(float))
    se = np.sqrt(np.diag(solution.covariance))
    g = system.geometry
    line_part = slice(system.intercepts.start, system.slopes.stop)
    heat = slice(system.intercepts.start, system.bends.stop)
    straight = np.zeros(len(states))
    return SweepFit(
        curve=curve,
        directions=directions,
        states=states,
        intercept_um=solution.coefficients[system.intercepts],
        intercept_se_um=se[system.intercepts],
        slope_um_per_m=solution.coefficients[system.slopes],
        slope_se_um_per_m=se[system.slopes],
        bend_um_per_m2=solution.coefficients[system.bends] if data.bent else straight,
        bend_se_um_per_m2=se[system.bends] if data.bent else straight,
        line_covariance=solution.covariance[line_part, line_part],
        geometry_coefficients=solution.coefficients[g],
        geometry_covariance=solution.covariance[g, g],
        geometry_um=system.design[:, g] @ solution.coefficients[g],
        line_um=system.design[:, heat] @ solution.coefficients[heat],
        outlier=outlier,
        noise_sd_um=solution.noise_sd_um,
        dof=solution.dof,
        rss_um2=solution.rss,
    )


@dataclass(frozen=True)
class ShapeChange:
    """The fit in which every heated sweep may change its shape: `terms` more unknowns, residual sum `rss_um2`.

    `change_um` and `se_um` (n,) are the change at every point with its standard error. The geometry is that of the
    cold block here: the mean change of shape cannot hide in it.
    """

    rss_um2: float
    terms: int
    change_um: Floats
    se_um: Floats
    geometry_coefficients: Floats
    geometry_covariance: Floats
    geometry_um: Floats


def shape_change(data: ComponentData, fit: SweepFit) -> ShapeChange:
    """Fit a change of shape to every heated sweep: second and third Legendre terms and a change of reversal.

    Where the fit has a bend already, the second term is in it.
    """
    good = ~fit.outlier
    span = (data.position_mm.min(), data.position_mm.max())
    x = 2.0 * (data.position_mm - span[0]) / (span[1] - span[0]) - 1.0
    terms = [2.5 * x**3 - 1.5 * x] if data.bent else [1.5 * x**2 - 0.5, 2.5 * x**3 - 1.5 * x]
    if len(fit.directions) == 2:
        terms.append(data.direction / 2.0)
    blocks = [term * (data.sweep == state) for state in fit.states for term in terms]
    extra = np.column_stack(blocks)
    system = _system(data, fit.curve, fit.directions, fit.states, extra)
    rich = _solve(system, data, good.astype(float))
    tail = slice(system.common.stop, system.design.shape[1])
    change = extra @ rich.coefficients[tail]
    variance = np.einsum("ij,jk,ik->i", extra, rich.covariance[tail, tail], extra)
    g = system.geometry
    return ShapeChange(
        rss_um2=rich.rss,
        terms=extra.shape[1],
        change_um=np.asarray(change),
        se_um=np.sqrt(np.maximum(variance, 0.0)),
        geometry_coefficients=rich.coefficients[g],
        geometry_covariance=rich.covariance[g, g],
        geometry_um=np.asarray(system.design[:, g] @ rich.coefficients[g]),
    )

"""The joint form of a campaign: all sweeps of all axes together, the drift of one direction counted once.

    E(p) = D(t) + Σ_a [G_a(p_a) + S_a(t) (p_a - P0_a) + C_a(t) (p_a - P0_a)²] + Σ_a ρ_a(p_a, t) × arm_a(p) + noise

Each axis is separated alone first; its intercept then holds the drift and the share of the other axes at the positions
where they stood. With these positions known the share is taken off every point at its own time, and the axes are
separated once more: what is left of the intercepts is the drift, seen by every sweep of every axis. `ρ_a` is the part
of the angular errors that changes along axis a (µrad), known where angles were measured; `arm_a` is made of the axes
that a carries. The constant part of a rotation is a slope of the axes behind it, and is measured as such.

The zero stays that of each axis' own cold sweeps: a resting axis stands on one side of its reversal, so the constants
of the cold sweeps differ by a few µm, and one common zero would turn that into false drift. Their mean is the one
constant of the geometry, and their spread is reported.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from thetacomp.arrays import CARTESIAN, Floats
from thetacomp.campaign import Campaign
from thetacomp.instrument import resolution
from thetacomp.machine import Machine
from thetacomp.model.axis_chain import ChainAxis, arms_behind_m, chain_of, turned_um
from thetacomp.separation.axis_shares import AxisFit, axis_share_um, between_nodes, node_weights
from thetacomp.separation.component import ComponentSeparation, GeometryCurve, Points
from thetacomp.separation.drift_nodes import MIN_MEANS, DriftMeans, Nodes, drift_means, join, scatter
from thetacomp.separation.drift_outliers import gross_means, gross_note, gross_readings, least_sd
from thetacomp.separation.reference import reference_time_s, refuse_reference_in_a_sweep
from thetacomp.separation.separate import separate_axis
from thetacomp.separation.sweep_fit import lever_m, state_weights

ANGLES = ("A", "B", "C")
AT_P0_MM = 1.0


@dataclass(frozen=True)
class JointSeparation:
    """The components of one campaign in the joint form, and its angles where they were measured (µrad, µrad/m)."""

    components: tuple[ComponentSeparation, ...]
    angles: tuple[ComponentSeparation, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Campaign:
    """One quantity of a campaign (`letters` name its three columns) with the positions of all swept axes, (n,) each.

    `angles` are the fits of the angular errors, by axis, whose arms are taken off; `bent` as in `separate_joint`.
    """

    machine: Machine
    campaign: Campaign
    chain: tuple[ChainAxis, ...]
    letters: tuple[str, ...]
    reference_s: float
    means: DriftMeans | None
    angles: dict[str, list[AxisFit]]
    bent: Collection[str] = ()

    def share(
        self, fits: dict[str, list[AxisFit]], moving: Sequence[str], t_s: Floats, at_mm: dict[str, Floats]
    ) -> Floats:
        """What the axes that do not move add at n points, (n, 3)."""
        out = np.zeros((len(t_s), 3))
        names = np.array(moving, dtype=str)
        for axis in self.chain:
            share = axis_share_um(fits[axis.name], self.letters, t_s, at_mm[axis.name])
            out += np.where((names != axis.name)[:, None], share, 0.0)
        return out

    def arms(self, t_s: Floats, at_mm: dict[str, Floats]) -> Floats:
        """What angular errors that change along an axis add over their arms at n points, (n, 3)."""
        out = np.zeros((len(t_s), 3))
        arms_m = arms_behind_m(self.chain, at_mm)
        for name, some in self.angles.items():
            out += turned_um(axis_share_um(some, ANGLES, t_s, at_mm[name]), arms_m[name])
        return out


def why_not_joint(machine: Machine, campaign: Campaign) -> str | None:
    """Why the axes of a campaign cannot be separated together; None where they can."""
    points = campaign.sweeps
    if points is None:
        return "it has no sweeps"
    swept = [axis for axis in machine.axes if axis.name in points.axis]
    if len(swept) < 2:
        return f"only axis {swept[0].name} was swept"
    if campaign.settings.datum == "common" or campaign.parameters is not None:
        return "its errors were separated already, or count from a common datum"
    moving = np.array(points.axis)
    for axis in swept:
        at_mm = points.at_mm.get(axis.name)
        if at_mm is None or not np.isfinite(at_mm[moving != axis.name]).all():
            return f"at_{axis.name}_mm is not given at every point of the other axes"
    chain = chain_of(swept)
    measured = {axis.name: np.isfinite(points.error_um[moving == axis.name]).any(axis=0) for axis in chain}
    for link in chain:
        off = (moving != link.name) & (np.abs(points.at_mm[link.name] - link.p0_mm) > AT_P0_MM)
        for k, direction in enumerate(CARTESIAN):
            if not measured[link.name][k] and np.isfinite(points.error_um[off, k]).any():
                return f"d{direction}_um was not measured along {link.name}, which stood off the middle of its travel"
    return None


def separate_joint(machine: Machine, campaign: Campaign, bent: Collection[str] = ()) -> JointSeparation:
    """Separate all axes of one campaign together. The campaign must pass `why_not_joint`.

    `bent` names the components whose heated sweeps are parabolas instead of lines. Raises AnalysisError where an axis
    has too few points.
    """
    points = campaign.sweeps
    assert points is not None
    reference_s = reference_time_s(campaign)
    refuse_reference_in_a_sweep(campaign, reference_s)
    chain = chain_of([axis for axis in machine.axes if axis.name in points.axis])
    means, notes = _drift_means(
        campaign, chain, campaign.drift.error_um if campaign.drift else None, least_sd(campaign)
    )
    whole = _Campaign(machine, campaign, chain, CARTESIAN, reference_s, means, {}, bent)
    angles, angle_fits = _angles(whole)
    components, _ = _solved(replace(whole, angles=angle_fits))
    return JointSeparation(tuple(components), tuple(angles), tuple(notes))


def _angles(whole: _Campaign) -> tuple[list[ComponentSeparation], dict[str, list[AxisFit]]]:
    """Angles are separated like errors, where every sweep has all three; they need no arms."""
    points, drift = whole.campaign.sweeps, whole.campaign.drift
    assert points is not None
    turned = points.rotation_urad
    if turned is None or not all(
        np.isfinite(turned[np.array(points.axis) == axis.name]).any(axis=0).all() for axis in whole.chain
    ):
        return [], {}
    means = None
    if drift is not None and drift.rotation_urad is not None:
        means, _ = _drift_means(
            whole.campaign, whole.chain, drift.rotation_urad, least_sd(whole.campaign, is_angle=True)
        )
    campaign = replace(whole.campaign, sweeps=replace(points, error_um=turned))
    return _solved(replace(whole, campaign=campaign, letters=ANGLES, means=means))


def _drift_means(
    campaign: Campaign, chain: Sequence[ChainAxis], error: Floats | None, least: float
) -> tuple[DriftMeans | None, list[str]]:
    """The drift record where it says where the axes stood, and a note where it cannot be joined.

    Readings that their neighbours in time contradict are left out; `least` is the smallest standard deviation of one.
    """
    drift = campaign.drift
    if drift is None or error is None:
        return None, []
    lacking = [a.name for a in chain if a.name not in drift.at_mm or not np.isfinite(drift.at_mm[a.name]).all()]
    if lacking:
        return None, [
            f"campaign {campaign.name}: drift.csv is left out, it lacks the positions of the axes"
            f" ({', '.join(f'at_{name}_mm' for name in lacking)})"
        ]
    at_mm = {a.name: drift.at_mm[a.name] for a in chain}
    gross = gross_readings(drift.t_s, error, at_mm, least)
    means = drift_means(drift, np.where(gross, np.nan, error), at_mm)
    gross_s = tuple(drift.t_s[column] for column in gross.T)
    return replace(means, gross_s=gross_s, resolution=tuple(resolution(column) for column in error.T)), []


def _solved(whole: _Campaign) -> tuple[list[ComponentSeparation], dict[str, list[AxisFit]]]:
    """All components of one quantity, and the fits of every axis."""
    points = whole.campaign.sweeps
    assert points is not None
    moving = np.array(points.axis)
    at_mm = {a.name: np.where(moving == a.name, points.position_mm, points.at_mm[a.name]) for a in whole.chain}
    # The arms first: a slope that holds the turn of another axis must not be taken off together with that turn.
    error = points.error_um - whole.arms(points.t_s, at_mm)
    alone = _fits(whole, error)
    share = whole.share(alone, points.axis, points.t_s, at_mm)
    fits = _fits(whole, error - share) if np.abs(share).max() > 1e-6 else alone
    components: list[ComponentSeparation] = []
    for letter in whole.letters:
        own = {name: f for name, some in fits.items() for f in some if f.separation.direction == letter}
        first = {name: f for name, some in alone.items() for f in some if f.separation.direction == letter}
        if own:
            components += _joined(whole, letter, own, first, alone, at_mm)
    order = [*(axis.name for axis in whole.chain), None]
    return sorted(components, key=lambda s: (order.index(s.axis), s.direction)), fits


def _fits(whole: _Campaign, error: Floats) -> dict[str, list[AxisFit]]:
    points = whole.campaign.sweeps
    assert points is not None
    campaign = replace(whole.campaign, sweeps=replace(points, error_um=error))
    return {
        axis.name: separate_axis(whole.machine.axis(axis.name), campaign, whole.reference_s, whole.letters, whole.bent)
        for axis in whole.chain
    }


def _joined(
    whole: _Campaign,
    letter: str,
    own: dict[str, AxisFit],
    first: dict[str, AxisFit],
    alone: dict[str, list[AxisFit]],
    at_mm: dict[str, Floats],
) -> list[ComponentSeparation]:
    """One direction: the drift of all sweeps, and every axis with its intercept taken out."""
    sweeps, covariance = _drift_of_sweeps(whole, own, at_mm)
    cold_s = np.concatenate([f.data.middle_s[f.data.cold] for f in own.values()])
    cold_sweep = np.concatenate([f.separation.sweep[f.data.cold] for f in own.values()])
    nodes, drift_notes = _with_means(whole, letter, own, alone, sweeps, covariance)
    constants = np.array([f.constant_um for f in own.values()])
    drift = _drift_component(whole, letter, own, nodes, (cold_s, cold_sweep), constants, first)
    drift = replace(drift, notes=(*drift.notes, *drift_notes))
    by_sweep = dict(zip(nodes.sweep.tolist(), nodes.value.tolist(), strict=True))
    return [drift, *(_without_drift(fitted, by_sweep) for fitted in own.values())]


def _with_means(
    whole: _Campaign,
    letter: str,
    own: dict[str, AxisFit],
    alone: dict[str, list[AxisFit]],
    sweeps: Nodes,
    covariance: Floats,
) -> tuple[Nodes, tuple[str, ...]]:
    """The drift of the sweeps joined with the drift record, whose gross readings are left out and reported."""
    means = whole.means
    if means is None or not len(sweeps.t_s):
        return sweeps, ()
    column = whole.letters.index(letter)
    share = whole.share(alone, ("",) * len(means.t_s), means.t_s, means.at_mm)
    share += whole.arms(means.t_s, means.at_mm)
    value = (means.error - share)[:, column]
    zero_s = max(whole.reference_s, max(float(f.separation.zero_t_s.max()) for f in own.values()))
    gross = gross_means(
        means.t_s,
        value,
        np.append(zero_s, sweeps.t_s),
        np.append(0.0, sweeps.value),
        between_nodes(zero_s, sweeps.t_s, means.t_s) @ sweeps.value,
        max(least_sd(whole.campaign, is_angle=letter in ANGLES), means.resolution[column]),
        float(np.median([f.fit.noise_sd_um for f in own.values()])),
    )
    seen = np.isfinite(value) & ~gross
    left_out_s = np.concatenate([means.gross_s[column], means.t_s[gross]])
    notes = []
    if len(left_out_s):
        notes.append(gross_note(left_out_s, "the readings beside them and the sweeps"))
    if np.count_nonzero(seen) < MIN_MEANS:
        if notes:
            notes.append(f"drift.csv is left out: {seen.sum()} good readings are left, at least {MIN_MEANS} are needed")
        return sweeps, tuple(notes)
    arms = _mean_arms(whole, own, means)[seen]
    sd = scatter(value[seen]) + 1e-3
    return join(sweeps, covariance, zero_s, means.t_s[seen], value[seen], arms, sd), tuple(notes)


def _drift_of_sweeps(whole: _Campaign, own: dict[str, AxisFit], at_mm: dict[str, Floats]) -> tuple[Nodes, Floats]:
    """Drift of all heated sweeps in order of time, (m,), and the covariance (2 m, 2 m) of drift and slopes.

    The slopes of the other axes were taken off times their distance from P0: their errors go into the drift. The
    slopes come axis by axis, as in `own`.
    """
    points = whole.campaign.sweeps
    assert points is not None
    blocks = [f.fit.line_covariance for f in own.values()]
    starts = dict(zip(own, np.cumsum([0, *(len(block) for block in blocks)]).tolist(), strict=False))
    rows, times, values, numbers = [], [], [], []
    size = sum(len(block) for block in blocks)
    for name, fitted in own.items():
        for j, state in enumerate(fitted.fit.states):
            row, t_s = np.zeros(size), fitted.data.middle_s[state]
            row[starts[name] + j] = 1.0
            in_sweep = points.sweep == fitted.separation.sweep[state]
            for axis in whole.chain:
                other = own.get(axis.name)
                if other is not None and axis.name != name:
                    m = len(other.fit.states)
                    arm_m = float(axis.arm_m(at_mm[axis.name][in_sweep]).mean())
                    slopes = slice(starts[axis.name] + m, starts[axis.name] + 2 * m)
                    row[slopes] -= arm_m * node_weights(other, np.array([t_s]))[0]
            rows.append(row)
            times.append(t_s)
            values.append(fitted.fit.intercept_um[j])
            numbers.append(int(fitted.separation.sweep[state]))
    order = np.argsort(times, kind="stable")
    slopes_only = [starts[name] + len(f.fit.states) + np.arange(len(f.fit.states)) for name, f in own.items()]
    design = np.vstack([np.array(rows).reshape(-1, size)[order], np.eye(size)[np.concatenate(slopes_only)]])
    covariance = design @ linalg.block_diag(*blocks) @ design.T
    t_s, value, sweep = np.array(times)[order], np.array(values)[order], np.array(numbers, dtype=np.int64)[order]
    se = np.sqrt(np.maximum(np.diag(covariance)[: len(t_s)], 0.0))
    return Nodes(t_s, value, se, sweep), covariance


def _mean_arms(whole: _Campaign, own: dict[str, AxisFit], means: DriftMeans) -> Floats:
    """What every slope of every axis adds to a mean, µm for a µm/m, (n, slopes)."""
    parts = []
    for name, fitted in own.items():
        axis = next(axis for axis in whole.chain if axis.name == name)
        parts.append(node_weights(fitted, means.t_s) * axis.arm_m(means.at_mm[name])[:, None])
    return np.hstack(parts)


def _drift_component(
    whole: _Campaign,
    letter: str,
    own: dict[str, AxisFit],
    nodes: Nodes,
    cold: tuple[Floats, Floats],
    constants: Floats,
    first: dict[str, AxisFit],
) -> ComponentSeparation:
    """The drift of one direction, a state at every sweep, cold ones included."""
    cold_s, cold_sweep = cold
    zeros = np.zeros(len(cold_s))
    t_s = np.concatenate([cold_s, nodes.t_s])
    order = np.argsort(t_s, kind="stable")
    extra = nodes.sweep.copy()
    # Moments of the drift record alone get numbers of their own, behind those of the sweeps.
    last = max([*cold_sweep.tolist(), *nodes.sweep.tolist()])
    extra[extra < 0] = last + 1 + np.arange(np.count_nonzero(extra < 0))
    nan, flat = np.full(len(t_s), np.nan), np.zeros(len(t_s))
    return ComponentSeparation(
        campaign=whole.campaign.name,
        component=f"D{letter}",
        direction=letter,
        axis=None,
        p0_mm=0.0,
        p_min_mm=0.0,
        p_max_mm=0.0,
        reference_s=whole.reference_s,
        zero_t_s=np.sort(np.concatenate([f.separation.zero_t_s for f in own.values()])),
        sweep=np.concatenate([cold_sweep, extra])[order],
        t_s=t_s[order],
        cold=(np.arange(len(t_s)) < len(cold_s))[order],
        intercept_um=np.concatenate([zeros, nodes.value])[order],
        intercept_se_um=np.concatenate([zeros, nodes.se])[order],
        slope_um_per_m=flat,
        slope_se_um_per_m=flat,
        rms_um=nan,
        noise_sd_um=float("nan"),
        dof=float("nan"),
        cold_intercept_um=float(constants.mean()),
        notes=(*_drift_notes(letter, list(own), nodes, constants, first), *_closure_notes(letter, own, nodes)),
        form="joint",
    )


def _drift_notes(
    letter: str, axes: list[str], nodes: Nodes, constants: Floats, first: dict[str, AxisFit]
) -> tuple[str, ...]:
    """What adding the intercepts of single sweeps would cost, and how well the constants of the geometry agree."""
    if letter in ANGLES or len(axes) < 2 or not len(nodes.t_s):
        return ()
    naive = sum(node_weights(f, nodes.t_s) @ f.fit.intercept_um for f in first.values())
    wrong_um = float(np.abs(naive - nodes.value).max())
    spread_um = float(np.ptp(constants))
    listed = " and ".join([", ".join(axes[:-1]), axes[-1]])
    return (
        f"the naive sum of the intercepts of the sweeps along {listed} would be wrong by up to {wrong_um:.0f} µm:"
        " it counts the drift more than once; the joint form counts it once",
        f"the constants of the cold sweeps along {listed} differ by up to {spread_um:.1f} µm (reversal of resting axes,"
        " drift during the cold block); the geometry has their mean",
    )


def _closure_notes(letter: str, own: dict[str, AxisFit], nodes: Nodes) -> tuple[str, ...]:
    """Axes whose sweeps see another drift than the sweeps of the others, by more than chance explains."""
    notes = []
    unit = "µrad" if letter in ANGLES else "µm"
    for name, fitted in own.items():
        mine = np.isin(nodes.sweep, fitted.separation.sweep)
        if len(own) < 3 or not mine.any():
            continue
        known_s, known = nodes.t_s[~mine], nodes.value[~mine]
        inside = mine & (nodes.t_s > known_s.min()) & (nodes.t_s < known_s.max())
        if np.count_nonzero(inside) < 3:
            continue
        apart = nodes.value[inside] - np.interp(nodes.t_s[inside], known_s, known)
        typical, chance = float(np.sqrt(np.mean(apart**2))), float(np.sqrt(2.0 * np.mean(nodes.se**2)))
        if typical > 3.0 * chance:
            notes.append(
                f"the sweeps along {name} see a drift that differs from that of the other sweeps by {typical:.0f}"
                f" {unit} (RMS; chance alone: {chance:.0f}): a line does not follow a bend that grows with heat, or the"
                " frame moved between the sweeps"
            )
    return tuple(notes)


def _without_drift(fitted: AxisFit, drift: dict[int, float]) -> ComponentSeparation:
    """The component of one axis with its line or bend, zero at P0; its points without constant and drift."""
    s, fit, data = fitted.separation, fitted.fit, fitted.data
    constant = fitted.constant_um
    heated = np.array([drift[int(s.sweep[state])] for state in fit.states])
    weights = state_weights(data, fit.states) if len(fit.states) else np.zeros((len(data.t_s), 0))
    drift_um = weights @ heated
    lever = lever_m(data)
    line_um = (weights @ fit.slope_um_per_m) * lever + (weights @ fit.bend_um_per_m2) * lever**2
    assert s.points is not None
    points: Points = replace(
        s.points,
        error_um=s.points.error_um - constant - drift_um,
        geometry_um=s.points.geometry_um - constant,
        line_um=line_um,
        drift_um=drift_um,
    )
    curves: tuple[GeometryCurve, ...] = tuple(replace(c, value_um=c.value_um - constant) for c in s.geometry)
    zeros = np.zeros(len(s.t_s))
    return replace(s, intercept_um=zeros, intercept_se_um=zeros, points=points, geometry=curves, form="joint")

"""From tracker points to errors of the machine: tie to the foundation, fit the frame once, subtract the command."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from thetacomp.arrays import CARTESIAN, Bools, Floats, Ints
from thetacomp.campaign import SweepPoints, TrackerSettings, TrackerTie
from thetacomp.cold_block import cold_block_length, sweep_table
from thetacomp.machine import Machine
from thetacomp.tracker.closure import (
    closures,
    excess_by_station,
    inflated,
    scale_drift,
    tracker_motions,
    without_moved_targets,
)
from thetacomp.tracker.doubt import FrameError, TrackerDoubt
from thetacomp.tracker.foundation import Foundation, Network, adjust, find_rounds
from thetacomp.tracker.notes import describe, scale_doubt
from thetacomp.tracker.rigid import (
    RigidFit,
    best_fit,
    design,
    fit_rigid,
    line_direction,
    point_covariance_um2,
    scale_um_per_m,
    turned,
)
from thetacomp.tracker.ties import (
    RoundWeights,
    refuse_moved_station,
    round_weights,
    tied_points,
    unbracketed,
    uneven_steps,
    usable_rounds,
)

MISFIT_UM = 5000.0


def nominal_mm(machine: Machine, points: SweepPoints) -> Floats:
    """Commanded machine points (n, 3): sum over the axes of direction times position; NaN where one is not known.

    An axis that never moves and has no position is taken to stand still: a constant goes into the translation.
    """
    out = np.zeros((len(points.t_s), 3))
    moving = np.array(points.axis)
    for axis in machine.axes:
        own = moving == axis.name
        if not own.any() and axis.name not in points.at_mm:
            continue
        elsewhere = points.at_mm.get(axis.name, np.full(len(points.t_s), np.nan))
        out[:, CARTESIAN.index(axis.cartesian)] += axis.sign * np.where(own, points.position_mm, elsewhere)
    return out


def to_machine_frame(
    machine: Machine,
    points: SweepPoints,
    xyz_mm: Floats,
    foundation: Foundation,
    instrument: TrackerSettings,
    reference_s: float | None = None,
) -> tuple[SweepPoints, TrackerTie, tuple[TrackerDoubt, ...]]:
    """Errors of the machine at `points`, which were measured at `xyz_mm` (n, 3) in the frame of their station.

    Returns the points with `error_um`, `sd_um`, `noise_um` and `tie_covariance`, what was found about frame and
    stations, and what is doubtful. The frame is fitted on the sweeps that ended by `reference_s` (default: the cold
    block) and never again. Raises FrameError where frame or ties cannot be determined, with the reason.
    """
    station = points.station or ("the tracker",) * len(points.t_s)
    nominal = nominal_mm(machine, points)
    measured = np.asarray(np.isfinite(np.hstack([xyz_mm, nominal])).all(axis=1), dtype=bool)
    cold = _cold_points(points, reference_s) & measured
    _refuse_line(nominal[cold], points, cold)
    own_um2 = np.full((len(xyz_mm), 3, 3), np.nan)
    own_um2[measured] = point_covariance_um2(xyz_mm[measured], instrument)
    tie = _tie(points.t_s, station, xyz_mm, nominal, cold, measured, foundation, instrument)
    fit = fit_rigid(tie.xyz_mm[cold], nominal[cold], turned(own_um2, tie.rotation)[cold])
    _refuse_misfit(machine, points, tie.xyz_mm, nominal, cold, fit)
    error, noise_um2, parts = _errors(tie, fit, nominal, own_um2, cold)
    scale = scale_um_per_m(fit, nominal[cold])
    motions = tracker_motions(tie.network, tie.covariance, fit.transform.rotation) if tie.network is not None else None
    result = replace(
        points,
        error_um=error,
        sd_um=np.sqrt(np.einsum("nii->ni", noise_um2 + parts.frame_um2) + _tie_variance(tie, parts)),
        noise_um=np.sqrt(np.einsum("nii->ni", noise_um2)),
        tie_covariance=_common(points, measured, tie, parts),
    )
    size = np.linalg.norm(fit.residual_um, axis=1)[fit.used]
    report = TrackerTie(
        rotation=fit.transform.rotation,
        translation_mm=fit.transform.translation_mm,
        cold_points=int(fit.used.sum()),
        frame_rms_um=float(np.sqrt(np.mean(size**2))),
        frame_largest_um=float(size.max()),
        scale_um_per_m=scale[0],
        scale_se_um_per_m=scale[1],
        closures=closures(foundation, tie.network, tie.excess, motions)
        if tie.network is not None and motions is not None
        else (),
        round_t_s=np.array([item.t_s for item in tie.network.rounds] if tie.network is not None else []),
        round_station=tuple(item.station for item in tie.network.rounds) if tie.network is not None else (),
        motion_um=motions.value_um if motions is not None else np.zeros((0, 3)),
        motion_se_um=motions.se_um if motions is not None else np.zeros((0, 3)),
    )
    left_out = int((~fit.used).sum())
    notes = describe(report, _axes(points, cold), left_out)
    doubts = (*tie.doubts, *scale_doubt(*scale))
    return result, replace(report, notes=notes, doubts=tuple(item.message for item in doubts)), doubts


def _cold_points(points: SweepPoints, reference_s: float | None) -> Bools:
    table = sweep_table(points)
    if reference_s is None:
        reference_s = float(table.end_s[cold_block_length(table.axis) - 1])
    cold = table.sweep[table.end_s <= reference_s + 1.0]
    if not len(cold):
        raise FrameError(
            "no-cold-sweep",
            f"no sweep ended before reference_s = {reference_s:g} s: there is no cold block to fit the frame on.",
            "set reference_s in campaign.toml to the end of the cold sweeps, or leave it out.",
        )
    return np.isin(points.sweep, cold)


def _axes(points: SweepPoints, rows: Bools) -> tuple[str, ...]:
    return tuple(dict.fromkeys(np.array(points.axis)[rows].tolist()))


def _refuse_line(nominal: Floats, points: SweepPoints, cold: Bools) -> None:
    """Raises FrameError where the cold points lie on one line: the roll about it stays open."""
    axes = ", ".join(_axes(points, cold))
    fix = "measure a cold sweep of at least one more axis, in another direction, before any heat."
    if len(nominal) < 3:
        raise FrameError(
            "frame-few", f"the cold block has {len(nominal)} complete points; a frame needs three and more.", fix
        )
    direction = line_direction(nominal)
    if direction is None:
        return
    letter = CARTESIAN[int(np.abs(direction).argmax())]
    raise FrameError(
        "frame-line",
        f"all points of the cold block lie on one line along {letter} (axis {axes}): the roll of the tracker about"
        f" {letter} cannot be determined, so the errors across that line have no direction.",
        fix,
    )


@dataclass(frozen=True)
class _Tie:
    """Machine points in foundation coordinates; without foundation targets those of the resting tracker."""

    xyz_mm: Floats
    rotation: Floats
    network: Network | None
    share: RoundWeights | None
    covariance: Floats
    steps: dict[int, Floats]
    excess: dict[str, float]
    doubts: tuple[TrackerDoubt, ...]


def _tie(
    t_s: Floats,
    station: tuple[str, ...],
    xyz_mm: Floats,
    nominal: Floats,
    cold: Bools,
    measured: Bools,
    foundation: Foundation,
    instrument: TrackerSettings,
) -> _Tie:
    used = list(dict.fromkeys(name for name, good in zip(station, measured, strict=True) if good))
    if not len(foundation.t_s) and len(used) == 1:
        alone = TrackerDoubt(
            "no-foundation",
            "there are no foundation targets (rows without an axis): a tracker that sinks or turns during the day"
            " cannot be distinguished from a machine that drifts, and no interval includes it.",
            "measure at least three fixed targets on the foundation before and after every round of sweeps.",
        )
        eye = np.broadcast_to(np.eye(3), (len(xyz_mm), 3, 3))
        return _Tie(xyz_mm, eye, None, None, np.zeros((0, 0)), {}, {}, (alone,))
    rounds = find_rounds(foundation, t_s, station)
    rounds, doubts = usable_rounds(foundation, rounds, used, _rough_rotations(station, xyz_mm, nominal, cold))
    share = round_weights(rounds, t_s, station)
    cold_share = share.weight[cold].mean(axis=0)
    own_um2 = point_covariance_um2(foundation.xyz_mm, instrument)
    network = adjust(foundation, rounds, own_um2, cold_share)
    refuse_moved_station(network)
    network, moved = without_moved_targets(foundation, network, own_um2, cold_share)
    excess = excess_by_station(network)
    covariance = inflated(network, excess)
    steps, uneven = uneven_steps(network, covariance, share)
    tied, rotation = tied_points(network, share, xyz_mm)
    doubts += moved + uneven + scale_drift(foundation, network) + unbracketed(rounds, t_s, station)
    return _Tie(tied, rotation, network, share, covariance, steps, excess, tuple(doubts))


def _rough_rotations(station: tuple[str, ...], xyz_mm: Floats, nominal: Floats, cold: Bools) -> dict[str, Floats]:
    """Rotation into machine axes of every station with cold points that are not on one line; used in messages alone."""
    names, found = np.array(station), {}
    for name in dict.fromkeys(station):
        rows = cold & (names == name)
        if rows.sum() >= 3 and line_direction(nominal[rows]) is None:
            found[name] = best_fit(xyz_mm[rows], nominal[rows]).rotation
    return found


def _refuse_misfit(
    machine: Machine, points: SweepPoints, tied_mm: Floats, nominal: Floats, cold: Bools, fit: RigidFit
) -> None:
    """Raises FrameError where the cold points are millimetres away from the commanded ones, with a guess at why."""
    rms_um = float(np.sqrt(np.mean(np.sum(fit.residual_um**2, axis=1))))
    if rms_um < MISFIT_UM:
        return
    centred, wanted = tied_mm[cold] - tied_mm[cold].mean(axis=0), nominal[cold] - nominal[cold].mean(axis=0)
    ratio = float(np.sqrt(np.sum(centred**2) / np.sum(wanted**2)))
    hint = ""
    if not 0.98 < ratio < 1.02:
        hint = f" The measured points span {ratio:.4g} times the commanded distances: is `unit` right?"
    for axis in machine.axes:
        turned_mm = nominal.copy()
        share = np.array([name == axis.name for name in points.axis])
        at = np.where(share, points.position_mm, points.at_mm.get(axis.name, np.zeros(len(share))))
        turned_mm[:, CARTESIAN.index(axis.cartesian)] -= 2.0 * axis.sign * at
        other = best_fit(tied_mm[cold], turned_mm[cold])
        rest = 1000.0 * (other.apply(tied_mm[cold]) - turned_mm[cold])
        if np.sqrt(np.mean(np.sum(rest**2, axis=1))) < 0.1 * rms_um:
            hint = f" It fits with the direction of axis {axis.name} turned: is machine.toml right?"
    raise FrameError(
        "frame-misfit",
        f"the cold points miss the commanded ones by {rms_um / 1000:.1f} mm (RMS) after the best rotation and"
        f" translation.{hint}",
        "check position_mm, at_<axis>_mm, the directions in machine.toml, the unit, and the names of the targets.",
    )


@dataclass(frozen=True)
class _Parts:
    """`jacobian` (n, 3, 6): small motion of the tracker's pose -> machine axes; `frame_um2` (n, 3, 3)."""

    jacobian: Floats
    frame_um2: Floats


def _errors(tie: _Tie, fit: RigidFit, nominal: Floats, own_um2: Floats, cold: Bools) -> tuple[Floats, Floats, _Parts]:
    error = 1000.0 * (fit.transform.apply(tie.xyz_mm) - nominal)
    noise = turned(own_um2, fit.transform.rotation @ tie.rotation)
    lever = design(nominal, fit.centre_mm)
    frame = lever @ fit.covariance @ np.swapaxes(lever, 1, 2)
    # The frame follows the noise of the points that it was fitted on: there its share counts the other way.
    frame[np.flatnonzero(cold)[fit.used]] *= -1.0
    centre = tie.network.centre_mm if tie.network is not None else np.zeros(3)
    jacobian = fit.transform.rotation @ design(tie.xyz_mm, centre)
    return error, noise, _Parts(jacobian, frame)


def _pose_rows(tie: _Tie, parts: _Parts, rows: Ints) -> tuple[Floats, Floats]:
    """How the poses of all rounds (6 R), and the odd steps, act on the points `rows`: (m, 3, 6 R) and (m, 3, steps)."""
    assert tie.share is not None
    jacobian = parts.jacobian[rows]
    acting = np.einsum("nij,nr->nirj", jacobian, tie.share.weight[rows]).reshape(len(jacobian), 3, -1)
    odd = np.zeros((len(jacobian), 3, len(tie.steps)))
    for s, (later, step) in enumerate(tie.steps.items()):
        # A step at an unknown moment between two rounds: the straight line is off by step sqrt(f (1 - f)), one sd.
        f = tie.share.fraction[rows]
        inside = (tie.share.after[rows] == later) * np.sqrt(f * (1.0 - f))
        odd[:, :, s] = (jacobian @ step) * inside[:, None]
    return acting, odd


def _tie_variance(tie: _Tie, parts: _Parts) -> Floats:
    if tie.network is None:
        return np.zeros((len(parts.jacobian), 3))
    acting, odd = _pose_rows(tie, parts, np.arange(len(parts.jacobian)))
    return np.asarray(np.sum((acting @ tie.covariance) * acting, axis=2) + np.sum(odd**2, axis=2))


def _common(points: SweepPoints, measured: Bools, tie: _Tie, parts: _Parts) -> Floats | None:
    """Covariance (sweeps, 3, 2, 2) of what the tie does to offset and slope of every sweep."""
    if tie.network is None:
        return None
    count = int(points.sweep.max()) + 1
    out = np.zeros((count, 3, 2, 2))
    for number in range(count):
        rows = np.flatnonzero((points.sweep == number) & measured)
        if len(rows) < 2:
            continue
        lever_m = (points.position_mm[rows] - points.position_mm[rows].mean()) / 1000.0
        to_line = np.linalg.pinv(np.column_stack([np.ones(len(rows)), lever_m]))
        acting, odd = _pose_rows(tie, parts, rows)
        for d in range(3):
            line, steps = to_line @ acting[:, d], to_line @ odd[:, d]
            out[number, d] = line @ tie.covariance @ line.T + steps @ steps.T
    return out

"""Fixed foundation targets tie every station and every hour of the tracker to the floor that carries the machine.

One adjustment holds all rounds: the targets have fixed coordinates, the tracker has one pose (6) for each round. Of all
free networks the one is taken in which the tracker does not move in the mean of the cold block, so that the covariance
of a pose is that of its motion since then.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Bools, Floats, Ints
from thetacomp.tracker.doubt import FrameError
from thetacomp.tracker.rigid import Rigid, best_fit, design, line_direction, turned

ROUND_GAP_S = 600.0
FEWEST_TARGETS = 3
ITERATIONS = 20


@dataclass(frozen=True)
class Foundation:
    """Readings of fixed targets in the frame of their station, n readings in order of time."""

    t_s: Floats
    station: tuple[str, ...]
    target: tuple[str, ...]
    xyz_mm: Floats

    def take(self, rows: Bools | Ints) -> Foundation:
        """Some of the readings."""
        kept = np.arange(len(self.t_s))[rows].tolist()
        return Foundation(
            self.t_s[kept],
            tuple(self.station[i] for i in kept),
            tuple(self.target[i] for i in kept),
            self.xyz_mm[kept],
        )


@dataclass(frozen=True)
class Round:
    """One visit of the foundation targets: readings `rows` of one station, at the mean time `t_s`."""

    station: str
    t_s: float
    rows: Ints


def find_rounds(readings: Foundation, machine_t_s: Floats, machine_station: Sequence[str]) -> tuple[Round, ...]:
    """Neighbouring readings of one station; a machine point in between or ten minutes of rest begin a new round."""
    rounds: list[Round] = []
    stations = np.array(readings.station)
    for station in dict.fromkeys(readings.station):
        rows = np.flatnonzero(stations == station)
        of_station = np.array([name == station for name in machine_station], dtype=bool)
        between = np.searchsorted(np.sort(machine_t_s[of_station]), readings.t_s[rows])
        new = (np.diff(readings.t_s[rows]) > ROUND_GAP_S) | (np.diff(between) > 0)
        rounds += [
            Round(station, float(readings.t_s[part].mean()), part) for part in np.split(rows, np.flatnonzero(new) + 1)
        ]
    return tuple(sorted(rounds, key=lambda item: item.t_s))


def is_complete(readings: Foundation, rows: Ints) -> bool:
    """Whether a round fixes all six motions: three targets that are not on one line."""
    points = _means(readings, rows)
    return len(points) >= FEWEST_TARGETS and line_direction(np.array(list(points.values()))) is None


def _means(readings: Foundation, rows: Ints) -> dict[str, Floats]:
    found: dict[str, list[Floats]] = {}
    for i in rows.tolist():
        found.setdefault(readings.target[i], []).append(readings.xyz_mm[i])
    return {name: np.mean(points, axis=0) for name, points in found.items()}


@dataclass(frozen=True)
class Network:
    """The adjusted network, R rounds: `poses` carry tracker coordinates into those of the foundation.

    `covariance` (6 R, 6 R) is that of the small motions of all poses about `centre_mm`, from the stated uncertainty
    alone. `residual_um` (n, 3) belongs to the readings, `round_of` (n,) says in which round each was taken;
    `chi2` (R,) and `freedom` (R,) compare the closure with the stated uncertainty.
    """

    rounds: tuple[Round, ...]
    poses: tuple[Rigid, ...]
    centre_mm: Floats
    covariance: Floats
    residual_um: Floats
    round_of: Ints
    weight: Floats
    chi2: Floats
    freedom: Floats
    targets_mm: dict[str, Floats]


def adjust(readings: Foundation, rounds: tuple[Round, ...], covariance_um2: Floats, cold_share: Floats) -> Network:
    """Adjust all rounds in one. `covariance_um2` (n, 3, 3) in tracker axes; `cold_share` (R,) is the gauge.

    Raises FrameError where a round shares fewer than three targets, or targets on one line, with the others.
    """
    poses, targets = _located(readings, rounds)
    names = list(targets)
    place = {name: k for k, name in enumerate(names)}
    round_of = np.full(len(readings.t_s), -1)
    for k, item in enumerate(rounds):
        round_of[item.rows] = k
    used = np.flatnonzero(round_of >= 0)
    of_target = np.array([place[readings.target[i]] for i in used])
    points_mm = np.array([targets[name] for name in names])
    centre = points_mm.mean(axis=0)
    count, size = len(rounds), 6 * len(rounds) + 3 * len(names)
    for _ in range(ITERATIONS):
        rotations = np.array([poses[k].rotation for k in round_of[used]])
        weight = np.linalg.inv(turned(covariance_um2[used], rotations))
        shifts = np.array([poses[k].translation_mm for k in round_of[used]])
        tied = np.einsum("nij,nj->ni", rotations, readings.xyz_mm[used]) + shifts
        residual = 1000.0 * (tied - points_mm[of_target])
        rows = np.zeros((len(used), 3, size))
        steps = design(tied, centre)
        for n, (k, j) in enumerate(zip(round_of[used], of_target, strict=True)):
            rows[n, :, 6 * k : 6 * k + 6] = steps[n]
            rows[n, :, 6 * count + 3 * j : 6 * count + 3 * j + 3] = -np.eye(3)
        weighted = np.einsum("nij,nja->nia", weight, rows).reshape(-1, size)
        normal = rows.reshape(-1, size).T @ weighted
        inverse = _gauged_inverse(normal, cold_share)
        step = -inverse @ (weighted.T @ residual.ravel())
        poses = [pose.after(step[6 * k : 6 * k + 6], centre) for k, pose in enumerate(poses)]
        points_mm = points_mm + 1e-3 * step[6 * count :].reshape(-1, 3)
        if np.abs(step).max() < 1e-3:
            break
    all_residuals = np.full((len(readings.t_s), 3), np.nan)
    all_residuals[used] = residual
    explained = (rows @ inverse) @ np.swapaxes(rows, 1, 2)
    influence = np.einsum("nij,nji->n", explained, weight)
    own = np.einsum("ni,nij,nj->n", residual, weight, residual)
    all_weights = np.full((len(readings.t_s), 3, 3), np.nan)
    all_weights[used] = weight
    return Network(
        rounds=rounds,
        poses=tuple(poses),
        centre_mm=centre,
        covariance=inverse[: 6 * count, : 6 * count],
        residual_um=all_residuals,
        round_of=round_of,
        weight=all_weights,
        chi2=np.array([own[round_of[used] == k].sum() for k in range(count)]),
        freedom=np.array([(3.0 - influence[round_of[used] == k]).sum() for k in range(count)]),
        targets_mm=dict(zip(names, points_mm, strict=True)),
    )


def _gauged_inverse(normal: Floats, cold_share: Floats) -> Floats:
    """Inverse of the singular normal matrix where the tracker rests in the mean of the cold block."""
    count, size = len(cold_share), len(normal)
    gauge = np.zeros((6, size))
    for k in range(count):
        gauge[:, 6 * k : 6 * k + 6] = cold_share[k] * np.eye(6)
    bordered = np.block([[normal, gauge.T], [gauge, np.zeros((6, 6))]])
    return np.asarray(np.linalg.inv(bordered)[:size, :size])


def _located(readings: Foundation, rounds: Sequence[Round]) -> tuple[list[Rigid], dict[str, Floats]]:
    """Rough poses and target coordinates, round by round from the first one."""
    waiting = list(range(len(rounds)))
    poses: dict[int, Rigid] = {0: Rigid(np.eye(3), np.zeros(3))}
    targets = dict(_means(readings, rounds[0].rows))
    waiting.remove(0)
    while waiting:
        for k in waiting:
            seen = _means(readings, rounds[k].rows)
            shared = [name for name in seen if name in targets]
            known = np.array([targets[name] for name in shared])
            if len(shared) >= FEWEST_TARGETS and line_direction(known) is None:
                poses[k] = best_fit(np.array([seen[name] for name in shared]), known)
                for name, point in seen.items():
                    targets.setdefault(name, poses[k].apply(point[None])[0])
                waiting.remove(k)
                break
        else:
            lost = rounds[waiting[0]]
            names = ", ".join(sorted(_means(readings, lost.rows)))
            raise FrameError(
                "foundation-unconnected",
                f"station {lost.station} at {lost.t_s / 3600:.2f} h saw the targets {names}; fewer than three of them,"
                f" or only some on one line, are among those that the other rounds saw ({', '.join(sorted(targets))}),"
                " so it cannot be tied to them.",
                "measure at least three common foundation targets, not on one line, from every station; check that a"
                " target has the same name everywhere.",
            )
    return [poses[k] for k in range(len(rounds))], targets

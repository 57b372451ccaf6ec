"""How well the foundation targets close: per station, against the stated uncertainty, and which target moved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thetacomp.campaign import Floats, StationClosure
from thetacomp.errors import AnalysisError
from thetacomp.tracker.finding import Finding
from thetacomp.tracker.foundation import FEWEST_TARGETS, Foundation, Network, Round, adjust, is_complete
from thetacomp.tracker.rigid import design

Z_95, Z_9999 = 1.645, 3.719


def chi2_quantile(freedom: float, z: float) -> float:
    """Quantile of chi-square at the normal quantile `z` (Wilson and Hilferty 1931)."""
    share = 2.0 / (9.0 * max(freedom, 1e-6))
    return float(freedom * (1.0 - share + z * np.sqrt(share)) ** 3)


def excess_by_station(network: Network) -> dict[str, float]:
    """Factor by which the closure of a station exceeds the stated uncertainty; 1 where chance explains it."""
    found = {}
    for station in dict.fromkeys(item.station for item in network.rounds):
        own = np.array([item.station == station for item in network.rounds])
        chi2, freedom = float(network.chi2[own].sum()), float(network.freedom[own].sum())
        above = freedom > 0.5 and chi2 > chi2_quantile(freedom, Z_95)
        found[station] = float(np.sqrt(chi2 / freedom)) if above else 1.0
    return found


def inflated(network: Network, excess: dict[str, float]) -> Floats:
    """Covariance of the poses with the closure in it: what exceeds the stated uncertainty widens it."""
    factor = np.repeat([excess[item.station] for item in network.rounds], 6)
    return np.asarray(network.covariance * factor[:, None] * factor[None, :])


@dataclass(frozen=True)
class Motions:
    """Where the tracker itself stood at each round against its station's first one, along machine X, Y, Z."""

    value_um: Floats
    se_um: Floats


def tracker_motions(network: Network, covariance: Floats, rotation: Floats) -> Motions:
    """Motion (R, 3) of the tracker's origin and its standard error, in the axes that `rotation` leads to."""
    count = len(network.rounds)
    value, se = np.zeros((count, 3)), np.zeros((count, 3))
    first: dict[str, int] = {}
    for k, item in enumerate(network.rounds):
        start = first.setdefault(item.station, k)
        origin = network.poses[start].translation_mm
        motion = network.poses[k].motion_from(network.poses[start], network.centre_mm)
        jacobian = design(origin[None], network.centre_mm)[0]
        value[k] = rotation @ jacobian @ motion
        if k != start:
            rows = np.zeros((3, 6 * count))
            rows[:, 6 * k : 6 * k + 6] = rotation @ jacobian
            rows[:, 6 * start : 6 * start + 6] = -rotation @ jacobian
            se[k] = np.sqrt(np.diag(rows @ covariance @ rows.T))
    return Motions(value, se)


def closures(
    readings: Foundation, network: Network, excess: dict[str, float], motions: Motions
) -> tuple[StationClosure, ...]:
    """One entry a station, in order of their first rounds."""
    out = []
    for station in dict.fromkeys(item.station for item in network.rounds):
        own = [k for k, item in enumerate(network.rounds) if item.station == station]
        rows = np.flatnonzero(np.isin(network.round_of, own))
        size = np.linalg.norm(network.residual_um[rows], axis=1)
        worst = int(rows[int(size.argmax())])
        out.append(
            StationClosure(
                station=station,
                rounds=len(own),
                targets=len({readings.target[i] for i in rows.tolist()}),
                rms_um=float(np.sqrt(np.mean(size**2))),
                largest_um=float(size.max()),
                largest_target=readings.target[worst],
                largest_t_s=float(readings.t_s[worst]),
                moved_um=motions.value_um[own[-1]],
                moved_se_um=motions.se_um[own[-1]],
                excess=excess[station],
            )
        )
    return tuple(out)


def moved_targets(
    readings: Foundation, rounds: tuple[Round, ...], covariance_um2: Floats, cold_share: Floats, network: Network
) -> list[Finding]:
    """Targets that moved against the others, found one by one: the one without which the rest closes best."""
    found: list[Finding] = []
    rest, network_left = rounds, network
    while network_left.chi2.sum() > chi2_quantile(float(network_left.freedom.sum()), Z_9999):
        names = sorted({readings.target[i] for item in rest for i in item.rows.tolist()})
        if len(names) <= FEWEST_TARGETS:
            found.append(_undecided(names, readings, network_left))
            break
        trials = [(name, _without(name, readings, rest, covariance_um2, cold_share)) for name in names]
        able = [(name, trial) for name, trial in trials if trial is not None]
        if not able:
            found.append(_undecided(names, readings, network_left))
            break
        name, trial = min(able, key=lambda pair: _surplus(pair[1]))
        if _surplus(trial) > 0.5 * _surplus(network_left):
            # No single target explains it: the scatter as a whole is larger than stated.
            found.append(_scattered(network_left))
            break
        found.append(_moved(name, readings, trial))
        rest, network_left = trial.rounds, trial
    return found


def _surplus(network: Network) -> float:
    return max(float(network.chi2.sum() - network.freedom.sum()), 0.0)


def _without(
    name: str, readings: Foundation, rounds: tuple[Round, ...], covariance_um2: Floats, cold_share: Floats
) -> Network | None:
    kept = tuple(
        Round(item.station, item.t_s, np.array([i for i in item.rows.tolist() if readings.target[i] != name]))
        for item in rounds
    )
    if not all(len(item.rows) and is_complete(readings, item.rows) for item in kept):
        return None
    try:
        return adjust(readings, kept, covariance_um2, cold_share)
    except AnalysisError:
        return None


def _moved(name: str, readings: Foundation, others: Network) -> Finding:
    """The place of a target in every round, from the poses that the others give."""
    places, times = [], []
    for k, item in enumerate(others.rounds):
        span = (readings.t_s[item.rows].min() - 600.0, readings.t_s[item.rows].max() + 600.0)
        for i in range(len(readings.t_s)):
            same = readings.target[i] == name and readings.station[i] == item.station
            if same and span[0] <= readings.t_s[i] <= span[1]:
                places.append(others.poses[k].apply(readings.xyz_mm[i][None])[0])
                times.append(float(readings.t_s[i]))
    points = np.array(places)
    apart_um = 1000.0 * np.linalg.norm(points[:, None] - points[None], axis=2)
    # Against the median a single wrong reading stands out; of two places the later one is named.
    away = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    worst = len(away) - 1 - int(np.round(away, 6)[::-1].argmax())
    return Finding(
        "foundation-moved",
        f"the foundation target {name} moved by {apart_um.max():.0f} µm against the others (at"
        f" {times[worst] / 3600:.2f} h).",
        f"check how {name} is fastened; delete its readings, or those before or after it was touched.",
    )


def _undecided(names: list[str], readings: Foundation, network: Network) -> Finding:
    size = np.linalg.norm(network.residual_um, axis=1)
    worst = int(np.nanargmax(size))
    return Finding(
        "foundation-moved",
        f"the foundation targets {', '.join(names)} moved against each other: {size[worst]:.0f} µm remain at"
        f" {readings.target[worst]} ({readings.t_s[worst] / 3600:.2f} h). Which of them moved cannot be told from"
        f" {len(names)} targets.",
        "check how they are fastened; four or more targets show which one moved.",
    )


def _scattered(network: Network) -> Finding:
    ratio = float(np.sqrt(network.chi2.sum() / network.freedom.sum()))
    return Finding(
        "foundation-scatter",
        f"the foundation targets scatter {ratio:.1f} times as much as [tracker] in campaign.toml states; no single"
        " target explains it.",
        "check the stated standard deviations, the targets and the air between them; the intervals were widened"
        " to what was seen.",
    )

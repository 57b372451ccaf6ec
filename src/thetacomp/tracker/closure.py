"""How well the foundation targets close: per station, against the stated uncertainty, and which target moved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.campaign import StationClosure
from thetacomp.errors import AnalysisError
from thetacomp.tracker.doubt import TrackerDoubt
from thetacomp.tracker.foundation import FEWEST_TARGETS, Foundation, Network, Round, adjust, is_complete
from thetacomp.tracker.rigid import design

Z_95, Z_9999 = 1.645, 3.719
# By so much must the closure without one target be better (chi-square) than that without any other.
CLEARLY_BETTER = 25.0
SCALE_SIGMA = 4.0
SMALLEST_SCALE_UM_PER_M = 3.0


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


def without_moved_targets(
    readings: Foundation, network: Network, covariance_um2: Floats, cold_share: Floats
) -> tuple[Network, list[TrackerDoubt]]:
    """The network without targets that moved against the others, found one by one, and what was found.

    The target is removed without which the rest closes best. Where that is undecided the network stays as it is.
    """
    found: list[TrackerDoubt] = []
    while network.chi2.sum() > chi2_quantile(float(network.freedom.sum()), Z_9999):
        names = sorted({readings.target[i] for item in network.rounds for i in item.rows.tolist()})
        trials = {name: _without(name, readings, network.rounds, covariance_um2, cold_share) for name in names}
        able = {name: trial for name, trial in trials.items() if trial is not None}
        if not able:
            found.append(_undecided(names, readings, network))
            break
        ranked = sorted(able, key=lambda key: float(able[key].chi2.sum()))
        name = ranked[0]
        if _surplus(able[name]) > 0.5 * _surplus(network):
            found.append(_scattered(network))
            break
        if len(ranked) > 1 and able[ranked[1]].chi2.sum() - able[name].chi2.sum() < CLEARLY_BETTER:
            found.append(_undecided(names, readings, network))
            break
        found.append(_moved(name, readings, able[name]))
        network = able[name]
    if len(network.targets_mm) == FEWEST_TARGETS:
        found.append(_only_three(sorted(network.targets_mm)))
    return network, found


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


def _moved(name: str, readings: Foundation, others: Network) -> TrackerDoubt:
    """What the target did, from the poses that the others give: one step that stays, or one wrong reading."""
    places, times = _places(name, readings, others)
    count = len(places)
    best = (0.0, 0.0, 0, False)  # evidence, size, first reading, a step that stays
    for k in range(count):
        for rest, part, stays in ((places[:k], places[k:], True), (np.delete(places, k, 0), places[k : k + 1], False)):
            if not len(rest) or (stays and len(part) == 1):
                continue
            size = 1000.0 * float(np.linalg.norm(part.mean(axis=0) - rest.mean(axis=0)))
            best = max(best, (size**2 * len(part) * len(rest) / count, size, k, stays))
    _, size, k, stays = best
    did = f"moved by {size:.0f} µm against the others" if stays else f"misses its place by {size:.0f} µm"
    return TrackerDoubt(
        "foundation-moved",
        f"the foundation target {name} {did} {'from' if stays else 'at'} {times[k] / 3600:.2f} h"
        f"{' on' if stays else ''}. It was left out of all ties.",
        f"check how {name} is fastened and read; delete its readings, or those that are wrong.",
    )


def _places(name: str, readings: Foundation, others: Network) -> tuple[Floats, Floats]:
    """Readings (m, 3) of a target in foundation coordinates, in order of time, each by the pose of its own round."""
    places, times = [], []
    for i in np.flatnonzero(np.array(readings.target) == name).tolist():
        own = [k for k, item in enumerate(others.rounds) if item.station == readings.station[i]]
        k = min(own, key=lambda round_: abs(others.rounds[round_].t_s - readings.t_s[i]))
        places.append(others.poses[k].apply(readings.xyz_mm[i][None])[0])
        times.append(float(readings.t_s[i]))
    return np.array(places), np.array(times)


def _only_three(names: list[str]) -> TrackerDoubt:
    return TrackerDoubt(
        "foundation-three",
        f"there are only three foundation targets ({', '.join(names)}): one that sinks out of their plane looks like a"
        " tracker that tilts, and no closure shows it.",
        "measure four or more targets, spread around the machine and at different heights.",
    )


def round_scales(readings: Foundation, network: Network) -> tuple[Floats, Floats]:
    """How much longer than in the mean of all rounds each round measures the foundation, µm/m, with standard error."""
    scale, se = np.zeros(len(network.rounds)), np.zeros(len(network.rounds))
    for k in range(len(network.rounds)):
        rows = np.flatnonzero(network.round_of == k)
        places = np.array([network.targets_mm[readings.target[i]] for i in rows.tolist()])
        lever_m = (places - network.centre_mm) / 1000.0
        jacobian = np.concatenate([design(places, network.centre_mm), lever_m[:, :, None]], axis=2)
        weight = network.weight[rows]
        inverse = np.linalg.inv(np.einsum("nia,nij,njb->ab", jacobian, weight, jacobian))
        right = np.einsum("nia,nij,nj->a", jacobian, weight, network.residual_um[rows])
        scale[k], se[k] = (inverse @ right)[6], np.sqrt(inverse[6, 6])
    return scale, se


def scale_drift(readings: Foundation, network: Network) -> list[TrackerDoubt]:
    """A scale that changes over the day: the laser's air, or a floor that expands."""
    scale, se = round_scales(readings, network)
    worst = int(np.argmax(np.abs(scale) / se))
    if abs(scale[worst]) < max(SCALE_SIGMA * se[worst], SMALLEST_SCALE_UM_PER_M):
        return []
    return [
        TrackerDoubt(
            "foundation-scale",
            f"the foundation measures {scale[worst]:+.1f} ± {se[worst]:.1f} µm/m (standard error) longer at"
            f" {network.rounds[worst].t_s / 3600:.2f} h than in the mean of the day. This is not applied.",
            "check air temperature, pressure and humidity in the tracker; concrete grows by 10 µm/m per kelvin.",
        )
    ]


def _undecided(names: list[str], readings: Foundation, network: Network) -> TrackerDoubt:
    size = np.linalg.norm(network.residual_um, axis=1)
    worst = int(np.nanargmax(size))
    return TrackerDoubt(
        "foundation-moved",
        f"the foundation targets {', '.join(names)} moved against each other: {size[worst]:.0f} µm remain at"
        f" {readings.target[worst]} ({readings.t_s[worst] / 3600:.2f} h). It is not clear which of them moved,"
        " so none was left out: the ties of this campaign are wrong by about as much.",
        "check how they are fastened; five or more targets show which one moved.",
    )


def _scattered(network: Network) -> TrackerDoubt:
    ratio = float(np.sqrt(network.chi2.sum() / network.freedom.sum()))
    return TrackerDoubt(
        "foundation-scatter",
        f"the foundation targets scatter {ratio:.1f} times as much as [tracker] in campaign.toml states; no single"
        " target explains it.",
        "check the stated standard deviations, the targets and the air between them; the intervals were widened"
        " to what was seen.",
    )

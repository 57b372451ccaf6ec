"""The pose of the tracker at every machine point, from the rounds of foundation targets of its station."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats, Ints
from thetacomp.tracker.closure import Z_9999, chi2_quantile
from thetacomp.tracker.doubt import FrameError, TrackerDoubt
from thetacomp.tracker.foundation import Foundation, Network, Round, is_complete
from thetacomp.tracker.rigid import design, line_direction, rotation_matrix

LARGEST_STEP_UM = 1000.0
UNBRACKETED_S = 3600.0


def usable_rounds(
    readings: Foundation, rounds: tuple[Round, ...], stations: Sequence[str], to_machine: dict[str, Floats]
) -> tuple[tuple[Round, ...], list[TrackerDoubt]]:
    """Rounds that fix all six motions; the others are reported. Raises FrameError where a station has none.

    `to_machine` holds, for stations that took part in the cold block, the rough rotation into machine axes.
    """
    good = tuple(item for item in rounds if is_complete(readings, item.rows))
    for station in stations:
        if not any(item.station == station for item in good):
            own = [item for item in rounds if item.station == station]
            raise _untied(readings, own, station, to_machine.get(station))
    found = [
        TrackerDoubt(
            "foundation-round",
            f"the round of foundation targets from station {item.station} at {item.t_s / 3600:.2f} h has only"
            f" {_named(readings, item)}; it is not used, the rounds before and after it serve instead.",
            "measure at least three targets, not on one line, in every round.",
        )
        for item in rounds
        if not is_complete(readings, item.rows)
    ]
    return good, found


def _named(readings: Foundation, item: Round) -> str:
    names = sorted({readings.target[i] for i in item.rows.tolist()})
    return f"{', '.join(names)}{', on one line' if len(names) > 2 else ''}"


def _untied(readings: Foundation, own: Sequence[Round], station: str, rotation: Floats | None) -> FrameError:
    fix = "measure at least three fixed foundation targets, not on one line, before and after every round of sweeps."
    if not own:
        return FrameError(
            "foundation-missing",
            f"station {station} has machine points but no foundation targets (rows without an axis): its position"
            " relative to the other stations, and whether it sank, cannot be found from the machine: heat moves it.",
            fix,
        )
    best = max(own, key=lambda item: len({readings.target[i] for i in item.rows.tolist()}))
    points = readings.xyz_mm[best.rows]
    direction = line_direction(points)
    names = sorted({readings.target[i] for i in best.rows.tolist()})
    head = f"the foundation targets of station {station} ({', '.join(names)})"
    if len(names) == 1 or direction is None or not direction.any():
        return FrameError(
            "foundation-few",
            f"{head} are fewer than three: the rotation of the tracker cannot be determined, only its position.",
            fix,
        )
    return FrameError(
        "foundation-line",
        f"{head} lie on one line, along {in_words(direction, rotation)}: the roll of the tracker about this line cannot"
        " be determined, and every point off the line would be wrong by it.",
        fix,
    )


def in_words(direction: Floats, rotation: Floats | None = None) -> str:
    """A direction as its components, in machine axes where the rotation into them is known."""
    vector = direction if rotation is None else rotation @ direction
    vector = vector * np.sign(vector[int(np.abs(vector).argmax())])
    parts = ", ".join(f"{value + 0.0:.2f}" for value in vector)
    axes = "the tracker's own x, y, z" if rotation is None else "machine X, Y, Z"
    main = "xyz"[int(np.abs(vector).argmax())]
    return f"({parts}) in {axes}, mostly {main if rotation is None else main.upper()}"


@dataclass(frozen=True)
class RoundWeights:
    """Weights (n, R) of the rounds at n machine points, and the fraction (n,) of the way between the two rounds."""

    weight: Floats
    before: Ints
    after: Ints
    fraction: Floats


def round_weights(rounds: Sequence[Round], t_s: Floats, station: Sequence[str]) -> RoundWeights:
    """Each point hangs between the last round before it and the next one after it, straight in time."""
    weight = np.zeros((len(t_s), len(rounds)))
    before, after = np.zeros(len(t_s), dtype=np.int64), np.zeros(len(t_s), dtype=np.int64)
    fraction = np.zeros(len(t_s))
    names = np.array(station)
    for name in dict.fromkeys(station):
        own = np.array([k for k, item in enumerate(rounds) if item.station == name], dtype=np.int64)
        times = np.array([rounds[k].t_s for k in own])
        points = np.flatnonzero(names == name) if len(own) else own
        if not len(points):
            continue  # a station without a complete point
        place = np.searchsorted(times, t_s[points])
        low, high = np.clip(place - 1, 0, len(own) - 1), np.clip(place, 0, len(own) - 1)
        span = times[high] - times[low]
        share = np.where(span > 0, (t_s[points] - times[low]) / np.where(span > 0, span, 1.0), 0.0)
        before[points], after[points], fraction[points] = own[low], own[high], share
        weight[points, own[low]] += 1.0 - share
        weight[points, own[high]] += share
    return RoundWeights(weight, before, after, fraction)


def tied_points(network: Network, share: RoundWeights, xyz_mm: Floats) -> tuple[Floats, Floats]:
    """Points (n, 3) in foundation coordinates, and the rotation (n, 3, 3) that brought each there."""
    first = _first_rounds(network.rounds)
    tied, rotation = np.full_like(xyz_mm, np.nan), np.zeros((len(xyz_mm), 3, 3))
    motions = _motions(network)
    centre = network.centre_mm
    for k in sorted(set(first.values())):
        rows = np.flatnonzero(np.array([first[network.rounds[b].station] == k for b in share.before]))
        motion = share.weight[rows] @ motions
        turn = rotation_matrix(motion[:, 3:] * 1e-6)
        base = network.poses[k].apply(xyz_mm[rows]) - centre
        tied[rows] = np.einsum("nij,nj->ni", turn, base) + centre + motion[:, :3] * 1e-3
        rotation[rows] = turn @ network.poses[k].rotation
    return tied, rotation


def _first_rounds(rounds: Sequence[Round]) -> dict[str, int]:
    first: dict[str, int] = {}
    for k, item in enumerate(rounds):
        first.setdefault(item.station, k)
    return first


def _motions(network: Network) -> Floats:
    """Small motion (R, 6) of every round against the first one of its station."""
    first = _first_rounds(network.rounds)
    return np.array(
        [
            pose.motion_from(network.poses[first[item.station]], network.centre_mm)
            for pose, item in zip(network.poses, network.rounds, strict=True)
        ]
    )


def refuse_moved_station(network: Network) -> None:
    """A label that was carried elsewhere is a new station. Raises FrameError for a step of more than a millimetre."""
    for k, later in _neighbours(network.rounds):
        motion = network.poses[later].motion_from(network.poses[k], network.centre_mm)
        step_um = float(np.linalg.norm(design(network.poses[k].translation_mm[None], network.centre_mm)[0] @ motion))
        if step_um > LARGEST_STEP_UM:
            name = network.rounds[k].station
            raise FrameError(
                "station-moved",
                f"station {name} moved by {step_um / 1000:.1f} mm between its foundation targets at"
                f" {network.rounds[k].t_s / 3600:.2f} h and at {network.rounds[later].t_s / 3600:.2f} h.",
                "give the tracker another name in `station` from the moment at which it was moved; check that"
                " the targets were not confused.",
            )


def _neighbours(rounds: Sequence[Round]) -> list[tuple[int, int]]:
    last: dict[str, int] = {}
    pairs = []
    for k, item in enumerate(rounds):
        if item.station in last:
            pairs.append((last[item.station], k))
        last[item.station] = k
    return pairs


def uneven_steps(
    network: Network, covariance: Floats, share: RoundWeights
) -> tuple[dict[int, Floats], list[TrackerDoubt]]:
    """Steps (6,) between two rounds with machine points in between that do not fit the usual rate of the station.

    By the number of the later round. A straight line in time is then a poor tie.
    """
    steps: dict[int, Floats] = {}
    found: list[TrackerDoubt] = []
    pairs = _neighbours(network.rounds)
    motions = _motions(network)
    for station in dict.fromkeys(item.station for item in network.rounds):
        own = [pair for pair in pairs if network.rounds[pair[0]].station == station]
        if not own:
            continue
        hours = np.array([network.rounds[b].t_s - network.rounds[a].t_s for a, b in own]) / 3600.0
        change = np.array([motions[b] - motions[a] for a, b in own])
        rate = np.median(change / hours[:, None], axis=0) if len(own) > 2 else np.zeros(6)
        for (a, b), h, value in zip(own, hours, change, strict=True):
            between = (share.before == a) & (share.after == b)
            if not between.any():
                continue
            odd = value - rate * h
            rows = np.zeros((6, len(covariance)))
            rows[:, 6 * b : 6 * b + 6], rows[:, 6 * a : 6 * a + 6] = np.eye(6), -np.eye(6)
            chi2 = float(odd @ np.linalg.solve(rows @ covariance @ rows.T, odd))
            if len(own) > 2 and chi2 > chi2_quantile(6.0, Z_9999):
                steps[b] = odd
                found.append(_uneven(network, a, b, odd))
    return steps, found


def _uneven(network: Network, a: int, b: int, odd: Floats) -> TrackerDoubt:
    origin = network.poses[a].translation_mm
    size = float(np.linalg.norm(design(origin[None], network.centre_mm)[0] @ odd))
    return TrackerDoubt(
        "station-step",
        f"station {network.rounds[a].station} moved by {size:.0f} µm more than at its usual rate between"
        f" {network.rounds[a].t_s / 3600:.2f} h and {network.rounds[b].t_s / 3600:.2f} h; sweeps in that time are tied"
        " by a straight line, and their intervals were widened.",
        "measure the foundation targets again at once when the tracker was touched; leave out sweeps in between.",
    )


def unbracketed(rounds: Sequence[Round], t_s: Floats, station: Sequence[str]) -> list[TrackerDoubt]:
    """Sweeps that begin long before the first round of their station, or end long after the last one."""
    found = []
    for name in dict.fromkeys(item.station for item in rounds):
        times = [item.t_s for item in rounds if item.station == name]
        if name not in station:
            continue
        own = t_s[np.array([other == name for other in station], dtype=bool)]
        late, early = float(own.max()) - max(times), min(times) - float(own.min())
        for gap_s, which, moment in ((early, "before the first", own.min()), (late, "after the last", own.max())):
            if gap_s > UNBRACKETED_S:
                found.append(
                    TrackerDoubt(
                        "foundation-not-bracketed",
                        f"the machine point of station {name} at {moment / 3600:.2f} h was measured"
                        f" {gap_s / 3600:.1f} h {which} round of foundation targets: a motion of the tracker in that"
                        " time is not noticed, and no interval includes it.",
                        "measure the foundation targets before the first sweep and after the last one.",
                    )
                )
    return found

"""The strategies for sensors, each a pure function that says for every sensor why it stayed or went.

Five of the six strategies of Yang (dissertation, Shanghai Jiao Tong University 1998, as cited by Cui, Gao, Yao 2012).
The sixth, observability, asks whether the deformation can be reconstructed from the readings: that needs a model of
the deformation and cannot be judged by correlations.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from thetacomp.arrays import Floats
from thetacomp.sensors.key_points import StrategyDecision, StrategyTable

NAN = float("nan")

WEIGHTED_REGRET = 0.20
# Within this of the best |r| of one parameter a sensor predicts that parameter as well as the best does.
NEAR_BEST = 0.05
# The difference of two sensors with |r| = 0.9 still holds a gradient or a history, which a model can use.
GROUP_R = 0.95
MIN_GAIN = 0.05
# No instrument resolves a gain below this, so it is no reason for another sensor.
MIN_GAIN_UM = 0.01
SENSITIVE_SHARE = 0.5
LINEAR_RATIO = 1.5

# The publication states no rule. This one gives its three sets, and was found afterwards.
PAPER_FACTOR = 2.0
PAPER_ROUNDING = 0.02
PAPER_GROUP_R = 0.75


def regrets(correlation: Floats) -> Floats:
    """How much |r| each sensor loses against the best one of the same parameter, (parameters, sensors)."""
    size = np.abs(correlation)
    best = np.max(np.where(np.isfinite(size), size, -np.inf), axis=1, keepdims=True, initial=-np.inf)
    return np.where(np.isfinite(size), np.where(np.isfinite(best), best, 0.0) - size, np.nan)


def spans(value: Floats) -> Floats:
    """Largest less smallest value of every column of (n, columns), (columns,); NaN where a column has none."""
    good = np.isfinite(value)
    high = np.where(good, value, -np.inf).max(axis=0, initial=-np.inf)
    low = np.where(good, value, np.inf).min(axis=0, initial=np.inf)
    known = np.asarray(good.any(axis=0))
    return np.where(known, np.where(known, high, 0.0) - np.where(known, low, 0.0), np.nan)


def main_factor_paper(
    axis: str,
    sensors: Sequence[str],
    parameters: Sequence[str],
    correlation: Floats,
    threshold: float | None = None,
) -> StrategyTable:
    """Main factor as the paper's sets follow from its tables: ranked by the largest regret over all parameters.

    `correlation` is (parameters, sensors). Regrets are rounded to two decimals, as the tables are. A sensor stays up
    to `threshold`; without one, up to twice the smallest of these figures plus 0.02 (the rounding of two regrets).
    """
    regret = np.round(regrets(correlation), 2)
    known = np.asarray(np.isfinite(regret).any(axis=0))
    worst = np.where(known, np.max(np.where(np.isfinite(regret), regret, -np.inf), axis=0, initial=-np.inf), np.nan)
    if not known.any():
        return StrategyTable("main factor (paper)", axis, "largest regret of |r|", _all_go(sensors, "no correlation"))
    limit = PAPER_FACTOR * float(np.nanmin(worst)) + PAPER_ROUNDING if threshold is None else threshold
    figure_name = f"largest regret of |r|, up to {limit:.2f} stays"
    if threshold is None:
        figure_name += f" ({PAPER_FACTOR:g} × smallest {float(np.nanmin(worst)):.2f} + {PAPER_ROUNDING:g})"
    decisions = []
    for j, sensor in enumerate(sensors):
        if not known[j]:
            decisions.append(StrategyDecision(sensor, False, NAN, "no correlation with any parameter"))
            continue
        row = int(np.nanargmax(regret[:, j]))
        best = int(np.nanargmax(np.abs(correlation[row])))
        stays = bool(worst[j] <= limit + 1e-9)
        reason = (
            f"{'within' if stays else 'above'} {limit:.2f}; {parameters[row]} |r| {abs(correlation[row, j]):.2f},"
            f" best {abs(correlation[row, best]):.2f} ({sensors[best]})"
        )
        decisions.append(StrategyDecision(sensor, stays, float(worst[j]), reason))
    return StrategyTable("main factor (paper)", axis, figure_name, tuple(decisions))


def main_factor(
    axis: str,
    sensors: Sequence[str],
    parameters: Sequence[str],
    correlation: Floats,
    weight_um: Floats,
    threshold: float = WEIGHTED_REGRET,
) -> StrategyTable:
    """Main factor: regret of |r|, averaged over the parameters with their µm as weights.

    `correlation` (parameters, sensors), `weight_um` (parameters,) the range of each parameter in µm over the travel.
    A sensor stays up to `threshold`, or where it is within 0.05 of the best for one parameter: two heat sources that
    drive different parameters both keep their sensors.
    """
    regret = regrets(correlation)
    known = np.asarray(np.isfinite(regret))
    weight = weight_um[:, None] * known
    total = weight.sum(axis=0)
    mean = np.where(total > 0, (np.where(known, regret, 0.0) * weight).sum(axis=0) / np.where(total > 0, total, 1), NAN)
    decisions = []
    for j, sensor in enumerate(sensors):
        if not np.isfinite(mean[j]):
            decisions.append(StrategyDecision(sensor, False, NAN, "no correlation with any parameter that votes"))
        elif mean[j] <= threshold:
            reason = f"on average within {threshold:.2f} of the best |r|, {len(parameters)} parameters weighted by µm"
            decisions.append(StrategyDecision(sensor, True, float(mean[j]), reason))
        elif near := [i for i in range(len(parameters)) if known[i, j] and regret[i, j] <= NEAR_BEST]:
            named = ", ".join(f"{parameters[i]} ({weight_um[i]:.0f} µm)" for i in near)
            decisions.append(
                StrategyDecision(sensor, True, float(mean[j]), f"within {NEAR_BEST} of the best |r| for {named}")
            )
        else:
            loss = np.where(known[:, j], regret[:, j] * weight_um, -1.0)
            i = int(np.argmax(loss))
            reason = (
                f"above {threshold:.2f}; loses most in {parameters[i]} ({weight_um[i]:.0f} µm):"
                f" |r| {abs(correlation[i, j]):.2f}, best {np.nanmax(np.abs(correlation[i])):.2f}"
            )
            decisions.append(StrategyDecision(sensor, False, float(mean[j]), reason))
    return StrategyTable("main factor", axis, "mean regret of |r|, weighted by µm", tuple(decisions))


def correlation_groups(sensors: Sequence[str], correlation: Floats, threshold: float) -> tuple[tuple[str, ...], ...]:
    """Groups of sensors in which every pair has |r| of at least `threshold` (complete linkage on 1 - |r|).

    `correlation` (sensors, sensors); a missing one counts as none. Groups in the order of their first sensor.
    """
    if len(sensors) < 2:
        return tuple((s,) for s in sensors)
    distance = 1.0 - np.nan_to_num(np.abs(correlation), nan=0.0)
    distance = np.maximum((distance + distance.T) / 2.0, 0.0)
    np.fill_diagonal(distance, 0.0)
    label = fcluster(linkage(squareform(distance, checks=False), "complete"), 1.0 - threshold + 1e-9, "distance")
    return tuple(
        tuple(s for s, k in zip(sensors, label, strict=True) if k == number) for number in dict.fromkeys(label)
    )


def medoid(group: Sequence[str], sensors: Sequence[str], correlation: Floats) -> str:
    """The sensor of a group with the largest mean |r| to the others of it; the first where several are equal."""
    index = [list(sensors).index(s) for s in group]
    size = np.nan_to_num(np.abs(correlation[np.ix_(index, index)]), nan=0.0)
    return group[int(np.argmax(np.round(size.sum(axis=1), 9)))]


def mutual_irrelevance(
    axis: str,
    sensors: Sequence[str],
    correlation: Floats,
    drive_sensors: Sequence[str] = (),
    threshold: float = GROUP_R,
) -> tuple[StrategyTable, tuple[tuple[str, ...], ...]]:
    """Mutual irrelevance: one representative of every group of redundant sensors.

    The representative is the first of `drive_sensors` (those on the drive of the moving axis) in the group, else the
    group's medoid. Returns the table and the groups. The figure is |r| with the representative.
    """
    groups = correlation_groups(sensors, correlation, threshold)
    names = list(sensors)
    decisions: dict[str, StrategyDecision] = {}
    for group in groups:
        drives = [s for s in drive_sensors if s in group]
        chosen = drives[0] if drives else medoid(group, sensors, correlation)
        for sensor in group:
            r = 1.0 if sensor == chosen else float(abs(correlation[names.index(sensor), names.index(chosen)]))
            others = ", ".join(s for s in group if s != chosen)
            if sensor != chosen:
                reason = f"has the same information as {chosen} (all pairs |r| ≥ {threshold:.2f})"
            elif len(group) == 1:
                reason = (
                    f"|r| below {threshold:.2f} with part of every other group" if len(groups) > 1 else "the only one"
                )
            elif drives:
                reason = f"on the drive of axis {axis}; stands for {others}"
            else:
                reason = f"middle of its group; stands for {others}"
            decisions[sensor] = StrategyDecision(sensor, sensor == chosen, r, reason)
    table = StrategyTable(
        "mutual irrelevance", axis, "|r| with the representative", tuple(decisions[s] for s in sensors)
    )
    return table, groups


def fewest_sensors(
    axis: str,
    candidates: Sequence[str],
    error_um: Callable[[Sequence[int]], float],
    limit: int,
    scheme: str,
    min_gain: float = MIN_GAIN,
) -> StrategyTable:
    """Fewest sensors: forward, one at a time, while the hold-out error falls by more than `min_gain`.

    Where no sensor helps alone, the best pair does if it gains as much: two that work against each other. `error_um`
    gives the hold-out error of a set of candidates (indices); it starts from no sensor at all. `limit` is the largest
    number of sensors; `scheme` says in words what was held out. Kept sensors come first, in order.
    """
    chosen: list[int] = []
    before = error_um([])
    none_um = before
    decisions: list[StrategyDecision] = []
    full = False
    while len(chosen) < len(candidates):
        if len(chosen) >= limit:
            full = True
            break
        left = [j for j in range(len(candidates)) if j not in chosen]
        trial: dict[tuple[int, ...], float] = {(j,): error_um([*chosen, j]) for j in left}
        enough = min(before * (1.0 - min_gain), before - MIN_GAIN_UM)
        if not chosen and limit > 1 and not min(trial.values()) < enough:
            trial |= {pair: error_um(pair) for pair in combinations(left, 2)}
        best = min(trial, key=lambda added: (trial[added], added))
        if not trial[best] < enough:
            break
        pair = "; only both together help" if len(best) > 1 else ""
        reason = f"hold-out error {before:.1f} -> {trial[best]:.1f} µm over the travel ({scheme}){pair}"
        decisions += [StrategyDecision(candidates[j], True, trial[best], reason) for j in best]
        chosen += best
        before = trial[best]
    for j, sensor in enumerate(candidates):
        if j in chosen:
            continue
        with_it = error_um([*chosen, j])
        if full:
            reason = f"the limit of {limit} sensor{'s' if limit > 1 else ''} for this number of states is reached"
        elif not np.isfinite(with_it):
            reason = "too few states to hold any out"
        else:
            reason = (
                f"no gain of {100 * min_gain:.0f} %: {before:.1f} µm without it, {with_it:.1f} µm with it ({scheme})"
            )
        decisions.append(StrategyDecision(sensor, False, with_it, reason))
    name = f"hold-out error with it, µm (without a sensor {none_um:.1f})"
    return StrategyTable("fewest sensors", axis, name, tuple(decisions))


def maximum_sensitivity(axis: str, sensors: Sequence[str], rise_K: Floats) -> StrategyTable:
    """Maximum sensitivity: the span of each sensor's temperature over all states, in K; half the largest stays.

    `rise_K` (states, sensors). The larger the span, the less noise, resolution and drift of the sensor matter.
    """
    span = spans(rise_K)
    largest = float(np.nanmax(span)) if np.isfinite(span).any() else NAN
    decisions = []
    for sensor, value in zip(sensors, span, strict=True):
        if not np.isfinite(value):
            decisions.append(StrategyDecision(sensor, False, NAN, "no reading"))
            continue
        stays = bool(value >= SENSITIVE_SHARE * largest and value > 0)
        share = 100.0 * value / largest if largest > 0 else 0.0
        decisions.append(
            StrategyDecision(sensor, stays, float(value), f"{share:.0f} % of the largest span, {largest:.1f} K")
        )
    return StrategyTable("maximum sensitivity", axis, "span of temperature, K", tuple(decisions))


def nearest_linear(
    axis: str, sensors: Sequence[str], rise_K: Floats, value: Floats, weight_um: Floats
) -> StrategyTable:
    """Nearest linear: the largest deviation of a parameter from its straight line over the temperature.

    In percent of the parameter's range, averaged over the parameters with their µm as weights. Hysteresis between
    warming and cooling shows here. `rise_K` (n, p), `value` (n, m), `weight_um` (m,).
    """
    figure = np.full(len(sensors), NAN)
    for j in range(len(sensors)):
        shares, weights = [], []
        for i in range(value.shape[1]):
            good = np.isfinite(rise_K[:, j]) & np.isfinite(value[:, i])
            x, y = rise_K[good, j], value[good, i]
            if np.count_nonzero(good) < 3 or np.ptp(x) == 0 or np.ptp(y) == 0:
                continue
            x = x - x.mean()
            residual = y - y.mean() - x * (x @ y) / (x @ x)
            shares.append(100.0 * np.abs(residual).max() / np.ptp(y))
            weights.append(weight_um[i])
        if shares and sum(weights) > 0:
            figure[j] = np.average(shares, weights=weights)
    best = float(np.nanmin(figure)) if np.isfinite(figure).any() else NAN
    decisions = []
    for sensor, percent in zip(sensors, figure, strict=True):
        if not np.isfinite(percent):
            decisions.append(StrategyDecision(sensor, False, NAN, "no reading, or no change"))
            continue
        stays = bool(percent <= LINEAR_RATIO * best + 1e-9)
        reason = f"{'within' if stays else 'above'} {LINEAR_RATIO:g} × the smallest, {best:.1f} %"
        decisions.append(StrategyDecision(sensor, stays, float(percent), reason))
    return StrategyTable("nearest linear", axis, "largest deviation from a line, % of range", tuple(decisions))


def _all_go(sensors: Sequence[str], reason: str) -> tuple[StrategyDecision, ...]:
    return tuple(StrategyDecision(s, False, NAN, reason) for s in sensors)

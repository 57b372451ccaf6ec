"""Clocks that disagree: temperatures stamped earlier or later than the errors of the same campaign.

The errors of all campaigns are fitted with the temperatures at the same moment, once for every shift between the two
tables. Heat gives the moment away: an error cannot begin before the temperatures that cause it, and one law holds for
all campaigns. A shift is claimed where two laws agree on it, temperatures alone and temperatures with their lag, and
where what no instrument's scatter explains becomes clearly smaller.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Bools, Floats, Ints
from thetacomp.campaign import Campaign
from thetacomp.model.filters import run_filters
from thetacomp.model.temperatures import Temperatures
from thetacomp.reading.components import MeasuredComponent, measured_components
from thetacomp.reading.problems import ProblemList

STEP_S = 600.0
SHIFTS_S = STEP_S * np.arange(-12, 13)
NONE = len(SHIFTS_S) // 2
SMALLEST_S = 1200.0  # sensors away from the heat lead or lag the error by some minutes on a healthy machine
APART_S = 1500.0  # by how much the two laws may differ on the shift
LAG_S = 3600.0
DIRECTIONS = 12
GRID_S = 60.0
FEWEST = 12
FEWEST_SENSORS = 5  # fewer may all lead or lag the error by half an hour on a healthy machine
MOST = 400  # rows of a component that a campaign needs at most: a shift of minutes shows in fewer
KEPT_FROM_END_S = 3600.0  # errors near the end of the log have no temperatures to be shifted to
RIDGE = 1e-4
EXPLAINED = 0.9  # share of the motion that a law must explain at its best shift, or it says nothing of time
MOVES = 3.0  # a component moves if its sum of squares is so many times that of its scatter
FLOOR = 0.1  # share of the scatter below which a smaller misfit means nothing
# Least gain, as log ratio of the misfit, without the lag and with it: in the mean over components, and summed over
# them, where one campaign is shifted or all are. Few sensors on a machine with hidden heat gain less, but not nothing.
GAINS = (0.15, 0.1)
EVIDENCE_ONE, EVIDENCE_ALL = (2.0, 1.5), (1.2, 0.6)
SAME_GAIN = 0.7  # of two campaigns, either may be the one that is off if their gains are alike


@dataclass(frozen=True)
class ClockShift:
    """Temperatures of `campaigns` are stamped `shift_s` later (below zero: earlier) than their errors.

    `either` says that only the two campaigns against each other are off: one of them, by that amount.
    """

    campaigns: tuple[str, ...]
    shift_s: float
    either: bool = False

    def __str__(self) -> str:
        minutes = 10 * round(abs(self.shift_s) / STEP_S)
        names = f" {'or' if self.either else 'and'} ".join(self.campaigns)
        where = f"campaign{'s' if len(self.campaigns) > 1 and not self.either else ''} {names}"
        by = "than the errors, or earlier" if self.either else "than the errors"
        side = "later" if self.either or self.shift_s > 0.0 else "earlier"
        return (
            f"{where}: the temperatures seem to be stamped about {minutes} min {side} {by}; set right, they explain"
            " the errors much better"
        )


@dataclass(frozen=True)
class _Moments:
    """Cross products of one component over campaigns (c) and shifts (s): what every fit is made of.

    `gram` (c, s, p, p), `right` (c, s, p); `total` and `scatter` (c,) are the sums of squares of errors and noise.
    """

    gram: Floats
    right: Floats
    total: Floats
    scatter: Floats

    def misfit(self, gram: Floats, right: Floats) -> tuple[Floats, Floats]:
        """Log of the misfit and the unexplained share at each shift, (s,), of moments summed over campaigns."""
        size = np.trace(gram, axis1=1, axis2=2)[:, None, None] / gram.shape[1]
        law = np.linalg.solve(gram + (RIDGE * size + 1e-12) * np.eye(gram.shape[1]), right[..., None])[..., 0]
        total, scatter = float(self.total.sum()), float(self.scatter.sum())
        left = total - 2.0 * np.sum(law * right, axis=1) + np.einsum("si,sij,sj->s", law, gram, law)
        misfit = np.maximum(left - scatter, 0.0)
        return np.log(misfit + FLOOR * scatter + 1e-4 * total), misfit / max(total - scatter, 1e-12)


def clock_shifts(campaigns: Sequence[Campaign]) -> tuple[ClockShift, ...]:
    """Shifts between temperatures and errors that the measurements give away; none where they do not say.

    Needs five sensors, drift or sweeps at twelve moments a campaign, and errors that temperatures explain.
    """
    judged = [c for c in campaigns if c.drift is not None or c.sweeps is not None]
    sensors = [s for s in judged[0].temperatures.sensor_ids if _everywhere(judged, s)] if judged else []
    laws = [_moments(judged, sensors, lags) for lags in ((), (LAG_S,))] if len(sensors) >= FEWEST_SENSORS else []
    if not laws or not all(laws):
        return ()
    at = np.full(len(judged), NONE)
    found: list[ClockShift] = []
    while len(found) <= len(judged) // 2:
        claim = _strongest(laws, at)
        if claim is None:
            break
        rows, shift_s, either = claim
        found.append(ClockShift(tuple(judged[int(i)].name for i in rows), shift_s, either))
        if len(rows) > 1 or len(judged) == 1:
            break
        at[rows] = NONE + round(shift_s / STEP_S)
    return tuple(found)


def check_clocks(campaigns: Sequence[Campaign], recorded: bool, problems: ProblemList) -> None:
    """Note every shift of `clock_shifts` as a warning."""
    for shift in clock_shifts(campaigns):
        problems.warning(
            "clock-shift",
            "recording.toml" if recorded else f"campaigns/{shift.campaigns[0]}",
            f"{shift}.",
            "compare the clocks of the logger and of the measuring instrument (summer time? another time zone?), and"
            " correct the times of one table.",
        )


def _everywhere(campaigns: Sequence[Campaign], sensor: str) -> bool:
    return all(sensor in c.temperatures.sensor_ids for c in campaigns)


def _strongest(laws: Sequence[Sequence[_Moments]], at: Ints) -> tuple[Ints, float, bool] | None:
    """The shift on which both laws agree and that gains most: rows of its campaigns, seconds, and whether either."""
    count = len(at)
    groups = [np.arange(count)] if (at == NONE).all() else []
    groups += [np.array([c]) for c in range(count) if count > 1 and at[c] == NONE]
    gained: list[tuple[float, float, Ints]] = []
    for rows in groups:
        curves = [_curve(law, at, rows) for law in laws]
        if any(curve is None for curve in curves):
            continue
        places = [(*_lowest(found[0]), found[1]) for found in curves if found is not None]
        shifts_s, gains = [place[0] for place in places], [place[1] for place in places]
        agree = abs(shifts_s[0] - shifts_s[1]) <= APART_S and min(map(abs, shifts_s)) >= SMALLEST_S
        evidence = EVIDENCE_ALL if len(rows) == count else EVIDENCE_ONE
        enough = zip(places, GAINS, evidence, strict=True)
        if agree and all(gain >= max(least, summed / parts) for (_, gain, parts), least, summed in enough):
            gained.append((gains[0] * (count if len(rows) > 1 else 1), shifts_s[0], rows))
    if not gained:
        return None
    gained.sort(key=lambda entry: -entry[0])
    best, shift_s, rows = gained[0]
    others = [entry for entry in gained[1:] if len(entry[2]) == 1 and entry[1] * shift_s < 0.0]
    if count == 2 and len(rows) == 1 and others and others[0][0] > SAME_GAIN * best:
        return np.arange(2), shift_s, True
    return rows, shift_s, False


def _curve(law: Sequence[_Moments], at: Ints, rows: Ints) -> tuple[Floats, int] | None:
    """Log misfit (s,) with the campaigns `rows` shifted and the others where they are, against no shift.

    The mean over components that the law explains, counted in campaigns, and their number; None where it explains too
    few of them.
    """
    curves, unexplained = [], []
    for part in law:
        own = np.arange(len(at))
        gram, right = part.gram[own, at].sum(axis=0), part.right[own, at].sum(axis=0)
        moved_gram = gram - part.gram[rows, at[rows]].sum(axis=0) + part.gram[rows].sum(axis=0)
        moved_right = right - part.right[rows, at[rows]].sum(axis=0) + part.right[rows].sum(axis=0)
        logs, share = part.misfit(moved_gram, moved_right)
        curves.append((logs - logs[NONE]) * (1 if len(rows) > 1 else len(at)))
        unexplained.append(float(share.min()))
    good: Bools = np.array(unexplained) < 1.0 - EXPLAINED
    if 2 * good.sum() < len(good):
        return None
    return np.asarray(np.array(curves)[good].mean(axis=0)), int(good.sum())


def _lowest(curve: Floats) -> tuple[float, float]:
    """Shift in s of the lowest point, between the steps by a parabola, and the gain there."""
    i = int(curve.argmin())
    if not 0 < i < len(curve) - 1:
        return float(SHIFTS_S[i]), float(-curve[i])
    a, b, c = curve[i - 1 : i + 2]
    return float(SHIFTS_S[i] + STEP_S * 0.5 * (a - c) / max(a - 2.0 * b + c, 1e-12)), float(-curve[i])


def _moments(campaigns: Sequence[Campaign], sensors: Sequence[str], lags_s: tuple[float, ...]) -> list[_Moments]:
    """Moments of every component that moves and is measured in all campaigns."""
    logs = [_even(c.recording()[0].select(sensors)) for c in campaigns]
    rises = np.vstack([log.value_degC - log.value_degC[0] for log in logs])
    scale = np.sqrt(np.mean(rises**2, axis=0)) + 0.05  # the noise of a sensor that does not warm up stays small
    _, _, turn = np.linalg.svd(rises[::5] / scale, full_matrices=False)
    inputs = [_inputs(log, turn[:DIRECTIONS].T / scale[:, None], lags_s) for log in logs]
    measured = [{m.name: m for m in measured_components(c)} for c in campaigns]
    names = [name for name in measured[0] if all(name in found for found in measured)]
    parts = []
    for name in names:
        own = [_campaign_moments(log.t_s, x, found[name]) for log, x, found in zip(logs, inputs, measured, strict=True)]
        if all(entry is not None for entry in own):
            gram, right, total, scatter = zip(*[entry for entry in own if entry is not None], strict=True)
            part = _Moments(np.array(gram), np.array(right), np.array(total), np.array(scatter))
            if part.total.sum() > MOVES * part.scatter.sum():
                parts.append(part)
    return parts


def _even(heat: Temperatures) -> Temperatures:
    """All sensors each minute, gaps bridged by straight lines."""
    t_s = np.arange(heat.t_s[0], heat.t_s[-1] + GRID_S, GRID_S)
    columns = []
    for column in heat.value_degC.T:
        good = np.isfinite(column)
        columns.append(np.interp(t_s, heat.t_s[good], column[good]) if good.any() else np.zeros(len(t_s)))
    return Temperatures(t_s, heat.sensor_ids, np.column_stack(columns))


def _inputs(log: Temperatures, turn: Floats, lags_s: tuple[float, ...]) -> Floats:
    """Leading directions of the rises and their lags, (n, inputs)."""
    leading = (log.value_degC - log.value_degC[0]) @ turn
    if not lags_s:
        return np.asarray(leading)
    return np.hstack([leading, run_filters(log.t_s, leading, lags_s)[0].reshape(len(leading), -1)])


def _campaign_moments(
    t_s: Floats, inputs: Floats, measured: MeasuredComponent
) -> tuple[Floats, Floats, float, float] | None:
    """Cross products at every shift of one component of one campaign; None where it has too few rows."""
    rows = np.flatnonzero(np.isfinite(measured.error_um) & (measured.t_s <= t_s[-1] - KEPT_FROM_END_S))
    rows = rows[:: max(1, len(rows) // MOST)]
    if len(rows) < FEWEST:
        return None
    place = np.unique(measured.place[rows], axis=0, return_inverse=True)[1].ravel()
    lever = measured.lever[rows]
    error = _centred(measured.error_um[rows, None], place)[:, 0]
    grams, rights = [], []
    for shift_s in SHIFTS_S:
        at_s = measured.t_s[rows] + shift_s
        x = np.column_stack([np.interp(at_s, t_s, column) for column in inputs.T])
        x = _centred(np.hstack([x, x * lever[:, None]]) if lever.any() else x, place)
        grams.append(x.T @ x)
        rights.append(x.T @ error)
    degrees = len(rows) - place.max() - 1
    variance = _scatter(error, lever, measured.sweep[rows])
    return np.array(grams), np.array(rights), float(error @ error), degrees * variance


def _centred(columns: Floats, place: Ints) -> Floats:
    """Columns (n, k) less their mean at each place: geometry says nothing of time."""
    count = np.bincount(place).astype(float)
    means = np.column_stack([np.bincount(place, column) / count for column in columns.T])
    return np.asarray(columns - means[place])


def _scatter(error: Floats, lever: Floats, sweep: Ints) -> float:
    """Variance of a reading: about the line of its sweep, or in drift about its neighbours in time."""
    if not lever.any():
        bent = error[:-2] - 2.0 * error[1:-1] + error[2:]
        return float((1.4826 * np.median(np.abs(bent))) ** 2 / 6.0)
    squares, degrees = 0.0, 0
    for number in np.unique(sweep):
        rows = sweep == number
        if rows.sum() > 3:
            line = np.column_stack([np.ones(rows.sum()), lever[rows]])
            left = error[rows] - line @ np.linalg.lstsq(line, error[rows], rcond=None)[0]
            squares, degrees = squares + float(left @ left), degrees + int(rows.sum()) - 2
    return squares / max(degrees, 1)


def clock_notes(campaigns: Sequence[Campaign]) -> tuple[str, ...]:
    """The same in the words of an analysis."""
    return tuple(f"clocks disagree: {shift}" for shift in clock_shifts(campaigns))

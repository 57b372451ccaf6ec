"""Whose fault it is: one sensor that spoils the predictions of others, or two channels that were exchanged."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.screening.events import Event
from thetacomp.screening.window import History

BASE = 5  # blocks before the exchange that give the levels
SAME_TIME = 3  # blocks that may lie between two onsets


def exchanged_with(history: History, event: Event, offset_K: Floats, opened: Mapping[int, Event]) -> int | None:
    """The sensor whose channel now carries the one of the event, if two were exchanged at its onset; else None.

    Both readings must fit the other sensor's expected course to a quarter of the distance of the two levels, and
    clearly better than their own.
    """
    j, begin, p = event.j, max(event.onset - BASE, history.first), history.p
    excluded = frozenset(opened)
    h = min(1, len(history.model.horizon_s) - 1)
    if event.onset <= begin or event.onset + 1 >= history.count:
        return None
    before = np.mean(history.rows(begin, event.onset)[:, p : 2 * p], axis=0)
    after = history.rows(event.onset + 1, history.count)
    tried = []
    for k in range(p):
        elsewhere = k in opened and abs(opened[k].onset - event.onset) > SAME_TIME
        if k == j or not history.model.screened[k] or elsewhere or not np.isfinite(after[:, [j, k]]).any(axis=0).all():
            continue
        both = excluded | {j, k}
        off = []
        for own, other in ((j, k), (k, j)):
            predicted = history.predicted(history.model.weights(h, both, own), begin)
            rise = predicted[event.onset + 1 - begin :] - np.mean(predicted[: event.onset - begin])
            expected = before[own] + rise
            crossed = float(np.nanmean(np.abs(after[:, other] - offset_K[other] - expected)))
            straight = float(np.nanmean(np.abs(after[:, own] - offset_K[own] - expected)))
            off.append((crossed, straight))
        if max(c for c, _ in off) < 0.25 * abs(before[k] - before[j]) and all(c < 0.4 * s for c, s in off):
            tried.append((sum(c for c, _ in off), k))
    return min(tried)[1] if tried else None


def culprit(history: History, statistic: Floats, excluded: frozenset[int]) -> int:
    """The sensor without which the remaining residuals are smallest; a fault also spoils what it predicts.

    `statistic` (H, p) are the residuals in standard deviations that raised the alarm. Tried are the sensors with the
    largest ones, and those that move the prediction of the worst one most.
    """
    relative = np.abs(statistic) / history.model.threshold[:, None]
    h, worst = np.unravel_index(int(np.argmax(relative)), relative.shape)
    helping = history.contributions(int(h), int(worst), excluded)
    candidates = {*np.argsort(-np.max(relative, axis=0))[:5].tolist(), *np.argsort(-helping)[:4].tolist()} - excluded

    def remaining(j: int) -> float:
        return float(np.sum(history.statistic(excluded | {j}) ** 2))

    return int(min(sorted(j for j in candidates if history.model.screened[j]), key=remaining))

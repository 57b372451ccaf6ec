"""Probes: a displacement measured now and then sets the offset of a prediction right.

A probe is a new datum: what is predicted from then on is the change since the probe. A model that will be probed is
therefore fitted on errors since the datum and on errors since the last probe together. The filters of the heat
history keep running through a probe.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thetacomp.arrays import Floats
from thetacomp.errors import AnalysisError
from thetacomp.fitting.ridge import HistoryRidge


def follow_probes(t_s: Floats, predicted_um: Floats, probe_t_s: Floats, probe_um: Floats, gain: float = 1.0) -> Floats:
    """Prediction (n,) with the offset of the last probe before each row; unchanged before the first probe.

    `t_s` (n,) and `probe_t_s` (k,) ascending, `probe_um` (k,) the measured errors; a NaN is no probe. At each probe
    the offset moves by `gain` times what is still missing; 1 believes the probe entirely. A probe serves later rows
    only, so the row at which it is taken keeps the error that the probe found.
    Raises AnalysisError for a gain outside 0..1 or a probe outside the rows.
    """
    if not 0.0 < gain <= 1.0:
        raise AnalysisError(f"the gain of a probe must be above 0 and at most 1, found {gain:g}.")
    t_s, predicted_um = np.asarray(t_s, dtype=np.float64), np.asarray(predicted_um, dtype=np.float64)
    valid = np.isfinite(probe_um)
    probe_t_s, probe_um = np.asarray(probe_t_s)[valid], np.asarray(probe_um)[valid]
    outside = (probe_t_s < t_s[0]) | (probe_t_s > t_s[-1])
    if outside.any():
        raise AnalysisError(f"the probe at {probe_t_s[outside][0]:g} s lies outside {t_s[0]:g} to {t_s[-1]:g} s.")
    missing_um = probe_um - np.interp(probe_t_s, t_s, predicted_um)
    offsets_um = [0.0]
    for found_um in missing_um:
        offsets_um.append(offsets_um[-1] + gain * (float(found_um) - offsets_um[-1]))
    corrected: Floats = predicted_um + np.array(offsets_um)[np.searchsorted(probe_t_s, t_s, side="left")]
    return corrected


def probe_rows(t_s: Floats, groups: NDArray[Any], every_s: float) -> NDArray[np.intp]:
    """Rows at which a clock of period `every_s` strikes inside a campaign, `t_s` and `groups` (n,)."""
    strikes = np.diff(np.floor(np.asarray(t_s) / every_s)) > 0
    return np.flatnonzero(strikes & (groups[1:] == groups[:-1])) + 1


def since_probe(values: Floats, groups: NDArray[Any], probes: NDArray[np.intp]) -> Floats:
    """Values (n, k) less those at the last earlier probe of the same campaign; unchanged before its first probe."""
    values = np.asarray(values, dtype=np.float64)
    out = values.copy()
    for label in np.unique(groups):
        rows = np.flatnonzero(groups == label)
        own = probes[groups[probes] == label]
        last = np.searchsorted(own, rows, side="left") - 1
        probed = last >= 0
        out[rows[probed]] -= values[own[last[probed]]]
    return out


def fit_between_probes(
    model: HistoryRidge, X: ArrayLike, y: ArrayLike, groups: ArrayLike, probes: NDArray[np.intp]
) -> HistoryRidge:
    """Fit on errors since the datum and since the last probe; both parts get the same mean square.

    `X`, `y` and `groups` as in `HistoryRidge.fit`, `probes` the rows at which the training data are probed.
    Raises AnalysisError as `fit` does.
    """
    x, target, labels = np.asarray(X, dtype=np.float64), np.asarray(y, dtype=np.float64), np.asarray(groups)
    columns = target.reshape(len(target), -1)
    change_um = since_probe(columns, labels, probes)
    weight = np.sqrt(np.nanmean(columns**2) / max(float(np.nanmean(change_um**2)), 1e-12))
    return model.fit(
        np.vstack([x, weight * since_probe(x, labels, probes)]),
        np.concatenate([target, weight * change_um.reshape(target.shape)]),
        np.concatenate([labels, labels]),
    )

"""Hold-out error of a set of sensors, from cross products that are formed once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thetacomp.arrays import Floats, Ints
from thetacomp.sensors.parameters import INTERCEPT, ParameterTable


def line_targets(table: ParameterTable, votes: Sequence[bool]) -> tuple[Floats, Ints]:
    """Errors in µm whose mean square is that over the travel, (n, targets), and the component of each (targets,).

    A line's mean square over the travel equals that of its values at the two Gauss points, middle ± half / sqrt(3).
    A parameter that does not vote counts as zero; a state without one of the voting parameters is NaN.
    """
    columns, owner = [], []
    for c, component in enumerate(dict.fromkeys(p.component for p in table.parameters)):
        parts = [j for j, p in enumerate(table.parameters) if p.component == component and votes[j]]
        if not parts:
            continue
        p = table.parameters[parts[0]]
        middle_m, half_m = (p.start_m + p.end_m) / 2.0, (p.end_m - p.start_m) / 2.0
        for lever_m in (middle_m - half_m / 3.0**0.5, middle_m + half_m / 3.0**0.5):
            shape = [1.0 if table.parameters[j].kind == INTERCEPT else lever_m for j in parts]
            columns.append(table.value[:, parts] @ np.array(shape))
            owner.append(c)
    targets = np.column_stack(columns) if columns else np.empty((len(table.value), 0))
    return targets, np.array(owner, dtype=np.int64)


class HoldOut:
    """Hold-out error of linear models `constant + Σ b_j rise_j`, for any subset of the given sensors.

    `rise_K` (n, p) without missing values, `target_um` (n, targets) with NaN where missing, `owner` (targets,) the
    component of each target. The cross products of every fold are formed once; each subset then costs a few small
    solutions, however many samples there are.
    """

    def __init__(self, rise_K: Floats, target_um: Floats, owner: Ints, fold: Ints) -> None:
        n, p = rise_K.shape
        scale = np.sqrt(np.mean(rise_K**2, axis=0)) if n else np.ones(p)
        x = np.column_stack([np.ones(n), rise_K / np.where(scale > 0, scale, 1.0)])
        self.owner = owner
        numbers = np.unique(fold)
        targets = target_um.shape[1]
        self._gram = np.zeros((targets, len(numbers), p + 1, p + 1))
        self._cross = np.zeros((targets, len(numbers), p + 1))
        self._power = np.zeros((targets, len(numbers)))
        self._count = np.zeros((targets, len(numbers)))
        for f, number in enumerate(numbers):
            rows = fold == number
            xf = x[rows]
            for t in range(targets):
                y = target_um[rows, t]
                good = np.isfinite(y)
                xg, yg = xf[good], y[good]
                self._gram[t, f], self._cross[t, f] = xg.T @ xg, xg.T @ yg
                self._power[t, f], self._count[t, f] = yg @ yg, len(yg)

    def rms_um(self, sensors: Sequence[int]) -> float:
        """RMS over travel and held-out states of the error vector that remains, in µm; inf where not computable."""
        if not self._gram.size:
            return float("inf")
        keep = np.array([0, *(j + 1 for j in sensors)])
        gram = self._gram[:, :, keep[:, None], keep]
        cross = self._cross[:, :, keep]
        train_count = self._count.sum(axis=1, keepdims=True) - self._count
        if ((train_count < len(keep)) & (self._count > 0)).any():
            return float("inf")
        coefficients = (
            np.linalg.pinv(gram.sum(axis=1, keepdims=True) - gram, rcond=1e-9, hermitian=True)
            @ (cross.sum(axis=1, keepdims=True) - cross)[..., None]
        )[..., 0]
        squares = (
            self._power
            - 2.0 * np.einsum("tfk,tfk->tf", coefficients, cross)
            + np.einsum("tfk,tfkl,tfl->tf", coefficients, gram, coefficients)
        )
        mean_square = np.maximum(squares.sum(axis=1), 0.0) / np.maximum(self._count.sum(axis=1), 1.0)
        # The targets of one component share its mean square; components are directions of one error vector.
        per_component = [mean_square[self.owner == c].mean() for c in np.unique(self.owner)]
        return float(np.sqrt(np.sum(per_component)))

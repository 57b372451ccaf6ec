"""What is held out: whole campaigns, or states where there is one campaign, and the second half in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thetacomp.arrays import Ints
from thetacomp.states import AxisStates

# Above this many states in a single campaign neighbours are nearly copies: blocks are held out instead of states.
MAX_SINGLE_STATES = 24
BLOCKS = 5


@dataclass(frozen=True)
class Fold:
    """Rows of the states that train and rows that test."""

    train: Ints
    test: Ints


def hold_out(states: AxisStates) -> tuple[str, tuple[Fold, ...]]:
    """The kind of split (`campaign`, `state` or `block`) and its folds."""
    present = np.unique(states.campaign)
    if len(present) > 1:
        return "campaign", _folds(states, [states.campaign == index for index in present])
    count = len(states)
    if count <= MAX_SINGLE_STATES:
        return "state", _folds(states, [np.arange(count) == row for row in range(count)])
    return "block", _folds(states, [np.arange(count) * BLOCKS // count == block for block in range(BLOCKS)])


def forward_in_time(states: AxisStates) -> tuple[Fold, ...]:
    """First half trains, second half tests: halves of the campaigns, or of the states where there is one campaign."""
    present = np.unique(states.campaign)
    if len(present) > 1:
        late = np.isin(states.campaign, present[(len(present) + 1) // 2 :])
    else:
        late = np.arange(len(states)) >= (len(states) + 1) // 2
    return _folds(states, [late])


def named_test(states: AxisStates, tests: Sequence[str]) -> tuple[Fold, ...]:
    """The campaigns of `tests` are tested by a model of all others."""
    names = np.array([name in set(tests) for name in states.campaigns])
    return _folds(states, [names[states.campaign]])


def training_states(states: AxisStates, fold: Fold) -> AxisStates:
    """The states that train a fold. A sensor that a tested campaign does not have counts as not read in training.

    So the model that is tested does without it, and no state of the tested campaign drops out of the judgement.
    """
    train = states.take(fold.train)
    rise_K = train.rise_K.copy()
    for index in np.unique(states.campaign[fold.test]):
        rise_K[:, ~np.isfinite(states.rise_K[states.campaign == index]).any(axis=0)] = np.nan
    return replace(train, rise_K=rise_K)


def _folds(states: AxisStates, masks: Sequence[np.ndarray]) -> tuple[Fold, ...]:
    return tuple(Fold(np.flatnonzero(~mask), np.flatnonzero(mask)) for mask in masks if mask.any() and not mask.all())

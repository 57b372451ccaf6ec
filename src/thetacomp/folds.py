"""What is held out, by one rule for sensors, fits and validation: campaigns, or states or blocks of a single one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from thetacomp.arrays import Ints
from thetacomp.axis_states import AxisStates

# Above this many states in a single campaign neighbours are nearly copies: only whole blocks are new to a model.
MAX_SINGLE_STATES = 24
BLOCKS = 5
NAMED_TEST = "test"

SplitKind = Literal["campaign", "state", "block"]


@dataclass(frozen=True)
class Fold:
    """Rows of the states that train and rows that test."""

    train: Ints
    test: Ints


@dataclass(frozen=True)
class FoldNumbers:
    """What is held out together: `index` (n,) counts the folds from 0."""

    kind: SplitKind
    index: Ints

    @property
    def in_words(self) -> str:
        """Such as `one campaign left out`."""
        if self.kind == "block":
            return f"one of {BLOCKS} blocks in time left out"
        return f"one {self.kind} left out"


def fold_numbers(campaign: Ints) -> FoldNumbers:
    """The rule: leave a campaign out; of a single campaign (n,) a state, or a block in time where it is long."""
    present = np.unique(campaign)
    n = len(campaign)
    if len(present) > 1:
        return FoldNumbers("campaign", np.searchsorted(present, campaign))
    if n <= MAX_SINGLE_STATES:
        return FoldNumbers("state", np.arange(n))
    return FoldNumbers("block", np.arange(n) * BLOCKS // n)


def hold_out(states: AxisStates) -> tuple[SplitKind, tuple[Fold, ...]]:
    """The kind of split and its folds."""
    numbers = fold_numbers(states.campaign)
    return numbers.kind, _folds([numbers.index == number for number in np.unique(numbers.index)])


def forward_in_time(states: AxisStates) -> tuple[Fold, ...]:
    """First half trains, second half tests: halves of the campaigns, or of the states where there is one campaign."""
    present = np.unique(states.campaign)
    if len(present) > 1:
        late = np.isin(states.campaign, present[(len(present) + 1) // 2 :])
    else:
        late = np.arange(len(states)) >= (len(states) + 1) // 2
    return _folds([late])


def named_test(states: AxisStates, tests: Sequence[str]) -> tuple[Fold, ...]:
    """The campaigns of `tests` are tested by a model of all others."""
    names = np.array([name in set(tests) for name in states.campaigns])
    return _folds([names[states.campaign]])


def main_split(states: AxisStates, tests: Sequence[str]) -> tuple[str, tuple[Fold, ...]]:
    """The split that a model is judged by: the campaigns of `tests` (`test`), or `hold_out` where none is named."""
    return (NAMED_TEST, named_test(states, tests)) if tests else hold_out(states)


def training_states(states: AxisStates, fold: Fold) -> AxisStates:
    """The states that train a fold. A sensor that a tested campaign does not have counts as not read in training.

    So the model that is tested does without it, and no state of the tested campaign drops out of the judgement.
    """
    train = states.take(fold.train)
    rise_K = train.rise_K.copy()
    for index in np.unique(states.campaign[fold.test]):
        rise_K[:, ~np.isfinite(states.rise_K[states.campaign == index]).any(axis=0)] = np.nan
    return replace(train, rise_K=rise_K)


def _folds(masks: Sequence[np.ndarray]) -> tuple[Fold, ...]:
    return tuple(Fold(np.flatnonzero(~mask), np.flatnonzero(mask)) for mask in masks if mask.any() and not mask.all())

"""A fit is made once: the stored model, its in-sample figure and every split ask for the same ones again and again."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from thetacomp.axis_states import AxisStates

M = TypeVar("M")


class CachedProcedure(Generic[M]):
    """A procedure that keeps what it made: called again on states that are equal number by number, it gives that.

    Right for a procedure that depends on its states alone, as every one that is repeated inside the folds must.
    """

    def __init__(self, procedure: Callable[[AxisStates], M]) -> None:
        self._procedure = procedure
        self._made: dict[bytes, M] = {}

    def __call__(self, states: AxisStates) -> M:
        """The model of these states."""
        digest = hashlib.blake2b(digest_size=16)
        _feed(digest, states)
        key = digest.digest()
        if key not in self._made:
            self._made[key] = self._procedure(states)
        return self._made[key]


def _feed(digest: hashlib.blake2b, value: Any) -> None:
    if isinstance(value, np.ndarray):
        digest.update(f"{value.dtype.str}{value.shape}".encode())
        digest.update(np.ascontiguousarray(value).data)
    elif is_dataclass(value):
        for field in fields(value):
            _feed(digest, getattr(value, field.name))
    elif isinstance(value, tuple) and value and is_dataclass(value[0]):
        for item in value:
            _feed(digest, item)
    else:
        digest.update(f"{value!r};".encode())

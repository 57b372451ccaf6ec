"""Kinds of arrays, and the three directions that errors are counted in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

CARTESIAN = ("X", "Y", "Z")

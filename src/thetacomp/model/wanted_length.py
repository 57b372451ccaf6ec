"""The wanted length: where parts are to be true at 20 °C, the tool follows the workpiece. Numpy only.

A workpiece at θ is longer by α (θ - 20 °C) for each unit of length. A machine that is true to the metre cuts it too
short by that, once it has cooled. To follow it, the wanted position of the tool is `p + α (θ - 20) (p - zero)`, so the
error `actual - wanted` gains `-α (θ - 20) (p - zero)` along the axis: at +10 K and 11.5e-6 1/K 345 µm on three metres.
ISO 1 fixes the 20 °C.
"""

from __future__ import annotations

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.machine import Axis, WantedLength
from thetacomp.model.document import ModelDocument

REFERENCE_DEGC = 20.0


def follows_workpiece(model: ModelDocument) -> bool:
    """True where lengths follow the workpiece."""
    return model.length.wanted == "workpiece"


def zero_mm(model: ModelDocument, axis: Axis) -> float:
    """Where the workpiece's length counts from on an axis: as stated, else P0 of the axis' error, else mid-travel."""
    if axis.name in model.length.zero_mm:
        return model.length.zero_mm[axis.name]
    law = model.control.get(axis.name)
    return float(np.mean(axis.travel_mm)) if law is None or law.p0_mm is None else law.p0_mm


def expansion_um_per_m_per_K(length: WantedLength) -> float:
    """Expansion of the workpiece in µm/m for each kelvin; 0 where it is not followed."""
    return 1e6 * (length.workpiece_expansion_per_K or 0.0) if length.wanted == "workpiece" else 0.0


def length_error_um(model: ModelDocument, axis: Axis, workpiece_degC: Floats, position_mm: Floats) -> Floats:
    """What following the workpiece adds to the error along an axis' Cartesian direction, (n,) in µm."""
    grown = expansion_um_per_m_per_K(model.length) * (np.asarray(workpiece_degC) - REFERENCE_DEGC)
    error_um: Floats = -axis.sign * grown * (np.asarray(position_mm) - zero_mm(model, axis)) / 1000.0
    return error_um

"""Comparison of our coefficients with published equations of the same machine."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from thetacomp.axis_states import AxisStates
from thetacomp.campaign import MachineFolder
from thetacomp.fitting.key_point_law import AxisModel
from thetacomp.fitting.training import train
from thetacomp.preparation import prepare

# A correlation below this leaves the coefficients so uncertain that a comparison proves nothing.
MIN_CORRELATION = 0.9
TOLERANCE = 0.10


@dataclass(frozen=True)
class PublishedEquation:
    """`E = (slope_const + slope_per_degC θ) p + intercept_const + intercept_per_degC θ`, in µm/m, µm and °C."""

    number: int
    component: str
    sensor: str
    slope_const_um_per_m: float
    slope_um_per_m_per_degC: float
    intercept_const_um: float
    intercept_um_per_degC: float


@dataclass(frozen=True)
class CoefficientComparison:
    """One coefficient in print and recomputed. `verdict`: agrees, reversed, differs or weak (|r| at most 0.9)."""

    equation: int
    component: str
    coefficient: str
    unit: str
    printed: float
    recomputed: float
    correlation: float
    verdict: str


def read_published_equations(path: Path) -> tuple[PublishedEquation, ...]:
    """Read the table of printed equations (columns as the fields of PublishedEquation)."""
    with path.open(encoding="utf-8", newline="") as file:
        return tuple(
            PublishedEquation(
                int(row["equation"]),
                row["component"],
                row["sensor"],
                *(float(row[name]) for name in list(row)[3:]),
            )
            for row in csv.DictReader(file)
        )


def compare_with_published(
    equations: Sequence[PublishedEquation], folder: MachineFolder
) -> tuple[CoefficientComparison, ...]:
    """Compare every printed coefficient with that of the paper's way on the folder's own campaigns.

    In absolute temperatures and with the cold residue left in: a publication that does not refer its parameters to the
    cold state keeps a constant there; it is added back here.
    """
    rows: list[CoefficientComparison] = []
    trained = train(prepare(folder), axes=(), lost=())
    for equation in equations:
        for states, model in trained.fitted_paper:
            if equation.component in states.components and model.inputs == (equation.sensor,):
                rows += _compare(equation, states, model)
    return tuple(rows)


def _compare(equation: PublishedEquation, states: AxisStates, model: AxisModel) -> list[CoefficientComparison]:
    k = states.components.index(equation.component)
    regression = model.regressions[equation.component]
    column = states.sensors.index(equation.sensor)
    reference_degC = states.reference_degC[0, column]
    rows = []
    for j, (kind, unit, constant, per_degC, parameter, cold) in enumerate(
        (
            (
                "intercept",
                "µm",
                equation.intercept_const_um,
                equation.intercept_um_per_degC,
                states.intercept_um[:, k],
                states.cold_intercept_um[0, k],
            ),
            (
                "slope",
                "µm/m",
                equation.slope_const_um_per_m,
                equation.slope_um_per_m_per_degC,
                states.slope_um_per_m[:, k],
                states.cold_slope_um_per_m[0, k],
            ),
        )
    ):
        known = np.isfinite(parameter) & np.isfinite(states.rise_K[:, column])
        r = float(np.corrcoef(parameter[known], states.rise_K[known, column])[0, 1])
        coefficient = float(regression.coef_[j, 0])
        own_constant = float(regression.intercept_[j] - coefficient * reference_degC + cold)
        for name, own_unit, printed, own in (
            (f"{kind} constant", unit, constant, own_constant),
            (f"{kind} per °C", f"{unit}/°C", per_degC, coefficient),
        ):
            rows.append(
                CoefficientComparison(
                    equation.number, equation.component, name, own_unit, printed, own, r, _verdict(printed, own, r)
                )
            )
    return rows


def _verdict(printed: float, own: float, r: float) -> str:
    if abs(r) <= MIN_CORRELATION:
        return "weak"
    if abs(own - printed) <= TOLERANCE * abs(printed):
        return "agrees"
    if abs(own + printed) <= TOLERANCE * abs(printed):
        return "reversed"
    return "differs"

"""Small model documents made by hand, for tests of prediction and export."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from thetacomp.model.document import ModelDocument
from thetacomp.model.format_1 import from_format_1

Part = dict[str, Any]
"""A component of a law on key temperatures with its covariances, as format 1 writes it."""


def term(constant: float, *coefficients: float, sd: float = 0.0, variance: float = 0.0) -> Part:
    """A term whose covariance is diagonal with one `variance`."""
    size = len(coefficients) + 1
    return {
        "constant": constant,
        "coefficients_per_K": list(coefficients),
        "covariance": [[variance if i == j else 0.0 for j in range(size)] for i in range(size)],
        "residual_sd": sd,
        "r_squared": 0.99,
    }


def component(
    name: str,
    intercept: Part,
    slope: Part | None,
    reference: Mapping[str, float],
    *,
    p: tuple[float, float, float] = (0.0, 0.0, 1000.0),
    correlation: float = 0.0,
    dof: int = 8,
    **more: Any,
) -> Part:
    """The component `EXY` or `DX`; `p` is (P0, lowest, highest)."""
    drift = name.startswith("D")
    return {
        "direction": name[1],
        "axis": None if drift else name[2:],
        "p0_mm": None if drift else p[0],
        "p_min_mm": None if drift else p[1],
        "p_max_mm": None if drift else p[2],
        "reference": {"campaign": "A", "t_s": 0.0, "temperature_degC": dict(reference)},
        "inputs": list(reference),
        "intercept": intercept,
        "slope": slope,
        "residual_correlation": correlation,
        "dof": dof,
        "states": dof + 1 + len(reference),
        "residual_um": (1.0, 2.0),
        "equation": "",
        **more,
    }


def document(
    axes: Mapping[str, str],
    components: Mapping[str, Part],
    rise_K: Mapping[str, tuple[float, float]],
    *,
    sign: Literal["stated", "unproven"] = "stated",
    datum: Literal["campaign", "common"] = "campaign",
    mode: str = "",
    **more: Any,
) -> ModelDocument:
    """A model of axes name -> direction; temperatures ranged from the components' references by `rise_K`."""
    ready = [one for fallback in more.get("fallbacks", ()) for one in fallback["components"].values()]
    references: dict[str, float] = {}
    for one in (*components.values(), *ready):
        references.update(one["reference"]["temperature_degC"])
    return from_format_1(
        {
            "kind": "thetacomp model",
            "format": 1,
            "version": "0",
            "created": "2026-03-02T10:00:00",
            "machine": "Test machine",
            "axes": [{"name": n, "direction": d, "travel_mm": (-3000.0, 3000.0)} for n, d in axes.items()],
            "sign": sign,
            "method": "linear regression",
            "components": components,
            "training": {
                "campaigns": ("A",),
                "mode": mode,
                "instrument": "",
                "datum": datum,
                "range_degC": {
                    s: (references[s] + r[0], references[s] + r[1]) for s, r in rise_K.items() if s in references
                },
                "range_rise_K": rise_K,
            },
            **more,
        }
    )


def nothing_predicts(name: str, constant: float = 0.0, **place: Any) -> Part:
    """A component without inputs, as the analysis stores it where no sensor follows the error; 40 µm remained."""
    empty = component(name, term(constant, sd=2.0), term(0.0, sd=1.0), {}, **place)
    return empty | {"residual_um": (20.0, 40.0)}


PLACES = {"X": (1234.567, -512.25, 2988.125), "Y": (0.0, 0.0, 3000.0), "W": (481.3, 10.0, 993.7)}


def three_axes(
    sign: Literal["stated", "unproven"] = "stated",
    directions: tuple[str, str, str] = ("+X", "+Y", "-Z"),
    **other: Part,
) -> ModelDocument:
    """Axes X, Y and W with all nine errors, two of them with two inputs, of the size of a heavy machine.

    `other` components stand in their place.
    """
    x, y, w = {"tx": 19.31}, {"ty": 18.87, "oil": 21.4}, {"tw": 19.6}
    parts = {
        "EXX": (term(-3.17, -22.3, sd=4.0, variance=0.2), term(0.71, -7.07, sd=1.5, variance=0.03), x),
        "EYX": (term(1.3, 1.2, sd=3.0, variance=0.1), term(-0.2, -2.33, sd=1.0, variance=0.02), x),
        "EZX": (term(2.2, -25.1, sd=5.0, variance=0.2), term(0.1, 0.523, sd=0.5, variance=0.01), x),
        "EXY": (term(-4.1, 23.0, -1.7, sd=6.0, variance=0.3), term(0.9, 15.1, 0.37, sd=2.0, variance=0.05), y),
        "EYY": (term(3.1, 12.3, 0.9, sd=4.0, variance=0.2), term(-0.4, 8.05, -0.21, sd=1.0, variance=0.03), y),
        "EZY": (term(0.7, -34.0, 2.1, sd=5.0, variance=0.3), term(-0.6, -4.86, 0.11, sd=1.0, variance=0.02), y),
        "EXW": (term(-1.9, -24.4, sd=5.0, variance=0.2), term(0.33, 2.36, sd=1.0, variance=0.02), w),
        "EYW": (term(0.8, 5.8, sd=2.0, variance=0.1), term(0.05, -1.17, sd=0.5, variance=0.01), w),
        "EZW": (term(-2.6, 8.7, sd=4.0, variance=0.2), term(-0.7, -8.3, sd=1.5, variance=0.03), w),
    }
    components = {
        name: component(name, intercept, slope, reference, p=PLACES[name[2]], correlation=-0.4)
        for name, (intercept, slope, reference) in parts.items()
    }
    rises = {"tx": (-0.5, 8.3), "ty": (0.0, 6.8), "oil": (-1.0, 5.2), "tw": (0.0, 11.9)}
    return document(dict(zip("XYW", directions, strict=True)), components | other, rises, sign=sign)

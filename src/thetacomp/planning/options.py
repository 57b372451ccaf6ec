"""What a user may choose about a measuring plan, and the refusal of what cannot be measured."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime

from thetacomp.errors import InputError, Problem
from thetacomp.safe_names import name_fault

LEAST_POINTS, MOST_POINTS = 5, 999
COMMAND = "thetacomp plan"


@dataclass(frozen=True)
class PlanOptions:
    """Choices of one plan. `park_mm` and `nc_axis` go by axis name; `tracker_at_mm` is in the frame of the tool point.

    `tracker_u_um + tracker_u_um_per_m * distance` is the expanded uncertainty (k = 2) of each coordinate of a point.
    Without `tracker_at_mm` every point is taken to lie `tracker_distance_mm` away.
    """

    points: int = 11
    dwell_s: float = 4.0
    settle_s: float = 2.0
    sweep_feed_mm_min: float = 3000.0
    feed_mm_min: float = 1000.0
    speed_rpm: float = 650.0
    duration_h: float = 7.5
    cool_h: float = 3.0
    interval_min: float = 60.0
    mode: str = ""
    instrument: str = "laser tracker"
    tracker_u_um: float = 15.0
    tracker_u_um_per_m: float = 6.0
    tracker_at_mm: tuple[float, float, float] | None = None
    tracker_distance_mm: float = 5000.0
    vertical: str = "Y"
    park_mm: Mapping[str, float] = field(default_factory=dict)
    nc_axis: Mapping[str, str] = field(default_factory=dict)
    start: datetime | None = None
    must_see_um: float | None = None


# Option, lowest and highest value that makes sense, and whether the lowest itself is allowed.
_RANGES = (
    ("dwell_s", 0.0, 600.0, False),
    ("settle_s", 0.0, 600.0, True),
    ("sweep_feed_mm_min", 0.0, 200_000.0, False),
    ("feed_mm_min", 0.0, 200_000.0, False),
    ("speed_rpm", 0.0, 200_000.0, True),
    ("duration_h", 0.0, 72.0, False),
    ("cool_h", 0.0, 72.0, True),
    ("interval_min", 0.0, 1440.0, False),
    ("tracker_u_um", 0.0, 10_000.0, False),
    ("tracker_u_um_per_m", 0.0, 10_000.0, True),
    ("tracker_distance_mm", 0.0, 200_000.0, False),
)


def check_options(options: PlanOptions) -> None:
    """Raises InputError with every value that no plan can be made of."""
    problems = [
        problem(
            f"--{name.replace('_', '-')} is {getattr(options, name):g}, expected a number"
            f" {'from' if allowed else 'above'} {low:g} up to {high:g}.",
            "correct the option.",
        )
        for name, low, high, allowed in _RANGES
        if not (low <= getattr(options, name) <= high and (allowed or getattr(options, name) > low))
    ]
    if not LEAST_POINTS <= options.points <= MOST_POINTS:
        problems.append(
            problem(
                f"--points is {options.points}, expected {LEAST_POINTS} to {MOST_POINTS}: fewer do not show the"
                " shape of a cold axis.",
                "choose 10 to 20 points an axis.",
            )
        )
    if options.vertical not in ("X", "Y", "Z"):
        problems.append(
            problem(
                f"--vertical is '{options.vertical}', expected X, Y or Z.",
                "name the machine direction that points up: Y with a horizontal spindle, Z with a vertical one.",
            )
        )
    problems += [
        problem(f"{option} {text!r}: {name_fault(text)}.", "name it otherwise.")
        for option, text in (("--mode", options.mode), ("--instrument", options.instrument))
        if name_fault(text)
    ]
    if options.tracker_at_mm is not None and not all(map(math.isfinite, options.tracker_at_mm)):
        problems.append(problem("--tracker-at holds a value that is no finite number.", "give X,Y,Z in mm."))
    if options.must_see_um is not None and not 0 < options.must_see_um < math.inf:
        problems.append(
            problem(f"--must-see-um is {options.must_see_um:g}, expected a size above 0.", "give it in µm.")
        )
    if problems:
        raise InputError(problems)


def problem(message: str, fix: str, code: str = "plan-option", file: str = COMMAND) -> Problem:
    """One error about the plan."""
    return Problem("error", code, file, message, fix)


def pairs(option: str, texts: Sequence[str], example: str) -> dict[str, str]:
    """`NAME=VALUE` texts of a repeated option as a mapping. Raises InputError where one is written otherwise."""
    found: dict[str, str] = {}
    for text in texts:
        name, sign, value = text.partition("=")
        if not sign or not name.strip() or not value.strip() or name.strip() in found:
            raise InputError([problem(f"{option} {text}: expected each axis once, as NAME=VALUE.", f"like {example}.")])
        found[name.strip()] = value.strip()
    return found


def numbers(option: str, text: str, count: int) -> tuple[float, ...]:
    """Finite numbers separated by commas. Raises InputError where the text is something else."""
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count or not all(map(math.isfinite, values)):
        example = ",".join(["1500", "-4000", "1200"][:count])
        raise InputError(
            [
                problem(
                    f"{option} {text}: expected {count} number{'s separated by commas' if count > 1 else ''}.",
                    f"write it like {option} {example}, in mm, with a decimal point.",
                )
            ]
        )
    return values

"""`thetacomp keypoints --method exact`: the proven best sensors, with progress and an honest end when stopped."""

from __future__ import annotations

import math
import signal
import textwrap
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from thetacomp.cli.common import Outcome

if TYPE_CHECKING:
    from thetacomp.sensors.sensor_curve import CurvePoint, ScoreName, SensorCurve
    from thetacomp.sensors.subset import SearchProgress

_EVERY_S = 2.0
_WIDTH = 100
_HOLD = "\N{NO-BREAK SPACE}"  # a sensor and its share stay on one line
_SCORES = {
    "held_out": "each campaign left out in turn",
    "residual": "residual in-sample",
    "worst_campaign": "the worst campaign that is left out",
}


@dataclass(frozen=True)
class Search:
    """What is searched: one number of `sensors` or the curve, what is made smallest, seconds for each number."""

    sensors: int | None
    score: ScoreName
    budget_s: float | None


def exact_key_points(path: Path, train: Sequence[str], mix: bool, search: Search, quiet: bool) -> Outcome:
    """Search every axis of a folder; Ctrl-C ends the search and reports what is known until then."""
    from thetacomp.errors import AnalysisError
    from thetacomp.preparation import prepare
    from thetacomp.reading import read_folder
    from thetacomp.sensors.sensor_curve import sensor_curve

    prepared = prepare(read_folder(path), train, mix=mix)
    curves: list[SensorCurve] = []
    notes: list[str] = []
    counts = None if search.sensors is None else [search.sensors]
    with _interruptible() as stopped:
        for states in prepared.training:
            if stopped():
                notes.append(f"{_where(states.axis)}: not searched, the search was stopped before")
                continue
            try:
                tell = _progress(states.axis, quiet)
                curves.append(sensor_curve(states, counts, search.score, search.budget_s, tell, stopped))
            except AnalysisError as exc:
                notes.append(str(exc))
    if not curves:
        raise AnalysisError(" ".join(notes) or "there is nothing to choose sensors for.")
    notes += prepared.screening_notes
    text = "\n\n".join([*(_text(curve) for curve in curves), *(textwrap.fill(note, _WIDTH) for note in notes)])
    return Outcome(text, {"axes": [asdict(curve) for curve in curves], "notes": notes})


@contextmanager
def _interruptible() -> Iterator[Callable[[], bool]]:
    """Ctrl-C sets a mark instead of ending the program: the search stops after its round and keeps what it has."""
    asked: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, frame: asked.append(number))
    try:
        yield lambda: bool(asked)
    finally:
        signal.signal(signal.SIGINT, before)


def _progress(axis: str, quiet: bool) -> Callable[[int, SearchProgress], None]:
    """Reports the progress of a long search, every two seconds."""
    told_s = time.monotonic()

    def tell(count: int, state: SearchProgress) -> None:
        nonlocal told_s
        if quiet or time.monotonic() - told_s < _EVERY_S:
            return
        told_s = time.monotonic()
        typer.echo(
            f"… {_where(axis)}, {count} sensors: {100.0 * state.settled_share:.0f} % of the sets settled,"
            f" best {state.score:.3g} µm, none below {state.bound:.3g} µm; Ctrl-C stops here",
            err=True,
        )

    return tell


def _where(axis: str) -> str:
    return f"axis {axis}" if axis else "drift at a fixed position"


def _text(curve: SensorCurve) -> str:
    place = _where(curve.axis)
    title = f"{place[0].upper()}{place[1:]}: best sensors by {_SCORES[curve.score]}"
    lines = [title, "=" * len(title), f"{len(curve.campaigns)} campaigns: {', '.join(curve.campaigns)}", ""]
    lines.append("sensors   in-sample    held out   proven   which")
    for point in curve.points:
        proven = "yes" if point.proven else "no"
        head = f"{point.count:7d}{_um(point.residual_um)}{_um(point.held_out_um)}   {proven:<6}   "
        lines += textwrap.wrap(", ".join(point.sensors), _WIDTH, initial_indent=head, subsequent_indent=" " * len(head))
    lines += [_bound(point) for point in curve.points if not point.proven]
    lines += ["RMS in µm over travel and states of the error vector that remains; linear in the rises."]
    if len(curve.points) > 1:
        lines.append(f"Enough (within 5 % of the best): {curve.best}.")
    if curve.shares is not None:
        told = [
            f"{name}{_HOLD}{100.0 * share:.0f}{_HOLD}%"
            for share, name in sorted(zip(curve.shares.share, curve.shares.sensors, strict=True), reverse=True)
            if share > 0.0
        ]
        head = f"Chosen among the best {curve.shares.count} in {curve.shares.draws} draws of the campaigns: "
        wrapped = textwrap.wrap(head + ", ".join(told), _WIDTH, subsequent_indent="  ")
        lines += [line.replace(_HOLD, " ") for line in wrapped]
    lines += [textwrap.fill(f"Note: {note}", _WIDTH) for note in curve.notes]
    return "\n".join(lines)


def _bound(point: CurvePoint) -> str:
    return (
        f"{point.count} sensors: stopped early. The set above scores {point.score_um:.3g} µm;"
        f" no set can score below {point.bound_um:.3g} µm."
    )


def _um(value: float) -> str:
    return f"{value:9.2f} µm" if math.isfinite(value) else f"{'–':>9}   "

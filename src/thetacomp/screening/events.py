"""A fault as it is followed, for the use of the screening alone; what the user sees is a `Finding`."""

from __future__ import annotations

from dataclasses import dataclass

from thetacomp.screening.faults import FaultKind


@dataclass(eq=False)  # an event is itself: searching a year of them by value would take minutes
class Event:
    """A fault as it is followed; block numbers, shifts in K. `end` is the block of its end, None while it lasts.

    `decided` says that the kind is settled; `open` that the sensor's own reading is not used; `dropped` that it was no
    separate fault after all.
    """

    j: int
    kind: FaultKind
    onset: int
    onset_s: float
    detected_s: float
    statistic: float
    threshold: float
    window_s: float
    alarm: int
    decided: bool = False
    open: bool = True
    end: int | None = None
    end_s: float | None = None
    shift_K: float = 0.0
    offset_before_K: float = 0.0
    size_K: float = float("nan")
    partner: int | None = None
    helpers: tuple[int, ...] = ()
    returned: int = 0
    dropped: bool = False

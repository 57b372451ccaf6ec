"""What a tracker campaign cannot give, or gives with a doubt, in words."""

from __future__ import annotations

from dataclasses import dataclass

from thetacomp.errors import AnalysisError


@dataclass(frozen=True)
class TrackerDoubt:
    """Something doubtful in the tracker points: what was found, and how to fix it."""

    code: str
    message: str
    fix: str


class FrameError(AnalysisError):
    """The points do not determine a frame or a tie. `doubt` says what is missing and why."""

    def __init__(self, code: str, message: str, fix: str) -> None:
        self.doubt = TrackerDoubt(code, message, fix)
        super().__init__(f"{message} Fix: {fix}")

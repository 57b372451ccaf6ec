"""Tracker points in the tracker's own frame become errors in the machine frame: NumPy alone."""

from thetacomp.tracker.doubt import FrameError, TrackerDoubt
from thetacomp.tracker.foundation import Foundation
from thetacomp.tracker.frame import to_machine_frame

__all__ = ["Foundation", "FrameError", "TrackerDoubt", "to_machine_frame"]

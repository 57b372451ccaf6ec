"""Data hygiene: faulty temperature channels found from the other sensors, repaired where possible, with the evidence.

At run time it needs numpy alone, so that the online service can screen live samples with the same code.
"""

from thetacomp.screening.detector import Detector, ScreenedSample
from thetacomp.screening.faults import Finding, with_fault
from thetacomp.screening.model import DetectionLimit, ScreeningModel, from_json
from thetacomp.screening.screen import Screening, fit_screening, screen

__all__ = [
    "DetectionLimit",
    "Detector",
    "Finding",
    "ScreenedSample",
    "Screening",
    "ScreeningModel",
    "fit_screening",
    "from_json",
    "screen",
    "with_fault",
]

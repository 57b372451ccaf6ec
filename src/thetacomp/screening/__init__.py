"""Data hygiene: faulty temperature channels found from the other sensors, repaired where possible, with the evidence.

At run time it needs numpy alone, so that the online service can screen live samples with the same rules.
"""

from thetacomp.screening.faults import Finding, with_fault
from thetacomp.screening.live import Detector, ScreenedSample
from thetacomp.screening.live_model import ScreeningModel, fit_screening

__all__ = [
    "Detector",
    "Finding",
    "ScreenedSample",
    "ScreeningModel",
    "fit_screening",
    "with_fault",
]

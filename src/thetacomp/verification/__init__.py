"""Verification with compensation on: before and after, what was applied, harm by position, go or no-go."""

from thetacomp.verification.outcome import Verification
from thetacomp.verification.verify import verify_folder

__all__ = ["Verification", "verify_folder"]

"""Verification with compensation on: before and after, what was applied, harm by position, go or no-go."""

from thetacomp.verification.outcome import VerificationResult
from thetacomp.verification.verify import verify_folder

__all__ = ["VerificationResult", "verify_folder"]

"""Separation of measured errors into geometry, slope and intercept (paper, section 2)."""

from thetacomp.separation.component import ComponentSeparation, GeometryCurve, LinearityTest, Points
from thetacomp.separation.form_choice import Separated, separate_all
from thetacomp.separation.separate import separate_campaign, separate_folder

__all__ = [
    "ComponentSeparation",
    "GeometryCurve",
    "LinearityTest",
    "Points",
    "Separated",
    "separate_all",
    "separate_campaign",
    "separate_folder",
]

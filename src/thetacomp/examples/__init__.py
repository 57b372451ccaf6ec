"""Machine folders that come with thetacomp."""

from __future__ import annotations

from pathlib import Path

TK6920 = Path(__file__).parent / "tk6920"
"""The published tables of a TK6920 floor-type boring and milling machine, as a machine folder."""

TK6920_EQUATIONS = Path(__file__).parent / "tk6920_equations.csv"
"""The equations (3) to (11) as that publication prints them, in our names and units."""

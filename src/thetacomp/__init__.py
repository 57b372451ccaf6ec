"""thetacomp: takes the thermal error out of machine tools."""

__version__ = "0.1.0"

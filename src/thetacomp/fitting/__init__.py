"""Thermal models: the regression, the procedures that choose its inputs, and the stored document."""

"""The temperature field: what every sensor did, and the rules of sensor placement (paper, section 1)."""

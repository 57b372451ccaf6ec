"""The choice of the sensors that matter: strategies, and the key points of every axis (paper, section 3)."""

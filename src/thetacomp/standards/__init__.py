"""Evaluations that standards define: ISO 230-2 (positioning) and ISO 230-3 (thermal effects). NumPy alone."""

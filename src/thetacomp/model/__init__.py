"""From a stored model and temperatures to the thermal error: the law, its bounds and where it holds."""

"""Sheets that need both wings: the verification page, and the replay through the limits of a control."""

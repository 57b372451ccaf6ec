"""Sphinx reads the Markdown pages of this folder: `make docs`."""

project = "thetacomp"
extensions = ["myst_parser"]
source_suffix = {".md": "markdown"}
exclude_patterns = ["_build"]
html_theme = "alabaster"
myst_heading_anchors = 3

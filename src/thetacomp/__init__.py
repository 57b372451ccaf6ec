"""thetacomp: takes the thermal error out of machine tools.

`read_folder` and `campaign_from_frames` can be imported from here; see `thetacomp.reading`.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    """Import the readers when they are first asked for: the machine wing never pays for them."""
    if name in ("campaign_from_frames", "read_folder"):
        return getattr(import_module("thetacomp.reading"), name)
    raise AttributeError(f"module 'thetacomp' has no attribute {name!r}")

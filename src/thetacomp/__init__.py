"""thetacomp: takes the thermal error out of machine tools.

    analysis = thetacomp.analyze(thetacomp.read_folder("my-machine"))
    error = analysis.model.predict(temperatures, positions).to_frame()

See `thetacomp.api` and docs/from_python.md.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"
__all__ = ["analyze", "export", "load_model", "read_folder", "read_frames", "verify"]


def __getattr__(name: str) -> Any:
    """Import the public API when it is first asked for: the machine wing never pays for it."""
    if name in __all__:
        return getattr(import_module("thetacomp.api"), name)
    raise AttributeError(f"module 'thetacomp' has no attribute {name!r}")

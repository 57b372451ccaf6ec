"""What is installed on demand: the optional packages, what each is for, and one line that names the extra."""

from __future__ import annotations

from importlib import import_module
from typing import Literal

from thetacomp.errors import ThetacompError

Extra = Literal["twin", "parquet", "families", "pandas"]

# The package that shows whether an extra is installed, and what the extra is for.
_EXTRAS: dict[Extra, tuple[str, str]] = {
    "twin": ("skfem", "The virtual machine"),
    "parquet": ("pyarrow", "Reading Parquet files"),
    "families": ("sklearn", "Comparing families of models"),
    "pandas": ("pandas", "A table as a pandas DataFrame"),
}


class MissingExtraError(ThetacompError):
    """Something was asked for that needs an optional package which is not installed."""


def require(extra: Extra) -> None:
    """Import the package of an extra; MissingExtraError, which says how to install it, where it is absent."""
    package, purpose = _EXTRAS[extra]
    try:
        import_module(package)
    except ModuleNotFoundError as exc:
        raise MissingExtraError(
            f"{purpose} needs the extra '{extra}', which is not installed (no module '{exc.name}')."
            f" Fix: pip install 'thetacomp[{extra}]', or '.[{extra}]' in a clone."
        ) from None

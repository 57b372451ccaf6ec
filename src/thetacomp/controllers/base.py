"""What all export targets share: settings from a TOML file, the files they make, and the linear law of a register."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from pydantic import ValidationError

from thetacomp.campaign import Floats
from thetacomp.compensation.law import Law
from thetacomp.errors import InputError, Problem
from thetacomp.machine import Strict
from thetacomp.models.document import LinearTerm

SettingsT = TypeVar("SettingsT", bound=Strict)


@dataclass(frozen=True)
class ExportFile:
    """One file of an export: its name and its whole text."""

    name: str
    text: str


@dataclass(frozen=True)
class RegisterLaw:
    """What a register of the control wants, as a linear law: `constant + Σ factor_j (θ_j - reference_j)`.

    The unit is that of the owner, per K for the factors. It is not an error: sign and unit of the control are in it.
    """

    constant: float
    sensors: tuple[str, ...] = ()
    factors: tuple[float, ...] = ()
    reference_degC: tuple[float, ...] = ()

    def at(self, temperature_degC: Mapping[str, Floats]) -> Floats:
        """The register value at n states, shape (n,)."""
        value = np.full(np.shape(next(iter(temperature_degC.values()), np.zeros(1))), self.constant)
        for sensor, factor, reference in zip(self.sensors, self.factors, self.reference_degC, strict=True):
            value = value + factor * (temperature_degC[sensor] - reference)
        return value


def register_law(law: Law, term: LinearTerm, scale: float) -> RegisterLaw:
    """A term of the error's law times `scale`, which carries the sign and the unit of the register."""
    return RegisterLaw(
        constant=scale * term.constant if law.keeps_constant else 0.0,
        sensors=law.inputs,
        factors=tuple(scale * coefficient for coefficient in term.coefficients_per_K),
        reference_degC=tuple(law.reference_degC.tolist()),
    )


def read_settings(path: Path | None, kind: type[SettingsT]) -> SettingsT:
    """Read the export settings; the defaults where there is no file. Raises InputError with every problem found."""
    if path is None:
        return kind()
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise InputError([_problem(path, "there is no such file.", "name the settings file.")]) from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as exc:
        raise InputError([_problem(path, f"not readable as TOML ({exc}).", "write `key = value` lines.")]) from None
    try:
        return kind.model_validate(raw)
    except ValidationError as exc:
        raise InputError(
            [
                _problem(
                    path,
                    f"{'.'.join(str(part) for part in error['loc'])}: {error['msg']}.",
                    f"known settings are {', '.join(kind.model_fields)}.",
                )
                for error in exc.errors()
            ]
        ) from None


def _problem(path: Path, message: str, fix: str) -> Problem:
    return Problem("error", "export-settings", str(path), message, fix)

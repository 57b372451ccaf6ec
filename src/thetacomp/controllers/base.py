"""What all export targets share: settings from a TOML file, the files they make, and the linear law of a register."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import ValidationError

from thetacomp.arrays import Floats
from thetacomp.errors import InputError, Problem
from thetacomp.machine import Strict
from thetacomp.model.law import ComponentLaw

SettingsT = TypeVar("SettingsT", bound=Strict)


@dataclass(frozen=True)
class ExportFile:
    """One file of an export: its name and its text."""

    name: str
    text: str


@dataclass(frozen=True)
class Export:
    """The files of an export, and remarks about them: sentences for the console.

    `plan` holds the facts behind the files, for the sheet that a person follows.
    `absent` names files of the same target that this model does not need: an older one must not be taken for new.
    """

    files: tuple[ExportFile, ...]
    plan: Any
    remarks: tuple[str, ...] = ()
    absent: tuple[str, ...] = ()


@dataclass(frozen=True)
class RegisterLaw:
    """What a register of the control wants, as a linear law: `constant + Σ factor_j (θ_j - reference_j)`.

    The unit is that of the owner, per K for the factors. It is not an error: sign and unit of the control are in it.
    """

    constant: float
    sensors: tuple[str, ...] = ()
    factors: tuple[float, ...] = ()
    reference_degC: tuple[float, ...] = ()

    @property
    def used(self) -> bool:
        """False where the register stays at zero."""
        return bool(self.constant or self.sensors)

    def at(self, temperature_degC: Mapping[str, Floats]) -> Floats:
        """The register value at n states, shape (n,)."""
        value = np.full(np.shape(next(iter(temperature_degC.values()), np.zeros(1))), self.constant)
        for sensor, factor, reference in zip(self.sensors, self.factors, self.reference_degC, strict=True):
            value = value + factor * (temperature_degC[sensor] - reference)
        return value


def register_law(one: ComponentLaw, power: int, scale: float) -> RegisterLaw:
    """What a power of u carries in the error's law times `scale`, which holds the sign and the unit of the register."""
    term = one.component.terms[power]
    return RegisterLaw(
        constant=scale * term.constant if one.law.keeps_constant else 0.0,
        sensors=one.inputs if term.coefficients else (),
        factors=tuple(scale * coefficient for coefficient in term.coefficients),
        reference_degC=tuple(one.law.zero.tolist()) if term.coefficients else (),
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
        known = tuple(kind.model_fields)
        raise InputError(
            [
                _problem(path, in_words(dict(error), known), f"known settings are {', '.join(known)}.")
                for error in exc.errors()
            ]
        ) from None


_KINDS = {
    "bool": "true or false",
    "dict": "a table",
    "float": "a number",
    "int": "a whole number",
    "model": "a table",
    "string": "a text in quotes",
}


def in_words(error: Mapping[str, Any], known: Sequence[str]) -> str:
    """One error of a pydantic check in plain words: the setting, what was found, what is expected."""
    kind, context = str(error["type"]), error.get("ctx", {})
    place = ".".join(str(part) for part in error["loc"] if part != "[key]")
    if kind == "extra_forbidden":
        return f"unknown setting '{place}'{_nearest(place, known) or '.'}"
    if error["loc"][-1:] == ("[key]",):
        return f"{place}: this key is not known here, expected {context.get('expected', 'another one')}."
    bounds = {"greater_than_equal": ("at least", "ge"), "less_than_equal": ("at most", "le")}
    bounds |= {"greater_than": ("above", "gt"), "less_than": ("below", "lt")}
    if kind == "literal_error":
        expected = str(context["expected"])
    elif kind in bounds:
        words, key = bounds[kind]
        expected = f"a value {words} {context[key]}"
    elif kind == "string_pattern_mismatch":
        expected = "a name of letters, digits and underscores that does not begin with a digit"
    elif kind == "finite_number":
        expected = "a finite number"
    else:
        expected = _KINDS.get(kind.split("_")[0], "another kind of value")
    return f"{place} = {error['input']!r}: expected {expected}."


def _nearest(name: str, known: Sequence[str]) -> str:
    """`, did you mean x?` for a name that begins or looks like this one; nothing where none is near."""
    begins = [one for one in known if len(name) > 2 and one.startswith(name.lower())]
    close = begins or difflib.get_close_matches(name.lower(), known, n=1, cutoff=0.6)
    return f", did you mean {close[0]}?" if close else ""


def _problem(path: Path, message: str, fix: str) -> Problem:
    return Problem("error", "export-settings", str(path), message, fix)

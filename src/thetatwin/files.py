"""Reads a bundled or a user's TOML file into its model, with all its problems reported at once."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

from thetacomp.errors import InputError, Problem
from thetacomp.machine import Strict

Model = TypeVar("Model", bound=Strict)


def load_toml(model: type[Model], name_or_path: str | Path, bundled: Sequence[str]) -> Model:
    """The model in a bundled file of that name or in a TOML file. Raises InputError with every problem found."""
    name = str(name_or_path)

    def problem(code: str, message: str, fix: str) -> Problem:
        return Problem("error", code, name, message, fix)

    try:
        if name in bundled:
            text = resources.files("thetatwin").joinpath("presets", f"{name}.toml").read_text(encoding="utf-8")
        else:
            text = Path(name_or_path).read_text(encoding="utf-8")
        return model.model_validate(tomllib.loads(text))
    except (FileNotFoundError, IsADirectoryError):
        known = ", ".join(bundled)
        found = problem(
            "missing", f"neither a file nor one of the bundled {known}.", "name a bundled one or a TOML file."
        )
        raise InputError([found]) from None
    except UnicodeDecodeError:
        raise InputError([problem("text", "not UTF-8 text.", "save the file as UTF-8.")]) from None
    except tomllib.TOMLDecodeError as exc:
        raise InputError([problem("toml", f"not valid TOML: {exc}.", "correct that line.")]) from None
    except ValidationError as exc:
        fix = f"compare with the bundled {' and '.join(bundled)}."
        places = [(".".join(str(part) for part in error["loc"]) or "file", error["msg"]) for error in exc.errors()]
        raise InputError([problem("value", f"{place}: {text}.", fix) for place, text in places]) from None

"""Reading `model.json`: the result is a usable model or one clear message, for any content of the file."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from pydantic import ValidationError

from thetacomp.errors import ModelFileError
from thetacomp.model.check import problems
from thetacomp.model.document import FORMAT, ModelDocument
from thetacomp.model.format_1 import from_format_1

LARGEST_FILE_MB = 64
DEEPEST = 20
MOST_DIGITS = 40
LARGEST_NUMBER = 1e12
LONGEST_TEXT = 20_000
AGAIN = "Fix: do not edit model files by hand; run `thetacomp analyze` again."


def load_model(path: Path) -> ModelDocument:
    """Read a stored model of format 1 or 2. Raises ModelFileError with place, what was found, and what to do."""
    raw = _parsed(path)
    if not isinstance(raw, dict) or raw.get("kind") != "thetacomp model":
        raise ModelFileError(f"{path}: this JSON file is not a thetacomp model (no kind 'thetacomp model').")
    known: dict[int, Callable[[Any], ModelDocument]] = {1: from_format_1, FORMAT: _from_format_2}
    found = raw.get("format")
    if type(found) is not int or found not in known:
        raise ModelFileError(
            f"{path}: model format {found!r}; this version reads formats 1 and {FORMAT}."
            " Fix: use the thetacomp version that wrote it, or run `thetacomp analyze` again."
        )
    try:
        _check_values(raw, ())
        model = known[found](raw)
    except ValidationError as exc:
        first = exc.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        _refuse(path, f"{place}: {first['msg']}", exc.error_count())
    except ValueError as exc:
        _refuse(path, str(exc), 1)
    faults = problems(model)
    if faults:
        _refuse(path, faults[0], len(faults))
    return model


def _from_format_2(raw: Any) -> ModelDocument:
    # As JSON, so that "12" and true are no numbers, while a list is still a tuple.
    return ModelDocument.model_validate_json(json.dumps(raw), strict=True)


def _refuse(path: Path, fault: str, count: int) -> NoReturn:
    raise ModelFileError(f"{path}: {fault} ({count} problem{'s' if count > 1 else ''} in all). {AGAIN}") from None


def _parsed(path: Path) -> Any:
    try:
        if path.stat().st_size > LARGEST_FILE_MB * 1e6:
            raise ModelFileError(f"{path}: larger than {LARGEST_FILE_MB} MB, which no model is. {AGAIN}")
        text = path.read_text(encoding="utf-8-sig")
        return json.loads(text, parse_int=_whole, parse_constant=_no_number)
    except FileNotFoundError:
        raise ModelFileError(
            f"{path}: there is no such file. Fix: name the model.json that `thetacomp analyze` wrote."
        ) from None
    except RecursionError:
        raise ModelFileError(f"{path}: brackets nested too deep to be a model. {AGAIN}") from None
    except (OSError, ValueError) as exc:
        raise ModelFileError(f"{path}: not readable as JSON ({exc}). Fix: run `thetacomp analyze` again.") from None


def _whole(digits: str) -> int:
    if len(digits) > MOST_DIGITS:
        raise ValueError(f"a number of {len(digits)} digits: {digits[:10]}…")
    return int(digits)


def _no_number(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a number that JSON knows")


def _check_values(value: Any, place: tuple[str | int, ...]) -> None:
    """Refuse by its place what no model holds: a number, a text or a nesting out of all proportion."""
    where = ".".join(str(part) for part in place)
    if len(place) > DEEPEST:
        raise ValueError(f"{where}: nested deeper than {DEEPEST} levels")
    if isinstance(value, dict):
        for key, item in value.items():
            _check_values(item, (*place, key[:80]))
    elif isinstance(value, list):
        for number, item in enumerate(value):
            _check_values(item, (*place, number))
    elif isinstance(value, str):
        if len(value) > LONGEST_TEXT:
            raise ValueError(f"{where}: a text of {len(value)} characters")
    elif isinstance(value, int | float) and not abs(value) <= LARGEST_NUMBER:
        raise ValueError(f"{where}: {value:.3g} is larger than anything a model holds")

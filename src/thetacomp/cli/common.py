"""What all commands share: one way to end, in words or as one JSON object, and never with a traceback."""

from __future__ import annotations

import json
import math
import os
import secrets
import sys
import tempfile
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

from thetacomp import __version__
from thetacomp.errors import InputError, OutputError, ThetacompError
from thetacomp.files import write_file

# The matrices here are small: threads of the linear algebra cost more than they bring. NumPy is not loaded yet.
for _library in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_library, "1")

DONE, BAD_INPUT, BAD_USAGE, NOT_FIT = 0, 1, 2, 3

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object for scripts instead of text.")]


@dataclass(frozen=True)
class Outcome:
    """How a command ended: words for a person, the same as data for scripts, and the exit code."""

    text: str
    data: dict[str, Any] = field(default_factory=dict)
    exit_code: int = DONE


def progress_lines(as_json: bool) -> Callable[[str], None]:
    """What a long command calls with one line a step; silent where a script reads the output."""

    def tell(message: str) -> None:
        if not as_json:
            with suppress(OSError):  # a full disk behind the console is no reason to stop
                typer.echo(f"… {message}", err=True)

    return tell


def run(work: Callable[[], Outcome], as_json: bool) -> None:
    """Run the body of a command, print its outcome, and leave with its exit code."""
    # Windows consoles often default to a code page that has no µ or θ.
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(encoding="utf-8", errors="replace")
    try:
        outcome = work()
    except InputError as exc:
        problems = [vars(problem) for problem in exc.problems]
        outcome = Outcome(str(exc), {"problems": problems}, BAD_INPUT)
    except ThetacompError as exc:
        outcome = Outcome(f"error: {exc}", {"error": str(exc)}, BAD_INPUT)
    except BrokenPipeError:
        _leave_quietly(DONE)
    except OSError as exc:
        text = f"error: {exc.filename or 'file'}: {exc.strerror or exc}. Fix: check the path, the rights and the disk."
        outcome = Outcome(text, {"error": text}, BAD_INPUT)
    except Exception:
        outcome = _defect()
    try:
        _print(outcome, as_json)
    except BrokenPipeError:
        _leave_quietly(DONE)
    except OSError as exc:  # the console is a file on a full disk
        with suppress(OSError):
            typer.echo(f"error: the results cannot be printed: {exc.strerror}.", err=True)
        _leave_quietly(BAD_INPUT)
    if outcome.exit_code:
        raise typer.Exit(outcome.exit_code)


def _print(outcome: Outcome, as_json: bool) -> None:
    if as_json:
        document = {"thetacomp": __version__, "exit_code": outcome.exit_code, **_jsonable(outcome.data)}
        typer.echo(json.dumps(document, ensure_ascii=False, indent=2, allow_nan=False))
    else:
        typer.echo(outcome.text, err=outcome.exit_code == BAD_INPUT)
    sys.stdout.flush()


def _leave_quietly(exit_code: int) -> NoReturn:
    """End without a message: the reader of a pipe (head, less) left early, or the console is full."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError):  # streams of a test have no number
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    raise typer.Exit(exit_code) from None


def _defect() -> Outcome:
    """A defect of thetacomp itself: the details go to a file, the user gets one line."""
    details = f"thetacomp {__version__}, Python {sys.version}\n{' '.join(sys.argv)}\n{traceback.format_exc()}"
    text = "error: this is a defect of thetacomp, not of your files."
    try:
        path = Path(tempfile.gettempdir()) / f"thetacomp-defect-{secrets.token_hex(4)}.txt"
        text += f" Details for a report are in {write_file(path, details)}"
    except (OSError, OutputError) as exc:
        text += f" Details for a report could not be stored ({exc})."
    return Outcome(text, {"error": text}, BAD_INPUT)


def _jsonable(value: Any) -> Any:
    """JSON has no NaN or infinity: they become null."""
    if isinstance(value, dict):
        return {str(key): _jsonable(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_jsonable(item) for item in value]
    if hasattr(value, "item"):  # numpy scalars
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value

"""What all commands share: one way to end, in words or as one JSON object, and never with a traceback."""

from __future__ import annotations

import json
import math
import os
import sys
import tempfile
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Any

import typer

from thetacomp import __version__
from thetacomp.errors import InputError, ThetacompError

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
        # The reader of a pipe (head, less) left early: that is no error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise typer.Exit(DONE) from None
    except OSError as exc:
        text = f"error: {exc.filename or 'file'}: {exc.strerror or exc}. Fix: check the path, the rights and the disk."
        outcome = Outcome(text, {"error": text}, BAD_INPUT)
    except Exception:
        outcome = _defect()
    if as_json:
        document = {"thetacomp": __version__, "exit_code": outcome.exit_code, **_jsonable(outcome.data)}
        typer.echo(json.dumps(document, ensure_ascii=False, indent=2, allow_nan=False))
    else:
        typer.echo(outcome.text, err=outcome.exit_code == BAD_INPUT)
    if outcome.exit_code:
        raise typer.Exit(outcome.exit_code)


def _defect() -> Outcome:
    """A defect of thetacomp itself: the details go to a file, the user gets one line."""
    with tempfile.NamedTemporaryFile(
        "w", prefix="thetacomp-defect-", suffix=".txt", delete=False, encoding="utf-8"
    ) as log:
        log.write(f"thetacomp {__version__}, Python {sys.version}\n{' '.join(sys.argv)}\n{traceback.format_exc()}")
    text = f"error: this is a defect of thetacomp, not of your files. Details for a report are in {log.name}"
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

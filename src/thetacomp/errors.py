"""The exceptions a user can meet. Every one carries a message that says what, where and how to fix it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong or doubtful in the user's files.

    The message names what was found and what was expected; `fix` says how to correct it.
    """

    severity: Literal["error", "warning"]
    code: str
    file: str
    message: str
    fix: str
    row: int | None = None
    column: str | None = None

    def __str__(self) -> str:
        place = self.file
        if self.row is not None:
            place += f", row {self.row}"
        if self.column is not None:
            place += f", column '{self.column}'"
        return f"{self.severity}: {place}: {self.message} Fix: {self.fix}"


class ThetacompError(Exception):
    """Base of everything thetacomp raises on purpose. The command line shows its text and exits with 1."""


class InputError(ThetacompError):
    """The user's files cannot be used as they are. `problems` holds every problem found, not just the first."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))


class AnalysisError(ThetacompError):
    """The files are readable, but what was asked cannot be computed from them."""


class ModelFileError(ThetacompError):
    """A model.json cannot be read: not ours, damaged, or of a format this version does not know."""


class OutputError(ThetacompError):
    """Something cannot be written at its destination; what was there before is untouched."""

    def __init__(self, path: Path, what: str, fix: str) -> None:
        self.path, self.what, self.fix = path, what, fix
        super().__init__(f"{path}: {what} Fix: {fix}")

"""Files that a user keeps: written to a temporary name, flushed to disk and renamed, so that none is ever partial."""

from __future__ import annotations

import errno
import glob
import os
import secrets
import shutil
from collections.abc import Mapping
from pathlib import Path

from thetacomp.errors import OutputError

Files = Mapping[str, str | bytes]
"""Contents by the name of the file below a folder, with `/` between the parts. Text becomes UTF-8, newlines as is."""

UNFINISHED = ".thetacomp-new"
_NAME_LENGTH = 50  # a file name has 255 bytes at most, a letter up to four

_REASONS = {
    errno.ENOSPC: ("the disk is full", "free some space, or name a folder on another disk."),
    errno.EDQUOT: ("the disk quota is used up", "free some space, or name a folder on another disk."),
    errno.EFBIG: ("the system allows no file of this size", "raise the limit, or write to another disk."),
    errno.EROFS: ("the disk is read-only", "name a folder on another disk."),
    errno.EACCES: ("no right to write here", "name another place, or change the rights."),
    errno.EPERM: ("no right to write here", "name another place, or change the rights."),
    errno.ENOTDIR: ("a file stands where a folder must be", "name another place."),
    errno.EEXIST: ("a file stands where a folder must be", "name another place."),
    errno.ENAMETOOLONG: ("the name is too long", "name a shorter path."),
}


def write_file(path: Path, content: str | bytes) -> Path:
    """Write one file whole or not at all; returns `path`. A link goes on pointing to its file, rights are kept.

    Raises OutputError, with what was there before unchanged.
    """
    target = Path(os.path.realpath(path))
    beside = beside_name(target, f".{secrets.token_hex(4)}{UNFINISHED}")
    data = content.encode() if isinstance(content, str) else content
    try:
        _refuse_protected(target)
        try:
            with beside.open("xb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            if target.exists():
                shutil.copymode(target, beside)
            beside.replace(target)
        except BaseException:
            beside.unlink(missing_ok=True)
            raise
        flush(target.parent)
    except OSError as exc:
        raise not_written(path, exc) from None
    return path


def write_files(folder: Path, files: Files) -> tuple[Path, ...]:
    """Write every file below `folder`, making folders on the way; returns the paths. Raises OutputError."""
    paths = []
    for name, content in files.items():
        path = folder / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as exc:
            raise not_written(path, exc) from None
        paths.append(write_file(path, content))
    return tuple(paths)


def beside_name(path: Path, ending: str) -> Path:
    """A hidden neighbour of `path`."""
    return path.with_name(f".{path.name[:_NAME_LENGTH]}{ending}")


def unfinished(path: Path) -> list[Path]:
    """What runs that were killed while they wrote `path` have left beside it."""
    return list(path.parent.glob(glob.escape(beside_name(path, ".").name) + f"*{UNFINISHED}"))


def not_written(path: Path, exc: OSError) -> OutputError:
    """The message for a refusal of the system."""
    what, fix = _REASONS.get(exc.errno or 0, (exc.strerror or str(exc), "check the path, the rights and the disk."))
    return OutputError(path, f"not written, {what}. What was there before is unchanged.", fix)


def flush(path: Path) -> None:
    """Make a file, or the names in a folder, durable. Systems that cannot open a folder need no such thing."""
    try:
        handle = os.open(path, os.O_RDONLY)
    except OSError:
        return
    try:
        os.fsync(handle)
    except OSError:
        pass
    finally:
        os.close(handle)


def _refuse_protected(target: Path) -> None:
    """A rename would replace even a file that its owner has protected."""
    if target.exists() and not os.access(target, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

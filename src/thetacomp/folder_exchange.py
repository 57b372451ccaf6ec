"""Exchanges a folder for one made next to it: a reader, even after a power failure, finds one complete folder."""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from fnmatch import fnmatchcase
from pathlib import Path

from thetacomp.errors import OutputError
from thetacomp.files import UNFINISHED, beside_name, flush, not_written

_REPLACED = ".thetacomp-old"
_LOCK = ".thetacomp-lock"
_held: set[Path] = set()  # by this process: the lock of the system distinguishes processes, but not their threads
_guard = threading.Lock()
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2


@contextmanager
def only_writer(place: Path) -> Iterator[None]:
    """Hold `place` against every other run that writes there. Raises OutputError where another one does."""
    path = beside_name(place, _LOCK)
    with _guard:
        if place in _held:
            raise _in_use(place)
        _held.add(place)
    try:
        yield from _system_lock(path, place)
    finally:
        _held.discard(place)


def _system_lock(path: Path, place: Path) -> Iterator[None]:
    handle = _locked(path, place)
    # Another run may have ended, and removed the file, between our open and our lock.
    while not _same_file(handle, path):
        os.close(handle)
        handle = _locked(path, place)
    try:
        yield
    finally:
        if sys.platform == "win32":  # an open file cannot be removed there
            os.close(handle)
            path.unlink(missing_ok=True)
        else:
            path.unlink(missing_ok=True)
            os.close(handle)


def _locked(path: Path, place: Path) -> int:
    """A handle that holds the lock; the system gives it back when the process ends, however it ends."""
    try:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as exc:
        raise not_written(place, exc) from None
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        else:
            os.lockf(handle, os.F_TLOCK, 0)
    except OSError as exc:
        if exc.errno not in (errno.EAGAIN, errno.EACCES, errno.EDEADLK):
            return handle  # a disk over the network that knows no locks
        os.close(handle)
        raise _in_use(place) from None
    return handle


def _in_use(place: Path) -> OutputError:
    return OutputError(place, "another run of thetacomp is writing here.", "wait until it ends, or name another place.")


def _same_file(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), path.stat())
    except FileNotFoundError:
        return False


@contextmanager
def fresh_folder(place: Path, own: Sequence[str]) -> Iterator[Path]:
    """An empty folder next to `place` that takes its name at the end; after an error everything is as before.

    Files of the old folder that match none of the patterns `own` and are not rewritten are carried over.
    """
    fresh, old = beside_name(place, UNFINISHED), beside_name(place, _REPLACED)
    with _refused_as(place):
        if old.exists() and not place.exists():
            old.rename(place)  # a run was ended between the two renames of _exchange
        for left in (fresh, old):
            _remove(left)
        fresh.mkdir()
    try:
        yield fresh
        with _refused_as(place):
            if place.exists():
                carry_over(place, fresh, own)
                shutil.copymode(place, fresh)
            _flush_all(fresh)
            _exchange(fresh, place, old)
            for left in (fresh, old):
                if left.exists():  # the old folder: a file that was added at the last moment is kept too
                    carry_over(left, place, own)
    finally:
        if old.exists() and not place.exists():
            old.rename(place)  # the exchange was ended between its two renames
        # After the exchange the name of the fresh folder holds the old one.
        for left in (fresh, old):
            _remove(left)


@contextmanager
def _refused_as(place: Path) -> Iterator[None]:
    try:
        yield
    except OSError as exc:
        raise not_written(place, exc) from None


def carry_over(old: Path, fresh: Path, own: Sequence[str], below: str = "") -> None:
    """Give `fresh` every file of `old` that it does not have, as a hard link where the disk supports it."""
    for entry in sorted(os.scandir(old), key=lambda entry: entry.name):
        name, target = below + entry.name, fresh / entry.name
        if entry.is_dir(follow_symlinks=False):
            made = not target.exists()
            target.mkdir(exist_ok=True)
            carry_over(Path(entry.path), target, own, f"{name}/")
            if made and not any(target.iterdir()) and any(os.scandir(entry.path)):
                target.rmdir()  # it held nothing but files that do not come again
            elif made:
                shutil.copystat(entry.path, target)
        elif os.path.lexists(target) or any(fnmatchcase(name, pattern) for pattern in own):
            continue
        elif entry.is_symlink():
            target.symlink_to(os.readlink(entry.path))
        else:
            try:
                os.link(entry.path, target)
            except OSError:
                shutil.copy2(entry.path, target)
                flush(target)


def _exchange(fresh: Path, place: Path, old: Path) -> None:
    """`place` becomes what `fresh` is, in one step where the system knows one."""
    if not place.exists():
        fresh.rename(place)
    elif not _swap(fresh, place):
        place.rename(old)
        fresh.rename(place)
    flush(place.parent)


def _swap(a: Path, b: Path) -> bool:
    """Two folders exchange their names in one step; False where the system has no such call."""
    if not sys.platform.startswith("linux"):
        return False
    rename = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    return rename is not None and rename(_AT_FDCWD, os.fsencode(a), _AT_FDCWD, os.fsencode(b), _RENAME_EXCHANGE) == 0


def _flush_all(folder: Path) -> None:
    for root, _, _ in os.walk(folder):
        flush(Path(root))


def _remove(left: Path) -> None:
    """A folder that a run left behind; what cannot be removed is hidden and does no harm."""
    shutil.rmtree(left, ignore_errors=True)

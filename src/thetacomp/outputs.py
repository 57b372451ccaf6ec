"""Where results may go: `--out` is judged before the work begins, held against other runs, and changed in one step."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from fnmatch import fnmatchcase
from pathlib import Path

from thetacomp.errors import OutputError
from thetacomp.files import not_written, unfinished
from thetacomp.folder_exchange import fresh_folder, only_writer

# A folder that holds one of these was made by thetacomp and may be exchanged for a new one.
PAGES = ("report.html", "verification.html", "iso230.csv", "placement.html", "commissioning_sheet.html")
TABLE_ENDINGS = (".csv", ".xlsx")


@contextmanager
def output_folder(out: Path, inputs: Iterable[Path] = (), own: Sequence[str] = ()) -> Iterator[Path]:
    """The folder to write into: it becomes `out`, complete, when the block ends without an error.

    `own` are patterns of the files that the command writes: older ones do not survive. Every other file of `out`
    does. `inputs` are what the command reads. Raises OutputError before the block where `out` cannot be used.
    """
    place = _resolved(out)
    _check_folder(out, place, [Path(os.path.realpath(path)) for path in inputs], own)
    with _parents(out, place), _named(out, place), only_writer(place), fresh_folder(place, own) as fresh:
        try:
            yield fresh
        except OutputError as exc:
            if not exc.path.is_relative_to(fresh):
                raise
            # The message names the file as the user will look for it.
            raise OutputError(out / exc.path.relative_to(fresh), exc.what, exc.fix) from None


@contextmanager
def output_table(out: Path, inputs: Iterable[Path] = ()) -> Iterator[None]:
    """Hold the table `out` while it is made. Raises OutputError before the block where it cannot be written."""
    place = _resolved(out)
    for path in inputs:
        if _same(place, Path(os.path.realpath(path))):
            raise OutputError(out, f"it is read as well ({path}) and would be lost.", "name another file.")
    found = f"it is {_kind(place)}, " if place.exists() and not place.is_file() else ""
    if found or place.suffix.lower() not in TABLE_ENDINGS:
        raise OutputError(
            out, f"{found}expected a table, its name ending in {' or '.join(TABLE_ENDINGS)}.", "name it error.csv, say."
        )
    if not place.parent.is_dir():
        raise OutputError(out, f"there is no folder {out.parent}.", "make it, or name another.")
    for path in (place.parent, *([place] if place.exists() else [])):
        if not os.access(path, os.W_OK):
            raise OutputError(out, "no right to write here.", "name another file, or change the rights.")
    with _named(out, place), only_writer(place):
        for left in unfinished(place):  # a run was killed
            left.unlink(missing_ok=True)
        yield


def _resolved(out: Path) -> Path:
    place = Path(os.path.realpath(out))
    try:
        place.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return place
    except OSError as exc:
        raise not_written(out, exc) from None
    if place.is_symlink():
        raise OutputError(out, "it is a link that leads back to itself.", "name another place.")
    return place


def _check_folder(out: Path, place: Path, inputs: Sequence[Path], own: Sequence[str]) -> None:
    if place.exists() and not place.is_dir():
        raise OutputError(out, f"it is {_kind(place)}, expected a folder.", "name a folder.")
    for path in inputs:
        _refuse_input(out, place, path, own)
    here = Path.cwd()
    if any(_same(place, path) for path in (here, *here.parents)) or os.path.ismount(place):
        raise OutputError(
            out,
            "a folder of results is exchanged as a whole, and this one cannot be: it is a disk, or the folder in which"
            " the command runs.",
            f"name a folder inside it, such as {out / 'results'}.",
        )
    if place.is_dir():
        _refuse_foreign(out, place)
    for path in (next(p for p in place.parents if p.exists()), *([place] if place.exists() else [])):
        if not path.is_dir():
            raise OutputError(out, f"{path} is {_kind(path)}, expected a folder.", "name another place.")
        if not os.access(path, os.W_OK | os.X_OK):
            raise OutputError(out, f"no right to write in {path}.", "name another place, or change the rights.")


def _refuse_input(out: Path, place: Path, path: Path, own: Sequence[str]) -> None:
    """The machine folder, what stands above it and its campaigns are no place for results; nor is a file's own name."""
    fix = "name another folder, such as results."
    if path.is_dir():
        if any(_same(place, above) for above in (path, *path.parents)):
            raise OutputError(out, f"it is or holds the folder that is read, {path}.", fix)
        root = next((above for above in place.parents if _same(above, path)), None)
        if root is not None and place.relative_to(root).parts[0].casefold() == "campaigns":
            raise OutputError(out, f"it lies among the campaigns that are read, in {path}.", fix)
    elif _same(path.parent, place) and any(fnmatchcase(path.name, pattern) for pattern in own):
        raise OutputError(out, f"{path.name} in it is read and would be replaced.", fix)


def _refuse_foreign(out: Path, place: Path) -> None:
    """Only a folder that is empty or holds results of thetacomp is exchanged."""
    try:
        names = sorted(entry.name for entry in os.scandir(place))
    except OSError as exc:
        raise not_written(out, exc) from None
    shown = [name for name in names if not name.startswith(".")]
    if shown and not set(shown) & set(PAGES):
        more = f" and {len(shown) - 3} more" if len(shown) > 3 else ""
        raise OutputError(
            out,
            f"it holds {', '.join(shown[:3])}{more}, but no results of thetacomp.",
            "name a new or an empty folder, so that nothing of yours is mixed with results.",
        )


@contextmanager
def _parents(out: Path, place: Path) -> Iterator[None]:
    """Make the folders above `place`; remove them again where nothing came of it."""
    made = [path for path in place.parents if not path.exists()]
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
    except OSError as exc:
        raise not_written(out, exc) from None
    try:
        yield
    except BaseException:
        for path in made:
            try:
                path.rmdir()
            except OSError:
                break
        raise


@contextmanager
def _named(out: Path, place: Path) -> Iterator[None]:
    """Messages about `place` name `out` instead, as the user wrote it."""
    try:
        yield
    except OutputError as exc:
        raise (OutputError(out, exc.what, exc.fix) if exc.path == place else exc) from None


def _same(a: Path, b: Path) -> bool:
    """Whether two paths lead to one place, however they are spelled; where one does not exist, by their text."""
    try:
        return os.path.samefile(a, b)
    except OSError:
        return os.path.normcase(a) == os.path.normcase(b)


def _kind(path: Path) -> str:
    mode = path.stat().st_mode
    return "a file" if stat.S_ISREG(mode) else "a folder" if stat.S_ISDIR(mode) else "a device"

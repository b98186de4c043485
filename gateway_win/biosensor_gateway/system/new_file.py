"""Creates files and folders atomically, without replacing existing ones, and temporary ones."""

from __future__ import annotations

import os
import shutil
import stat
import tempfile
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from biosensor_common.errors import GatewayError, cannot_write

_ANY_MODE = 0o666
_OWNER_MODE = 0o600


@contextmanager
def new_file(path: Path, like: Path) -> Generator[BinaryIO]:
    """Open a file for writing, which gets its name when the block ends without an error.

    Until then it has a temporary name in the same folder; after an error it is removed.

    Parameters
    ----------
    like
        A file whose read permissions the new one gets, on POSIX.

    Raises
    ------
    FileExistsError
        If *path* exists; it is not changed.
    OSError
        If the file cannot be written.
    """
    mode = stat.S_IMODE(like.stat().st_mode) & _ANY_MODE | _OWNER_MODE
    temporary = path.with_name(f"{path.name}.{os.getpid()}.part")
    # A killed process with the same id may have left one.
    temporary.unlink(missing_ok=True)
    try:
        with os.fdopen(_create(temporary, mode), "wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        _take_name(temporary, path, mode)
    finally:
        temporary.unlink(missing_ok=True)


def _take_name(made: Path, path: Path, mode: int) -> None:
    # A rename would replace a file that was created meanwhile; creating the target fails then.
    os.close(_create(path, mode))
    try:
        made.replace(path)
    except OSError:
        # On Windows, another program may have one of both open.
        path.unlink(missing_ok=True)
        raise


def _create(path: Path, mode: int) -> int:
    # Without O_BINARY, Windows translates line ends.
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
    return os.open(path, flags, mode)


@contextmanager
def temporary_disk(raised: Callable[[str], GatewayError]) -> Generator[None]:
    """Raise another error, which takes a sentence, where temporary files cannot be written."""
    try:
        yield
    except OSError as error:
        place = ""
        with suppress(OSError):  # there may be no folder for them at all
            place = f" to {tempfile.gettempdir()}"
        told = cannot_write(f"temporary files{place}", error)
        raise raised(f"{told}; the variable TMPDIR (on Windows TEMP) names the folder") from error


@contextmanager
def temporary_file(raised: Callable[[str], GatewayError]) -> Generator[BinaryIO]:
    """Open a file without a name, for reading and writing; see `temporary_disk`."""
    with temporary_disk(raised):
        file = tempfile.TemporaryFile()  # noqa: SIM115 - closed below
    try:
        yield file
    finally:
        # What could not be written has been told.
        with suppress(OSError):
            file.close()


_FOLDER_MODE = 0o755


@contextmanager
def new_place(path: Path, like: Path) -> Generator[Path]:
    """Yield a temporary path for a file or folder, moved to *path* at the end of the block.

    It has the same name, in a temporary folder next to *path*. After an error it is removed.

    Parameters
    ----------
    like
        A file whose read permissions the new files get, on POSIX.

    Raises
    ------
    FileExistsError
        If *path* exists; it is not changed.
    OSError
        If it cannot be written.
    """
    if os.path.lexists(path):
        raise FileExistsError(path)
    mode = stat.S_IMODE(like.stat().st_mode) & _ANY_MODE | _OWNER_MODE
    workshop = path.with_name(f"{path.name}.{os.getpid()}.part")
    # A killed process with the same id may have left one.
    shutil.rmtree(workshop, ignore_errors=True)
    workshop.mkdir(0o700)
    try:
        made = workshop / path.name
        yield made
        for file in _files(made):
            _finish(file, mode)
        if made.is_dir():
            made.chmod(_FOLDER_MODE & ~_umask() | _OWNER_MODE)
            # Fails if something but an empty folder was created there meanwhile.
            made.rename(path)
        else:
            _take_name(made, path, _OWNER_MODE)
    finally:
        shutil.rmtree(workshop, ignore_errors=True)


def _files(made: Path) -> Iterator[Path]:
    if not made.is_dir():
        yield made
        return
    for each in made.rglob("*"):
        if each.is_file():
            yield each


def _finish(file: Path, mode: int) -> None:
    """Set a file's mode, and wait until it is on the disk."""
    file.chmod(mode & ~_umask())
    with file.open("rb+") as opened:
        os.fsync(opened.fileno())


def _umask() -> int:
    mask = os.umask(0o077)
    os.umask(mask)
    return mask

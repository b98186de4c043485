"""Writes a file that is there whole or not at all, and never in the place of another."""

from __future__ import annotations

import os
import shutil
import stat
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

_ANY_MODE = 0o666
_OWNER_MODE = 0o600


@contextmanager
def new_file(path: Path, like: Path) -> Generator[BinaryIO]:
    """Open a file for writing, which gets its name when the block ends without an error.

    Until then it has another name in the same folder, and none after an error.

    Parameters
    ----------
    path
        Its name.
    like
        On POSIX, it can be read by nobody who cannot read that file.

    Raises
    ------
    FileExistsError
        Something has that name; it is as it was.
    OSError
        It cannot be written.
    """
    mode = stat.S_IMODE(like.stat().st_mode) & _ANY_MODE | _OWNER_MODE
    temporary = path.with_name(f"{path.name}.{os.getpid()}.part")
    # Of a process with this number that was killed here.
    temporary.unlink(missing_ok=True)
    try:
        with os.fdopen(_create(temporary, mode), "wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        # To move it would replace what somebody has put there meanwhile; this refuses.
        os.close(_create(path, mode))
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def _create(path: Path, mode: int) -> int:
    # Windows translates line ends unless it is told not to.
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
    return os.open(path, flags, mode)


_FOLDER_MODE = 0o755


@contextmanager
def new_place(path: Path, like: Path) -> Generator[Path]:
    """Give a path of the same name, of what becomes `path` when the block ends without an error.

    It is in another folder beside `path`, which is there only while the block runs.

    Parameters
    ----------
    path
        What is to be made.
    like
        On POSIX, it can be read by nobody who cannot read that file.

    Raises
    ------
    FileExistsError
        Something has that name; it is as it was.
    OSError
        It cannot be written.
    """
    if os.path.lexists(path):
        raise FileExistsError(path)
    mode = stat.S_IMODE(like.stat().st_mode) & _ANY_MODE | _OWNER_MODE
    workshop = path.with_name(f"{path.name}.{os.getpid()}.part")
    # Of a process with this number that was killed here.
    shutil.rmtree(workshop, ignore_errors=True)
    workshop.mkdir(0o700)
    try:
        made = workshop / path.name
        yield made
        for file in _files(made):
            _settle(file, mode)
        if made.is_dir():
            made.chmod(_FOLDER_MODE & ~_umask() | _OWNER_MODE)
            # Refuses all but an empty folder that somebody has put there meanwhile.
            made.rename(path)
        else:
            _move_file(made, path)
    finally:
        shutil.rmtree(workshop, ignore_errors=True)


def _files(made: Path) -> Iterator[Path]:
    if not made.is_dir():
        yield made
        return
    for each in made.rglob("*"):
        if each.is_file():
            yield each


def _settle(file: Path, mode: int) -> None:
    """Give a file its mode, and wait until it is on the disk."""
    file.chmod(mode & ~_umask())
    with file.open("rb+") as opened:
        os.fsync(opened.fileno())


def _umask() -> int:
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


def _move_file(made: Path, path: Path) -> None:
    # To move it would replace what somebody has put there meanwhile; this refuses.
    path.touch(_OWNER_MODE, exist_ok=False)
    made.replace(path)

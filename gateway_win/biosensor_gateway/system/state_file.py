"""Makes the state folder, and replaces files of it in one step: no reader sees half of one."""

from __future__ import annotations

import errno
import os
import time
from pathlib import Path

_TRIES = 5
_PAUSE_S = 0.01


def make_folder(folder: Path) -> None:
    """Make a folder with all above it; on POSIX nobody but the user can look into new ones.

    Names of people and what was recorded of them are in there, and computers of labs have other
    users.

    Raises
    ------
    OSError
        It cannot be made.
    """
    for each in reversed((folder, *folder.parents)):
        if not each.exists():
            each.mkdir(0o700, exist_ok=True)
    if not folder.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(folder))


def replace(path: Path, text: str, *, private: bool = False, durable: bool = False) -> None:
    """Put a text in the place of a file; what was there stays until the new one is whole.

    Parameters
    ----------
    path
        The file, which need not exist; its folder is made.
    text
        Written as UTF-8.
    private
        On POSIX, nobody but the user can read it at any time.
    durable
        It also survives a loss of power.

    Raises
    ------
    OSError
        It cannot be written; the old file is as it was.
    """
    make_folder(path.parent)
    temporary = path.with_name(f"{path.name}.{os.getpid()}")
    # Of a process with this number that was killed here; it may be open to everybody.
    temporary.unlink(missing_ok=True)
    mode = 0o600 if private else 0o666
    handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
            if durable:
                file.flush()
                os.fsync(file.fileno())
        _move(temporary, path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise


def read(path: Path) -> str:
    """Return the text of a file that another process may be replacing.

    Raises
    ------
    OSError
        It cannot be read.
    UnicodeDecodeError
        It is no UTF-8.
    """
    for _ in range(_TRIES - 1):
        try:
            return path.read_text(encoding="utf-8")
        except PermissionError:
            time.sleep(_PAUSE_S)
    return path.read_text(encoding="utf-8")


def _move(source: Path, target: Path) -> None:
    # Windows refuses for as long as a reader has the old file open.
    for _ in range(_TRIES - 1):
        try:
            source.replace(target)
        except PermissionError:
            time.sleep(_PAUSE_S)
        else:
            return
    source.replace(target)

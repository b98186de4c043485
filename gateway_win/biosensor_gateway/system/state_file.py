"""Creates the state folder, and replaces its files atomically."""

from __future__ import annotations

import errno
import os
import time
from pathlib import Path

_TRIES = 5
_PAUSE_S = 0.01


def make_folder(folder: Path) -> None:
    """Create a folder and its parents; on POSIX only the user can look into new ones.

    Raises
    ------
    OSError
        If it cannot be created.
    """
    # The folder can have names and data of people, and a lab's computers have several users.
    for each in reversed((folder, *folder.parents)):
        if not each.exists():
            each.mkdir(0o700, exist_ok=True)
    if not folder.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(folder))


def replace(path: Path, text: str, *, private: bool = False, durable: bool = False) -> None:
    """Replace a file's content atomically; the file need not exist, and its folder is created.

    Parameters
    ----------
    text
        Written as UTF-8.
    private
        On POSIX, only the user can read the file, at any time.
    durable
        Whether the new content must survive a loss of power.

    Raises
    ------
    OSError
        If the file cannot be written; its old content is still there.
    """
    make_folder(path.parent)
    temporary = path.with_name(f"{path.name}.{os.getpid()}")
    # A killed process with the same id may have left one, perhaps readable by everybody.
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
        If it cannot be read.
    UnicodeDecodeError
        If it is not UTF-8.
    """
    # Windows refuses to open a file while it is replaced.
    for _ in range(_TRIES - 1):
        try:
            return path.read_text(encoding="utf-8")
        except PermissionError:
            time.sleep(_PAUSE_S)
    return path.read_text(encoding="utf-8")


def _move(source: Path, target: Path) -> None:
    # Windows refuses while a reader has the old file open.
    for _ in range(_TRIES - 1):
        try:
            source.replace(target)
        except PermissionError:
            time.sleep(_PAUSE_S)
        else:
            return
    source.replace(target)

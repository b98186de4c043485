"""Writes a file that is there whole or not at all, and never in the place of another."""

from __future__ import annotations

import os
import stat
from collections.abc import Generator
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

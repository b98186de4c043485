"""Runs other programs: child processes that are watched, and system programs by their full path."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from os import PathLike
from pathlib import Path
from typing import IO, Any

LONGEST_DELAY_S = 30.0
STABLE_AFTER_S = 60.0
"""A process that ran for this long did not fail at its start, so the back-off starts again."""

# NO_WINDOW: creation flags of a child without a window, which does not receive our Ctrl-C.
# END_SIGNALS: what asks a process to end; whoever has a child passes that on to it.
if sys.platform == "win32":
    NO_WINDOW = subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW
    END_SIGNALS = (signal.SIGINT, signal.SIGBREAK)
else:
    NO_WINDOW = 0
    END_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

_CRASHES = 0xC0000000
"""Exit codes of Windows from this number on are errors that ended the program."""


def start(
    command: Sequence[str],
    *,
    stdin: int = subprocess.DEVNULL,
    stdout: int | IO[bytes] | None = subprocess.DEVNULL,
    stderr: int | IO[bytes] | None = subprocess.DEVNULL,
    env: Mapping[str, str] | None = None,
    cwd: PathLike[str] | None = None,
    pass_fds: Sequence[int] = (),
    bufsize: int = -1,
) -> subprocess.Popen[bytes]:
    """Start a child without a window and without this process's terminal; raises ``OSError``.

    A child that ends at the end of its stdin also ends if this process is killed: give it a pipe.
    """
    return subprocess.Popen(
        command,
        stdin=stdin,
        stdout=stdout,
        stderr=stderr,
        env=env,
        cwd=cwd,
        pass_fds=pass_fds,
        bufsize=bufsize,
        creationflags=NO_WINDOW,
        # Ctrl-C in the terminal is meant for this process only, which then shuts the child down.
        start_new_session=True,
    )


def send(process: subprocess.Popen[bytes], data: bytes) -> None:
    """Write to a child's stdin; do nothing if the child has ended."""
    assert process.stdin is not None
    with suppress(OSError):
        process.stdin.write(data)
        process.stdin.flush()


def close_input(process: subprocess.Popen[bytes]) -> None:
    """Ask a child to end by closing its stdin; do nothing if it has ended."""
    if process.stdin is not None:
        with suppress(OSError):
            process.stdin.close()


def wait_or_kill(process: subprocess.Popen[Any], limit_s: float) -> bool:
    """Wait for a child that was asked to end; return whether it had to be killed."""
    try:
        process.wait(limit_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return True
    return False


def ending_in_words(code: int) -> str:
    """Return a sentence for an exit code."""
    if code >= _CRASHES:
        # Windows documents its status codes as hexadecimal numbers, so that people find them.
        return f"crash {code:#010X}".replace("0X", "0x")
    if code >= 0:
        return f"exit code {code}"
    try:
        return f"killed by {signal.Signals(-code).name}"
    except ValueError:
        return f"killed by signal {-code}"


class Backoff:
    """Exponential back-off between the restarts of a child.

    Parameters
    ----------
    first_s
        Delay after the first failure; then 1 s, 2 s, 4 s, up to `LONGEST_DELAY_S`.
    """

    def __init__(self, first_s: float = 0.0) -> None:
        self._first_s = first_s
        self._last_s: float | None = None

    def next_s(self, lived_s: float) -> float:
        """Return the delay before the next start, given how long the last child ran."""
        if self._last_s is None or lived_s >= STABLE_AFTER_S:
            self._last_s = self._first_s
        else:
            self._last_s = min(max(1.0, 2 * self._last_s), LONGEST_DELAY_S)
        return self._last_s


TIME_LIMIT_S = 5.0
"""Time limit of a program."""

if sys.platform == "win32":
    import ctypes

    _LONGEST_PATH = 32768
    _SUFFIX = ".exe"

    def windows_folder(*, system: bool) -> Path:
        r"""Return the folder of Windows or of its programs (``System32``), ignoring variables.

        Raises
        ------
        OSError
            If Windows does not return it.
        """
        text = ctypes.create_unicode_buffer(_LONGEST_PATH)
        kernel = ctypes.windll.kernel32
        ask = kernel.GetSystemDirectoryW if system else kernel.GetSystemWindowsDirectoryW
        if not ask(text, _LONGEST_PATH):
            raise ctypes.WinError()
        return Path(text.value)

    def _folders() -> Iterator[Path]:
        yield windows_folder(system=True)

else:
    _SUFFIX = ""

    def _folders() -> Iterator[Path]:
        # An empty or relative entry means the current folder or one below it.
        entries = os.environ.get("PATH", os.defpath).split(os.pathsep)
        yield from (folder for folder in map(Path, entries) if folder.is_absolute())


def full_path(name: str) -> str | None:
    r"""Return the full path of a system program; None if it does not exist.

    On Windows only ``System32`` is searched. Elsewhere the folders of ``PATH`` are searched, but
    not those that depend on the current folder: a study's folder may contain a program that
    somebody else put there (CWE-427).
    """
    for folder in _folders():
        program = folder / f"{name}{_SUFFIX}"
        # Unlike Path.is_file, this does not raise for a folder that the user may not read.
        if os.path.isfile(program) and os.access(program, os.X_OK):  # noqa: PTH113
            return str(program)
    return None


def output_of(*command: str) -> str | None:
    """Return a program's output with any exit code; None if it does not exist or hangs."""
    ended = _ended(*command)
    return None if ended is None else ended.stdout


def succeeds(*command: str) -> bool | None:
    """Return whether a program's exit code is 0; None if it does not exist or hangs."""
    ended = _ended(*command)
    return None if ended is None else ended.returncode == 0


def _ended(*command: str) -> subprocess.CompletedProcess[str] | None:
    path = full_path(command[0])
    if path is None:
        return None
    try:
        return subprocess.run(
            [path, *command[1:]],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            errors="replace",
            timeout=TIME_LIMIT_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None

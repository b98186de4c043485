"""A terminal that takes no output: nobody reads its other end, or it was stopped by Ctrl-S."""

from __future__ import annotations

import contextlib
import os
import select
import subprocess
import termios
import threading
import tty
from collections.abc import Generator, Mapping, Sequence

_BLOCK = 1 << 16


class HeldConsole:
    """The terminal of one program; whoever writes to it waits until it is released.

    Parameters
    ----------
    is_stopped
        It was stopped by its user; otherwise it is full as soon as the kernel's buffer is.
    """

    def __init__(self, *, is_stopped: bool) -> None:
        self._ours, self._terminal = os.openpty()
        tty.setraw(self._terminal)
        self._is_stopped = is_stopped
        if is_stopped:
            termios.tcflow(self._terminal, termios.TCOOFF)
        self._shown = bytearray()
        self._reader = threading.Thread(target=self._read, daemon=True)

    @contextlib.contextmanager
    def program(
        self, command: Sequence[str], environment: Mapping[str, str]
    ) -> Generator[subprocess.Popen[bytes]]:
        """Run a program there; whatever becomes of it, it is gone in the end."""
        process = subprocess.Popen(
            command,
            stdin=self._terminal,
            stdout=self._terminal,
            stderr=self._terminal,
            env=environment,
        )
        try:
            yield process
        finally:
            process.kill()
            process.wait()
            os.close(self._terminal)
            os.close(self._ours)

    @property
    def takes_output(self) -> bool:
        """Whether a program could write now without waiting."""
        return bool(select.select([], [self._terminal], [], 0)[1])

    def release(self) -> None:
        """Show everything from now on."""
        if self._is_stopped:
            termios.tcflow(self._terminal, termios.TCOON)
        self._reader.start()

    @property
    def shown(self) -> str:
        """What came since it was released."""
        return bytes(self._shown).decode()

    def _read(self) -> None:
        with contextlib.suppress(OSError):
            while block := os.read(self._ours, _BLOCK):
                self._shown += block

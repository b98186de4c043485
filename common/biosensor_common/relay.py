"""Relays this process's stdout and stderr, so that no writer is ever blocked.

liblsl, rcutils and DDS write directly to the file descriptors, some while they hold a lock or
Python's GIL: a blocked terminal would then block all their threads.
"""

from __future__ import annotations

import contextlib
import faulthandler
import io
import os
import sys
import threading
import time
from collections.abc import Callable, Generator, Sequence

from biosensor_common.outflow import Outflow

STDOUT, STDERR = 1, 2
# Time limit for the last lines when the process ends.
LAST_LINES_S = 1.0
_PIPE_BYTES = 1 << 20
_BLOCK = 1 << 16
_ASK_AGAIN_S = 0.05


def console(descriptor: int, name: str) -> Outflow | None:
    """Duplicate the output of a descriptor; None if it has none, as in a windowed program."""
    try:
        # A raw file has neither a buffer nor a lock, and writes Unicode to a Windows console.
        output = open(os.dup(descriptor), "wb", buffering=0)  # noqa: PTH123, SIM115 - no path
    except OSError:
        return None
    return Outflow(name, lambda lines: write_all(output.write, lines), end=output.close)


def write_all(write: Callable[[memoryview], int | None], data: bytes | memoryview) -> None:
    """Write all data to an unbuffered output, which may accept only a part at a time."""
    left = memoryview(data)
    while left:
        written = write(left)
        if written is None:
            # Another program that shares the terminal has made it non-blocking.
            time.sleep(_ASK_AGAIN_S)
        else:
            left = left[written:]


class Relay:
    """Reads from a redirected descriptor in a thread, and passes the lines to an `Outflow`.

    The descriptor is replaced by a non-blocking pipe, which drops data when it is full.

    Parameters
    ----------
    descriptor
        1 or 2; the outflow must write to its original output through another descriptor.
    outflow
        Receives the lines; may have other sources, too.
    """

    def __init__(self, descriptor: int, outflow: Outflow) -> None:
        self._descriptor, self._outflow = descriptor, outflow
        self._real = os.dup(descriptor)
        self._reading, writing = os.pipe()
        _never_wait(writing)
        _lead(descriptor, writing)
        os.close(writing)
        if descriptor == STDERR and faulthandler.is_enabled():
            # faulthandler writes to the original output: after a crash no thread reads the pipe.
            faulthandler.enable(self._real)
        self._thread = threading.Thread(
            target=self._read, name=f"from descriptor {descriptor}", daemon=True
        )
        self._thread.start()

    def close(self, limit_s: float) -> None:
        """Restore the descriptor, or redirect it to nowhere if its output stays blocked.

        Later writes can therefore not block, either.
        """
        if self._outflow.flush(limit_s):
            _lead(self._descriptor, self._real)
        else:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            _lead(self._descriptor, nowhere)
            os.close(nowhere)
        # The thread has ended, unless a child process still has the pipe open.
        self._thread.join(limit_s)

    def _read(self) -> None:
        while block := os.read(self._reading, _BLOCK):
            self._outflow.put(block)


@contextlib.contextmanager
def relayed(relays: Sequence[tuple[int, Outflow | None]]) -> Generator[None]:
    """Relay the descriptors that have an outflow, and close the outflows at the end."""
    begun = [Relay(descriptor, outflow) for descriptor, outflow in relays if outflow]
    try:
        yield
    finally:
        deadline = time.monotonic() + LAST_LINES_S
        for relay in begun:
            relay.close(max(0.0, deadline - time.monotonic()))
        for _, outflow in relays:
            if outflow:
                outflow.close(max(0.0, deadline - time.monotonic()))


def console_relayed() -> contextlib.AbstractContextManager[None]:
    """Relay stdout and stderr in the context, so that the console cannot block this process."""
    return relayed([(each, console(each, "console")) for each in (STDOUT, STDERR)])


def _never_wait(pipe: int) -> None:
    if sys.platform == "linux":
        import fcntl  # noqa: PLC0415 - exists there only

        # The user's limit may be lower; the default size is enough, too.
        with contextlib.suppress(OSError):
            fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
    # On Windows, pipes can be non-blocking from Python 3.12 on; before, the reader must keep up.
    if sys.platform != "win32" or sys.version_info >= (3, 12):
        os.set_blocking(pipe, False)


def _lead(descriptor: int, target: int) -> None:
    os.dup2(target, descriptor)
    if sys.platform == "win32":
        # Python's object for a Windows console can write to nothing else, and a file object cannot
        # write to a console, so it has to be replaced.
        name = "stdout" if descriptor == STDOUT else "stderr"
        before = getattr(sys, name)
        if isinstance(before, io.TextIOWrapper):
            again = open(  # noqa: SIM115 - no path
                descriptor,
                "w",
                encoding=before.encoding,
                errors=before.errors,
                buffering=1,
                closefd=False,
            )
            setattr(sys, name, again)

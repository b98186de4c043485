"""Relays what this process writes to its stdout and stderr, so that no writer ever waits.

liblsl, rcutils and DDS write to the descriptors themselves, some with a lock or Python's GIL
held: with a terminal that takes nothing, all their threads stand still.
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
# How long the last lines may take when the process ends.
LAST_LINES_S = 1.0
_PIPE_BYTES = 1 << 20
_BLOCK = 1 << 16
_ASK_AGAIN_S = 0.05


def console(descriptor: int, name: str) -> Outflow | None:
    """Open the output behind a descriptor again; None if there is none, as in a window."""
    try:
        # Neither buffer nor lock; on Windows, it writes Unicode to a console.
        output = open(os.dup(descriptor), "wb", buffering=0)  # noqa: PTH123, SIM115 - no path
    except OSError:
        return None
    return Outflow(name, lambda lines: write_all(output.write, lines), end=output.close)


def write_all(write: Callable[[memoryview], int | None], data: bytes | memoryview) -> None:
    """Write to an unbuffered output, which may take a part at a time."""
    left = memoryview(data)
    while left:
        written = write(left)
        if written is None:
            # Another program that shares the terminal has made it non-blocking.
            time.sleep(_ASK_AGAIN_S)
        else:
            left = left[written:]


class Relay:
    """Reads in a thread what is written to a descriptor, and hands it to an `Outflow`.

    The descriptor becomes a pipe that takes what it can and never lets a writer wait.

    Parameters
    ----------
    descriptor
        1 or 2; what it leads to, the outflow must write to by another descriptor.
    outflow
        Takes what is written. It may have other sources.
    """

    def __init__(self, descriptor: int, outflow: Outflow) -> None:
        self._descriptor, self._outflow = descriptor, outflow
        self._real = os.dup(descriptor)
        self._reading, writing = os.pipe()
        _never_wait(writing)
        _lead(descriptor, writing)
        os.close(writing)
        if descriptor == STDERR and faulthandler.is_enabled():
            # In a crash there is no thread left to read.
            faulthandler.enable(self._real)
        self._thread = threading.Thread(
            target=self._read, name=f"from descriptor {descriptor}", daemon=True
        )
        self._thread.start()

    def close(self, limit_s: float) -> None:
        """Lead the descriptor back, or nowhere if what it leads to takes nothing within the limit.

        So whatever is written later cannot wait, either.
        """
        if self._outflow.flush(limit_s):
            _lead(self._descriptor, self._real)
        else:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            _lead(self._descriptor, nowhere)
            os.close(nowhere)
        # It has come to its end, unless a program that we have started holds the pipe.
        self._thread.join(limit_s)

    def _read(self) -> None:
        while block := os.read(self._reading, _BLOCK):
            self._outflow.put(block)


@contextlib.contextmanager
def relayed(relays: Sequence[tuple[int, Outflow | None]]) -> Generator[None]:
    """Relay descriptors for a while, and close their outflows; one without is left alone."""
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
    """Let nothing in this process wait for the console while the context lasts."""
    return relayed([(each, console(each, "console")) for each in (STDOUT, STDERR)])


def _never_wait(pipe: int) -> None:
    if sys.platform == "linux":
        import fcntl  # noqa: PLC0415 - exists there only

        # The user's limit may be lower; the usual size does, too.
        with contextlib.suppress(OSError):
            fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
    # Windows' pipes know it from Python 3.12 on; before, the reader has to be fast enough.
    if sys.platform != "win32" or sys.version_info >= (3, 12):
        os.set_blocking(pipe, False)


def _lead(descriptor: int, target: int) -> None:
    os.dup2(target, descriptor)
    if sys.platform == "win32":
        # Python's own object for a console cannot write to anything else, and the reverse.
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

"""Writes lines to outputs that may block for a while, and relays stdout and stderr to them.

Ctrl-S, a selection in a Windows console or a stalled network blocks a terminal, and a disk may
hang. A thread that wrote to it directly would be blocked for as long. liblsl, rcutils and DDS write
directly to the file descriptors, some while they hold a lock or Python's GIL: a blocked terminal
would then block all their threads.
"""

from __future__ import annotations

import contextlib
import faulthandler
import io
import os
import re
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Sequence

MOST_BYTES = 1_000_000


def missing(count: int, name: str) -> str:
    """Return the sentence about lines that were dropped because the output was blocked."""
    lines = "line is" if count == 1 else "lines are"
    return f"{count} {lines} missing here: the {name} accepted no output"


class NonblockingWriter:
    """A bounded queue of lines that a separate thread writes; all methods are thread-safe.

    The thread may block in a write forever. It is a daemon, so that the process can exit
    meanwhile. ``write`` must therefore use nothing that the interpreter waits for at its exit,
    such as the locks of buffered files.

    Parameters
    ----------
    name
        Name of the output, for instance "console".
    write
        Writes whole lines to the output. Lines are dropped if it raises ``OSError``, or the
        ``ValueError`` of a closed file.
    end
        Called in the thread after the last line.
    most_bytes
        Limit of the queue; lines that do not fit are dropped and counted.

    Attributes
    ----------
    notice
        Returns the line that replaces a number of dropped ones. It must not call this object.
    shape
        Transforms the queued lines before they are written, in the thread.
    """

    def __init__(
        self,
        name: str,
        write: Callable[[bytes], object],
        *,
        end: Callable[[], object] = lambda: None,
        most_bytes: int = MOST_BYTES,
    ) -> None:
        self.name = name
        self.notice: Callable[[int], bytes] = self._plain_notice
        self.shape: Callable[[bytes], bytes] = lambda lines: lines
        self._write, self._end = write, end
        self._most_bytes = most_bytes
        # Reentrant, because a signal handler may log in the middle of a call.
        self._changed = threading.Condition()
        self._waiting: deque[bytes] = deque()
        self._waiting_bytes = self._left_out = 0
        self._write_began_s: float | None = None
        self._deadline_s: float | None = None
        self._thread = threading.Thread(target=self._run, name=f"to the {name}", daemon=True)
        self._thread.start()

    def put(self, lines: bytes) -> None:
        """Queue lines without waiting. After `close` they are lost."""
        with self._changed:
            # A queue that was full must first be half empty, or every other line would be a notice.
            room = self._most_bytes // (2 if self._left_out else 1)
            if self._waiting and self._waiting_bytes + len(lines) > room:
                self._left_out += max(1, lines.count(b"\n"))
                return
            if self._left_out:
                self._append(self._take_notice())
            self._append(lines)
            self._changed.notify_all()

    def put_if_idle(self, lines: bytes) -> bool:
        """Queue lines only if the queue is empty; dropped lines are not counted.

        For lines that are soon outdated. Empty lines let `shape` add its own.
        """
        with self._changed:
            if not self._is_idle():
                return False
            self._append(lines)
            self._changed.notify_all()
            return True

    @property
    def is_behind(self) -> bool:
        """Whether further lines are waiting while some are being written."""
        return bool(self._waiting)

    @property
    def held_for_s(self) -> float:
        """Duration of the present write in s; 0 if nothing is being written."""
        began = self._write_began_s
        return 0.0 if began is None else time.monotonic() - began

    def flush(self, limit_s: float) -> bool:
        """Wait until all lines are written or the time is over; return whether they are written."""
        with self._changed:
            return self._changed.wait_for(self._is_idle, limit_s)

    def close(self, limit_s: float) -> bool:
        """End the thread after the last line, and wait for it; return whether it has ended.

        Only the first call's limit counts, so that later calls do not wait again.
        """
        with self._changed:
            if self._deadline_s is None:
                self._deadline_s = time.monotonic() + limit_s
            self._changed.notify_all()
        self._thread.join(max(0.0, self._deadline_s - time.monotonic()))
        return not self._thread.is_alive()

    def _is_idle(self) -> bool:
        return not self._waiting and not self._left_out and self._write_began_s is None

    def _append(self, lines: bytes) -> None:
        self._waiting.append(lines)
        self._waiting_bytes += len(lines)

    def _take_notice(self) -> bytes:
        count, self._left_out = self._left_out, 0
        return self.notice(count)

    def _plain_notice(self, count: int) -> bytes:
        return f"[{missing(count, self.name)}]\n".encode()

    def _run(self) -> None:
        while (lines := self._next()) is not None:
            try:
                self._write(self.shape(lines))
            except (OSError, ValueError):
                # The output is gone or closed, so the error cannot be reported there, either.
                continue
        self._end()

    def _next(self) -> bytes | None:
        """Wait for lines and return them; None at the end."""
        with self._changed:
            self._write_began_s = None
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._waiting or self._left_out or self._deadline_s)
            if self._waiting:
                lines = self._waiting.popleft()
                self._waiting_bytes -= len(lines)
            elif self._left_out:
                lines = self._take_notice()
            else:
                return None
            self._write_began_s = time.monotonic()
            return lines


STDOUT, STDERR = 1, 2
# Time limit for the last lines when the process ends.
LAST_LINES_S = 1.0
_PIPE_BYTES = 1 << 20
_BLOCK = 1 << 16
_ASK_AGAIN_S = 0.05
# Of IPv4: without IPv6 alone, others find the streams all the same.
_NO_MULTICAST = re.compile(rb"Couldn't create multicast responder for \d+\.")
NO_NETWORK = (
    b"LSL cannot use multicast here, as without a network: other computers may not find the "
    b"streams of this one\n"
)


def console(descriptor: int, name: str) -> NonblockingWriter | None:
    """Return a writer to a file descriptor; None if that is not open, as in a windowed program."""
    try:
        # A raw file has neither a buffer nor a lock, and writes Unicode to a Windows console.
        output = open(os.dup(descriptor), "wb", buffering=0)  # noqa: PTH123, SIM115 - no path
    except OSError:
        return None
    return NonblockingWriter(name, lambda lines: write_all(output.write, lines), end=output.close)


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
    """Reads from a redirected descriptor in a thread, and passes the lines to a writer.

    The descriptor is replaced by a non-blocking pipe, which drops data when it is full.

    Parameters
    ----------
    descriptor
        1 or 2; the writer must write to its original output through another descriptor.
    writer
        Receives the lines; may have other sources, too.
    """

    def __init__(self, descriptor: int, writer: NonblockingWriter) -> None:
        self._descriptor, self._writer = descriptor, writer
        self._real = os.dup(descriptor)
        self._reading, writing = os.pipe()
        _never_wait(writing)
        _lead(descriptor, writing)
        os.close(writing)
        if descriptor == STDERR and faulthandler.is_enabled():
            # faulthandler writes to the original output: after a crash no thread reads the pipe.
            faulthandler.enable(self._real)
        self._has_told_no_network = False
        self._thread = threading.Thread(
            target=self._read, name=f"from descriptor {descriptor}", daemon=True
        )
        self._thread.start()

    def close(self, limit_s: float) -> None:
        """Restore the descriptor, or redirect it to nowhere if its output stays blocked.

        Later writes can therefore not block, either.
        """
        if self._writer.flush(limit_s):
            _lead(self._descriptor, self._real)
        else:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            _lead(self._descriptor, nowhere)
            os.close(nowhere)
        # The thread has ended, unless a child process still has the pipe open.
        self._thread.join(limit_s)

    def _read(self) -> None:
        while block := os.read(self._reading, _BLOCK):
            lines = self._without_repeats(block)
            if lines:
                self._writer.put(lines)

    def _without_repeats(self, block: bytes) -> bytes:
        """Replace liblsl's lines about multicast, three for each outlet, by one sentence."""
        if not _NO_MULTICAST.search(block):
            return block
        kept: list[bytes] = []
        for line in block.splitlines(keepends=True):
            if not _NO_MULTICAST.search(line):
                kept.append(line)
            elif not self._has_told_no_network:
                self._has_told_no_network = True
                kept.append(NO_NETWORK)
        return b"".join(kept)


@contextlib.contextmanager
def relayed(relays: Sequence[tuple[int, NonblockingWriter | None]]) -> Generator[None]:
    """Relay the descriptors that have an writer, and close the writers at the end."""
    begun = [Relay(descriptor, writer) for descriptor, writer in relays if writer]
    try:
        yield
    finally:
        deadline = time.monotonic() + LAST_LINES_S
        for relay in begun:
            relay.close(max(0.0, deadline - time.monotonic()))
        for _, writer in relays:
            if writer:
                writer.close(max(0.0, deadline - time.monotonic()))


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

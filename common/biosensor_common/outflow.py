"""Queues lines for an output that may block for a while.

Ctrl-S, a selection in a Windows console or a stalled network blocks a terminal, and a disk may
hang. A thread that wrote to it directly would be blocked for as long.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable

MOST_BYTES = 1_000_000


def missing(count: int, name: str) -> str:
    """Return the sentence about lines that were dropped because the output was blocked."""
    lines = "line is" if count == 1 else "lines are"
    return f"{count} {lines} missing here: the {name} took no output"


class Outflow:
    """A bounded queue of lines that a separate thread writes; all methods are thread-safe.

    The thread may block in a write for ever. It is a daemon, so that the process can exit
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
        """Whether lines are waiting besides those that are being written."""
        return bool(self._waiting)

    @property
    def held_for_s(self) -> float:
        """For how many seconds the present write has lasted; 0 if nothing is being written."""
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

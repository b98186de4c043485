"""Queues lines for an output that may take none for a while.

A terminal stops taking output by Ctrl-S, by a selection in a Windows console or by a
network that stalls, a disk by hanging. Whoever writes then waits for as long as it lasts.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable

MOST_BYTES = 1_000_000


def missing(count: int, name: str) -> str:
    """Return the sentence about lines that an output could not take."""
    lines = "line is" if count == 1 else "lines are"
    return f"{count} {lines} missing here: the {name} took no output"


class Outflow:
    """A bounded queue of lines, written by a thread of its own; all may be called by any thread.

    The thread may wait in a write for ever. It is a daemon, so a process can end meanwhile:
    ``write`` must use nothing that the end of the interpreter waits for, such as the locks of
    buffered files.

    Parameters
    ----------
    name
        What the output is called, "console" for instance.
    write
        Writes whole lines to the output. What it refuses by an ``OSError``, or by the
        ``ValueError`` of a closed file, is given up.
    end
        Called in the thread after the last line.
    most_bytes
        How much may wait; what does not fit is left out and counted.

    Attributes
    ----------
    notice
        Makes the line that takes the place of so many others. It must not call this object.
    shape
        Makes what is written of what was put, in the thread; it may keep some back, or add.
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
        # Reentrant: a signal handler may log in the middle of a call.
        self._changed = threading.Condition()
        self._waiting: deque[bytes] = deque()
        self._waiting_bytes = self._left_out = 0
        self._write_began_s: float | None = None
        self._deadline_s: float | None = None
        self._thread = threading.Thread(target=self._run, name=f"to the {name}", daemon=True)
        self._thread.start()

    def put(self, lines: bytes) -> None:
        """Have lines written soon; never waits. After `close` they are lost."""
        with self._changed:
            # Once it was full it has to be half empty, or every other line would be a notice.
            room = self._most_bytes // (2 if self._left_out else 1)
            if self._waiting and self._waiting_bytes + len(lines) > room:
                self._left_out += max(1, lines.count(b"\n"))
                return
            if self._left_out:
                self._append(self._take_notice())
            self._append(lines)
            self._changed.notify_all()

    def put_if_idle(self, lines: bytes) -> bool:
        """Have lines written now, or leave them out, uncounted, if anything else is waiting.

        For what is soon outdated. Of empty lines `shape` may make something.
        """
        with self._changed:
            if not self._is_idle():
                return False
            self._append(lines)
            self._changed.notify_all()
            return True

    @property
    def is_behind(self) -> bool:
        """Whether there is more to write than what is being written."""
        return bool(self._waiting)

    @property
    def held_for_s(self) -> float:
        """How long the output has been taking what it takes now; 0 if nothing is being written."""
        began = self._write_began_s
        return 0.0 if began is None else time.monotonic() - began

    def flush(self, limit_s: float) -> bool:
        """Wait until all is written, at most so long; return whether it is."""
        with self._changed:
            return self._changed.wait_for(self._is_idle, limit_s)

    def close(self, limit_s: float) -> bool:
        """End the thread after the last line, and wait for it; return whether it has ended.

        Only the limit of the first call counts, so whoever comes later does not wait again.
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
                # Its reader has gone, or it was closed; there is nobody to tell here.
                continue
        self._end()

    def _next(self) -> bytes | None:
        """Wait for lines; None at the end."""
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

"""Ends a process within a time limit, even if some of its threads hang."""

from __future__ import annotations

import os
import threading
from contextlib import suppress

END_S = 5.0
"""How long a program may take to exit by itself."""
_STDERR = 2


def end_within(limit_s: float = END_S, code: int = 1) -> None:
    """End this process with an exit code after a time limit, unless it has exited by then.

    At its exit the interpreter waits for every thread, also for one that hangs in a library.
    """
    timer = threading.Timer(limit_s, _end, [limit_s, code])
    timer.daemon = True
    timer.start()


def _end(limit_s: float, code: int) -> None:
    sentence = f"it has not ended by itself within {limit_s:g} s, so it is ended now\n"
    # The reader of stderr may be gone.
    with suppress(OSError):
        os.write(_STDERR, sentence.encode())
    os._exit(code)

"""Ends a process that was asked to end, whatever its threads wait for."""

from __future__ import annotations

import os
import threading
from contextlib import suppress

END_S = 5.0
"""How long a program may take to end by itself."""
_STDERR = 2


def end_within(limit_s: float = END_S) -> None:
    """End this process after so long, with exit code 1, unless it has ended by then.

    A thread that hangs in a library would be waited for without a limit at the end.
    """
    timer = threading.Timer(limit_s, _end, [limit_s])
    timer.daemon = True
    timer.start()


def _end(limit_s: float) -> None:
    sentence = f"it has not ended by itself within {limit_s:g} s, so it is ended now\n"
    # Whoever reads it may be gone.
    with suppress(OSError):
        os.write(_STDERR, sentence.encode())
    os._exit(1)

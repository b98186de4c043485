"""Measures time that a machine was free to use: where others work, too, that is less.

A figure that is required, such as "within two seconds of the start", is one of a machine
that has processors to give. While programs wait for one, the clock goes on and nothing
moves; Linux tells for how long that was (``/proc/pressure/cpu``).
"""

from __future__ import annotations

import re
import time
from pathlib import Path

_PRESSURE = Path("/proc/pressure/cpu")
_STALLED_US = re.compile(r"^some .*total=(\d+)$", re.MULTILINE)


class Stopwatch:
    """Runs from when it is made."""

    def __init__(self) -> None:
        self._begin_s, self._stalled_s = time.monotonic(), _stalled_s()

    def elapsed_s(self) -> float:
        """Seconds since then."""
        return time.monotonic() - self._begin_s

    def free_s(self) -> float:
        """Those of them in which no program waited for a processor.

        On a kernel that does not say it, all of them.
        """
        # The two are read one after the other.
        return max(0.0, self.elapsed_s() - self.stalled_s())

    def stalled_s(self) -> float:
        """Seconds in which one waited."""
        return _stalled_s() - self._stalled_s


def _stalled_s() -> float:
    try:
        found = _STALLED_US.search(_PRESSURE.read_text(encoding="ascii"))
    except OSError:
        return 0.0
    return int(found[1]) / 1e6 if found else 0.0

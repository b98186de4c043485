"""Logs through rclpy without flooding the log."""

from __future__ import annotations

import threading
from time import monotonic

from rclpy.logging import RcutilsLogger

SAME_AGAIN_S = 60.0
BURST, BURST_S = 200, 10.0


class LimitedLog:
    """Logs each sentence at most once a minute, and at most 200 of them in 10 s.

    Suppressed lines are counted, and the next line has their number. Thread-safe.
    """

    def __init__(self, logger: RcutilsLogger) -> None:
        self._logger = logger
        self._lock = threading.Lock()
        self._said: dict[str, float] = {}
        self._held_back = 0

    def warn(self, sentence: str) -> None:
        """Log a warning, or count it as suppressed."""
        text = self._admit(sentence)
        if text:
            self._logger.warning(text)

    def inform(self, sentence: str) -> None:
        """Log a line at level INFO, or count it as suppressed."""
        text = self._admit(sentence)
        if text:
            self._logger.info(text)

    def _admit(self, sentence: str) -> str:
        """Return the line to log; empty if it is suppressed."""
        with self._lock:
            now = monotonic()
            self._said = {old: at for old, at in self._said.items() if now - at < SAME_AGAIN_S}
            recent = sum(now - at < BURST_S for at in self._said.values())
            if sentence in self._said or recent >= BURST:
                self._held_back += 1
                return ""
            self._said[sentence] = now
            more, self._held_back = self._held_back, 0
        return sentence + (f" ({more} lines were suppressed)" if more else "")

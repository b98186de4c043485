"""Logs through rclpy without flooding the log."""

from __future__ import annotations

import threading
from time import monotonic

from rclpy.logging import RcutilsLogger

SAME_AGAIN_S = 60.0
BURST, BURST_S = 200, 10.0


class LimitedLog:
    """Says each sentence once a minute, and no more than 200 of them in 10 s.

    What is held back is counted and said with the next one that goes out. May be
    called by any thread.
    """

    def __init__(self, logger: RcutilsLogger) -> None:
        self._logger = logger
        self._lock = threading.Lock()
        self._said: dict[str, float] = {}
        self._held_back = 0

    def warn(self, sentence: str) -> None:
        """Log a warning, or count it as held back."""
        text = self._admit(sentence)
        if text:
            self._logger.warning(text)

    def inform(self, sentence: str) -> None:
        """Log what is no warning, or count it as held back."""
        text = self._admit(sentence)
        if text:
            self._logger.info(text)

    def _admit(self, sentence: str) -> str:
        """Return what to say, empty if it is held back."""
        with self._lock:
            now = monotonic()
            self._said = {old: at for old, at in self._said.items() if now - at < SAME_AGAIN_S}
            recent = sum(now - at < BURST_S for at in self._said.values())
            if sentence in self._said or recent >= BURST:
                self._held_back += 1
                return ""
            self._said[sentence] = now
            more, self._held_back = self._held_back, 0
        return sentence + (f" ({more} lines were held back)" if more else "")

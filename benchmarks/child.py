"""How a measuring process talks with the parent that started it: by lines."""

from __future__ import annotations

import sys
import threading
from queue import Empty, SimpleQueue


def say(word: str) -> None:
    """Tell the parent."""
    sys.stdout.write(f"{word}\n")
    sys.stdout.flush()


class Orders:
    """What the parent says."""

    def __init__(self) -> None:
        self.closed = threading.Event()  # Set when the parent closes the pipe, which means: finish.
        self._lines: SimpleQueue[str] = SimpleQueue()
        threading.Thread(target=self._read, daemon=True).start()

    def poll(self) -> str | None:
        """Return the next order, None if there is none at present."""
        try:
            return self._lines.get_nowait()
        except Empty:
            return None

    def _read(self) -> None:
        for line in sys.stdin:
            self._lines.put(line.strip())
        self.closed.set()

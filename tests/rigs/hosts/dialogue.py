"""Programs that are steered by lines of JSON: each line of standard input is answered by one."""

from __future__ import annotations

import json
import queue
import sys
import threading
from collections.abc import Callable, Mapping
from typing import Any

Obey = Callable[[Mapping[str, Any]], Any]
"""Carries out one command; what it returns is the answer."""


class Dialogue:
    """The steered side; commands are carried out in the thread that calls `answer`."""

    def __init__(self) -> None:
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._ended = threading.Event()
        threading.Thread(target=self._read, daemon=True).start()

    @property
    def ended(self) -> bool:
        """Whether nobody will command any more."""
        return self._ended.is_set()

    def answer(self, obey: Obey) -> None:
        """Carry out the commands that have come; an error is an answer, too."""
        while not self._lines.empty():
            try:
                answer = {"answer": obey(json.loads(self._lines.get()))}
            except Exception as error:  # noqa: BLE001 - whoever gave the command gets its error
                answer = {"error": f"{type(error).__name__}: {error}"}
            print(json.dumps(answer), flush=True)

    def _read(self) -> None:
        for line in sys.stdin:
            self._lines.put(line)
        self._ended.set()

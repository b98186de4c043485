"""A log that is opened when there is time for it: its libraries take half a second to import."""

from __future__ import annotations

import contextlib
from pathlib import Path
from types import TracebackType
from typing import Self


class LaterLog:
    """A `StartLog` that is opened on request, or when something fails; a context manager.

    Parameters
    ----------
    folder
        Where the file goes.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._is_open = False
        self._stack = contextlib.ExitStack()

    def open(self) -> None:
        """Log to the file and to the console from now on."""
        from biosensor_gateway.cli.start_log import StartLog  # takes half a second
        from biosensor_gateway.settings.models import LogSettings

        self._is_open = True
        log = self._stack.enter_context(StartLog(self._folder))
        log.go_on(LogSettings(), verbose=False, title=str)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if isinstance(error, Exception) and not self._is_open:
            self.open()
        self._stack.__exit__(kind, error, trace)

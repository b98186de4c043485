"""Writes into the log file why a run did not come about, whatever became of its window."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self

import structlog
import typer

from biosensor_common.errors import ConfigError, GatewayError
from biosensor_gateway.settings.models import LogSettings
from biosensor_gateway.system.logs import configure_logs, end_logs, log_to_file_alone

_log = structlog.get_logger("biosensor_gateway.cli")


class StartLog:
    """Opens the log file before the settings are read; a context manager.

    What leaves the context is logged to the file: an error of ours as its sentence, any other
    with its traceback. The console is the caller's.

    Parameters
    ----------
    folder
        Where the file goes.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._problem: ConfigError | None = None

    def __enter__(self) -> Self:
        try:
            log_to_file_alone(self._folder)
        except ConfigError as error:
            self._problem = error
        return self

    def go_on(self, settings: LogSettings, *, verbose: bool, title: Callable[[str], str]) -> None:
        """Log as the settings want it, to the console as well; see `configure_logs`."""
        if self._problem is None:
            try:
                configure_logs(settings, self._folder, verbose=verbose, title=title)
            except ConfigError as error:
                self._problem = error
        if self._problem is not None:
            # Recording goes on without a log file; it does not go on unsaid.
            configure_logs(settings, None, verbose=verbose, title=title)
            _log.warning(str(self._problem))

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._problem is None and isinstance(error, Exception):
            self._note(error)
        end_logs()

    def _note(self, error: Exception) -> None:
        if isinstance(error, typer.Exit | typer.Abort):
            return
        try:
            # The agent may have come to its end before, and its log with it.
            log_to_file_alone(self._folder)
        except ConfigError:
            return
        if isinstance(error, GatewayError):
            _log.error(str(error), reason=str(error.reason.value))
        else:
            _log.error("the agent failed", exc_info=error)

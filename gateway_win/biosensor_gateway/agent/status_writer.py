"""Keeps the status file up to date for as long as the agent runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import structlog

from biosensor_gateway.agent import status_file

UNWRITTEN_REPORTS = 3
"""After so many in a row that were refused, the log says so."""

_log = structlog.get_logger("biosensor_gateway.agent")


class StatusWriter:
    """Writes the status of devices, and says in the log once that it cannot.

    Parameters
    ----------
    folder
        Where the file goes.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._refused = 0
        self._said = False

    def write(self, status: dict[str, Any]) -> None:
        """Replace the file; what cannot be written now is written with the next report."""
        try:
            status_file.write_status(self._folder, status)
            self._refused = 0
        except OSError as error:
            self._refused += 1
            # Windows refuses while somebody reads it, and a second later does not.
            patience = UNWRITTEN_REPORTS if isinstance(error, PermissionError) else 1
            if not self._said and self._refused >= patience:
                self._said = True
                _log.warning(
                    "the status file cannot be written; `status` will not work", error=str(error)
                )

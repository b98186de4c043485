"""Opens the page beside a program of the terminal."""

from __future__ import annotations

from pathlib import Path

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.system.own_command import start_beside

_END_AFTER_MIN = "1"


def open_page_beside(settings: Path | None) -> None:
    """Open the page; it ends by itself when neither a window nor an agent is there any more.

    Parameters
    ----------
    settings
        The file that was named; None for the usual one.

    Raises
    ------
    TransportError
        ``ABSENT`` if the system cannot start it.
    """
    named = [] if settings is None else ["--settings", str(settings.absolute())]
    try:
        start_beside(["page", "--end-after", _END_AFTER_MIN, *named])
    except OSError as error:
        message = f"the page could not be started: {error.strerror or error}"
        raise TransportError(TransportReason.ABSENT, message) from error

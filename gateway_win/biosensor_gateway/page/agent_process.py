"""Starts the agent as a program of its own, which outlives the page."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.agent.single_instance import is_held
from biosensor_gateway.system.own_command import own_command

ALL_VIRTUAL = "all"

if sys.platform == "win32":
    _NO_WINDOW = subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW
else:
    _NO_WINDOW = 0


def start_agent(folder: Path, settings: Path, *, virtual: bool) -> None:
    """Start an agent that is started again whenever it dies.

    Parameters
    ----------
    folder
        Its state folder.
    settings
        Its settings file.
    virtual
        Stream virtual devices of every kind instead.

    Raises
    ------
    TransportError
        ``BUSY`` if one runs already; ``ABSENT`` if the system cannot start it.
    """
    if is_held(folder):
        raise TransportError(TransportReason.BUSY, "an agent runs already; end it first")
    what = ["--simulate", ALL_VIRTUAL] if virtual else ["--settings", str(settings)]
    command = own_command(["run", "--keep-alive", "--no-ask", *what])
    try:
        # Nothing that the page has open may be held open by the agent.
        subprocess.Popen(  # noqa: S603 - our own program
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            creationflags=_NO_WINDOW,
            # Ctrl-C at the page's terminal is meant for the page.
            start_new_session=True,
        )
    except OSError as error:
        message = f"the agent could not be started: {error.strerror or error}"
        raise TransportError(TransportReason.ABSENT, message) from error

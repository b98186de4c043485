"""Starts the agent as a program of its own, which outlives the page."""

from __future__ import annotations

from pathlib import Path

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.agent.single_instance import is_held
from biosensor_gateway.settings.places import SETTINGS_VARIABLE
from biosensor_gateway.system.own_command import start_beside

ALL_VIRTUAL = "all"


def start_agent(folder: Path, settings: Path, *, virtual: bool) -> None:
    """Start an agent that is started again whenever it dies.

    Parameters
    ----------
    folder
        Its state folder.
    settings
        Its settings file.
    virtual
        Stream virtual devices of every kind in place of those of the settings.

    Raises
    ------
    TransportError
        ``BUSY`` if one runs already; ``ABSENT`` if the system cannot start it.
    """
    if is_held(folder):
        raise TransportError(TransportReason.BUSY, "an agent runs already; end it first")
    what = ["--simulate", ALL_VIRTUAL] if virtual else ["--settings", str(settings)]
    try:
        # Named by an option, it must be there; virtual devices do without.
        start_beside(["run", "--keep-alive", "--no-ask", *what], {SETTINGS_VARIABLE: str(settings)})
    except OSError as error:
        message = f"the agent could not be started: {error.strerror or error}"
        raise TransportError(TransportReason.ABSENT, message) from error

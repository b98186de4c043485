"""``biosensor-gateway stop``."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.agent import control
from biosensor_gateway.agent.single_instance import wait_until_free
from biosensor_gateway.settings.places import state_folder

_ASK_AGAIN_S = 0.2


def stop(
    timeout: Annotated[
        float, typer.Option(min=1, help="How many seconds to wait until the agent has ended.")
    ] = 10.0,
) -> None:
    """End the running agent; exit code 1 if none runs or it does not end in time."""
    folder, deadline = state_folder(), time.monotonic() + timeout
    process = _ask_to_end(folder, deadline)
    if process is not None and not wait_until_free(folder, max(0.0, deadline - time.monotonic())):
        message = (
            f"the agent has not ended within {timeout:g} s; wait, or end its process {process} "
            "by the means of the system"
        )
        raise TransportError(TransportReason.BUSY, message)
    typer.echo("the agent has ended")


def _ask_to_end(folder: Path, deadline: float) -> int | None:
    """Ask until the agent answers, and return its process; None if it has ended by itself."""
    was_there = False
    while True:
        left = max(_ASK_AGAIN_S, deadline - time.monotonic())
        try:
            return control.ask(folder, "stop", time_limit_s=left)["process"]
        except TransportError as error:
            if error.reason is TransportReason.ABSENT and was_there:
                return None
            # While it starts, it does not listen yet.
            if error.reason is TransportReason.ABSENT or time.monotonic() >= deadline:
                raise
        was_there = True
        time.sleep(_ASK_AGAIN_S)

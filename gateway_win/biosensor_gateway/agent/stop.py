"""Ends the agent of a state folder, also one that has crashed and is about to be restarted."""

from __future__ import annotations

import time
from pathlib import Path

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.agent import control
from biosensor_gateway.agent.single_instance import wait_until_free
from biosensor_gateway.system import restart_notice
from biosensor_gateway.system.child import lives

USUAL_LIMIT_S = 10.0
_ASK_AGAIN_S = 0.2


def stop_agent(folder: Path, timeout_s: float = USUAL_LIMIT_S) -> str:
    """End the agent and wait until it has ended; return the outcome for people.

    Raises
    ------
    TransportError
        ``ABSENT`` if none runs, ``BUSY`` if it does not end in time, ``DENIED`` if its restart
        cannot be prevented.
    ProtocolError
        ``REFUSED``, with the sentence of the agent.
    """
    deadline = time.monotonic() + timeout_s
    supervisor = _prevent_restart(folder)
    if supervisor is not None:
        has_ended = _has_ended(supervisor, deadline)
        process, outcome = supervisor, "the agent had died, and is not started again"
    else:
        process = _ask_to_end(folder, deadline)
        has_ended = process is None or wait_until_free(folder, _left_s(deadline))
        outcome = "the agent has ended"
    if not has_ended:
        message = (
            f"the agent has not ended within {timeout_s:g} s; wait, or end its process {process} "
            "by the means of the system"
        )
        raise TransportError(TransportReason.BUSY, message)
    return outcome


def _prevent_restart(folder: Path) -> int | None:
    """Cancel the restart of a crashed agent; return its supervisor's process, None if none."""
    notice = restart_notice.read(folder)
    try:
        is_taken_down = notice is not None and restart_notice.take_down(folder)
    except OSError as error:
        message = f"cannot keep the agent from being started again: {error.strerror or error}"
        raise TransportError(TransportReason.DENIED, message) from error
    return notice.process if notice is not None and is_taken_down else None


def _has_ended(process: int, deadline: float) -> bool:
    while lives(process):
        if time.monotonic() >= deadline:
            return False
        time.sleep(_ASK_AGAIN_S)
    return True


def _left_s(deadline: float) -> float:
    return max(0.0, deadline - time.monotonic())


def _ask_to_end(folder: Path, deadline: float) -> int | None:
    """Ask the agent to end until it answers; return its process, None if it ends by itself."""
    was_there = False
    while True:
        left = max(_ASK_AGAIN_S, deadline - time.monotonic())
        try:
            return control.ask(folder, "stop", time_limit_s=left)["process"]
        except TransportError as error:
            if error.reason is TransportReason.ABSENT and was_there:
                return None
            # An agent that is starting holds its lock, but does not listen yet: ask again.
            if error.reason is TransportReason.ABSENT or time.monotonic() >= deadline:
                raise
        was_there = True
        time.sleep(_ASK_AGAIN_S)

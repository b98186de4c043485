"""Commands the running agent of the same user, by the control channel, and ends an agent.

An agent can also be ended after it has crashed, while it is about to be restarted.
"""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from biosensor_common.errors import (
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_gateway.agent.single_instance import LOCK_FILE, is_held, wait_until_free
from biosensor_gateway.system import restart_notice
from biosensor_gateway.system.child import lives

CONTROL_FILE = "control.json"
HOST = "127.0.0.1"
TIME_LIMIT_S = 5.0
"""Limit for receiving a request, for a command, and for sending the reply."""
_REPLY_LIMIT = 65536


def ask(
    folder: Path,
    command: str,
    arguments: Mapping[str, Any] | None = None,
    time_limit_s: float = TIME_LIMIT_S,
    lock_file: str = LOCK_FILE,
) -> dict[str, Any]:
    """Send a command to the running agent, and return its answer.

    Parameters
    ----------
    command, arguments
        Name and arguments of the command.
    time_limit_s
        Limit for connecting and for each read.
    lock_file
        Name of the lock file that the agent holds.

    Raises
    ------
    TransportError
        ``ABSENT`` if no agent runs, ``SILENT`` if one runs and does not answer.
    ProtocolError
        ``REFUSED``, with the sentence of the agent.
    """
    # The lock first: after a crash the file of port and token is still there.
    if not is_held(folder, lock_file):
        message = "no agent is running; start one with: biosensor-gateway run"
        raise TransportError(TransportReason.ABSENT, message)
    try:
        place = json.loads((folder / CONTROL_FILE).read_text(encoding="utf-8"))
        request = {
            "token": place["token"],
            "command": command,
            "arguments": arguments or {},
            # Both are on this computer, whose clock since its start no one sets.
            "until": time.monotonic() + time_limit_s,
        }
        reply = json_object(_exchange(int(place["port"]), line(request), time_limit_s))
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
        reply = None
    if reply is None or (reply.get("ok") is True and not isinstance(reply.get("answer"), dict)):
        message = (
            f"the agent with the state folder {folder} does not answer: it is starting, ending "
            "or stuck; try again"
        )
        raise TransportError(TransportReason.SILENT, message)
    if reply.get("ok") is not True:
        problem = f"the agent refused {command}: {reply.get('problem')}"
        raise ProtocolError(ProtocolReason.REFUSED, problem)
    return reply["answer"]


def _exchange(port: int, request: bytes, time_limit_s: float) -> bytes:
    with (
        socket.create_connection((HOST, port), time_limit_s) as connection,
        connection.makefile("rb") as replies,
    ):
        connection.sendall(request)
        return replies.readline(_REPLY_LIMIT)


def line(message: Mapping[str, Any]) -> bytes:
    """Encode a message as a line."""
    return json.dumps(message).encode() + b"\n"


def json_object(received: bytes) -> dict[str, Any] | None:
    """Decode a line; None if it is not a JSON object."""
    try:
        message: object = json.loads(received.decode())
    except (ValueError, RecursionError):
        return None
    return cast("dict[str, Any]", message) if isinstance(message, dict) else None


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
        process, outcome = supervisor, "the agent had died, and is not restarted"
    else:
        process = _ask_to_end(folder, deadline)
        has_ended = process is None or wait_until_free(folder, _left_s(deadline))
        outcome = "the agent has ended"
    if not has_ended:
        message = (
            f"the agent has not ended within {timeout_s:g} s; wait, or end its process {process} "
            "with the system's tools"
        )
        raise TransportError(TransportReason.BUSY, message)
    return outcome


def _prevent_restart(folder: Path) -> int | None:
    """Cancel the restart of a crashed agent; return its supervisor's process, None if none."""
    notice = restart_notice.read(folder)
    try:
        is_taken_down = notice is not None and restart_notice.take_down(folder)
    except OSError as error:
        message = f"cannot prevent the agent from being restarted: {error.strerror or error}"
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
            return ask(folder, "stop", time_limit_s=left)["process"]
        except TransportError as error:
            if error.reason is TransportReason.ABSENT and was_there:
                return None
            # An agent that is starting holds its lock, but does not listen yet: ask again.
            if error.reason is TransportReason.ABSENT or time.monotonic() >= deadline:
                raise
        was_there = True
        time.sleep(_ASK_AGAIN_S)

"""Client of the control channel, by which the same user's programs command the agent.

The server is `control_server`. The agent listens on the loopback address at a
free port. Port and a random token are in ``control.json`` in its state folder,
which only its user can read. A client sends one line of JSON and receives one::

    {"token": "5f…", "command": "stop", "arguments": {}}
    {"ok": true, "answer": {"process": 4711}}
    {"ok": false, "problem": "one sentence"}
"""

from __future__ import annotations

import json
import socket
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from biosensor_common.errors import (
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_gateway.agent.single_instance import LOCK_FILE, is_held

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
    folder
        State folder of the agent.
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
        request = {"token": place["token"], "command": command, "arguments": arguments or {}}
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

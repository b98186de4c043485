"""A request to the running agent: whatever comes, one line of JSON answers it.

No command runs without the token.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, cast

from biosensor_gateway.agent.control_server import REQUEST_LIMIT, ControlServer
from tests.fuzz.contract import ensure

_TOKEN = b"TOKEN"


def check(data: bytes) -> None:
    """Have the server answer, with the real token wherever the bytes say ``TOKEN``."""
    server, ran = _server()
    token: str = getattr(server, "_token")  # noqa: B009 - no business of anything but this test
    ran.clear()
    asyncio.run(_converse(server, data.replace(_TOKEN, token.encode())))
    ensure(not ran or _TOKEN in data, "a command ran without the token", ran)


@cache
def _server() -> tuple[ControlServer, list[str]]:
    ran: list[str] = []

    async def echo(arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        ran.append("echo")
        return arguments

    # Its address is never opened: requests come from memory.
    return ControlServer(Path(), {"echo": echo}), ran


async def _converse(server: ControlServer, request: bytes) -> None:
    reader = asyncio.StreamReader(REQUEST_LIMIT)
    reader.feed_data(request)
    reader.feed_eof()
    answer: bytes
    answer, _ = await getattr(server, "_reply")(reader)  # noqa: B009 - as above
    ensure(answer.endswith(b"\n") and answer.count(b"\n") == 1, "it is no line", answer)
    reply = cast("object", json.loads(answer))
    ensure(isinstance(reply, dict), "it is no object", answer)
    fields = cast("dict[str, object]", reply)
    ensure(fields.keys() in ({"ok", "answer"}, {"ok", "problem"}), "other fields", answer)

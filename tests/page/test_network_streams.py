"""What a script gets of the network's page: the streams as JSON."""

from __future__ import annotations

import asyncio
import json
from typing import Any, cast

from biosensor_gateway.page.models import NetworkView
from biosensor_gateway.page.network.source import NetworkSource
from biosensor_gateway.page.network_page import interface


class Source:
    """Sees nothing yet."""

    def status(self) -> NetworkView:
        return NetworkView(made_s=1.0, search=["Start an agent."])


def test_the_streams_are_answered_as_json() -> None:
    sent: list[dict[str, Any]] = []

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": b""}

    async def send(message: Any) -> None:
        sent.append(message)

    scope: dict[str, Any] = {
        "type": "http",
        "method": "GET",
        "path": "/api/v1/streams",
        "query_string": b"",
        "headers": [],
    }
    app: Any = interface(cast("NetworkSource", Source()))
    asyncio.run(app(scope, receive, send))
    assert sent[0]["status"] == 200
    told = json.loads(b"".join(each.get("body", b"") for each in sent))
    assert (told["made_s"], told["search"]) == (1.0, ["Start an agent."])

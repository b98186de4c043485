"""A plain client of the Cortex API: what any other program would write on `websockets`."""

from __future__ import annotations

import asyncio
import itertools
import json
import ssl
from collections import defaultdict
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, Self, cast

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from tests.rigs.polling import until

DEADLINE_S = 20.0
_QUERY_EVERY_S = 0.02


class CortexError(Exception):
    """A request that was answered with an error; ``code`` says which."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


class CortexClient:
    """One connection; an async context manager."""

    def __init__(self, settings: Mapping[str, Any]) -> None:
        self.settings = settings
        # Data messages by stream, in order.
        self.data: defaultdict[str, list[dict[str, Any]]] = defaultdict(list)
        self.warnings: list[dict[str, Any]] = []  # Warnings, in order.
        self._ids = itertools.count(1)
        self._pending: dict[int, asyncio.Future[dict[str, Any]]] = {}

    async def __aenter__(self) -> Self:
        self.socket: ClientConnection = await connect(
            self.settings["url"],
            ssl=_lenient(self.settings["ca_file"]),
            proxy=None,
            compression=None,
            open_timeout=DEADLINE_S,
            ping_interval=None,
            close_timeout=1.0,
        )
        self._reader = asyncio.create_task(self._read())
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.socket.close()
        await self._reader

    async def send(self, method: str, **params: Any) -> asyncio.Future[dict[str, Any]]:
        """Send a request; the future gets the whole reply."""
        number = next(self._ids)
        self._pending[number] = asyncio.get_running_loop().create_future()
        await self.socket.send(
            json.dumps({"jsonrpc": "2.0", "id": number, "method": method, "params": params})
        )
        return self._pending[number]

    async def ask(self, method: str, **params: Any) -> Any:
        """Send a request and return its result; raise CortexError where it is refused."""
        reply = await asyncio.wait_for(await self.send(method, **params), DEADLINE_S)
        if "error" in reply:
            raise CortexError(reply["error"]["code"])
        return reply["result"]

    async def until(self, condition: Callable[[], Any]) -> None:
        """Wait for a condition."""
        await until(condition)

    async def until_warned(self, code: int) -> dict[str, Any]:
        """Wait for a warning of this code and return it."""
        await self.until(lambda: code in self.warning_codes)
        return next(warning for warning in self.warnings if warning["code"] == code)

    async def until_data(self, stream: str, more: int = 1) -> None:
        """Wait for so many more messages of a stream."""
        wanted = len(self.data[stream]) + more
        await self.until(lambda: len(self.data[stream]) >= wanted)

    @property
    def warning_codes(self) -> list[int]:
        """Codes of the warnings so far."""
        return [warning["code"] for warning in self.warnings]

    async def authorize(self, client_id: str, client_secret: str, **params: Any) -> str:
        """Return a token."""
        result = await self.ask(
            "authorize", clientId=client_id, clientSecret=client_secret, **params
        )
        return result["cortexToken"]

    async def connect_headset(self) -> None:
        """Scan, connect and wait until the headset is connected."""
        headset = self.settings["headset"]
        await self.ask("controlDevice", command="refresh")
        for _ in range(round(DEADLINE_S / _QUERY_EVERY_S)):
            if await self.ask("queryHeadsets", id=headset):
                break
            await asyncio.sleep(_QUERY_EVERY_S)
        await self.ask("controlDevice", command="connect", headset=headset)
        await self.until_warned(104)

    async def begin(
        self, client_id: str, client_secret: str, *streams: str, status: str = "active"
    ) -> tuple[str, str]:
        """Go the whole way to streaming; return token and session."""
        token = await self.authorize(client_id, client_secret, debit=10)
        await self.connect_headset()
        session = await self.ask(
            "createSession", cortexToken=token, headset=self.settings["headset"], status=status
        )
        if streams:
            result = await self.ask(
                "subscribe", cortexToken=token, session=session["id"], streams=list(streams)
            )
            assert [one["streamName"] for one in result["success"]] == list(streams)
        return token, session["id"]

    async def _read(self) -> None:
        with suppress(ConnectionClosed):
            async for text in self.socket:
                self._sort(text)

    def _sort(self, text: str | bytes) -> None:
        message = _read_object(text)
        if "sid" in message and "time" in message:
            stream = next(key for key in message if key not in {"sid", "time"})
            self.data[stream].append(message)
        elif isinstance(message.get("warning"), dict):
            self.warnings.append(message["warning"])
        elif message.get("id") in self._pending:
            self._pending.pop(message["id"]).set_result(message)


def _read_object(text: str | bytes) -> dict[str, Any]:
    """Decode a message; nothing where it is not a JSON object."""
    try:
        message = json.loads(text, parse_constant=_reject)
    except ValueError:
        return {}
    return cast("dict[str, Any]", message) if isinstance(message, dict) else {}


def _reject(constant: str) -> None:
    raise ValueError(constant)


def _lenient(ca_file: str) -> ssl.SSLContext:
    context = ssl.create_default_context(cafile=ca_file)
    # From Python 3.13 on it is set; the vendor's authority lacks an extension that it wants.
    context.verify_flags &= ~ssl.VERIFY_X509_STRICT
    return context

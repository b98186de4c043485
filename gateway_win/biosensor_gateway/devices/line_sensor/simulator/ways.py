"""The links of virtual boards."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import Mapping, Sequence
from contextlib import suppress
from itertools import count
from typing import Any, Protocol

from websockets.asyncio.connection import broadcast
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.protocol import State

from biosensor_gateway.simulation.async_serial import PatientPort
from biosensor_gateway.simulation.faults import Untidiness
from biosensor_gateway.simulation.tcp_port import LOOPBACK, KeptPort, break_off

_BUFFER_BYTES = 4096
_WEB_SOCKET_ROOM_BYTES = 1 << 15


class Way(Protocol):
    """A board's end of the link; runs in the world's event loop."""

    @property
    def settings(self) -> Mapping[str, Any]:
        """Settings with which a driver finds it; known after opening."""
        ...

    async def open(self) -> None:
        """Open the link, with the same address as before."""
        ...

    def write(self, data: bytes) -> bool:
        """Send all data or nothing; return False without a listener."""
        ...

    def make_untidy(self, kind: Untidiness, *, on: bool) -> None:
        """Switch a disturbance of this link on or off."""
        ...

    def hang_up(self) -> None:
        """Close the link until `open` is called."""
        ...

    def dispose(self) -> None:
        """Close the link permanently."""
        ...


class Serial:
    """A serial port, or a TCP server.

    Parameters
    ----------
    tcp
        Use a TCP server; None for only on systems without pseudo-terminals.
    """

    def __init__(self, *, tcp: bool | None = None) -> None:
        options = {} if tcp is None else {"tcp": tcp}
        self._port = PatientPort(
            lambda _: None, lambda: None, buffer_bytes=_BUFFER_BYTES, **options
        )
        self.write = self._port.write
        self.hang_up = self._port.hang_up
        self.dispose = self._port.dispose

    @property
    def settings(self) -> Mapping[str, Any]:
        """The setting ``port``."""
        return {"port": self._port.name}

    async def open(self) -> None:
        """Open the link."""
        self._port.open()

    def make_untidy(self, kind: Untidiness, *, on: bool) -> None:
        """Join lines and split them at random places."""
        assert kind is Untidiness.GLUED
        self._port.glue(on=on)


class Udp:
    """Datagrams to a free port of this computer."""

    def __init__(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind((LOOPBACK, 0))
            self._number = int(free.getsockname()[1])
        self._socket: socket.socket | None = None
        self._overtakes = False
        self._sent = 0
        self._overtaken = b""

    @property
    def settings(self) -> Mapping[str, Any]:
        """The setting ``udp_port``."""
        return {"udp_port": self._number}

    async def open(self) -> None:
        """Start sending."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.connect((LOOPBACK, self._number))

    def write(self, data: bytes) -> bool:
        """Send a datagram; the system reports whether the previous one had a listener."""
        if self._socket is None:
            return False
        self._sent += 1
        late, self._overtaken = self._overtaken, b""
        if self._overtakes and not late and self._sent % 3 == 0:
            self._overtaken = data
            return True
        try:
            for each in (data, late) if late else (data,):
                self._socket.send(each)
        except OSError:
            return False
        return True

    def make_untidy(self, kind: Untidiness, *, on: bool) -> None:
        """Let datagrams overtake each other."""
        assert kind is Untidiness.OVERTAKEN
        self._overtakes = on

    def hang_up(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def dispose(self) -> None:
        """Close the socket."""
        self.hang_up()


class WebSocket:
    """A WebSocket server with one message per line."""

    def __init__(self) -> None:
        self._port = KeptPort()
        self._server: Server | None = None
        self._listeners: set[ServerConnection] = set()
        self._is_wanted = False

    @property
    def settings(self) -> Mapping[str, Any]:
        """The setting ``url``."""
        return {"url": f"ws://{LOOPBACK}:{self._port.number}/"}

    async def open(self) -> None:
        """Accept connections."""
        self._is_wanted = True
        server = await serve(
            self._serve, LOOPBACK, self._port.take(), compression=None, close_timeout=1.0
        )
        if not self._is_wanted:
            server.close()
            return
        self._server = server

    async def _serve(self, connection: ServerConnection) -> None:
        self._listeners.add(connection)
        try:
            await self._talk(connection)
        finally:
            self._listeners.discard(connection)

    async def _talk(self, connection: ServerConnection) -> None:
        await connection.wait_closed()

    def write(self, data: bytes) -> bool:
        """Send a message to all clients that read."""
        reading = self._reading
        broadcast(reading, data.decode("latin-1"))
        return bool(reading)

    def make_untidy(self, kind: Untidiness, *, on: bool) -> None:
        """Do nothing, because messages arrive complete and in order."""

    @property
    def _reading(self) -> list[ServerConnection]:
        return [
            each
            for each in self._listeners
            if each.state is State.OPEN
            and each.transport.get_write_buffer_size() < _WEB_SOCKET_ROOM_BYTES
        ]

    def hang_up(self) -> None:
        """Abort connections, and refuse new ones."""
        self._is_wanted = False
        for each in tuple(self._listeners):
            with suppress(OSError):
                break_off(each.transport)
        if self._server is not None:
            self._server.close()
            self._server = None

    def dispose(self) -> None:
        """Close the server."""
        self.hang_up()
        self._port.give_back()


class OpenEarableApp(WebSocket):
    """The app on a phone, with wearables with one sensor each.

    Written from https://github.com/OpenEarable/app, ``docs/connectors/websocket-ipc-api.md``.

    Parameters
    ----------
    wearables
        Names of the connected wearables.
    """

    def __init__(self, sensor: Mapping[str, Any], wearables: Sequence[str]) -> None:
        super().__init__()
        self._sensor = sensor
        self._wearables = {f"id-{number}": name for number, name in enumerate(wearables)}
        self._subscriptions: dict[ServerConnection, tuple[int, str]] = {}
        self._numbers = count(1)
        self.refuses = False  # Whether it answers each request with an error.

    async def _talk(self, connection: ServerConnection) -> None:
        await connection.send(json.dumps({"event": "ready", "methods": ["ping"], "endpoint": None}))
        try:
            async for said in connection:
                await self._answer(connection, json.loads(said))
        finally:
            self._subscriptions.pop(connection, None)

    async def _answer(self, connection: ServerConnection, request: Mapping[str, Any]) -> None:
        params, known = request["params"], self._wearables
        answer: dict[str, Any] = {"id": request["id"]}
        match request["method"], params.get("action"):
            case _ if self.refuses:
                answer["error"] = {"message": "Bad state: No permission", "type": "StateError"}
            case "list_connected", None:
                answer["result"] = [
                    {"device_id": each, "name": name, "type": "OpenEarableV2", "capabilities": []}
                    for each, name in known.items()
                ]
            case "invoke_action", "list_sensors" if params["device_id"] in known:
                answer["result"] = [self._sensor]
            case "subscribe", None if params["args"]["sensor_id"] == self._sensor["sensor_id"]:
                number = next(self._numbers)
                self._subscriptions[connection] = number, params["device_id"]
                # The first values arrive before the answer.
                await asyncio.sleep(0.03)
                of = {"stream": params["stream"], "device_id": params["device_id"]}
                answer["result"] = {"subscription_id": number, **of}
            case _:
                answer["error"] = {"message": f"Unsupported: {request}", "type": "Error"}
        await connection.send(json.dumps(answer))

    def write(self, data: bytes) -> bool:
        """Send values to all subscribers that read."""
        reading = [each for each in self._reading if each in self._subscriptions]
        for each in reading:
            self._tell(each, json.loads(data))
        return bool(reading)

    def end_values(self) -> None:
        """End all subscriptions, as when the wearable disconnects."""
        for each in self._reading:
            if each in self._subscriptions:
                number, device = self._subscriptions.pop(each)
                said = {"event": "stream_done", "subscription_id": number, "device_id": device}
                broadcast([each], json.dumps(said))

    def _tell(self, connection: ServerConnection, data: Mapping[str, Any]) -> None:
        number, device = self._subscriptions[connection]
        said = {
            "event": "stream",
            "subscription_id": number,
            "stream": "sensor_values",
            "device_id": device,
            "data": data,
        }
        broadcast([connection], json.dumps(said))

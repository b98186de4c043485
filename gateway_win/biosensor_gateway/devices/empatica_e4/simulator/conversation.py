"""The server's port, its clients, and the answers to their requests."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import inf

from biosensor_gateway.devices.empatica_e4.simulator.wire import SUBSCRIPTIONS
from biosensor_gateway.devices.empatica_e4.simulator.wristband import Wristband
from biosensor_gateway.simulation.faults import Glue
from biosensor_gateway.simulation.tcp_port import TcpPort, break_off

_ROOM_BYTES = 1 << 20
_REQUEST_BYTES = 4096

Hear = Callable[["Client", str], None]
"""Called with each request of a client, a line without its line end."""


class Client(asyncio.Protocol):
    """A client with its binding and subscriptions.

    Parameters
    ----------
    listener
        Notified when it connects and disconnects.
    """

    def __init__(self, listener: Listener, hear: Hear) -> None:
        self.bound_to = ""  # Id of a wristband, or empty.
        self.subscriptions: set[str] = set()  # Subscription words of streams.
        self.is_paused = False
        self._listener = listener
        self._hear = hear
        self._transport: asyncio.Transport | None = None
        self._unfinished = b""
        self._is_stalled = False
        self._held: bytearray | None = None
        self.glue = Glue(self._send)  # Buffer for all data sent to it.
        self._ended = asyncio.Event()

    @property
    def has_room(self) -> bool:
        """Whether a line can be sent now."""
        transport = self._transport
        if transport is None or transport.is_closing() or self._is_stalled:
            return False
        return transport.get_write_buffer_size() < _ROOM_BYTES

    @property
    def is_holding(self) -> bool:
        """Whether the rest of a torn line is being held back."""
        return self._held is not None

    def wants(self, device_id: str, subscription: str) -> bool:
        """Whether it is subscribed to a stream of a wristband now."""
        return (
            self.bound_to == device_id and subscription in self.subscriptions and not self.is_paused
        )

    def bind(self, device_id: str) -> None:
        """Bind to a wristband, or unbind if empty; all subscriptions end."""
        self.bound_to = device_id
        self.subscriptions.clear()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Register with the listener, unless it was closed meanwhile."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        if not self._listener.let_in(self):
            self.reset()

    def data_received(self, data: bytes) -> None:
        """Pass on complete lines, which may end with CRLF or LF."""
        *lines, self._unfinished = (self._unfinished + data).split(b"\n")
        if len(self._unfinished) > _REQUEST_BYTES:
            self.reset()
        for line in lines:
            self._hear(self, line.decode("ascii", "replace").strip())

    def connection_lost(self, exc: Exception | None) -> None:
        """Unregister from the listener."""
        del exc
        self._transport = None
        self.glue.forget()
        self._ended.set()
        self._listener.let_go(self)

    def write(self, data: bytes) -> None:
        """Send data, unless the connection is closed or stalled."""
        if self._held is not None:
            self._held += data
        else:
            self.glue.write(data)

    def write_torn(self, data: bytes, at: int, pause_s: float) -> None:
        """Send the first ``at`` bytes, and everything else after a pause."""
        self.write(data[:at])
        self._held = bytearray(data[at:])
        asyncio.get_running_loop().call_later(pause_s, self._send_held)

    def stall(self) -> None:
        """Stop sending and reading."""
        self._is_stalled = True
        if self._transport is not None:
            self._transport.pause_reading()

    def resume(self) -> None:
        """End a `stall`; requests received meanwhile are read now."""
        self._is_stalled = False
        if self._transport is not None and not self._transport.is_closing():
            self._transport.resume_reading()

    def close(self) -> None:
        """Close after sending all pending data."""
        if self._transport is not None:
            self._transport.close()

    async def end(self) -> None:
        """Discard pending data, close, and wait until closed."""
        if self._transport is not None:
            self._transport.abort()
            await self._ended.wait()

    def reset(self) -> None:
        """Abort the connection with an RST, like a killed process."""
        if self._transport is not None:
            break_off(self._transport)

    def _send(self, data: bytes) -> bool:
        if not self.has_room or self._transport is None:
            return False
        self._transport.write(data)
        return True

    def _send_held(self) -> None:
        held, self._held = self._held, None
        if held is not None:
            self.write(bytes(held))


_MODEL = "Empatica_E4"
_SWITCH = ("ON", "OFF")
_LONGEST_PATIENCE_MIN = 254
_NOT_BOUND = "ERR You are not connected to any device"


class Listener:
    """A TCP server whose port stays reserved while it is shut.

    Parameters
    ----------
    hear
        Called with each client's requests.
    """

    def __init__(self, hear: Hear) -> None:
        self.clients: set[Client] = set()
        self._hear = hear
        self._port = TcpPort(self._connected)
        self._connecting: set[asyncio.Task[object]] = set()
        self._is_stalled = self._glues = False

    @property
    def port(self) -> int:
        """TCP port, which stays the same when reopened; 0 before the first opening."""
        return self._port.number

    def open(self) -> None:
        """Start accepting clients.

        Raises
        ------
        TransportError
            BUSY if the port is not available.
        """
        self._port.open()

    def glue(self, *, on: bool) -> None:
        """Send data to all clients joined and split at random places, or unchanged."""
        self._glues = on
        for client in self.clients:
            client.glue.switch(on=on)

    def shut(self) -> None:
        """Refuse clients and abort existing connections, but keep the port."""
        self._port.shut()
        self.reset_all()

    def reset_all(self) -> None:
        """Abort all connections."""
        for client in tuple(self.clients):
            client.reset()

    def stall(self) -> None:
        """Stop sending and reading; connections stay, and new ones are accepted."""
        self._is_stalled = True
        for client in self.clients:
            client.stall()

    def resume(self) -> None:
        """End a `stall`."""
        self._is_stalled = False
        for client in self.clients:
            client.resume()

    async def stop(self) -> None:
        """Close all connections and release the port."""
        self._port.close()
        for client in tuple(self.clients):
            await client.end()

    def let_in(self, client: Client) -> bool:
        """Register a client, unless the port was shut meanwhile."""
        if not self._port.is_open:
            return False
        self.clients.add(client)
        client.glue.switch(on=self._glues)
        # In Python 3.11.2 (Debian 12), asyncio reads from a new connection even if it was paused
        # on creation, so it is paused again right after.
        asyncio.get_running_loop().call_soon(self._stall_new, client)
        return True

    def _stall_new(self, client: Client) -> None:
        if self._is_stalled:
            client.stall()

    def let_go(self, client: Client) -> None:
        """Forget a client whose connection has ended."""
        self.clients.discard(client)

    def _connected(self, connection: socket.socket) -> None:
        loop = asyncio.get_running_loop()
        task = loop.create_task(
            loop.connect_accepted_socket(lambda: Client(self, self._hear), connection)
        )
        self._connecting.add(task)
        task.add_done_callback(self._connecting.discard)


@dataclass(slots=True)
class Manners:
    """Behaviour of the server's answers."""

    late_s: float = 0.0  # Delay of answers; requests are executed at once.
    refuses_binding: bool = False  # Whether `device_connect` fails.
    # Streams to which subscriptions fail.
    refused_streams: set[str] = field(default_factory=set[str])
    # Commands whose next request gets no answer.
    withheld: set[str] = field(default_factory=set[str])
    # Commands that never get an answer, and whether they are executed anyway.
    never_answered: dict[str, bool] = field(default_factory=dict[str, bool])
    hides_all: bool = False  # Whether lists are empty.


# Time from a client's request for a radio link to the link.
_RADIO_CONNECT_S = 0.3


class Commands:
    """Executes requests.

    Parameters
    ----------
    wristbands
        All wristbands by lower-case id.
    connect
        Creates the radio link of a wristband.
    """

    def __init__(
        self,
        wristbands: dict[str, Wristband],
        manners: Manners,
        connect: Callable[[Wristband, float], None],
    ) -> None:
        self.requests: list[str] = []  # All lines from clients, in order.
        self._wristbands = wristbands
        self._manners = manners
        self._connect = connect
        self._known: dict[str, Callable[[Client, list[str]], str | None]] = {
            "device_discover_list": self._discover_list,
            "device_list": self._list,
            "device_connect_btle": self._connect_radio,
            "device_disconnect_btle": self._disconnect_radio,
            "device_connect": self._bind,
            "device_disconnect": self._unbind,
            "device_subscribe": self._subscribe,
            "pause": self._pause,
            "server_status": lambda _, __: "OK",
        }

    def hear(self, client: Client, request: str) -> None:
        """Execute a request and answer it."""
        if not request:
            return
        self.requests.append(request)
        command, *arguments = request.split()
        if not self._manners.never_answered.get(command, True):
            return
        carry_out = self._known.get(command)
        answer = carry_out(client, arguments) if carry_out else "ERR Unknown command"
        if answer is not None:
            self._answer(client, command, answer)

    def _answer(self, client: Client, command: str, answer: str) -> None:
        if command in self._manners.never_answered:
            return
        if command in self._manners.withheld:
            self._manners.withheld.remove(command)
            return
        say = partial(self._say, client, command, answer)
        if self._manners.late_s:
            asyncio.get_running_loop().call_later(self._manners.late_s, say)
        else:
            say()

    def _say(self, client: Client, command: str, answer: str) -> None:
        client.write(f"R {command} {answer}\n".encode())
        if command == "device_disconnect" and answer == "OK":
            client.close()

    def _discover_list(self, _: Client, __: list[str]) -> str:
        return self._listed(
            [
                f"{each.device_id} {_MODEL} {'allowed' if each.is_allowed else 'not_allowed'}"
                for each in self._wristbands.values()
                if each.is_advertising
            ]
        )

    def _list(self, _: Client, __: list[str]) -> str:
        return self._listed(
            [
                f"{each.device_id} {_MODEL}"
                for each in self._wristbands.values()
                if each.is_connected
            ]
        )

    def _listed(self, devices: Sequence[str]) -> str:
        shown = () if self._manners.hides_all else devices
        return " | ".join((str(len(shown)), *shown))

    def _connect_radio(self, client: Client, arguments: list[str]) -> str | None:
        wristband = self._find(arguments)
        patience_s = _patience_s(arguments[1:])
        if wristband is None or not wristband.is_advertising:
            return "ERR The device has not been discovered yet"
        if not wristband.is_allowed:
            return "ERR The device is not registered with the API key"
        if patience_s is None:
            return "ERR could not connect device over BTLE"
        finish = partial(self._finish_radio, client, wristband, patience_s)
        asyncio.get_running_loop().call_later(_RADIO_CONNECT_S, finish)
        return None

    def _finish_radio(self, client: Client, wristband: Wristband, patience_s: float) -> None:
        answer = "ERR could not connect device over BTLE"
        if wristband.is_advertising:
            self._connect(wristband, patience_s)
            answer = "OK"
        self._answer(client, "device_connect_btle", answer)

    def _disconnect_radio(self, _: Client, arguments: list[str]) -> str:
        wristband = self._find(arguments)
        if wristband is None or not (wristband.is_connected or wristband.is_lost):
            return "ERR The device is not connected over btle"
        wristband.disconnect()
        wristband.is_left_alone = True
        return "OK"

    def _bind(self, client: Client, arguments: list[str]) -> str:
        wristband = self._find(arguments)
        if self._manners.refuses_binding or wristband is None or not wristband.is_connected:
            return "ERR The device requested for connection is not available."
        if client.bound_to == wristband.device_id:
            return "ERR You've tried to connect to the device from the same connection"
        client.bind(wristband.device_id)
        return "OK"

    def _unbind(self, client: Client, _: list[str]) -> str:
        if not client.bound_to:
            return "ERR No connected device."
        client.bind("")
        return "OK"

    def _subscribe(self, client: Client, arguments: list[str]) -> str:
        if not client.bound_to:
            return _NOT_BOUND
        stream, switch = (*arguments, "", "")[:2]
        if stream not in SUBSCRIPTIONS - self._manners.refused_streams or switch not in _SWITCH:
            return f"{stream} ERR The stream is not available"
        if switch == "ON":
            client.subscriptions.add(stream)
        else:
            client.subscriptions.discard(stream)
        return f"{stream} OK"

    def _pause(self, client: Client, arguments: list[str]) -> str:
        if not client.bound_to:
            return _NOT_BOUND
        (switch,) = (*arguments, "")[:1]
        if switch not in _SWITCH:
            return "ERR The argument is ON or OFF"
        client.is_paused = switch == "ON"
        return switch

    def _find(self, arguments: list[str]) -> Wristband | None:
        return self._wristbands.get(arguments[0].lower()) if arguments else None


def _patience_s(arguments: list[str]) -> float | None:
    """Return how long a lost wristband stays discoverable; None for an invalid argument."""
    if not arguments:
        return 0.0
    if not arguments[0].isdecimal() or int(arguments[0]) > _LONGEST_PATIENCE_MIN:
        return None
    return int(arguments[0]) * 60.0 or inf

"""One TCP connection to the server."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Protocol

from biosensor_gateway.simulation.tcp_port import break_off

_ROOM_BYTES = 1 << 20
_REQUEST_BYTES = 4096

Hear = Callable[["Client", str], None]


class Door(Protocol):
    """Who knows the clients of a port, and decides who is one."""

    def let_in(self, client: Client) -> bool:
        """Take a client; False if there is no entry now."""
        ...

    def let_go(self, client: Client) -> None:
        """Forget a client whose connection has ended."""
        ...


class Client(asyncio.Protocol):
    """A client, with what it is bound and subscribed to.

    Parameters
    ----------
    door
        Is told that it came and went.
    hear
        Gets each request, a line without its end.

    Attributes
    ----------
    bound_to
        Id of a wristband, or empty.
    subscriptions
        Words of streams.
    """

    def __init__(self, door: Door, hear: Hear) -> None:
        self.bound_to = ""
        self.subscriptions: set[str] = set()
        self.is_paused = False
        self._door = door
        self._hear = hear
        self._transport: asyncio.Transport | None = None
        self._unfinished = b""
        self._is_stalled = False
        self._held: bytearray | None = None
        self._ended = asyncio.Event()

    @property
    def has_room(self) -> bool:
        """Tell whether a line can be sent now."""
        transport = self._transport
        if transport is None or transport.is_closing() or self._is_stalled:
            return False
        return transport.get_write_buffer_size() < _ROOM_BYTES

    @property
    def is_holding(self) -> bool:
        """Tell whether the rest of a torn line is held back."""
        return self._held is not None

    def wants(self, device_id: str, subscription: str) -> bool:
        """Tell whether it is to get a stream of a wristband now."""
        return (
            self.bound_to == device_id and subscription in self.subscriptions and not self.is_paused
        )

    def bind(self, device_id: str) -> None:
        """Bind to a wristband, or to none if it is empty; all subscriptions end."""
        self.bound_to = device_id
        self.subscriptions.clear()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Become one of the listener's clients, unless it has closed meanwhile."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        if not self._door.let_in(self):
            self.reset()

    def data_received(self, data: bytes) -> None:
        """Pass on whole lines; they may end CRLF or LF."""
        *lines, self._unfinished = (self._unfinished + data).split(b"\n")
        if len(self._unfinished) > _REQUEST_BYTES:
            self.reset()
        for line in lines:
            self._hear(self, line.decode("ascii", "replace").strip())

    def connection_lost(self, exc: Exception | None) -> None:
        """Be no client any more."""
        del exc
        self._transport = None
        self._ended.set()
        self._door.let_go(self)

    def write(self, data: bytes) -> None:
        """Send, if anything can be sent."""
        if self._held is not None:
            self._held += data
        elif self.has_room and self._transport is not None:
            self._transport.write(data)

    def write_torn(self, data: bytes, at: int, pause_s: float) -> None:
        """Send the first ``at`` bytes, and the rest and all that follows after a pause."""
        self.write(data[:at])
        self._held = bytearray(data[at:])
        asyncio.get_running_loop().call_later(pause_s, self._send_held)

    def stall(self) -> None:
        """Send nothing and read nothing."""
        self._is_stalled = True
        if self._transport is not None:
            self._transport.pause_reading()

    def resume(self) -> None:
        """End a `stall`; what was asked meanwhile is read now."""
        self._is_stalled = False
        if self._transport is not None and not self._transport.is_closing():
            self._transport.resume_reading()

    def close(self) -> None:
        """Close after what is still to be sent."""
        if self._transport is not None:
            self._transport.close()

    async def end(self) -> None:
        """Close without what is still to be sent, and wait until it is closed."""
        if self._transport is not None:
            self._transport.abort()
            await self._ended.wait()

    def reset(self) -> None:
        """Break the connection off with an RST, as a process does that is killed."""
        if self._transport is not None:
            break_off(self._transport)

    def _send_held(self) -> None:
        held, self._held = self._held, None
        if held is not None:
            self.write(bytes(held))

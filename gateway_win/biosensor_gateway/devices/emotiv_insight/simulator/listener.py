"""The server's socket and clients, with the faults of connections."""

from __future__ import annotations

import asyncio
import logging
import socket
import ssl
from collections.abc import Callable, Coroutine
from contextlib import suppress
from typing import Any

import trustme
from websockets.asyncio.connection import broadcast
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request
from websockets.protocol import State

from biosensor_gateway.simulation.tcp_port import LOOPBACK, KeptPort, break_off

_HOST = "localhost"


def server_context(authority: trustme.CA) -> ssl.SSLContext:
    """Return the TLS context of a local server, whose certificate the authority signs."""
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    with authority.issue_cert(_HOST).private_key_and_cert_chain_pem.tempfile() as path:
        context.load_cert_chain(path)
    return context


_CLOSE_TIMEOUT_S = 1.0
# Limit of data in TLS that the socket has not accepted yet.
_ROOM_BYTES = 1 << 15
# So high that the library never blocks a writer; `_ROOM_BYTES` limits the samples.
_WRITE_LIMIT_BYTES = 1 << 24
# For debugging a virtual service, only its clients' messages are interesting.
_wire_log = logging.getLogger("websockets.server.virtual_cortex")
_wire_log.setLevel(logging.WARNING)


class Client:
    """One connection."""

    def __init__(self, connection: ServerConnection) -> None:
        self._connection = connection
        self._is_stalled = False

    @property
    def is_open(self) -> bool:
        """Whether the connection is open."""
        return self._connection.state is State.OPEN

    @property
    def has_room(self) -> bool:
        """Whether a sample can be sent now; other messages are sent to slow readers, too."""
        unsent = self._connection.transport.get_write_buffer_size()
        return self.is_open and not self._is_stalled and unsent < _ROOM_BYTES

    def send(self, message: str | bytes) -> None:
        """Send a text or binary message, unless closed or stalled."""
        if self.is_open and not self._is_stalled:
            broadcast((self._connection,), message)

    def stall(self) -> None:
        """Stop sending and reading, including pings."""
        self._is_stalled = True
        self._connection.transport.pause_reading()

    def resume(self) -> None:
        """End a `stall`; messages received meanwhile are read now."""
        self._is_stalled = False
        if self._connection.state is not State.CLOSED:
            self._connection.transport.resume_reading()

    def abort(self) -> None:
        """Abort the connection, like a killed process."""
        break_off(self._connection.transport)

    async def close(self, code: int) -> None:
        """Close with the WebSocket closing handshake."""
        await self._connection.close(code)


class Listener:
    """A WebSocket server over TLS on the loopback interface.

    Parameters
    ----------
    gone
        Called with each client whose connection has ended.
    """

    def __init__(
        self,
        tls: ssl.SSLContext,
        hear: Callable[[Client, str | bytes], None],
        gone: Callable[[Client], None],
    ) -> None:
        self.clients: set[Client] = set()  # Clients that have finished the opening handshake.
        self._tls = tls
        self._hear = hear
        self._gone = gone
        self._port = KeptPort()
        self._is_open = False
        self._server: Server | None = None
        self._awake = asyncio.Event()
        self._awake.set()
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def port(self) -> int:
        """TCP port, which stays the same when reopened; 0 before the first opening."""
        return self._port.number

    def open(self) -> None:
        """Accept connections from now on."""
        listening = socket.create_server((LOOPBACK, self._port.take()))
        self._is_open = True
        self._spawn(self._serve_on(listening))

    def shut(self) -> None:
        """Refuse new connections; existing ones stay."""
        self._is_open = False
        if self._server is not None:
            self._server.close(close_connections=False)
            self._server = None

    def abort_all(self) -> None:
        """Abort all connections."""
        for client in self.clients:
            client.abort()

    def close_all(self, code: int) -> None:
        """Close all connections with the closing handshake."""
        for client in self.clients:
            self._spawn(client.close(code))

    def stall(self) -> None:
        """Stall all connections: nothing is answered, and no handshake is completed."""
        self._awake.clear()
        for client in self.clients:
            client.stall()

    def resume(self) -> None:
        """End a `stall`."""
        self._awake.set()
        for client in self.clients:
            client.resume()

    async def stop(self) -> None:
        """Close all connections and the port."""
        self.resume()
        await asyncio.gather(*self._tasks)
        server = self._server
        self.shut()
        self.close_all(1001)
        await asyncio.gather(*self._tasks)
        if server is not None:
            await server.wait_closed()
        self._port.give_back()

    async def _serve_on(self, listening: socket.socket) -> None:
        server = await serve(
            self._converse,
            sock=listening,
            ssl=self._tls,
            process_request=self._wait_until_awake,
            compression=None,
            open_timeout=None,
            ping_interval=None,
            close_timeout=_CLOSE_TIMEOUT_S,
            write_limit=_WRITE_LIMIT_BYTES,
            logger=_wire_log,
        )
        if self._is_open:
            self._server = server
        else:
            server.close(close_connections=False)

    async def _wait_until_awake(self, connection: ServerConnection, request: Request) -> None:
        del connection, request
        await self._awake.wait()

    async def _converse(self, connection: ServerConnection) -> None:
        client = Client(connection)
        self.clients.add(client)
        try:
            with suppress(ConnectionClosed):
                async for message in connection:
                    self._hear(client, message)
        finally:
            self.clients.discard(client)
            self._gone(client)

    def _spawn(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

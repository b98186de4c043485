"""The server's TCP port and who is connected to it."""

from __future__ import annotations

import asyncio
import socket
import sys

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.devices.empatica_e4.simulator.client import Client, Hear

_LOOK_EVERY_S = 0.01


class Listener:
    """A TCP server whose port stays its own while it is shut.

    Parameters
    ----------
    host
        Address to listen on.
    hear
        Gets each client's requests.

    Attributes
    ----------
    clients
        Those that are connected.
    """

    def __init__(self, host: str, hear: Hear) -> None:
        self.clients: set[Client] = set()
        self._host = host
        self._hear = hear
        self._socket: socket.socket | None = None
        self._port = 0
        self._serving: asyncio.Task[None] | None = None
        self._is_stalled = False

    @property
    def port(self) -> int:
        """TCP port, the same over all openings; 0 before the first."""
        return self._port

    def open(self) -> None:
        """Accept clients from now on.

        Raises
        ------
        TransportError
            BUSY if the port cannot be had.
        """
        listening = self._socket or self._bound()
        # Who comes before the loop serves waits in the backlog.
        listening.listen()
        self._socket = listening
        self._serving = asyncio.get_running_loop().create_task(self._serve(listening))

    def shut(self) -> None:
        """Refuse clients from now on, break off those that are connected, keep the port."""
        self._end_serving()
        self._socket = self._bound()
        self.reset_all()

    def reset_all(self) -> None:
        """Break every connection off."""
        for client in tuple(self.clients):
            client.reset()

    def stall(self) -> None:
        """Send and read nothing; connections stand, and new ones are taken."""
        self._is_stalled = True
        for client in self.clients:
            client.stall()

    def resume(self) -> None:
        """End a `stall`."""
        self._is_stalled = False
        for client in self.clients:
            client.resume()

    async def stop(self) -> None:
        """Close every connection and give the port back."""
        self._end_serving()
        self._socket = None
        for client in tuple(self.clients):
            await client.end()

    def let_in(self, client: Client) -> bool:
        """Take a client, unless the port was shut since it was accepted."""
        if self._serving is None:
            return False
        self.clients.add(client)
        if self._is_stalled:
            client.stall()
        return True

    def let_go(self, client: Client) -> None:
        """Forget a client whose connection has ended."""
        self.clients.discard(client)

    async def _serve(self, listening: socket.socket) -> None:
        # Not by asyncio's server: it loses who is accepted as it closes (`_attach` asserts that
        # it is open), and so does a `sock_accept` that is cancelled.
        while True:
            try:
                connection, _ = listening.accept()
            except (BlockingIOError, ConnectionAbortedError):
                await asyncio.sleep(_LOOK_EVERY_S)
                continue
            connection.setblocking(False)
            await asyncio.get_running_loop().connect_accepted_socket(
                lambda: Client(self, self._hear), connection
            )

    def _end_serving(self) -> None:
        if self._serving is not None:
            self._serving.cancel()
            self._serving = None
        if self._socket is not None:
            self._socket.close()

    def _bound(self) -> socket.socket:
        """Take the port without listening on it: connections are refused."""
        bound = socket.socket()
        if sys.platform != "win32":  # there it would let others take the same port
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.setblocking(False)
        try:
            bound.bind((self._host, self._port))
        except OSError as error:
            bound.close()
            message = f"port {self._port} of {self._host} cannot be had for a virtual E4 server"
            raise TransportError(TransportReason.BUSY, f"{message}: {error}") from error
        self._port = int(bound.getsockname()[1])
        return bound

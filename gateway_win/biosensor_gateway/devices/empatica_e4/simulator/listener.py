"""The server's TCP port and who is connected to it."""

from __future__ import annotations

import asyncio
import socket

from biosensor_gateway.devices.empatica_e4.simulator.client import Client, Hear
from biosensor_gateway.simulation.tcp_port import TcpPort


class Listener:
    """A TCP server whose port stays its own while it is shut.

    Parameters
    ----------
    hear
        Gets each client's requests.

    Attributes
    ----------
    clients
        Those that are connected.
    """

    def __init__(self, hear: Hear) -> None:
        self.clients: set[Client] = set()
        self._hear = hear
        self._port = TcpPort(self._connected)
        self._connecting: set[asyncio.Task[object]] = set()
        self._is_stalled = False

    @property
    def port(self) -> int:
        """TCP port, the same over all openings; 0 before the first."""
        return self._port.number

    def open(self) -> None:
        """Accept clients from now on.

        Raises
        ------
        TransportError
            BUSY if the port cannot be had.
        """
        self._port.open()

    def shut(self) -> None:
        """Refuse clients from now on, break off those that are connected, keep the port."""
        self._port.shut()
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
        self._port.close()
        for client in tuple(self.clients):
            await client.end()

    def let_in(self, client: Client) -> bool:
        """Take a client, unless the port was shut since it was accepted."""
        if not self._port.is_open:
            return False
        self.clients.add(client)
        # In Python 3.11.2, which Debian 12 has, asyncio reads from a new connection although that
        # was paused as it was made, so it is paused right after.
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

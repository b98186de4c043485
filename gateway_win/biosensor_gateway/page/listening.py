"""The sockets at which servers of the page listen."""

from __future__ import annotations

import socket


def listening_at(host: str, port: int) -> socket.socket:
    """Open a TCP socket whose connections send at once what they are given.

    asyncio asks for that only where a socket names its protocol, which those of
    `socket.create_server` do not. Else the second part of each answer waits for the browser to
    acknowledge the first, which it puts off by 40 ms (RFC 896 beside RFC 1122, 4.2.3.2).

    Parameters
    ----------
    port
        0 for one that the system chooses.

    Raises
    ------
    OSError
        The port is taken, or there is none.
    """
    listening = socket.create_server((host, port))
    # Accepted connections inherit it.
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return listening

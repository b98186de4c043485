"""Datagrams with the LSL time at which they came."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from pylsl import local_clock

from biosensor_gateway.transports.link import Received

Address = tuple[str, int]


class Datagrams(asyncio.DatagramProtocol):
    """Stamps each datagram when the loop hears of it, and hands it on."""

    def __init__(self, take: Callable[[Received, Address], None]) -> None:
        self._take = take

    def datagram_received(self, data: bytes, addr: Address) -> None:
        """Hand one on."""
        self._take(Received(data, local_clock()), (addr[0], addr[1]))

    def error_received(self, exc: Exception) -> None:
        """Pass over it: where nobody listens (yet), some systems say so at the next call."""

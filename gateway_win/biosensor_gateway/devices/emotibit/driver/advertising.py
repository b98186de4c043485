"""The channel on which EmotiBits are found.

The host asks on UDP port 3131, by broadcast or at an address, and each EmotiBit answers with
its id. Source: EmotiBit_FeatherWing, ``EmotiBitWiFi`` (MIT licence).
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from typing import NamedTuple

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.devices.emotibit.driver.protocol import Packet, Tag, read, write
from biosensor_gateway.transports.receiving import Address

ADVERTISING_PORT = 3131
BROADCAST_VARIABLE = "BIOSENSOR_GATEWAY_BROADCAST"
"""Environment variable with the address at which all EmotiBits are asked, where the usual one
does not reach them, as on a computer with several networks."""
BROADCAST = "255.255.255.255"
ASK_EVERY_S = 0.5
ANSWER_LIMIT_S = 3.0
AVAILABLE = "-1"
"""In place of a data port, from an EmotiBit that no host uses."""
_DATA_PORT, _DEVICE_ID = "DP", "DI"


class Nearby(NamedTuple):
    """An EmotiBit that answered.

    Attributes
    ----------
    address
        Of the answer.
    device
        Its id, such as ``MD-V5-0000123``; empty if it says none.
    in_use
        Whether a host uses it.
    """

    address: Address
    device: str
    in_use: bool

    def is_called(self, device: str) -> bool:
        """Whether it has this id."""
        return self.device.casefold() == device.casefold()


class _Answers(asyncio.DatagramProtocol):
    """Hands each datagram on."""

    def __init__(self, take: Callable[[bytes, Address], None]) -> None:
        self._take = take

    def datagram_received(self, data: bytes, addr: Address) -> None:
        self._take(data, (addr[0], addr[1]))

    def error_received(self, exc: Exception) -> None:
        """Pass over it: where nobody listens (yet), some systems say so at the next call."""


class Advertising:
    """The channel on which EmotiBits are found; open it, and close it."""

    def __init__(self, host: str, port: int) -> None:
        self._target = (host or os.environ.get(BROADCAST_VARIABLE) or BROADCAST, port)
        self._transport: asyncio.DatagramTransport | None = None
        self._number = 0
        self._heard: asyncio.Queue[tuple[Packet, Address]] = asyncio.Queue()

    async def open(self) -> None:
        """Open the socket.

        Raises
        ------
        TransportError
            ``UNAVAILABLE`` if there is no network, or no such host.
        """
        loop = asyncio.get_running_loop()
        try:
            self._transport, _ = await loop.create_datagram_endpoint(
                lambda: _Answers(self._take),
                ("0.0.0.0", 0),  # noqa: S104 - answers come by whatever network there is
                allow_broadcast=True,
            )
        except OSError as error:
            message = f"EmotiBit: no UDP on this computer ({error}); is there a network?"
            raise TransportError(TransportReason.UNAVAILABLE, message) from error

    def close(self) -> None:
        """Close the socket; may be called twice."""
        if self._transport is not None:
            self._transport.close()
            self._transport = None

    def tell(self, tag: Tag, *payload: str, to: Address | None = None) -> None:
        """Send a packet, to all unless it is for one."""
        if self._transport is not None:
            self._transport.sendto(write(tag, self._number, payload), to or self._target)
            self._number += 1

    async def hear(self) -> tuple[Packet, Address]:
        """Wait for the next packet."""
        return await self._heard.get()

    async def nearby(self, limit_s: float, wanted: str = "", *, first: bool) -> list[Nearby]:
        """Ask who is there.

        Parameters
        ----------
        limit_s
            How long to wait for answers.
        wanted
            Id of the device whose answer ends the waiting; empty for none.
        first
            Whether any answer ends it.
        """
        found: dict[Address, Nearby] = {}
        asking = asyncio.create_task(self._ask())
        try:
            async with asyncio.timeout(limit_s):
                while not any(first or each.is_called(wanted) for each in found.values()):
                    packet, address = await self.hear()
                    if packet.tag == Tag.HELLO_HOST:
                        port = packet.labelled(_DATA_PORT)
                        device = packet.labelled(_DEVICE_ID) or ""
                        found[address] = Nearby(address, device, port not in (AVAILABLE, None))
        except TimeoutError:
            pass
        finally:
            asking.cancel()
        return list(found.values())

    async def _ask(self) -> None:
        while True:
            self.tell(Tag.HELLO_EMOTIBIT)
            await asyncio.sleep(ASK_EVERY_S)

    def _take(self, data: bytes, address: Address) -> None:
        for packet in read(data).packets:
            self._heard.put_nowait((packet, address))

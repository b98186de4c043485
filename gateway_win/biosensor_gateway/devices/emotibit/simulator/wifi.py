"""The socket on which hosts ask for EmotiBits."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from types import MappingProxyType

from biosensor_gateway.devices.emotibit.simulator import wire
from biosensor_gateway.simulation.effects import Effects, lasting
from biosensor_gateway.simulation.faults import Untidiness

Address = tuple[str, int]


class Wifi(asyncio.DatagramProtocol):
    """The advertising channel, and how good the air is.

    Parameters
    ----------
    asked
        Gets each packet of a host, with its address.
    host, port
        Address and UDP port on which it can be asked; 0 takes a free one.

    Attributes
    ----------
    host
        Its address.
    is_there
        Whether it is in the Wi-Fi.
    to_lose
        So many datagrams of data do not come through.
    overtakes
        Whether each third datagram comes behind the next one.
    """

    def __init__(
        self, asked: Callable[[wire.Message, Address], None], host: str, port: int
    ) -> None:
        self._asked = asked
        self.host = host
        self._port = port
        self._transport: asyncio.DatagramTransport | None = None
        self._number = 0
        self.is_there = True
        self.to_lose = 0
        self.overtakes = False
        self._datagrams = 0
        self._overtaken: bytes | None = None

    @property
    def port(self) -> int:
        """The UDP port on which it can be asked."""
        if self._transport is None:
            raise RuntimeError("the virtual EmotiBit is not switched on")
        return int(self._transport.get_extra_info("sockname")[1])

    async def open(self) -> None:
        """Be in the Wi-Fi."""
        loop = asyncio.get_running_loop()
        self._transport, _ = await loop.create_datagram_endpoint(
            lambda: self, (self.host, self._port)
        )

    def close(self) -> None:
        """Leave the Wi-Fi."""
        if self._transport is not None:
            self._transport.close()
            self._transport = None

    def is_let_through(self) -> bool:
        """Whether the next datagram of data arrives."""
        if self.to_lose:
            self.to_lose -= 1
            return False
        return True

    def in_turn(self, datagram: bytes) -> list[bytes]:
        """Return what of the data arrives now: usually the datagram, as long as none overtakes."""
        self._datagrams += 1
        overtaken, self._overtaken = self._overtaken, None
        if overtaken is not None:
            return [datagram, overtaken]
        if self.overtakes and self._datagrams % 3 == 0:
            self._overtaken = datagram
            return []
        return [datagram]

    def tell(self, time_ms: int, tag: str, payload: list[str], address: Address) -> None:
        """Send a host a packet."""
        if self._transport is not None and self.is_there:
            self._transport.sendto(wire.packet(time_ms, self._number, tag, payload), address)
            self._number += 1

    def datagram_received(self, data: bytes, addr: Address) -> None:
        """Hand a host's packet on; one a datagram, as the firmware has it."""
        if self.is_there:
            self._asked(wire.heard(data.split(b"\n")[0]), (addr[0], addr[1]))

    def error_received(self, exc: Exception) -> None:
        """Pass over a host that is gone."""


def _overtake(wifi: Wifi) -> None:
    wifi.overtakes = True


def _keep_order(wifi: Wifi) -> None:
    wifi.overtakes = False


WIFI_EFFECTS: Effects[Wifi] = MappingProxyType(
    {Untidiness.OVERTAKEN: lasting(_overtake, _keep_order)}
)

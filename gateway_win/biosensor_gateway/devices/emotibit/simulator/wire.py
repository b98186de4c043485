"""Encodes an EmotiBit's packets, and parses a host's.

Source: EmotiBit_XPlat_Utils, ``EmotiBitPacket`` (MIT licence).
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import NamedTuple

from biosensor_gateway.simulation.tcp_port import break_off

LONGEST_DATAGRAM = 512
HELLO, HERE, CONNECT, PING, PONG = "HE", "HH", "EC", "PN", "PO"
DISCONNECT, NORMAL_POWER = "ED", "MN"
QUIET = frozenset({"ML", "MM"})
"""Low-power modes, in which it is connected but sends no data."""
REQUEST, TIME_LOCAL, TIME_UTC, ACKNOWLEDGED = "RD", "TL", "TU", "AK"


class Message(NamedTuple):
    """A packet of a host."""

    tag: str
    payload: tuple[str, ...]

    def behind(self, label: str) -> int | None:
        """Return the number after a label in the payload."""
        if label not in self.payload[:-1]:
            return None
        return int(self.payload[self.payload.index(label) + 1])


def packet(time_ms: int, number: int, tag: str, payload: Sequence[str], version: int = 1) -> bytes:
    """Return a packet with its line feed."""
    header = f"{time_ms},{number % 65536},{len(payload)},{tag},{version},100"
    return ",".join([header, *payload]).encode("ascii") + b"\n"


def heard(line: bytes) -> Message:
    """Parse a host's packet without its line feed."""
    fields = line.decode("ascii").strip().split(",")
    return Message(fields[3], tuple(fields[6:]))


def datagrams(packets: Sequence[bytes]) -> list[list[bytes]]:
    """Group packets into datagrams of limited size."""
    packed: list[list[bytes]] = [[]]
    for each in packets:
        if packed[-1] and sum(map(len, packed[-1])) + len(each) > LONGEST_DATAGRAM:
            packed.append([])
        packed[-1].append(each)
    return [each for each in packed if each]


class _Answers(asyncio.DatagramProtocol):
    """Receives a host's packets on the data channel."""

    def __init__(self, obey: Callable[[Message], None]) -> None:
        self._obey = obey

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        """Process one packet per datagram, like the firmware."""
        self._obey(heard(data.split(b"\n")[0]))

    def error_received(self, exc: Exception) -> None:
        """Ignore that a host is gone."""


class Host(asyncio.Protocol):
    """One connection to a host.

    Parameters
    ----------
    here
        Address of the device.
    host, control_port, data_port
        Address and ports of the host.
    obey
        Called with each packet that it sends on either channel.
    lost
        Called when it ends the connection.

    Attributes
    ----------
    data_port
        Identifies the same host.
    pinged_s
        Time of its last ping.
    """

    def __init__(
        self,
        here: str,
        host: str,
        control_port: int,
        data_port: int,
        obey: Callable[[Message], None],
        lost: Callable[[], None],
    ) -> None:
        self._here = here
        self._host = host
        self._control_port = control_port
        self.data_port = data_port
        self.pinged_s = 0.0
        self._obey = obey
        self._lost = lost
        self._control: asyncio.Transport | None = None
        self._connecting: asyncio.Task[None] | None = None
        self._rest = b""
        self._data: asyncio.DatagramTransport | None = None

    def connect(self, done: Callable[[], None]) -> None:
        """Connect the control channel, without which no data are sent, and call *done*."""

        async def connect() -> None:
            loop = asyncio.get_running_loop()
            with suppress(OSError):
                self._data, _ = await loop.create_datagram_endpoint(
                    lambda: _Answers(self._obey), (self._here, 0)
                )
                await loop.create_connection(
                    lambda: self, self._host, self._control_port, local_addr=(self._here, 0)
                )
                done()
                return
            self._lost()

        self._connecting = asyncio.create_task(connect())

    def send(self, datagram: bytes) -> bool:
        """Send data; return False without a connection."""
        if self._control is None or self._data is None:
            return False
        self._data.sendto(datagram, (self._host, self.data_port))
        return True

    def close(self) -> None:
        """Close the connection to the host."""
        if self._connecting is not None:
            self._connecting.cancel()
        if self._control is not None:
            break_off(self._control)
            self._control = None
        if self._data is not None:
            self._data.close()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Set up the control channel."""
        assert isinstance(transport, asyncio.Transport)
        self._control = transport

    def data_received(self, data: bytes) -> None:
        """Execute complete packets."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            self._obey(heard(line))

    def connection_lost(self, exc: Exception | None) -> None:
        """Note that the host has ended it."""
        if self._control is not None:
            self._control = None
            self._lost()

"""Control (TCP) and data (UDP) channels of one EmotiBit.

The host sends the wanted EmotiBit two port numbers: the EmotiBit connects to the first by TCP and
sends its data to the second by UDP. It continues as long as it gets a ping every ten seconds.
Source: EmotiBit_FeatherWing, ``EmotiBitWiFi`` (MIT licence).
"""

from __future__ import annotations

import asyncio
import os
from contextlib import suppress
from typing import NamedTuple

from biosensor_common.errors import (
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_gateway.devices.emotibit.driver.protocol import Packet, Read, Tag, read, write
from biosensor_gateway.system.clock import LSL_CLOCK
from biosensor_gateway.transports.link import Address
from biosensor_gateway.transports.ports import (
    ASKING,
    CONTROL,
    DATA,
    Accepting,
    DataPort,
    Ports,
)
from biosensor_gateway.transports.tap import LinkTap, What, ports_of_device

ADVERTISING_PORT = 3131
BROADCAST_VARIABLE = "BIOSENSOR_GATEWAY_BROADCAST"
"""Environment variable with the broadcast address for finding EmotiBits, if the default does not
reach them, for example on a computer with several networks."""
BROADCAST = "255.255.255.255"
ASK_EVERY_S = 0.5
ANSWER_LIMIT_S = 3.0
AVAILABLE = "-1"
"""Value instead of a data port in answers of an EmotiBit without a host."""
_DATA_PORT, _DEVICE_ID = "DP", "DI"


class Nearby(NamedTuple):
    """An EmotiBit that answered."""

    address: Address
    device: str  # Its id, such as `MD-V5-0000123`; empty if unknown.
    in_use: bool  # Whether a host uses it.

    def is_called(self, device: str) -> bool:
        """Whether it has this id."""
        return self.device.casefold() == device.casefold()


class Advertising:
    """The UDP channel for finding EmotiBits; must be opened and closed."""

    def __init__(self, host: str, port: int) -> None:
        self._target = (host or os.environ.get(BROADCAST_VARIABLE) or BROADCAST, port)
        self.ports = ports_of_device()
        """Ports, also for the other channels of the EmotiBit found."""
        self.tap = LinkTap(LSL_CLOCK)
        """Captures the traffic of all channels."""
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
        try:
            self._transport = await self.ports.asking(self._take)
        except OSError as error:
            message = f"EmotiBit: no UDP on this computer ({error}); is there a network?"
            raise TransportError(TransportReason.UNAVAILABLE, message) from error
        self.tap.opened(None, [])

    def close(self) -> None:
        """Close the socket; may be called twice."""
        if self._transport is not None:
            self._transport.close()
            self._transport = None
            self.tap.ended(What.CLOSED)

    def tell(self, tag: Tag, *payload: str, to: Address | None = None) -> None:
        """Send a packet, as a broadcast unless an address is given."""
        if self._transport is not None:
            data = write(tag, self._number, payload)
            self._transport.sendto(data, to or self._target)
            self.tap.came(What.SENT, ASKING, data, LSL_CLOCK())
            self._number += 1

    async def hear(self) -> tuple[Packet, Address]:
        """Wait for the next packet."""
        return await self._heard.get()

    async def nearby(self, limit_s: float, wanted: str = "", *, first: bool) -> list[Nearby]:
        """Search for EmotiBits.

        Parameters
        ----------
        limit_s
            How long to wait for answers.
        wanted
            Id of the device whose answer ends the search; empty for none.
        first
            Whether any answer ends the search.
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
        self.tap.came(What.CAME, ASKING, data, LSL_CLOCK())
        for packet in read(data).packets:
            self._heard.put_nowait((packet, address))


CONNECT_LIMIT_S = 5.0
PING_EVERY_S = 1.0
_CONTROL_PORT = "CP"
# After a pause of this length, all data sent before the end have arrived.
_QUIET_S = 0.05


class Arrived(NamedTuple):
    """A data datagram."""

    found: Read
    arrival_s: float
    address: Address  # Sender's address, to which answers are sent.


class _Control(asyncio.Protocol):
    """The control channel; the device sends nothing on it, so only its end matters."""

    def __init__(self, link: Link) -> None:
        self._link: Link | None = link

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        if self._link is not None and not self._link.take_control(transport):
            self._link = None
            transport.close()

    def connection_lost(self, exc: Exception | None) -> None:
        if self._link is not None:
            self._link.lose_control()


class Link:
    """Control and data channels of one EmotiBit, for one connection.

    Parameters
    ----------
    name
        What errors call the device.
    host
        Its address; data from other addresses are ignored.
    ports
        Ports as used for finding it.
    """

    def __init__(self, name: str, host: str, ports: Ports, tap: LinkTap) -> None:
        self.name = name
        self._host = host
        self._ports, self._tap = ports, tap
        self._server: Accepting | None = None
        self._control: asyncio.Transport | None = None
        self._is_controlled = asyncio.Event()
        self._data: DataPort | None = None
        self._arrived: asyncio.Queue[Arrived | TransportError] = asyncio.Queue()
        self._number = 0
        self._datagrams = 0

    async def open(self) -> None:
        """Listen on two ports.

        Raises
        ------
        TransportError
            ``UNAVAILABLE``.
        """
        try:
            here = self._ports.towards(self._host)
            self._server = await self._ports.accepting(lambda: _Control(self), here)
            self._data = self._ports.data(here)
        except OSError as error:
            message = f"{self.name}: no port for its data on this computer ({error})"
            raise TransportError(TransportReason.UNAVAILABLE, message) from error
        # The control channel shows when the device has gone.
        self._data.listen(self._take, lambda _: None)

    @property
    def payload(self) -> tuple[str, ...]:
        """Payload with the ports to which the device should connect."""
        assert self._server is not None
        return (_CONTROL_PORT, str(self._server.number), *self.data_payload)

    @property
    def data_payload(self) -> tuple[str, ...]:
        """Payload that identifies the device's own host."""
        assert self._data is not None
        return (_DATA_PORT, str(self._data.number))

    async def controlled(self, limit_s: float) -> bool:
        """Wait until the device has connected; return False after the time limit."""
        with suppress(TimeoutError):
            await asyncio.wait_for(self._is_controlled.wait(), limit_s)
        return self._is_controlled.is_set()

    def control(self, tag: Tag) -> None:
        """Send a command."""
        if self._control is not None and not self._control.is_closing():
            data = write(tag, self._number)
            self._control.write(data)
            self._tap.came(What.SENT, CONTROL, data, LSL_CLOCK())
            self._number += 1

    def answer(self, tag: Tag, payload: tuple[str, ...], to: Address) -> None:
        """Send a packet to the sender of data."""
        if self._data is not None:
            data = write(tag, self._number, payload)
            self._data.send(data, to)
            self._tap.came(What.SENT, DATA, data, LSL_CLOCK())
            self._number += 1

    async def read(self) -> Arrived:
        """Wait for the next datagram.

        Raises
        ------
        TransportError
            ``LOST`` when the device has ended the connection.
        """
        item = await self._arrived.get()
        if isinstance(item, TransportError):
            self._arrived.put_nowait(item)
            raise item
        return item

    async def close(self) -> None:
        """Disconnect the device and close; never raises."""
        self.control(Tag.DISCONNECT)
        if self._server is not None:
            self._server.close()
        if self._control is not None:
            self._control.close()
        if self._data is not None:
            self._data.end()

    def take_control(self, control: asyncio.Transport) -> bool:
        """Accept a connection; return False if it is not the device's."""
        host = control.get_extra_info("peername")[0]
        if self._control is not None or host != self._host:
            return False
        self._control = control
        self._tap.came(What.CAME, CONTROL, b"", LSL_CLOCK())
        self._is_controlled.set()
        return True

    def lose_control(self) -> None:
        """Report the end of the connection once all data that was sent before it has been read.

        After this computer was asleep, that may be seconds of data.
        """
        self._end_when_quiet(-1)

    def _end_when_quiet(self, before: int) -> None:
        if self._datagrams != before:
            loop = asyncio.get_running_loop()
            loop.call_later(_QUIET_S, self._end_when_quiet, self._datagrams)
            return
        self._tap.ended(What.LOST)
        message = f"{self.name}: the link was cut; is it on, charged and in the Wi-Fi?"
        self._arrived.put_nowait(TransportError(TransportReason.LOST, message))

    def _take(self, data: bytes, arrival_s: float, address: Address) -> None:
        if address[0] == self._host:
            self._datagrams += 1
            if self._tap.is_heard:
                self._tap.came(What.CAME, DATA, data, arrival_s)
            self._arrived.put_nowait(Arrived(read(data), arrival_s, address))


async def connect(advertising: Advertising, link: Link, nearby: Nearby) -> None:
    """Let the EmotiBit connect to a link.

    Raises
    ------
    TransportError, ProtocolError
        ``BUSY`` if another host uses it; ``NO_REPLY``.
    """
    advertising.tell(Tag.CONNECT, *link.payload, to=nearby.address)
    if await link.controlled(CONNECT_LIMIT_S):
        return
    if nearby.in_use:
        message = f"{link.name} refuses: another program or computer uses it; end that connection"
        raise TransportError(TransportReason.BUSY, message)
    message = (
        f"{link.name}: it answers but does not connect; does a firewall on this computer block it?"
    )
    raise ProtocolError(ProtocolReason.NO_REPLY, message)

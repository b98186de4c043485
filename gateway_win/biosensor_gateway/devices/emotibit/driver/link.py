"""Control (TCP) and data (UDP) of one EmotiBit.

To the one that is wanted the host names two ports of its own: the EmotiBit connects to the first
one by TCP and sends its data to the second one. It goes on as long as it gets a ping every ten
seconds. Source: EmotiBit_FeatherWing, ``EmotiBitWiFi`` (MIT licence).
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
    Asking,
    DataPort,
    Ports,
)
from biosensor_gateway.transports.tap import LinkTap, What, ports_of_device

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


class Advertising:
    """The channel on which EmotiBits are found; open it, and close it."""

    def __init__(self, host: str, port: int) -> None:
        self._target = (host or os.environ.get(BROADCAST_VARIABLE) or BROADCAST, port)
        self.ports = ports_of_device()
        """Also those of the other channels of an EmotiBit that is found."""
        self.tap = LinkTap(LSL_CLOCK)
        """Is told what passes, as are those."""
        self._transport: Asking | None = None
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
        """Send a packet, to all unless it is for one."""
        if self._transport is not None:
            data = write(tag, self._number, payload)
            self._transport.sendto(data, to or self._target)
            self.tap.came(What.SENT, ASKING, data, LSL_CLOCK())
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
        self.tap.came(What.CAME, ASKING, data, LSL_CLOCK())
        for packet in read(data).packets:
            self._heard.put_nowait((packet, address))


CONNECT_LIMIT_S = 5.0
PING_EVERY_S = 1.0
_CONTROL_PORT = "CP"
_QUIET_S = 0.05
"""When no more data came for so long, there is nothing left from before the end."""


class Arrived(NamedTuple):
    """A datagram of data.

    Attributes
    ----------
    found
        What it holds.
    arrival_s
        LSL clock.
    address
        Where it came from, to which answers go.
    """

    found: Read
    arrival_s: float
    address: Address


class _Control(asyncio.Protocol):
    """The channel of control, on which the device has nothing to say: its end is waited for."""

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
    """Control and data of one EmotiBit, for one connection.

    Parameters
    ----------
    name
        What errors call the device.
    host
        Its address: nobody else is listened to.
    ports
        Those by which it was found.
    tap
        Is told what passes.
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
        # That the device has gone, the control channel tells.
        self._data.listen(self._take, lambda _: None)

    @property
    def payload(self) -> tuple[str, ...]:
        """What tells the device where to connect."""
        assert self._server is not None
        return (_CONTROL_PORT, str(self._server.number), *self.data_payload)

    @property
    def data_payload(self) -> tuple[str, ...]:
        """What tells the device that it is its own host who asks."""
        assert self._data is not None
        return (_DATA_PORT, str(self._data.number))

    async def controlled(self, limit_s: float) -> bool:
        """Wait until the device has connected; return whether it has in time."""
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
        """Send a packet to where data came from."""
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
        """Let the device go, and close; never raises."""
        self.control(Tag.DISCONNECT)
        if self._server is not None:
            self._server.close()
        if self._control is not None:
            self._control.close()
        if self._data is not None:
            self._data.end()

    def take_control(self, control: asyncio.Transport) -> bool:
        """Take a connection that was made; return False for one that is not the device's."""
        host = control.get_extra_info("peername")[0]
        if self._control is not None or host != self._host:
            return False
        self._control = control
        self._tap.came(What.CAME, CONTROL, b"", LSL_CLOCK())
        self._is_controlled.set()
        return True

    def lose_control(self) -> None:
        """Tell that the device has ended the connection, once what it sent before that is read.

        There may be seconds of it, where this computer slept.
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
    """Have the EmotiBit connect to a link.

    Raises
    ------
    TransportError, ProtocolError
        ``BUSY`` if another host uses it; ``NO_REPLY``.
    """
    advertising.tell(Tag.CONNECT, *link.payload, to=nearby.address)
    if await link.controlled(CONNECT_LIMIT_S):
        return
    if nearby.in_use:
        message = f"{link.name} refuses: another program or computer uses it; end that one"
        raise TransportError(TransportReason.BUSY, message)
    message = (
        f"{link.name}: it answers and does not connect; does a firewall of this computer refuse it?"
    )
    raise ProtocolError(ProtocolReason.NO_REPLY, message)

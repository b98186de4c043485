"""Links in memory, with the interfaces of those of the product, for unit tests in virtual time.

The product reads serial ports, TCP and UDP in threads, which no clock can tell to wait. Here the
event loop reads them. All that leads to a link, and what its errors say, is the product's.
"""

from __future__ import annotations

import asyncio
import errno
import itertools
import math
import os
import socket
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, ClassVar, Self
from urllib.parse import urlsplit

import numpy as np
import pylsl
import pytest
import serial
from numpy.typing import NDArray

from biosensor_gateway.devices.line_sensor import driver as line_driver
from biosensor_gateway.simulation import async_serial
from biosensor_gateway.simulation.async_serial import TcpSerialPort
from biosensor_gateway.system.clock import LSL_CLOCK
from biosensor_gateway.transports import byte_links, ports
from biosensor_gateway.transports.byte_links import FAREWELL_S, TcpLink
from biosensor_gateway.transports.ports import Take, UdpPort
from biosensor_gateway.transports.serial_port import USUAL_BAUD_RATE, SerialLink
from biosensor_gateway.transports.threads import Traffic
from tests.rigs.virtual_time import clock_of_the_test

_READ_BYTES = 1 << 16
_TERMINAL_BYTES = 1 << 14
"""What a pseudo-terminal keeps for a host that does not read."""


class _Stream(asyncio.Protocol):
    """A connection whose bytes go into a link's traffic."""

    def __init__(self, traffic: Traffic) -> None:
        self._traffic = traffic
        self._transport: asyncio.Transport | None = None
        self._has_ended = asyncio.Event()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        # No thread has anything to do.
        self._traffic.start(lambda: None, lambda: None)

    def data_received(self, data: bytes) -> None:
        if not self._traffic.closing:
            self._traffic.deliver(data, LSL_CLOCK())

    def connection_lost(self, exc: Exception | None) -> None:
        self._traffic.lost(exc)
        self._has_ended.set()

    def write(self, data: bytes) -> None:
        assert self._transport is not None
        self._transport.write(data)

    async def close(self, farewell_s: float) -> None:
        """Send what is waiting, give the other side some time to hang up too, and close."""
        assert self._transport is not None
        self._traffic.closing = True
        if farewell_s and not self._transport.is_closing():
            self._transport.write_eof()
            with suppress(TimeoutError):
                async with asyncio.timeout(farewell_s):
                    await self._has_ended.wait()
        self._transport.close()
        with suppress(TimeoutError):
            async with asyncio.timeout(FAREWELL_S):
                await self._has_ended.wait()
        self._transport.abort()


class MemoryTcpLink(TcpLink):
    """Takes the place of `TcpLink`."""

    def __init__(self, host: str, port: int) -> None:
        super().__init__(host, port)
        self._stream: _Stream | None = None

    async def open(self) -> None:
        loop = asyncio.get_running_loop()
        try:
            _, self._stream = await loop.create_connection(
                lambda: _Stream(self._traffic), self._host, self._port
            )
        except OSError as error:
            raise self._open_error(error) from error

    def write(self, data: bytes) -> None:
        if self._stream is not None:
            self._stream.write(data)

    async def close(self) -> None:
        if self._stream is not None:
            await self._stream.close(FAREWELL_S)


class MemoryPort(TcpSerialPort):
    """Takes the place of `PtyPort`: hosts find it by a name like those of serial ports."""

    numbers = itertools.count()
    tcp_ports: ClassVar[dict[str, int]] = {}
    held: ClassVar[set[str]] = set()

    def __init__(
        self, heard: Callable[[bytes], None], left: Callable[[], None], buffer_bytes: int
    ) -> None:
        super().__init__(heard, left, buffer_bytes)
        self._name = f"/dev/memory{next(self.numbers)}"

    @property
    def name(self) -> str:
        return self._name

    def open(self) -> None:
        super().open()
        self.tcp_ports[self._name] = self._port.number

    def hang_up(self) -> None:
        self.tcp_ports.pop(self._name, None)
        super().hang_up()

    def dispose(self) -> None:
        self.tcp_ports.pop(self._name, None)
        super().dispose()

    @classmethod
    def connected(cls, name: str) -> socket.socket:
        """Return the host's end of a port; raise OSError as the system does."""
        port = cls.tcp_ports.get(name)
        if port is None:
            raise OSError(errno.ENOENT, os.strerror(errno.ENOENT), name)
        if name in cls.held:
            raise OSError(errno.EBUSY, os.strerror(errno.EBUSY), name)
        host = socket.socket()
        host.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _TERMINAL_BYTES)
        host.connect(("127.0.0.1", port))
        return host


class MemorySerialLink(SerialLink):
    """Takes the place of `SerialLink`, for a `MemoryPort`."""

    def __init__(self, port: str, baudrate: int = USUAL_BAUD_RATE) -> None:
        super().__init__(port, baudrate)
        self._stream: _Stream | None = None

    async def open(self) -> None:
        loop = asyncio.get_running_loop()
        try:
            host = MemoryPort.connected(self._name)
        except OSError as error:
            raise self._open_error(error) from error
        MemoryPort.held.add(self._name)
        _, self._stream = await loop.create_connection(lambda: _Stream(self._traffic), sock=host)

    def write(self, data: bytes) -> None:
        if self._stream is not None:
            self._stream.write(data)

    async def close(self) -> None:
        if self._stream is not None:
            MemoryPort.held.discard(self._name)
            await self._stream.close(0.0)


class MemorySerial:
    """Takes the place of pyserial, for hosts that are no driver's."""

    def __init__(
        self,
        port: str,
        baudrate: int = USUAL_BAUD_RATE,
        timeout: float | None = None,
        write_timeout: float | None = None,
    ) -> None:
        del baudrate, write_timeout
        if port.startswith("socket://"):
            address = urlsplit(port)
            self._socket = socket.create_connection((address.hostname, address.port))
        else:
            self._socket = MemoryPort.connected(port)
        self.timeout = timeout

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def in_waiting(self) -> int:
        """How much can be read at once."""
        self._socket.settimeout(0.0)
        try:
            return len(self._socket.recv(_READ_BYTES, socket.MSG_PEEK))
        except BlockingIOError:
            return 0

    def read(self, size: int = 1) -> bytes:
        """Return so many bytes, or fewer if the time is over."""
        data = b""
        until_s = math.inf if self.timeout is None else LSL_CLOCK() + self.timeout
        with suppress(TimeoutError):
            while len(data) < size:
                left_s = max(0.0, until_s - LSL_CLOCK())
                self._socket.settimeout(None if math.isinf(left_s) else left_s)
                with suppress(BlockingIOError):
                    piece = self._socket.recv(size - len(data))
                    if not piece:
                        raise serial.SerialException("the device has hung up")
                    data += piece
                if left_s == 0:
                    break
        return data

    def write(self, data: bytes) -> int:
        """Send all of it."""
        self._socket.settimeout(None)
        self._socket.sendall(data)
        return len(data)

    def close(self) -> None:
        """Let the port go."""
        self._socket.close()


class MemoryUdpPort(UdpPort):
    """Takes the place of `UdpPort`."""

    def listen(self, take: Take, lost: Callable[[OSError], object]) -> None:
        del lost
        loop = asyncio.get_running_loop()
        self._socket.setblocking(False)

        def read() -> None:
            with suppress(BlockingIOError):
                while not self._closing:
                    data, (host, port, *_) = self._socket.recvfrom(_READ_BYTES)
                    take(data, LSL_CLOCK(), (host, port))

        loop.add_reader(self._socket.fileno(), read)

    def end(self) -> None:
        super().end()
        if self._socket.fileno() != -1:
            asyncio.get_running_loop().remove_reader(self._socket.fileno())
        self._socket.close()


@contextmanager
def links_in_memory() -> Generator[None]:
    """Have all links in memory, and all clocks virtual."""
    with clock_of_the_test.everywhere(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(async_serial, "PtyPort", MemoryPort)
        patch.setattr(byte_links, "SerialLink", MemorySerialLink)
        for opened in ("Serial", "serial_for_url"):
            patch.setattr(serial, opened, MemorySerial)
        patch.setattr(byte_links, "TcpLink", MemoryTcpLink)
        for user in (line_driver, ports):
            patch.setattr(user, "UdpPort", MemoryUdpPort)
        patch.setattr(MemoryPort, "tcp_ports", {})
        patch.setattr(MemoryPort, "held", set[str]())
        yield


class MemoryOutlet:
    """Takes what `LslOutlet` takes and keeps nothing; it always has consumers."""

    def __init__(self, info: pylsl.StreamInfo) -> None:
        self.channel_count = info.channel_count()
        self.is_text = info.channel_format() == pylsl.cf_string
        self._info = info

    def get_info(self) -> pylsl.StreamInfo:
        """Return the description of the stream, which has no uid here."""
        return self._info

    def push_sample(
        self, x: Sequence[Any] | NDArray[Any], timestamp: float = 0.0, pushthrough: bool = True
    ) -> None:
        """Take a sample of the right width."""
        assert len(x) == self.channel_count

    def push_chunk(
        self,
        x: Sequence[Any] | NDArray[Any],
        timestamp: float | Sequence[float] | NDArray[np.float64] = 0.0,
        pushthrough: bool = True,
    ) -> None:
        """Take samples of the right width, each with a stamp."""
        assert np.ndim(timestamp) == 0 or np.shape(timestamp) == (len(x),)
        assert np.shape(x) == (len(x), self.channel_count)

    def have_consumers(self) -> bool:
        """Whether somebody receives it: always, so that nothing waits."""
        return True

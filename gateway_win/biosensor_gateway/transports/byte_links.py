"""Creates the link for a device's ``port`` setting: a serial port or a socket."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import re
import socket
import sys
from collections.abc import Callable
from urllib.parse import urlsplit

from biosensor_common.errors import ConfigError, ConfigReason, TransportError, TransportReason
from biosensor_gateway.system.clock import LSL_CLOCK
from biosensor_gateway.transports.link import ByteLink, Received, Receiver
from biosensor_gateway.transports.serial_port import USUAL_BAUD_RATE, SerialLink
from biosensor_gateway.transports.tap import byte_link_of
from biosensor_gateway.transports.threads import Traffic, in_daemon_thread

OPEN_TIMEOUT_S = 20.0
WRITE_TIMEOUT_S = 2.0
CLOSE_TIMEOUT_S = 1.0
FAREWELL_S = 0.5
"""How long a closing link waits for the other side to hang up, too."""


class SocketLink:
    """A connected socket as a :class:`~biosensor_gateway.transports.link.ByteLink`.

    Parameters
    ----------
    name
        Name in error messages.
    connect
        Returns the connected, blocking socket; runs in a separate thread.
    open_error
        Converts an exception of `connect` to the error that a user sees.
    advice
        What to check if the connection has ended.
    """

    def __init__(
        self,
        name: str,
        connect: Callable[[], socket.socket],
        open_error: Callable[[OSError], TransportError],
        advice: str,
    ) -> None:
        self._name = name
        self._connect = connect
        self._open_error = open_error
        self._socket: socket.socket | None = None
        self._traffic = Traffic(name, advice)

    async def open(self) -> None:
        """Connect; see :class:`~biosensor_gateway.transports.link.ByteLink`."""
        try:
            async with asyncio.timeout(OPEN_TIMEOUT_S):
                connected = await in_daemon_thread(self._open_socket)
        except TimeoutError as error:
            self._traffic.closing = True
            raise self._open_error(error) from error
        except OSError as error:
            raise self._open_error(error) from error
        self._traffic.start(
            lambda: self._read_forever(connected), lambda: self._write_forever(connected)
        )

    async def read(self) -> Received:
        """Wait for the next bytes; raise ``LOST`` if the connection has ended."""
        return await self._traffic.read()

    def write(self, data: bytes) -> None:
        """Queue bytes for the writing thread."""
        self._traffic.write(data)

    async def close(self) -> None:
        """Send the queued bytes, then close the socket."""
        self._traffic.closing = True
        self._traffic.end_writing()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(CLOSE_TIMEOUT_S + FAREWELL_S):
                await in_daemon_thread(self._end)

    def _open_socket(self) -> socket.socket:
        connected = self._connect()
        # One timeout serves both ways: the reader tries again, the writer gives up.
        connected.settimeout(WRITE_TIMEOUT_S)
        self._socket = connected
        if self._traffic.closing:
            # Nobody waits for it any more; held open, it would refuse the next attempt.
            connected.close()
        return connected

    def _end(self) -> None:
        if self._socket is None:
            return
        if self._traffic.started:
            self._traffic.join_writer(CLOSE_TIMEOUT_S)
            self._traffic.join_reader(FAREWELL_S)
            with contextlib.suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)
            self._traffic.join_reader()
        self._socket.close()

    def _read_forever(self, connected: socket.socket) -> None:
        receiver = Receiver(connected)
        try:
            while data := self._receive(receiver):
                if not self._traffic.closing:
                    self._traffic.deliver(data, LSL_CLOCK())
            self._traffic.lost()
        except OSError as error:
            self._traffic.lost(error)

    @staticmethod
    def _receive(receiver: Receiver) -> bytes:
        while True:
            with contextlib.suppress(TimeoutError):
                return receiver.read()

    def _write_forever(self, connected: socket.socket) -> None:
        try:
            for data in self._traffic.outgoing():
                connected.sendall(data)
            # Closing at once, with bytes unread, would make the system throw away what is
            # still to be sent; the reader goes on until the other side hangs up.
            connected.shutdown(socket.SHUT_WR)
        except OSError as error:
            self._traffic.lost(error)


CONNECT_TIMEOUT_S = 10.0
KEEPALIVE = {"TCP_KEEPIDLE": 10, "TCP_KEEPINTVL": 5, "TCP_KEEPCNT": 3}
"""A peer that vanished silently is detected after at most 25 s."""
_OFF = "the host does not answer; is it on and in this network?"
_REASONS: dict[int | None, tuple[TransportReason, str]] = {
    errno.ECONNREFUSED: (
        TransportReason.ABSENT,
        "nothing listens there; start the program or check host and port",
    ),
    errno.ETIMEDOUT: (TransportReason.ABSENT, _OFF),
    errno.EHOSTUNREACH: (TransportReason.ABSENT, _OFF),
    errno.EHOSTDOWN: (TransportReason.ABSENT, _OFF),
    errno.ENETUNREACH: (TransportReason.ABSENT, "there is no route to that network; is it up?"),
    errno.EACCES: (TransportReason.DENIED, "the system refuses; allow it in the firewall"),
    errno.EPERM: (TransportReason.DENIED, "the system refuses; allow it in the firewall"),
}


class TcpLink(SocketLink):
    """A TCP connection as a :class:`~biosensor_gateway.transports.link.ByteLink`.

    Parameters
    ----------
    host
        Name or address, IPv4 or IPv6.
    port
        1 to 65535.
    """

    def __init__(self, host: str, port: int) -> None:
        self._host, self._port = host, port
        shown = f"[{host}]" if ":" in host else host
        advice = "is the program there still running?"
        super().__init__(f"{shown}:{port}", self._connected, self._explained, advice)

    def _connected(self) -> socket.socket:
        connection = socket.create_connection((self._host, self._port), CONNECT_TIMEOUT_S)
        # Commands are a few bytes long and each waits for its answer.
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in KEEPALIVE.items():
            option: int | None = getattr(socket, name, None)
            if option is None:
                continue
            # Windows before 10 1709, and Wine, refuse some; their defaults must do then.
            with contextlib.suppress(OSError):
                connection.setsockopt(socket.IPPROTO_TCP, option, value)
        return connection

    def _explained(self, error: OSError) -> TransportError:
        if isinstance(error, socket.gaierror):
            reason, advice = TransportReason.ABSENT, "no such host is known; check its name"
        elif isinstance(error, TimeoutError):
            reason, advice = TransportReason.ABSENT, _OFF
        else:
            unknown = (TransportReason.ABSENT, f"no connection ({error})")
            reason, advice = _REASONS.get(error.errno, unknown)
        return TransportError(reason, f"{self._name}: {advice}")


_MAC = re.compile(r"[0-9A-Fa-f]{2}(?::[0-9A-Fa-f]{2}){5}")
_SOCKET = "socket://"
_NO_ANSWER = "the device does not answer; switch it on and bring it near"
_PAIR = "the device refuses; pair it with this computer first"
_NO_RADIO = "this computer has no Bluetooth, or it is off; switch it on"
_RADIO_REASONS: dict[int | None, tuple[TransportReason, str]] = {
    errno.EHOSTDOWN: (TransportReason.ABSENT, _NO_ANSWER),
    errno.ETIMEDOUT: (TransportReason.ABSENT, _NO_ANSWER),
    errno.EADDRNOTAVAIL: (TransportReason.ABSENT, _NO_ANSWER),
    errno.ENETUNREACH: (TransportReason.ABSENT, _NO_ANSWER),
    errno.ECONNREFUSED: (TransportReason.ABSENT, "the device refuses; switch it off and on"),
    errno.ECONNRESET: (TransportReason.ABSENT, "the device refuses; switch it off and on"),
    errno.EBUSY: (TransportReason.BUSY, "another program is connected to it; close it there"),
    errno.EADDRINUSE: (TransportReason.BUSY, "another program is connected to it; close it there"),
    errno.EACCES: (TransportReason.DENIED, _PAIR),
    errno.EPERM: (TransportReason.DENIED, _PAIR),
    # Linux says this when no adapter is up, as it looks for a route to the address.
    errno.EHOSTUNREACH: (TransportReason.UNAVAILABLE, _NO_RADIO),
    errno.ENETDOWN: (TransportReason.UNAVAILABLE, _NO_RADIO),
    errno.ENODEV: (TransportReason.UNAVAILABLE, _NO_RADIO),
    errno.EAFNOSUPPORT: (TransportReason.UNAVAILABLE, _NO_RADIO),
    errno.EPROTONOSUPPORT: (TransportReason.UNAVAILABLE, _NO_RADIO),
}
if sys.platform == "linux":  # what it makes of "PIN or key missing"
    _RADIO_REASONS[errno.EBADE] = (TransportReason.DENIED, _PAIR)


class RfcommLink(SocketLink):
    """An RFCOMM connection as a :class:`~biosensor_gateway.transports.link.ByteLink`.

    Parameters
    ----------
    address
        MAC address, ``AA:BB:CC:DD:EE:FF``.
    channel
        RFCOMM channel, 1 to 30; a serial port profile nearly always has 1.
    """

    def __init__(self, address: str, channel: int = 1) -> None:
        self._address, self._channel = address, channel
        super().__init__(address, self._connected, self._explained, "is the device on and near?")

    async def open(self) -> None:
        """Connect; see :class:`~biosensor_gateway.transports.link.ByteLink`."""
        if not hasattr(socket, "AF_BLUETOOTH") or not hasattr(socket, "BTPROTO_RFCOMM"):
            message = (
                f"{self._address}: this Python cannot open Bluetooth connections; "
                "set the serial port of the paired device instead of its address"
            )
            raise TransportError(TransportReason.UNAVAILABLE, message)
        await super().open()

    def _connected(self) -> socket.socket:
        connection = socket.socket(socket.AF_BLUETOOTH, socket.SOCK_STREAM, socket.BTPROTO_RFCOMM)
        try:
            # Blocking: Windows cannot connect such a socket with a timeout.
            connection.connect((self._address, self._channel))
        except OSError:
            connection.close()
            raise
        return connection

    def _explained(self, error: OSError) -> TransportError:
        if isinstance(error, TimeoutError):
            reason, advice = TransportReason.ABSENT, _NO_ANSWER
        else:
            unknown = (TransportReason.ABSENT, f"no connection ({error})")
            reason, advice = _RADIO_REASONS.get(error.errno, unknown)
        return TransportError(reason, f"{self._name}: {advice}")


def byte_link(port: str, baud_rate: int = USUAL_BAUD_RATE) -> ByteLink:
    """Return the link to an address in a text; it is not open yet.

    Parameters
    ----------
    port
        ``socket://host:port`` for TCP (an IPv6 address in square brackets), a MAC
        address ``AA:BB:CC:DD:EE:FF`` for Bluetooth Classic; anything else is the
        name of a serial port.
    baud_rate
        For serial ports; Bluetooth and pure USB ports accept any.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE``, for a ``socket://`` without a host or port number.
    """
    if port.startswith(_SOCKET):
        return _tcp_link(port)
    if _MAC.fullmatch(port):
        return byte_link_of(RfcommLink(port.upper()))
    return byte_link_of(SerialLink(port, baud_rate))


def tcp_link(host: str, port: int) -> ByteLink:
    """Return the link to a host (name, IPv4 or IPv6) and TCP port (1 to 65535); not open yet."""
    return byte_link_of(TcpLink(host, port))


def _tcp_link(port: str) -> ByteLink:
    try:
        parts = urlsplit(port)
        host, number = parts.hostname, parts.port
    except ValueError:
        host, number = None, None
    if not host or not number:
        message = f"port {port!r} is not an address; write socket://HOST:NUMBER"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    return tcp_link(host, number)

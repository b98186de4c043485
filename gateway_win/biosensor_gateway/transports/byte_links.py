"""Opens the link that a device's ``port`` setting means."""

from __future__ import annotations

import errno
import re
import socket
import sys
from urllib.parse import urlsplit

from biosensor_common.errors import ConfigError, ConfigReason, TransportError, TransportReason
from biosensor_gateway.transports.link import ByteLink
from biosensor_gateway.transports.serial_port import USUAL_BAUD_RATE, SerialLink
from biosensor_gateway.transports.socket_link import SocketLink, TcpLink
from biosensor_gateway.transports.tap import byte_link_of

_MAC = re.compile(r"[0-9A-Fa-f]{2}(?::[0-9A-Fa-f]{2}){5}")
_SOCKET = "socket://"

_OFF = "the device does not answer; switch it on and bring it near"
_PAIR = "the device refuses; pair it with this computer first"
_NO_RADIO = "this computer has no Bluetooth, or it is off; switch it on"
_REASONS: dict[int | None, tuple[TransportReason, str]] = {
    errno.EHOSTDOWN: (TransportReason.ABSENT, _OFF),
    errno.ETIMEDOUT: (TransportReason.ABSENT, _OFF),
    errno.EADDRNOTAVAIL: (TransportReason.ABSENT, _OFF),
    errno.ENETUNREACH: (TransportReason.ABSENT, _OFF),
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
    _REASONS[errno.EBADE] = (TransportReason.DENIED, _PAIR)


class RfcommLink(SocketLink):
    """An RFCOMM connection as a :class:`~biosensor_gateway.transports.link.ByteLink`.

    Parameters
    ----------
    address
        MAC address, ``AA:BB:CC:DD:EE:FF``.
    channel
        RFCOMM channel, 1 to 30; a serial port profile is nearly always at 1.
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
            reason, advice = TransportReason.ABSENT, _OFF
        else:
            unknown = (TransportReason.ABSENT, f"no connection ({error})")
            reason, advice = _REASONS.get(error.errno, unknown)
        return TransportError(reason, f"{self._name}: {advice}")


def byte_link(port: str, baud_rate: int = USUAL_BAUD_RATE) -> ByteLink:
    """Return the closed link that a text means.

    Parameters
    ----------
    port
        ``socket://host:port`` for TCP (an IPv6 address in square brackets), a MAC
        address ``AA:BB:CC:DD:EE:FF`` for Bluetooth Classic; anything else is the
        name of a serial port.
    baud_rate
        Of a serial port; Bluetooth ones and those of USB alone take any.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE``, for a ``socket://`` without a host or a port number.
    """
    if port.startswith(_SOCKET):
        return _tcp_link(port)
    if _MAC.fullmatch(port):
        return byte_link_of(RfcommLink(port.upper()))
    return byte_link_of(SerialLink(port, baud_rate))


def tcp_link(host: str, port: int) -> ByteLink:
    """Return the closed link to a TCP port, 1 to 65535, of a host: its name, IPv4 or IPv6."""
    return byte_link_of(TcpLink(host, port))


def _tcp_link(port: str) -> ByteLink:
    try:
        parts = urlsplit(port)
        host, number = parts.hostname, parts.port
    except ValueError:
        host, number = None, None
    if not host or not number:
        message = f"port {port!r} is no address; write socket://HOST:NUMBER"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    return tcp_link(host, number)

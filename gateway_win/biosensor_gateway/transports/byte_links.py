"""Opens the link that a device's ``port`` setting means."""

from __future__ import annotations

import re
from urllib.parse import urlsplit

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.transports.link import ByteLink
from biosensor_gateway.transports.rfcomm import RfcommLink
from biosensor_gateway.transports.serial_port import USUAL_BAUD_RATE, SerialLink
from biosensor_gateway.transports.tcp_link import TcpLink

_MAC = re.compile(r"[0-9A-Fa-f]{2}(?::[0-9A-Fa-f]{2}){5}")
_SOCKET = "socket://"


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
        return RfcommLink(port.upper())
    return SerialLink(port, baud_rate)


def _tcp_link(port: str) -> TcpLink:
    try:
        parts = urlsplit(port)
        host, number = parts.hostname, parts.port
    except ValueError:
        host, number = None, None
    if not host or not number:
        message = f"port {port!r} is no address; write socket://HOST:NUMBER"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    return TcpLink(host, number)

"""TCP: programs that offer a device's bytes on a port, and serial ports over a network."""

from __future__ import annotations

import contextlib
import errno
import socket

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.transports.socket_link import SocketLink

CONNECT_TIMEOUT_S = 10.0
KEEPALIVE = {"TCP_KEEPIDLE": 10, "TCP_KEEPINTVL": 5, "TCP_KEEPCNT": 3}
"""A peer that vanished without a word is noticed after 25 s at most."""

_OFF = "the host does not answer; is it on and in this network?"
_REASONS: dict[int | None, tuple[TransportReason, str]] = {
    errno.ECONNREFUSED: (
        TransportReason.ABSENT,
        "nothing listens there; start the program or check host and port",
    ),
    errno.ETIMEDOUT: (TransportReason.ABSENT, _OFF),
    errno.EHOSTUNREACH: (TransportReason.ABSENT, _OFF),
    errno.EHOSTDOWN: (TransportReason.ABSENT, _OFF),
    errno.ENETUNREACH: (TransportReason.ABSENT, "there is no way to that network; is it up?"),
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

"""Connects to a Bluetooth Classic device by its address: RFCOMM sockets, no serial port."""

from __future__ import annotations

import errno
import socket
import sys

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.transports.socket_link import SocketLink

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

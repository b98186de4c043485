"""Exchanges text messages over a WebSocket, with vendors' services on this computer."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import ssl
from collections import deque
from urllib.parse import urlsplit

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidMessage, InvalidURI

from biosensor_common.errors import ConfigError, ConfigReason, TransportError, TransportReason
from biosensor_gateway.system.clock import LSL_CLOCK
from biosensor_gateway.transports.link import ReceivedText

OPEN_TIMEOUT_S = 5.0
PING_INTERVAL_S = 10.0
PING_TIMEOUT_S = 10.0
HANDSHAKE_OF_CLOSE_S = 2.0
CLOSE_TIMEOUT_S = 0.8
"""Less than the library would give the peer: the supervisor allows 2 s for everything."""
MAX_MESSAGE_BYTES = 2**22
KEPT_BYTES = 2**24
"""Over a minute of the busiest service known."""
_OVERHEAD_BYTES = 256
"""What a message costs besides its text, so that many empty ones are limited, too."""

# The library logs whole messages at `debug`: samples, and secrets.
_wire_log = logging.getLogger("websockets.client.biosensor_gateway")
_wire_log.setLevel(logging.INFO)


class WebSocketLink:
    """One WebSocket connection.

    A separate task reads all the time, so that a slow consumer neither fills the socket nor delays
    the pongs. If its queue is full, the oldest messages are discarded and counted in `dropped`.

    Parameters
    ----------
    url
        ``wss://host:port``; the certificate must be for this host.
    ca_file
        PEM file of the certificate authority; empty for those that the operating
        system trusts.
    """

    def __init__(self, url: str, ca_file: str = "") -> None:
        self._url = url
        self._ca_file = ca_file
        self._socket: ClientConnection | None = None
        self._reader: asyncio.Task[None] | None = None
        self._waiting: deque[ReceivedText] = deque()
        self._waiting_bytes = 0
        self._news = asyncio.Event()
        self._ended: TransportError | None = None
        self.dropped = 0

    async def open(self) -> None:
        """Connect and start reading.

        Raises
        ------
        TransportError
            ``ABSENT`` if nothing listens, ``DENIED`` if the certificate is not
            trusted, ``UNAVAILABLE`` if it is not a WebSocket server.
        ConfigError
            The file of the certificate authority or the URL is invalid.
        """
        context = tls_context(self._ca_file) if urlsplit(self._url).scheme == "wss" else None
        self._socket = await self._connect(context)
        self._reader = asyncio.create_task(self._read_forever(self._socket))

    async def read(self) -> ReceivedText:
        """Wait for the next message.

        Raises
        ------
        TransportError
            ``LOST``, after everything that had arrived was read.
        """
        while not self._waiting:
            if self._ended is not None:
                raise self._ended
            self._news.clear()
            await self._news.wait()
        message = self._waiting.popleft()
        self._waiting_bytes -= _cost(message)
        return message

    async def send(self, text: str) -> None:
        """Send a message; waits while the peer does not accept earlier ones.

        Raises
        ------
        TransportError
            ``LOST``.
        """
        if self._socket is None:
            raise TransportError(TransportReason.LOST, f"{self._url}: the connection is not open")
        try:
            await self._socket.send(text)
        except ConnectionClosed as error:
            raise self._lost(error) from error

    async def close(self) -> None:
        """Close the connection, if necessary without the peer's answer; never raises."""
        if self._socket is not None:
            # A peer that neither reads nor answers must not hold up the end.
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(CLOSE_TIMEOUT_S):
                    await self._socket.close()
            self._socket.transport.abort()
        if self._reader is not None:
            self._reader.cancel()
            await asyncio.wait({self._reader})

    async def _connect(self, context: ssl.SSLContext | None) -> ClientConnection:
        # Not the library's reconnecting iterator: it would retry a wrong certificate forever.
        try:
            parts = urlsplit(self._url)
            return await connect(
                self._url,
                ssl=context,
                # Named once more, so that no redirection leads to another host.
                host=parts.hostname,
                port=parts.port or 443,
                proxy=None,
                compression=None,
                user_agent_header=None,
                open_timeout=OPEN_TIMEOUT_S,
                ping_interval=PING_INTERVAL_S,
                ping_timeout=PING_TIMEOUT_S,
                close_timeout=HANDSHAKE_OF_CLOSE_S,
                max_size=MAX_MESSAGE_BYTES,
                logger=_wire_log,
            )
        except (OSError, InvalidHandshake, InvalidURI, ValueError, EOFError) as error:
            raise self._open_error(error) from error

    def _open_error(self, error: Exception) -> TransportError | ConfigError:
        match error:
            case ssl.SSLCertVerificationError():
                advice = (
                    f"its certificate is not trusted ({error.verify_message.rstrip('.')}); set "
                    "ca_file to the vendor's root certificate and use the host name in the "
                    "certificate"
                )
                return TransportError(TransportReason.DENIED, f"{self._url}: {advice}")
            case TimeoutError():
                advice = "it does not answer; restart the service"
            case OSError() if not isinstance(error, ssl.SSLError):
                advice = "nothing listens there; start the service"
            case InvalidMessage() | EOFError():
                advice = "it closes the connection immediately; is the service starting?"
            case InvalidURI() | ValueError() if not isinstance(error, OSError):
                message = f"{self._url}: not a usable URL ({error})"
                return ConfigError(ConfigReason.WRONG_VALUE, message)
            case _:
                message = (
                    f"{self._url}: the program that listens there is not the service ({error})"
                )
                return TransportError(TransportReason.UNAVAILABLE, message)
        return TransportError(TransportReason.ABSENT, f"{self._url}: {advice}")

    async def _read_forever(self, socket: ClientConnection) -> None:
        try:
            while True:
                message = await socket.recv()
                arrival = LSL_CLOCK()
                if isinstance(message, str):
                    self._keep(ReceivedText(message, arrival))
                else:
                    self.dropped += 1
        except ConnectionClosed as error:
            self._ended = self._lost(error)
        finally:
            if self._ended is None:
                self._ended = TransportError(TransportReason.LOST, f"{self._url}: closed here")
            self._news.set()

    def _keep(self, message: ReceivedText) -> None:
        self._waiting.append(message)
        self._waiting_bytes += _cost(message)
        while self._waiting_bytes > KEPT_BYTES:
            self._waiting_bytes -= _cost(self._waiting.popleft())
            self.dropped += 1
        self._news.set()

    def _lost(self, error: ConnectionClosed) -> TransportError:
        # Only the code: the peer's own words could quote what it was told.
        close = error.rcvd or error.sent
        cause = f"closed with code {close.code}" if close is not None else "cut"
        return TransportError(TransportReason.LOST, f"{self._url}: the connection was {cause}")


def tls_context(ca_file: str = "") -> ssl.SSLContext:
    """Return the TLS context of a client that checks certificate and host name.

    Raises
    ------
    ConfigError
        ``UNREADABLE``, if the file is missing or has no certificate.
    """
    try:
        context = ssl.create_default_context(cafile=ca_file or None)
    except OSError as error:
        message = f"ca_file {ca_file}: no certificate can be read from it ({error.strerror})"
        raise ConfigError(ConfigReason.UNREADABLE, message) from error
    # Since Python 3.13 on by default; vendors' roots without a keyUsage would be refused.
    context.verify_flags &= ~ssl.VERIFY_X509_STRICT
    return context


def _cost(message: ReceivedText) -> int:
    return len(message.text) + _OVERHEAD_BYTES

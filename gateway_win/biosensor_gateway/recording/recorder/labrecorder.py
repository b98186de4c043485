"""Client of LabRecorder's remote control: lines of text over TCP.

Facts from App-LabRecorder's ``tcpinterface.cpp`` and ``mainwindow.cpp``: a command is a
line; the reply is ``OK`` without a line end, whatever the command was, and comes when
its work is done. Commands are worked off by the thread of the window, so none is
answered while a message there waits for a click. Some versions lose the second of two
lines that arrive together: a command is sent when the one before was answered.
"""

from __future__ import annotations

import ipaddress
import socket
from types import TracebackType
from typing import Self

from biosensor_gateway.recording.labrecorder.errors import LabRecorderError, LabRecorderReason

DEFAULT_PORT = 22345
CONNECT_S = 5.0
REPLY_S = 30.0
"""``update`` and ``start`` look for streams for a second, ``stop`` closes each of them."""

_REPLY_BYTES = 4096
_OK = "OK"


class RemoteControl:
    """A connection to LabRecorder; a context manager.

    Parameters
    ----------
    host, port
        Where its remote control listens.

    Raises
    ------
    LabRecorderError
        ``UNREACHABLE`` on entering, if nothing listens there.
    """

    def __init__(self, host: str, port: int) -> None:
        self.host, self.port = host, port

    def __enter__(self) -> Self:
        try:
            self._connection = socket.create_connection((self.host, self.port), CONNECT_S)
        except (OSError, UnicodeError) as error:
            # A name with empty or overlong parts is refused before it is looked up.
            why = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            message = (
                f"LabRecorder's remote control does not answer at {self.host}:{self.port} ({why}); "
                "start LabRecorder there, tick 'EnableRCS', and let TCP through its firewall"
            )
            raise LabRecorderError(LabRecorderReason.UNREACHABLE, message) from error
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._connection.close()

    @property
    def is_local(self) -> bool:
        """Whether it runs on this computer, so that its files are here, too."""
        peer, own = self._connection.getpeername()[0], self._connection.getsockname()[0]
        return peer == own or ipaddress.ip_address(peer.partition("%")[0]).is_loopback

    def command(self, line: str, time_limit_s: float = REPLY_S) -> None:
        """Have one command worked off. That it succeeded is not known afterwards.

        Raises
        ------
        LabRecorderError
            ``NO_REPLY``, ``REFUSED`` or ``UNREACHABLE``.
        """
        where, word = f"LabRecorder at {self.host}:{self.port}", line.partition(" ")[0]
        try:
            self._connection.settimeout(time_limit_s)
            self._connection.sendall(f"{line}\n".encode())
            reply = self._connection.recv(_REPLY_BYTES).decode("utf-8", "replace").strip()
        except TimeoutError:
            message = (
                f"{where} does not answer to {word!r} within {time_limit_s:g} s; look at its "
                "window: a message there may wait for a click"
            )
            raise LabRecorderError(LabRecorderReason.NO_REPLY, message) from None
        except OSError as error:
            message = f"{where} went away at {word!r} ({error.strerror or error}); start it again"
            raise LabRecorderError(LabRecorderReason.UNREACHABLE, message) from error
        if not reply:
            message = f"{where} went away at {word!r}; start it again"
            raise LabRecorderError(LabRecorderReason.UNREACHABLE, message)
        if reply != _OK:
            message = f"{where} answers {reply!r} to {word!r}; is it LabRecorder at all?"
            raise LabRecorderError(LabRecorderReason.REFUSED, message)

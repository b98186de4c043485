"""A serial port that lets its host read pending data before the link breaks.

Data that a host has not read are lost when a port closes. With a busy host this is an unknown
amount, which could not be distinguished from a device that stopped measuring.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable

from biosensor_gateway.simulation.async_serial import serial_port

# Time that the system may need to report written data as unread.
_CHECK_S = 0.02
_PATIENCE_S = 1.0


class PatientPort:
    """The device's end of a serial port; an `AsyncSerialPort` for the loop's thread.

    Parameters
    ----------
    heard, left, buffer_bytes, tcp
        As for `serial_port`.
    """

    def __init__(
        self,
        heard: Callable[[bytes], None],
        left: Callable[[], None],
        *,
        buffer_bytes: int,
        tcp: bool = sys.platform == "win32",
    ) -> None:
        self._heard, self._left = heard, left
        self._port = serial_port(self._hear, self._leave, buffer_bytes=buffer_bytes, tcp=tcp)
        self._loop = asyncio.get_running_loop()
        self._hanging_up: asyncio.TimerHandle | None = None
        self._written_s = self._deadline_s = 0.0
        self._opens_again = False

    @property
    def name(self) -> str:
        """The port's name for the host, which stays the same when reopened."""
        return self._port.name

    def open(self) -> None:
        """Open the port, at once or as soon as it has closed."""
        if self._hanging_up is None:
            self._port.open()
        else:
            self._opens_again = True

    def write(self, data: bytes) -> bool:
        """Accept all of ``data`` without blocking; return False without a host or room."""
        taken = self._hanging_up is None and self._port.write(data)
        if taken:
            self._written_s = self._loop.time()
        return taken

    def glue(self, *, on: bool) -> None:
        """Join data and split it at random places, or send it unchanged."""
        self._port.glue(on=on)

    def drained(self) -> bool:
        """Whether a host has read everything, as far as known."""
        return self._port.drained()

    def hang_up(self) -> None:
        """Stop sending and receiving, and close once the host has read everything.

        A host that does not read for a second loses the rest.
        """
        self._opens_again = False
        if self._hanging_up is None:
            self._deadline_s = self._loop.time() + _PATIENCE_S
            self._hang_up_if_read()

    def dispose(self) -> None:
        """Close and remove the port at once and permanently."""
        if self._hanging_up is not None:
            self._hanging_up.cancel()
        self._port.dispose()

    def _hang_up_if_read(self) -> None:
        now_s = self._loop.time()
        is_read = now_s >= self._written_s + _CHECK_S and self._port.drained()
        if not is_read and now_s < self._deadline_s:
            self._hanging_up = self._loop.call_later(_CHECK_S, self._hang_up_if_read)
            return
        self._hanging_up = None
        self._port.hang_up()
        if self._opens_again:
            self._port.open()

    def _hear(self, data: bytes) -> None:
        if self._hanging_up is None:
            self._heard(data)

    def _leave(self) -> None:
        if self._hanging_up is None:
            self._left()

"""Notifications that wait for each other on their way out."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from bumble import att
from bumble.device import Connection


class Bundles:
    """Sends notifications at once, or has them wait for each other.

    Parameters
    ----------
    connection
        Returns the one that stands.
    """

    def __init__(self, connection: Callable[[], Connection | None]) -> None:
        self._connection = connection
        self._wait_s = 0.0
        self._waiting: list[tuple[Connection, bytes]] = []

    def wait(self, seconds: float) -> None:
        """Have them wait for so long and come together; 0 sends them at once."""
        self._wait_s = seconds
        if not seconds:
            self.flush()

    def send(self, connection: Connection, pdu: bytes) -> None:
        """Send one, now or later."""
        if not self._wait_s:
            connection.send_l2cap_pdu(att.ATT_CID, pdu)
            return
        if not self._waiting:
            asyncio.get_running_loop().call_later(self._wait_s, self.flush)
        self._waiting.append((connection, pdu))

    def flush(self) -> None:
        """Send those that wait, if their host is still there."""
        waiting, self._waiting = self._waiting, []
        for connection, pdu in waiting:
            if connection is self._connection():
                connection.send_l2cap_pdu(att.ATT_CID, pdu)

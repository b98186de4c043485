"""Indications of a virtual Bluetooth LE device: what its host has to confirm."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from bumble.device import Connection
from bumble.gatt import Characteristic


class Indications:
    """Puts one after the other on the link, and tells of each whether it got there.

    For the world's loop.

    Parameters
    ----------
    may_send
        Whether the device can still send this on that connection.
    """

    def __init__(self, may_send: Callable[[Connection, Characteristic[bytes]], bool]) -> None:
        self._may_send = may_send
        self._unconfirmed = asyncio.Lock()
        self._under_way: set[asyncio.Task[None]] = set()

    async def send(
        self, connection: Connection, characteristic: Characteristic[bytes], value: bytes
    ) -> bool:
        """Indicate a value, and wait until it is confirmed or the link has ended.

        Returns
        -------
        bool
            Whether it was put on the link. The host has it then, also where its confirmation
            is held up or cut off.
        """
        was_put_out = False

        async def indicate() -> None:
            nonlocal was_put_out
            async with self._unconfirmed:
                # It may have waited for another one, and the device have stopped meanwhile.
                if self._may_send(connection, characteristic):
                    was_put_out = True
                    server = connection.gatt_server
                    await server.indicate_subscriber(connection, characteristic, value)

        task = asyncio.create_task(indicate())
        self._under_way.add(task)
        task.add_done_callback(self._under_way.discard)
        try:
            await asyncio.wait({task})
        finally:
            # Without effect unless the sender itself is to end.
            task.cancel()
        if task.cancelled():
            # What bumble notes of a connection that has ended would stay.
            connection.gatt_server.on_disconnection(connection)
        else:
            task.result()
        return was_put_out

    def give_up(self) -> None:
        """Wait for no confirmation any more: the link has ended."""
        for task in self._under_way:
            task.cancel()

    async def ended(self) -> None:
        """Return when each sender knows what became of its own, after `give_up`."""
        if self._under_way:
            await asyncio.wait(self._under_way)

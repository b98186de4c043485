"""Ends a connection to a Bluetooth LE device, within a known time."""

from __future__ import annotations

import asyncio
from contextlib import suppress

from bleak import BleakClient
from bleak.exc import BleakError

from biosensor_gateway.transports.ble_pairing import Pairing
from biosensor_gateway.transports.deadlines import in_background

CLOSE_LIMIT_S = 1.5
"""Leaves a driver half a second to say good-bye."""


async def hang_up(
    client: BleakClient, attempt: asyncio.Task[None] | None, pairing: Pairing
) -> None:
    """Disconnect, and unpair where that is wished; never raises.

    Parameters
    ----------
    attempt
        To connect; it may still be under way.
    """
    # Left to itself after a while: some calls never return when the service has died.
    ending = in_background(_disconnect(client, attempt, pairing))
    await asyncio.wait({ending}, timeout=CLOSE_LIMIT_S)


async def _disconnect(
    client: BleakClient, attempt: asyncio.Task[None] | None, pairing: Pairing
) -> None:
    if attempt is not None:
        # An attempt that was cancelled tidies up behind itself first.
        await asyncio.wait({attempt})
    if pairing.ends_with_connection:
        # Whatever comes of it, the connection has to end.
        with suppress(BleakError, NotImplementedError, OSError):
            await client.unpair()
        pairing.note_unpaired()
    await client.disconnect()

"""Calls between a user of bleak, in any event loop, and the virtual radio in its own."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from contextlib import suppress
from typing import Any, TypeVar, TypeVarTuple

from bleak.exc import (
    BleakBluetoothNotAvailableError,
    BleakBluetoothNotAvailableReason,
    BleakError,
    BleakGATTProtocolError,
)
from bumble.att import ATT_Error

from biosensor_common.errors import GatewayError, TransportError, TransportReason
from biosensor_gateway.simulation.world import World

_T = TypeVar("_T")
_Ts = TypeVarTuple("_Ts")


async def in_world(world: World, coroutine: Coroutine[Any, Any, _T]) -> _T:
    """Run a coroutine in the world's loop; to cancel this is to cancel it.

    Raises
    ------
    BleakError
        Whatever went wrong, as bleak's own backends would put it.
    """
    try:
        return await asyncio.wrap_future(asyncio.run_coroutine_threadsafe(coroutine, world.loop))
    except ATT_Error as error:
        raise BleakGATTProtocolError(error.error_code) from error
    except (GatewayError, ValueError) as error:
        raise _as_bleak(error) from error


def tell(
    loop: asyncio.AbstractEventLoop, function: Callable[[*_Ts], object], *arguments: *_Ts
) -> None:
    """Have a function called soon in another loop; if that is closed, nobody listens."""
    with suppress(RuntimeError):
        loop.call_soon_threadsafe(function, *arguments)


def _as_bleak(error: Exception) -> BleakError:
    if isinstance(error, TransportError) and error.reason is TransportReason.UNAVAILABLE:
        reason = BleakBluetoothNotAvailableReason.POWERED_OFF
        return BleakBluetoothNotAvailableError(str(error), reason)
    return BleakError(str(error))

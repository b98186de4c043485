"""A link's first moments: the device behind it may have been left streaming, in any format."""

from __future__ import annotations

import asyncio
from typing import NamedTuple

from biosensor_gateway.devices.shimmer.driver.commands import STOP_STREAMING
from biosensor_gateway.transports.link import ByteLink, Received

LISTEN_S = 0.5
QUIET_S = 0.3
ATTEMPTS = 3
ATTEMPT_S = 1.5
IDLE_BYTES = 16
"""An idle device may say this much, unasked: that it was docked."""


class _Discarded(NamedTuple):
    size: int
    until_s: float | None
    quiet: bool


async def stop_streaming(link: ByteLink) -> float | None:
    """Make the device behind an open link silent, and throw away what it said.

    Returns
    -------
    float or None
        LSL time of the last bytes of a device that was streaming, None if it was not.

    Raises
    ------
    TransportError
        ``LOST``.
    """
    heard = await _discard(link, LISTEN_S, LISTEN_S)
    was_streaming, until_s = heard.size > IDLE_BYTES, heard.until_s
    for _ in range(ATTEMPTS):
        link.write(STOP_STREAMING)
        heard = await _discard(link, QUIET_S, ATTEMPT_S)
        until_s = heard.until_s or until_s
        if heard.quiet:
            break
    return until_s if was_streaming else None


async def _discard(link: ByteLink, quiet_s: float, limit_s: float) -> _Discarded:
    """Read until nothing comes for ``quiet_s``, for at most ``limit_s``."""
    size, until_s = 0, None
    try:
        async with asyncio.timeout(limit_s):
            while True:
                received = await _next(link, quiet_s)
                if received is None:
                    return _Discarded(size, until_s, quiet=True)
                size, until_s = size + len(received.data), received.arrival
    except TimeoutError:
        return _Discarded(size, until_s, quiet=False)


async def _next(link: ByteLink, quiet_s: float) -> Received | None:
    try:
        async with asyncio.timeout(quiet_s):
            return await link.read()
    except TimeoutError:
        return None

"""Waiting for something that Cortex tells by a warning, or does not tell at all."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import TypeVar

from biosensor_gateway.devices.emotiv_insight.driver.messages import Warned

_T = TypeVar("_T")


async def until(
    ask: Callable[[Warned | None], Awaitable[_T | None]],
    heard: asyncio.Queue[Warned],
    *,
    every_s: float,
    patience_s: float,
) -> _T | None:
    """Ask until there is an answer: now, at each warning, and regularly besides.

    Parameters
    ----------
    ask
        Returns None for "not yet"; gets the warning that it is asked for, if one is.
    heard
        Warnings that may mean that it is time.
    every_s
        How often to ask without a warning: one may have gone unheard.
    patience_s
        When to give up, and return None.
    """
    loop = asyncio.get_running_loop()
    deadline = loop.time() + patience_s
    warned: Warned | None = None
    while True:
        answer = await ask(warned)
        left = deadline - loop.time()
        if answer is not None or left <= 0:
            return answer
        try:
            async with asyncio.timeout(min(every_s, left)):
                warned = await heard.get()
        except TimeoutError:
            warned = None

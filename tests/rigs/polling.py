"""Waiting for what happens in other threads and processes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

_DEADLINE_S = 20.0
_STEP_S = 0.005


async def until(condition: Callable[[], object]) -> None:
    """Return once the condition holds.

    Raises
    ------
    TimeoutError
        If it never does.
    """
    now = asyncio.get_running_loop().time
    deadline = now() + _DEADLINE_S
    while not condition():
        if now() > deadline:
            raise TimeoutError("what was waited for never happened")
        await asyncio.sleep(_STEP_S)

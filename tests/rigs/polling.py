"""Waiting for what happens in other threads and processes."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import TypeVar

_T = TypeVar("_T")

_DEADLINE_S, _DEADLINE_OF_THREADS_S = 20.0, 30.0
_STEP_S = 0.005


def wait_until(
    holds: Callable[[], _T | None], expected: str = "what was waited for", deadline_s: float = 60.0
) -> _T:
    """Return what it is once it is true; the test fails if it never is.

    It may take long on a busy machine.
    """
    deadline = time.monotonic() + deadline_s
    while not (found := holds()):
        assert time.monotonic() < deadline, f"never happened: {expected}"
        time.sleep(_STEP_S)
    return found


async def eventually(condition: Callable[[], object]) -> None:
    """Return once the condition holds; the test fails if it never does, by the clock of the wall.

    For what happens in threads and processes, also while a loop's own time stands still.
    """
    deadline = time.monotonic() + _DEADLINE_OF_THREADS_S
    while not condition():
        assert time.monotonic() < deadline, "it did not happen"
        await asyncio.sleep(_STEP_S)


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

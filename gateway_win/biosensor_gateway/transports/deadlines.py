"""Sets limits to calls of libraries that may neither end nor heed their cancellation."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any, TypeVar

_T = TypeVar("_T")

# The event loop itself keeps only weak references.
_running: set[asyncio.Task[Any]] = set()


def in_background(operation: Coroutine[Any, Any, _T]) -> asyncio.Task[_T]:
    """Start a task that may be abandoned: its error is nobody's then."""
    task = asyncio.create_task(operation)
    _running.add(task)
    task.add_done_callback(_ended)
    return task


async def within(
    seconds: float,
    operation: Coroutine[Any, Any, _T] | asyncio.Task[_T],
    unless: asyncio.Future[Any] | None = None,
) -> _T:
    """Await an operation for a limited time, whatever it does, and cancel it then.

    For what tidies up behind itself when it is cancelled; see `outlasting` for all else.

    Parameters
    ----------
    operation
        Cancelled, and left to itself, when the time is over or nobody waits any more.
    unless
        Ends the waiting as well, once it is done.

    Raises
    ------
    TimeoutError
        The operation did not end in time, or `unless` came first.
    ConnectionAbortedError
        The operation cancelled itself, as WinRT's do when a device vanishes.
    """
    task = operation if isinstance(operation, asyncio.Task) else in_background(operation)
    try:
        return await outlasting(seconds, task, unless)
    finally:
        task.cancel()


async def outlasting(
    seconds: float, task: asyncio.Task[_T], unless: asyncio.Future[Any] | None = None
) -> _T:
    """Await for a limited time what goes on afterwards, for the system does so in any case.

    A call that was made cannot be taken back by not waiting for its answer. So the task looks
    after what comes of it, however late; parameters and errors are those of `within`.
    """
    awaited: set[asyncio.Future[Any]] = {task} if unless is None else {task, unless}
    await asyncio.wait(awaited, timeout=seconds, return_when=asyncio.FIRST_COMPLETED)
    if not task.done():
        raise TimeoutError
    if task.cancelled():
        raise ConnectionAbortedError("the call cancelled itself")
    return task.result()


def _ended(task: asyncio.Task[Any]) -> None:
    _running.discard(task)
    if not task.cancelled():
        # Looked at, so that the event loop does not report an abandoned one.
        task.exception()

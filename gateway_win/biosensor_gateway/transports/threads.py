"""Runs blocking calls in threads that never hold up the end of the program."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import ParamSpec, TypeVar

_T = TypeVar("_T")
_P = ParamSpec("_P")


async def in_daemon_thread(call: Callable[[], _T]) -> _T:
    """Run a blocking call in a thread of its own and await its result.

    asyncio's own pool is no choice here: the interpreter joins it at exit, and
    a call that hangs in a driver would hang the program.
    """
    return await asyncio.get_running_loop().run_in_executor(_DAEMONS, call)


class _DaemonThreads(Executor):
    """Starts a thread for each call."""

    def submit(self, fn: Callable[_P, _T], /, *args: _P.args, **kwargs: _P.kwargs) -> Future[_T]:
        """Start it now."""
        future: Future[_T] = Future()
        # Running from now on: cancelling the awaiting task must not take the result's place away.
        future.set_running_or_notify_cancel()

        def run() -> None:
            try:
                future.set_result(fn(*args, **kwargs))
            except Exception as error:  # noqa: BLE001 - handed on to the awaiting caller
                future.set_exception(error)

        threading.Thread(target=run, daemon=True).start()
        return future


_DAEMONS = _DaemonThreads()

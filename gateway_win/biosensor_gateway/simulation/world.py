"""The thread and event loop in which virtual devices run.

They have a separate one, so that a slow agent or test does not affect the devices.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Coroutine
from concurrent.futures import Future
from types import TracebackType
from typing import Any, Self, TypeVar

from biosensor_gateway.system.clock import LSL_CLOCK, Clock

_T = TypeVar("_T")
_TIMEOUT_S = 20.0


class World:
    """An asyncio event loop in a separate thread; a context manager.

    Attributes
    ----------
    clock
        Clock of everything in it.
    """

    def __init__(self, clock: Clock = LSL_CLOCK) -> None:
        self.clock = clock
        self.loop = clock.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="virtual devices", daemon=True)
        self._ended = Future[None]()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.await_(self._cancel_all())
        self.loop.call_soon_threadsafe(self.loop.stop)
        self.clock.wait_for(self._ended, _TIMEOUT_S)
        self._thread.join()
        self.loop.close()

    def await_(self, coroutine: Coroutine[Any, Any, _T]) -> _T:
        """Run a coroutine in the world's event loop and return its result; for other threads."""
        future = asyncio.run_coroutine_threadsafe(coroutine, self.loop)
        return self.clock.wait_for(future, _TIMEOUT_S)

    def call(self, function: Callable[[], _T]) -> _T:
        """Run a function in the world's thread and return its result; for other threads."""

        async def run() -> _T:
            return function()

        return self.await_(run())

    def _run(self) -> None:
        asyncio.set_event_loop(self.loop)
        self.loop.run_forever()
        self._ended.set_result(None)

    async def _cancel_all(self) -> None:
        others = asyncio.all_tasks() - {asyncio.current_task()}
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)

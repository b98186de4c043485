"""The thread and event loop in which virtual devices run, and their oscillators.

Devices have a separate loop, so that a slow agent or test does not affect the devices.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Coroutine
from concurrent.futures import Future
from typing import Any, Self, TypeVar

from biosensor_gateway.system.clock import LSL_CLOCK, Clock

_T = TypeVar("_T")
_TIMEOUT_S = 20.0


class World:
    """An asyncio event loop in a separate thread; a context manager."""

    def __init__(self, clock: Clock = LSL_CLOCK) -> None:
        self.clock = clock
        self.loop = clock.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="virtual devices", daemon=True)
        self._ended = Future[None]()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
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


class Oscillator:
    """Device time since power-on, running fast by some ppm.

    Parameters
    ----------
    clock
        The true time, on the LSL clock.
    drift_ppm
        Positive for fast: more device seconds than true ones.
    start_s
        True time of power-on on the LSL clock; now by default.
    """

    def __init__(self, clock: Clock, drift_ppm: float = 0.0, start_s: float | None = None) -> None:
        self.clock = clock
        self._true_s = clock() if start_s is None else start_s
        self._device_s = 0.0
        self._rate = 1 + drift_ppm * 1e-6

    @property
    def drift_ppm(self) -> float:
        """Current drift of the oscillator."""
        return (self._rate - 1) * 1e6

    def now(self) -> float:
        """Return device seconds since power-on."""
        return self.at(self.clock())

    def at(self, true_s: float) -> float:
        """Return device seconds at an LSL time, not before the last `set_drift`."""
        return self._device_s + (true_s - self._true_s) * self._rate

    def true_time(self, device_s: float) -> float:
        """Return the LSL time at which the device's clock shows ``device_s``."""
        return self._true_s + (device_s - self._device_s) / self._rate

    async def reach(self, device_s: float) -> float:
        """Wait until the device's clock shows ``device_s``; return the true time."""
        left = self.true_time(device_s) - self.clock()
        if left <= 0:
            return self.true_time(device_s)
        await asyncio.sleep(left)
        # The drift may have changed during the wait.
        return await self.reach(device_s)

    def set_drift(self, ppm: float) -> None:
        """Change the drift from now on."""
        now = self.clock()
        self._device_s, self._true_s = self.at(now), now
        self._rate = 1 + ppm * 1e-6

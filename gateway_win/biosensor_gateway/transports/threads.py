"""Runs blocking calls and a link's reading and writing in threads that never delay the end."""

from __future__ import annotations

import asyncio
import queue
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from typing import ParamSpec, TypeVar

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.transports.link import Received

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
            except Exception as error:  # noqa: BLE001 - passed on to the awaiting caller
                future.set_exception(error)

        threading.Thread(target=run, daemon=True).start()
        return future


_DAEMONS = _DaemonThreads()


class Traffic:
    """What came and what is to be sent; made and read in the event loop.

    Parameters
    ----------
    name
        What error messages call the link.
    advice
        What they tell a user to look at when it has ended.

    Attributes
    ----------
    closing
        Set it before the link is closed on purpose: from then on nothing is an error.
    """

    def __init__(self, name: str, advice: str) -> None:
        self._name = name
        self._advice = advice
        self.closing = False
        self._incoming: asyncio.Queue[Received | TransportError] = asyncio.Queue()
        self._outgoing: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._threads: tuple[threading.Thread, ...] = ()

    def start(self, reading: Callable[[], None], writing: Callable[[], None]) -> None:
        """Run both in threads of their own."""
        self._loop = asyncio.get_running_loop()
        self._threads = tuple(
            threading.Thread(target=target, daemon=True) for target in (reading, writing)
        )
        for thread in self._threads:
            thread.start()

    @property
    def started(self) -> bool:
        """Whether there are threads."""
        return bool(self._threads)

    async def read(self) -> Received:
        """Wait for the next bytes; raise ``LOST`` when the link has ended."""
        item = await self._incoming.get()
        if isinstance(item, TransportError):
            self._incoming.put_nowait(item)
            raise item
        return item

    def write(self, data: bytes) -> None:
        """Queue bytes for the writing thread."""
        self._outgoing.put(data)

    def end_writing(self) -> None:
        """Let the writing thread end once it has sent what is queued."""
        self._outgoing.put(None)

    def outgoing(self) -> Iterator[bytes]:
        """Wait for what is to be sent, until `end_writing`; for the writing thread."""
        while (data := self._outgoing.get()) is not None:
            yield data

    def deliver(self, data: bytes, arrival: float) -> None:
        """Pass on data with their LSL time of arrival; for the reading thread."""
        self._hand_on(Received(data, arrival))

    def lost(self, cause: Exception | None = None) -> None:
        """Tell that the link has ended, unless that is on purpose; for both threads."""
        if not self.closing:
            message = f"{self._name}: the link was cut; {self._advice}"
            error = TransportError(TransportReason.LOST, message)
            error.__cause__ = cause
            self._hand_on(error)

    def join_writer(self, seconds: float) -> None:
        """Wait for the writing thread, at most so long."""
        self._threads[1].join(seconds)

    def join_reader(self, seconds: float | None = None) -> bool:
        """Wait for the reading thread, at most so long; return whether it has ended."""
        self._threads[0].join(seconds)
        return not self._threads[0].is_alive()

    def _hand_on(self, item: Received | TransportError) -> None:
        assert self._loop is not None
        try:
            self._loop.call_soon_threadsafe(self._incoming.put_nowait, item)
        except RuntimeError:
            # The loop has ended; nobody is left to read.
            self.closing = True

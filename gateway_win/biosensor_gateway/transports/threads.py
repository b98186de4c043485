"""Runs blocking calls in threads, and limits calls that may hang and ignore cancellation."""

from __future__ import annotations

import asyncio
import queue
import threading
from collections.abc import Callable, Coroutine, Iterator
from concurrent.futures import Executor, Future
from typing import Any, ParamSpec, TypeVar

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.transports.link import Received

_T = TypeVar("_T")
_P = ParamSpec("_P")
# The event loop itself keeps only weak references.
_running: set[asyncio.Task[Any]] = set()


async def in_daemon_thread(call: Callable[[], _T]) -> _T:
    """Run a blocking call in a separate thread and await its result.

    asyncio's pool is not used: the interpreter joins its threads at exit, so a call that hangs in
    a driver would hang the program.
    """
    return await asyncio.get_running_loop().run_in_executor(_DAEMONS, call)


class _DaemonThreads(Executor):
    """Executor that starts a thread for each call."""

    def submit(self, fn: Callable[_P, _T], /, *args: _P.args, **kwargs: _P.kwargs) -> Future[_T]:
        """Start a call now."""
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
    """Received bytes and bytes to send; created and read in the event loop.

    Parameters
    ----------
    name
        Name of the link in error messages.
    advice
        What a user should check if it has ended.
    """

    def __init__(self, name: str, advice: str) -> None:
        self._name = name
        self._advice = advice
        # Set before the link is closed on purpose: from then on, nothing is an error.
        self.closing = False
        self._incoming: asyncio.Queue[Received | TransportError] = asyncio.Queue()
        self._outgoing: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._threads: tuple[threading.Thread, ...] = ()

    def start(self, reading: Callable[[], None], writing: Callable[[], None]) -> None:
        """Run both functions in separate threads."""
        self._loop = asyncio.get_running_loop()
        self._threads = tuple(
            threading.Thread(target=target, daemon=True) for target in (reading, writing)
        )
        for thread in self._threads:
            thread.start()

    @property
    def started(self) -> bool:
        """Whether the threads were started."""
        return bool(self._threads)

    async def read(self) -> Received:
        """Wait for the next bytes; raise ``LOST`` if the link has ended."""
        item = await self._incoming.get()
        if isinstance(item, TransportError):
            self._incoming.put_nowait(item)
            raise item
        return item

    def write(self, data: bytes) -> None:
        """Queue bytes for the writing thread."""
        self._outgoing.put(data)

    def end_writing(self) -> None:
        """End the writing thread after it has sent the queued bytes."""
        self._outgoing.put(None)

    def outgoing(self) -> Iterator[bytes]:
        """Yield the bytes to send, until `end_writing`; for the writing thread."""
        while (data := self._outgoing.get()) is not None:
            yield data

    def deliver(self, data: bytes, arrival: float) -> None:
        """Pass on data with their LSL time of arrival; for the reading thread."""
        self._hand_on(Received(data, arrival))

    def lost(self, cause: Exception | None = None) -> None:
        """Report the end of the link, unless it is on purpose; for both threads."""
        if not self.closing:
            message = f"{self._name}: the link was cut; {self._advice}"
            error = TransportError(TransportReason.LOST, message)
            error.__cause__ = cause
            self._hand_on(error)

    def join_writer(self, seconds: float) -> None:
        """Wait for the writing thread, within a time limit."""
        self._threads[1].join(seconds)

    def join_reader(self, seconds: float | None = None) -> bool:
        """Wait for the reading thread, within a time limit; return whether it has ended."""
        self._threads[0].join(seconds)
        return not self._threads[0].is_alive()

    def _hand_on(self, item: Received | TransportError) -> None:
        assert self._loop is not None
        try:
            self._loop.call_soon_threadsafe(self._incoming.put_nowait, item)
        except RuntimeError:
            # The loop has ended; nobody is left to read.
            self.closing = True


def in_background(operation: Coroutine[Any, Any, _T]) -> asyncio.Task[_T]:
    """Start a task that may be abandoned; then its error is ignored."""
    task = asyncio.create_task(operation)
    _running.add(task)
    task.add_done_callback(_ended)
    return task


async def within(
    seconds: float,
    operation: Coroutine[Any, Any, _T] | asyncio.Task[_T],
    unless: asyncio.Future[Any] | None = None,
) -> _T:
    """Await an operation for a limited time, then cancel it, even if it ignores that.

    Use it for operations that clean up when they are cancelled, otherwise `outlasting`.

    Parameters
    ----------
    operation
        Cancelled and abandoned when the time is over or the caller is cancelled.
    unless
        Also ends the wait when it is done.

    Raises
    ------
    TimeoutError
        The operation did not end in time, or `unless` was done first.
    ConnectionAbortedError
        The operation cancelled itself, as those of WinRT do when a device vanishes.
    """
    task = operation if isinstance(operation, asyncio.Task) else in_background(operation)
    try:
        return await outlasting(seconds, task, unless)
    finally:
        task.cancel()


async def outlasting(
    seconds: float, task: asyncio.Task[_T], unless: asyncio.Future[Any] | None = None
) -> _T:
    """Await an operation for a limited time, but let it continue, as the system does anyway.

    A request is not undone by ignoring its answer. So the task handles the result, however late.
    Parameters and errors are those of `within`.
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

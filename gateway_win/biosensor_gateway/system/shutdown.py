"""Ends the agent on request: by a signal, a closing console, or the end of the session."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import sys
from collections.abc import Callable, Coroutine, Generator
from types import FrameType
from typing import Any, NoReturn

from biosensor_common.process_limits import END_S, end_within


def end_quietly_until_running() -> None:
    """Let a request that comes before `until_signalled` end the process, with exit code 0.

    Nothing has to be closed by then. Must be called from the main thread, and before slow imports.
    """

    def end(_number: int, _frame: FrameType | None) -> NoReturn:
        raise SystemExit(0)

    for number in _requests():
        signal.signal(number, end)


@contextlib.contextmanager
def requests_interrupt() -> Generator[None]:
    """Treat the end of the terminal or of the session like Ctrl-C while the context lasts.

    What a command has half done, such as files of a person, is cleaned up as after Ctrl-C. Must be
    called from the main thread.
    """

    def raise_interrupt(_number: int, _frame: FrameType | None) -> NoReturn:
        raise KeyboardInterrupt

    numbers = [signal.SIGTERM, signal.SIGBREAK if sys.platform == "win32" else signal.SIGHUP]
    before = {each: signal.getsignal(each) for each in numbers}
    for number, handler in before.items():
        # A signal that is ignored, as under nohup, stays ignored.
        if handler != signal.SIG_IGN:
            signal.signal(number, raise_interrupt)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


async def until_signalled(
    main_task: Callable[[], Coroutine[Any, Any, None]],
    *,
    ends_within_s: float = END_S,
    code: int = 1,
) -> None:
    """Run a coroutine to its end; at a request to stop, cancel it once and wait for its end.

    Requests are SIGINT (Ctrl-C), SIGTERM and, on POSIX, SIGHUP (the terminal is
    closed) unless it was ignored before, as under ``nohup``; on Windows Ctrl-Break,
    the console's close, logoff and shutdown. Further requests are ignored until exit.
    Must run in the main thread.

    Parameters
    ----------
    ends_within_s
        Time after the first request at which the process is ended, even if it is blocked.
    code
        Its exit code then.

    Raises
    ------
    Exception
        An exception of the coroutine, but not its cancellation.
    """
    task = asyncio.create_task(main_task())
    loop = asyncio.get_running_loop()

    asked: list[bool] = []

    def stop() -> None:
        if not task.cancelling():
            task.cancel()

    def stop_from_any_thread() -> None:
        if not asked:
            asked.append(True)
            # Not in the loop, which may be what is blocked.
            end_within(ends_within_s, code)
        # After the loop has closed, the process is ending anyway.
        with contextlib.suppress(RuntimeError):
            loop.call_soon_threadsafe(stop)

    with _signals_call(stop_from_any_thread, deaf_afterwards=task.cancelling):
        if sys.platform == "win32":
            from biosensor_gateway.system import windows_session

            windows_session.watch(stop_from_any_thread)
        with contextlib.suppress(asyncio.CancelledError):
            await task


@contextlib.contextmanager
def _signals_call(
    stop_from_any_thread: Callable[[], None], *, deaf_afterwards: Callable[[], object]
) -> Generator[None]:
    """Let signals call a function; afterwards restore their handlers, or ignore them."""
    before = {number: signal.getsignal(number) for number in _requests()}
    if sys.platform == "win32":
        # Without the warning that the loop's wakeup socket is full, which is harmless.
        signal.set_wakeup_fd(signal.set_wakeup_fd(-1), warn_on_full_buffer=False)
    for number in before:
        # Not the loop's own signal handlers: they receive a signal through a socket, which other
        # threads can fill while the loop is busy, and the signal would be lost. This handler runs
        # between bytecodes of the main thread, so it has to wake the loop.
        signal.signal(number, lambda _number, _frame: stop_from_any_thread())
    try:
        yield
    finally:
        for number, handler in before.items():
            # After a request, further ones stay ignored while the interpreter shuts down.
            signal.signal(number, signal.SIG_IGN if deaf_afterwards() else handler)


def _requests() -> list[signal.Signals]:
    """Return the signals that ask a process of this system to end."""
    if sys.platform == "win32":
        return [signal.SIGINT, signal.SIGTERM, signal.SIGBREAK]
    hung_up = [] if signal.getsignal(signal.SIGHUP) == signal.SIG_IGN else [signal.SIGHUP]
    return [signal.SIGINT, signal.SIGTERM, *hung_up]

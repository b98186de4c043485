"""Ends the agent when it is asked to: by a signal, a closing console, the end of the session."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import sys
from collections.abc import Callable, Coroutine, Generator
from types import FrameType
from typing import Any, NoReturn

from biosensor_common.ending import END_S, end_within


def end_quietly_until_running() -> None:
    """Let a request that comes before `until_signalled` end the process, with exit code 0.

    Nothing has been opened then that would have to be closed. Must be called from
    the main thread, and before whatever takes long to import.
    """

    def end(_number: int, _frame: FrameType | None) -> NoReturn:
        raise SystemExit(0)

    for number in _requests():
        signal.signal(number, end)


async def until_signalled(
    main_task: Callable[[], Coroutine[Any, Any, None]], *, ends_within_s: float = END_S
) -> None:
    """Run a coroutine until it ends, or cancel it once and wait for its end when asked to stop.

    Requests are SIGINT (Ctrl-C), SIGTERM and, on POSIX, SIGHUP (the terminal is
    closed) unless it was ignored before, as under ``nohup``; on Windows Ctrl-Break,
    the console's close, logoff and shutdown. Later ones are ignored until exit. Must run
    in the main thread.

    Parameters
    ----------
    main_task
        Returns the coroutine.
    ends_within_s
        From the first request; the process is ended then, whatever it waits for.

    Raises
    ------
    Exception
        Whatever the coroutine raises; its cancellation is not passed on.
    """
    task = asyncio.create_task(main_task())
    loop = asyncio.get_running_loop()

    def stop() -> None:
        if not task.cancelling():
            end_within(ends_within_s)
            task.cancel()

    def stop_from_any_thread() -> None:
        # A request that comes after the loop has closed asks for what happens anyway.
        with contextlib.suppress(RuntimeError):
            loop.call_soon_threadsafe(stop)

    with _signals_call(stop_from_any_thread, deaf_afterwards=task.cancelling):
        if sys.platform == "win32":
            from biosensor_gateway.system import windows_shutdown

            windows_shutdown.watch(stop_from_any_thread)
        with contextlib.suppress(asyncio.CancelledError):
            await task


@contextlib.contextmanager
def _signals_call(
    stop_from_any_thread: Callable[[], None], *, deaf_afterwards: Callable[[], object]
) -> Generator[None]:
    """Have signals call it; afterwards they do what they did before, or nothing."""
    before = {number: signal.getsignal(number) for number in _requests()}
    if sys.platform == "win32":
        # The loop asks to be told when it need not be woken any more, which is no trouble.
        signal.set_wakeup_fd(signal.set_wakeup_fd(-1), warn_on_full_buffer=False)
    for number in before:
        # Runs between bytecodes of the main thread, so the loop has to be woken. The loop's own
        # handlers get a signal through a socket, which threads fill that have much to tell a loop
        # that is behind: the signal would be lost.
        signal.signal(number, lambda _number, _frame: stop_from_any_thread())
    try:
        yield
    finally:
        for number, handler in before.items():
            # What is ignored stays ignored while the interpreter shuts down.
            signal.signal(number, signal.SIG_IGN if deaf_afterwards() else handler)


def _requests() -> list[signal.Signals]:
    """Return the signals that ask a process of this system to end."""
    if sys.platform == "win32":
        return [signal.SIGINT, signal.SIGTERM, signal.SIGBREAK]
    hung_up = [] if signal.getsignal(signal.SIGHUP) == signal.SIG_IGN else [signal.SIGHUP]
    return [signal.SIGINT, signal.SIGTERM, *hung_up]

"""A program that the agent's way of ending can be tried on, on every system.

``python shutdown_program.py RECORD [CLOSING_S [WORD]]`` appends a line to the file RECORD for
whatever it does: ``running``, ``closing`` when it has been asked to end, ``closed`` after
CLOSING_S seconds (0 by default), ``returned`` after the loop has closed, and ``exiting`` when the
interpreter shuts down. It needs the standard library and structlog alone. WORD may be

``early``
    It says ``starting`` and takes a minute to start.
``late``
    It waits after ``returned`` until RECORD says ``go on``, and says ``gone on``.
``behind``
    Threads have told its loop more than the loop's socket holds; it says ``behind``, and the loop
    is held up for another second.
``hang``
    A thread of it waits for ever, and is waited for once it is asked to end.
``block``
    Its loop is held up for ever.
``window``
    On Windows it is not ``running`` before there is the window that hears of the session's end.
"""

from __future__ import annotations

import asyncio
import atexit
import sys
import threading
import time
from pathlib import Path

from biosensor_common.process_limits import END_S
from biosensor_gateway.system.shutdown import end_quietly_until_running, until_signalled

RECORD = Path(sys.argv[1])
CLOSING_S = float(sys.argv[2]) if len(sys.argv) > 2 else 0.0
WORD = sys.argv[3] if len(sys.argv) > 3 else ""
STARTING_S = 60.0
ENDS_WITHIN_S = 0.2
TOLD, BEHIND_S = 100_000, 1.0


def record(line: str) -> None:
    with RECORD.open("a", encoding="utf-8") as file:
        file.write(f"{line}\n")


def wait_for_window() -> None:
    """Wait until the window exists that is told of the session's end."""
    if sys.platform == "win32":
        import ctypes  # noqa: PLC0415 - Windows only

        from biosensor_gateway.system.windows_session import WINDOW_CLASS  # noqa: PLC0415 - the same

        while not ctypes.windll.user32.FindWindowW(WINDOW_CLASS, None):
            time.sleep(0.01)


def fall_behind() -> None:
    loop = asyncio.get_running_loop()
    for _ in range(TOLD):
        loop.call_soon_threadsafe(int)
    record("behind")
    time.sleep(BEHIND_S)


async def work() -> None:
    if WORD == "window":
        await asyncio.to_thread(wait_for_window)
    record("running")
    if WORD == "behind":
        fall_behind()
    if WORD == "block":
        threading.Event().wait()
    try:
        await asyncio.Event().wait()
    finally:
        record("closing")
        if WORD == "hang":
            await asyncio.to_thread(threading.Event().wait)
        await asyncio.sleep(CLOSING_S)
        record("closed")


def _limit_s() -> float:
    return ENDS_WITHIN_S if WORD in {"hang", "block"} else END_S


def main() -> None:
    end_quietly_until_running()
    if WORD == "early":
        record("starting")
        time.sleep(STARTING_S)
    atexit.register(record, "exiting")
    asyncio.run(until_signalled(work, ends_within_s=_limit_s()))
    record("returned")
    if WORD == "late":
        while "go on" not in RECORD.read_text(encoding="utf-8"):
            time.sleep(0.01)
        record("gone on")


if __name__ == "__main__":
    main()

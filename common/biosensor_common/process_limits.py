"""Limits of this process: open files, the LSL streams that they allow, malloc arenas, time to end.

Linux as it is installed lets a program open 1024 files, and macOS 256, unless the program itself
asks for more. docs/measurements.md has the descriptors of an outlet and of an inlet.
"""

from __future__ import annotations

import _thread
import ctypes
import errno
import os
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from biosensor_common.errors import TransportError, TransportReason

if sys.platform != "win32":  # resource exists only there
    import resource
OUTLET = 20
"""File descriptors per outlet: up to 17, and one for each of a few receivers."""
INLET = 12
"""File descriptors per inlet: up to 11.4, including its clock inlet."""
RESERVE = 64
"""File descriptors for other uses: log, state, ports of devices, clients, child processes."""
MOST = 65536
"""More than any lab needs. Containers allow a billion, and a program that closes every possible
descriptor before it starts a child process would then be busy for minutes."""
# macOS refuses more than OPEN_MAX even where it names no hard limit.
_OPEN_MAX = 10240
_FIX = {
    "linux": "sudo prlimit --pid $$ --nofile=65536:65536",
    "darwin": "sudo launchctl limit maxfiles 65536 200000",
}


def raise_limit() -> None:
    """Let this process and its children open as many files as the system allows."""
    if sys.platform == "win32":
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    for wanted in wanted_limits(soft, hard):
        try:
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
        except (OSError, ValueError):
            continue
        return


def wanted_limits(soft: int, hard: int) -> list[int]:
    """Return the limits to try, the best first; none if the present one cannot be raised.

    Parameters
    ----------
    soft, hard
        The present limits; a negative number means no limit.
    """
    most = MOST if hard < 0 else min(hard, MOST)
    if soft < 0:
        return []
    return [each for each in (most, _OPEN_MAX) if soft < each <= most]


def limit() -> int | None:
    """Return how many files this process may open; None if there is no limit."""
    if sys.platform == "win32":
        return None
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return None if soft < 0 else soft


def opened() -> int:
    """Return how many files this process has open; its limit if it can open no more."""
    try:
        # Listing the folder opens one file itself.
        return sum(1 for _ in Path("/dev/fd").iterdir()) - 1
    except OSError as error:
        # Without such a list on this system, liblsl fails by itself when no file is left.
        return (limit() or 0) if error.errno in {errno.EMFILE, errno.ENFILE} else 0


def room(each: int) -> int | None:
    """Return how many more streams with *each* descriptors fit; None if there is no limit."""
    most = limit()
    return None if most is None else fitting(most - opened(), each)


def fitting(free: int, each: int) -> int:
    """Return how many streams fit into the free descriptors minus the reserve."""
    return max(0, (free - RESERVE) // each)


def has_room(descriptors: int) -> bool:
    """Whether this process can open these files and still has some left for itself."""
    most = limit()
    # Programs use the reserve themselves, so half of it has to stay free.
    return most is None or most - opened() >= descriptors + RESERVE // 2


def require(each: int, what: str) -> None:
    """Raise an error if there is no room for one more stream.

    Raises
    ------
    TransportError
        ``EXHAUSTED``, with the command that makes room.
    """
    if not has_room(each):
        raise exhausted(f"{what} is left out")


def exhausted(what: str) -> TransportError:
    """Return the error for a stream that does not fit."""
    return TransportError(TransportReason.EXHAUSTED, f"{what}: {no_room()}")


def no_room() -> str:
    """Return why no further stream can be opened, and how to raise the limit."""
    return f"{reason()}; {fix()}"


def reason() -> str:
    """Return what limits the streams of this process."""
    return f"this computer lets a program open {limit()} files, and each LSL stream takes some"


def fix() -> str:
    """Return the command that raises the limit."""
    return f"run in this terminal: {_FIX.get(sys.platform, _FIX['linux'])}, then start it again"


ARENAS = 1
"""A single arena keeps memory bounded and costs no time (docs/measurements.md)."""
# From glibc's malloc.h.
_M_ARENA_MAX = -8
_VARIABLE, _TUNABLES, _TUNABLE = "MALLOC_ARENA_MAX", "GLIBC_TUNABLES", "glibc.malloc.arena_max"


def limit_arenas(environment: Mapping[str, str]) -> bool:
    """Limit glibc's malloc arenas, which default to up to eight per processor.

    Memory that an ended thread leaves in its arena can be reused only by threads of that arena.
    Call it before any thread is started, because existing arenas stay.

    Parameters
    ----------
    environment
        Variables of the process; if the user has set the number there, nothing is changed.

    Returns
    -------
    bool
        Whether it was set; False with another C library, as on Windows and macOS.
    """
    has_own = environment.get(_VARIABLE) or _TUNABLE in environment.get(_TUNABLES, "")
    if has_own or sys.platform != "linux":
        return False
    # musl has no mallopt.
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    return mallopt is not None and bool(mallopt(_M_ARENA_MAX, ARENAS))


END_S = 5.0
"""How long a program may take to exit by itself."""
INTERRUPTED, INTERRUPTED_S = 130, 3.0
"""The exit code after Ctrl-C, and how long the exit may take then."""
_STDERR, _SAYING_S = 2, 0.1


def end_within(limit_s: float = END_S, code: int = 1) -> None:
    """End this process with an exit code after a time limit, unless it has exited by then.

    At its exit the interpreter waits for every thread, also for one that hangs in a library.
    """
    # Not of `threading`, whose locks the code may hold that a signal's handler interrupts.
    _thread.start_new_thread(_end, (limit_s, code))


def _end(limit_s: float, code: int) -> None:
    time.sleep(limit_s)
    sentence = f"it has not ended within {limit_s:g} s, so it is being ended now\n"
    # Not waited for: a terminal that is held with Ctrl-S, or a full pipe, may be what it hangs on.
    _thread.start_new_thread(_say, (sentence,))
    time.sleep(_SAYING_S)
    os._exit(code)


def _say(sentence: str) -> None:
    # The reader of stderr may be gone.
    with suppress(OSError):
        os.write(_STDERR, sentence.encode())

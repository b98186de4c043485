"""Limits of this process: its open files, the LSL streams that fit, and the heaps of threads.

Linux as it is installed lets a program open 1024 files, and macOS 256, unless the program itself
asks for more. docs/measurements.md has the descriptors of an outlet and of an inlet.
"""

from __future__ import annotations

import ctypes
import errno
import sys
from collections.abc import Mapping
from pathlib import Path

from biosensor_common.errors import TransportError, TransportReason

if sys.platform != "win32":  # resource exists only there
    import resource

OUTLET = 20
"""Descriptors of an outlet: up to 17, and one for each of some receivers."""
INLET = 12
"""Descriptors of an inlet: up to 11.4, its clock included."""
RESERVE = 64
"""Descriptors that are no stream's: log, state, ports of devices, clients, children."""
MOST = 65536
"""More than any lab needs. Containers allow a billion, and programs that close every descriptor
before they start another program would then do nothing else for minutes."""

# macOS refuses more than OPEN_MAX even where it names no hard limit.
_OPEN_MAX = 10240
_FIX = {
    "linux": "sudo prlimit --pid $$ --nofile=65536:65536",
    "darwin": "sudo launchctl limit maxfiles 65536 200000",
}


def raise_limit() -> None:
    """Let this process, and those that it starts, open as many files as the system allows."""
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
    """Return the limits to try, the best first; none if the present one cannot be bettered.

    Parameters
    ----------
    soft, hard
        The limits in force; a negative one stands for none.
    """
    most = MOST if hard < 0 else min(hard, MOST)
    if soft < 0:
        return []
    return [each for each in (most, _OPEN_MAX) if soft < each <= most]


def limit() -> int | None:
    """Return how many files this process may have open; None where nothing is said."""
    if sys.platform == "win32":
        return None
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return None if soft < 0 else soft


def opened() -> int:
    """Return how many files this process has open; as many as it may where none is left."""
    try:
        # The list itself takes one.
        return sum(1 for _ in Path("/dev/fd").iterdir()) - 1
    except OSError as error:
        # Where the system has no such list, liblsl says itself when there is no room.
        return (limit() or 0) if error.errno in {errno.EMFILE, errno.ENFILE} else 0


def room(each: int) -> int | None:
    """Return how many more streams of so many descriptors fit; None where there is no limit."""
    most = limit()
    return None if most is None else fitting(most - opened(), each)


def fitting(free: int, each: int) -> int:
    """Return how many streams fit into free descriptors, without the reserve."""
    return max(0, (free - RESERVE) // each)


def has_room(descriptors: int) -> bool:
    """Whether this process may open so many more files, and some for itself."""
    most = limit()
    # The reserve is what programs use; half of it has to be left for that.
    return most is None or most - opened() >= descriptors + RESERVE // 2


def require(each: int, what: str) -> None:
    """Make sure that there is room for one more stream.

    Raises
    ------
    TransportError
        ``EXHAUSTED``, with the command that makes room.
    """
    if not has_room(each):
        raise exhausted(f"{what} is left out")


def exhausted(what: str) -> TransportError:
    """Return the error of a stream that does not fit."""
    return TransportError(TransportReason.EXHAUSTED, f"{what}: {no_room()}")


def no_room() -> str:
    """Say why a stream does not fit, and what makes room."""
    return f"{reason()}; {fix()}"


def reason() -> str:
    """Say what limits the streams of this process."""
    return f"this computer lets a program open {limit()} files, and each LSL stream takes some"


def fix() -> str:
    """Say which command lets a program open more."""
    return f"run in this terminal: {_FIX.get(sys.platform, _FIX['linux'])}, then start it again"


ARENAS = 1
"""One leaves nothing behind, and costs no time (docs/measurements.md)."""

# From glibc's malloc.h.
_M_ARENA_MAX = -8
_VARIABLE, _TUNABLES, _TUNABLE = "MALLOC_ARENA_MAX", "GLIBC_TUNABLES", "glibc.malloc.arena_max"


def limit_arenas(environment: Mapping[str, str], arenas: int = ARENAS) -> bool:
    """Let all threads share a few of glibc's arenas, by default up to eight a processor.

    What a thread that has ended leaves in its arena is of use only to those that share it.
    Call it before there are threads: what exists stays.

    Parameters
    ----------
    environment
        Where the user may have said how many; then nothing is changed.
    arenas
        How many at most, from 1.

    Returns
    -------
    bool
        Whether it was set: not where the C library is another one, as on Windows and macOS.
    """
    has_own = environment.get(_VARIABLE) or _TUNABLE in environment.get(_TUNABLES, "")
    if has_own or sys.platform != "linux":
        return False
    # musl has none.
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    return mallopt is not None and bool(mallopt(_M_ARENA_MAX, arenas))

"""A number that no other process of tests on this machine has, and the ports that go with it."""

from __future__ import annotations

import random
import tempfile
from pathlib import Path

from filelock import FileLock, Timeout

# Domain d uses the ports 7400 + 250 d and above, here up to 16,399: below LSL's and below
# those that the system hands out.
_SLOTS = range(1, 36)
_FOLDER = Path(tempfile.gettempdir()) / "biosensor-gateway-tests-slots"
_FIRST_PORT, _PORTS = 17_000, 300
# The number is this process's as long as the lock lives.
_locks: list[FileLock] = []


def take_slot() -> int:
    """Return a number from 1 to 35, for as long as this process lives.

    Chosen at random, two of a few processes had the same ROS domain once in thirty runs,
    and heard each other. If all are taken, the number is another's, too.
    """
    _FOLDER.mkdir(exist_ok=True)
    for slot in random.sample(_SLOTS, len(_SLOTS)):
        lock = FileLock(_FOLDER / str(slot))
        try:
            lock.acquire(blocking=False)
        except (Timeout, PermissionError):
            continue
        _locks.append(lock)
        return slot
    return random.choice(_SLOTS)


def lsl_ports(slot: int) -> tuple[int, int]:
    """Return LSL's discovery port of a slot, and the first one of its streams."""
    first = _FIRST_PORT + slot * _PORTS
    return first, first + 1

"""Carries packets between two TUN devices, each late by the same time.

    python -m tests.rigs.hosts.relay DEVICE_A DEVICE_B SECONDS_A_TO_B SECONDS_B_TO_A

It says ``ready`` once both devices carry packets, and runs until SIGINT. The kernel need
not be able to delay packets itself (netem).
"""

from __future__ import annotations

import fcntl
import os
import selectors
import signal
import struct
import sys
import time
from collections import deque
from contextlib import suppress
from typing import NamedTuple

from tests.rigs.processes import before_others

_TUNSETIFF, _IFF_TUN, _IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
_LARGEST_PACKET = 65_536
# So many packets are fetched of one device before the other's turn.
_BATCH = 64


class Way(NamedTuple):
    """One direction: read from, write to, seconds between, and what is on the way."""

    source: int
    sink: int
    delay_s: float
    waiting: deque[tuple[float, bytes]]

    def fetch(self) -> None:
        """Read what has come; it is due after the delay."""
        with suppress(BlockingIOError):
            for _ in range(_BATCH):
                packet = os.read(self.source, _LARGEST_PACKET)
                self.waiting.append((time.monotonic() + self.delay_s, packet))

    def deliver(self) -> None:
        """Write what is due."""
        now = time.monotonic()
        while self.waiting and self.waiting[0][0] <= now:
            os.write(self.sink, self.waiting.popleft()[1])


def opened(name: str) -> int:
    """Return the file of a TUN device, whose packets it reads and writes without a header."""
    file = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    request = struct.pack("16sH22x", name.encode(), _IFF_TUN | _IFF_NO_PI)
    fcntl.ioctl(file, _TUNSETIFF, request)
    return file


def relay(ways: tuple[Way, Way]) -> None:
    """Carry packets for ever."""
    with selectors.DefaultSelector() as selector:
        for way in ways:
            selector.register(way.source, selectors.EVENT_READ, way)
        while True:
            due = [way.waiting[0][0] for way in ways if way.waiting]
            patience_s = max(0.0, min(due) - time.monotonic()) if due else None
            for key, _ in selector.select(patience_s):
                key.data.fetch()
            for way in ways:
                way.deliver()


def main() -> None:
    before_others()
    a, b = (opened(name) for name in sys.argv[1:3])
    there_s, back_s = map(float, sys.argv[3:5])
    print("ready", flush=True)
    with suppress(KeyboardInterrupt):
        relay((Way(a, b, there_s, deque()), Way(b, a, back_s, deque())))


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)
    main()

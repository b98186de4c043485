"""Hosts at the serial port of a virtual device, which goes away with a fault and comes back."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Generic, Protocol, TypeVar

from tests.rigs.memory_links import MemoryPort
from tests.rigs.virtual_time import pause

_DEADLINE_S = 30.0
_POLL_S = 0.05


def is_there(port: str) -> bool:
    """Tell whether there is such a port, which may be one in memory."""
    return Path(port).exists() or port in MemoryPort.tcp_ports


class SerialHost(Protocol):
    """The other end of a port."""

    def close(self) -> None:
        """Let the port go."""
        ...


_HostT = TypeVar("_HostT", bound=SerialHost)


class SerialHosts(Generic[_HostT]):
    """Hosts of one test, ended with it.

    Parameters
    ----------
    make
        Opens a port by its name; raises OSError where there is none.
    """

    def __init__(self, make: Callable[[str], _HostT]) -> None:
        self._make = make
        self._hosts: list[_HostT] = []

    def connect(self, port: str) -> _HostT:
        """Open a port, once it is there."""
        deadline = time.monotonic() + _DEADLINE_S
        while True:
            try:
                self._hosts.append(self._make(port))
            except OSError:
                assert time.monotonic() < deadline, "the port did not come back"
                pause(_POLL_S)
            else:
                return self._hosts[-1]

    def close(self) -> None:
        """End all of them."""
        for host in self._hosts:
            host.close()
